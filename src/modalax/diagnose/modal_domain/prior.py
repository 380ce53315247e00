"""Probability of causes before the data: half that nothing stands out, the rest shared by kind, then by place."""

import math
from collections.abc import Sequence

import numpy as np

from modalax.diagnose.decision.beliefs import believed
from modalax.diagnose.modal_domain.causes import Change

NONE = 0.5  # probability before the data that nothing stands out
SECOND = 1e-4  # the same of each further cause, given the others: what they leave is mostly error of the model


class Prior:
    """Logarithmic prior probability of sets of causes."""

    def __init__(self, candidates: Sequence[Change]):
        self.kinds = {c.slug for c in candidates}
        self.total = {slug: sum(c.weight for c in candidates if c.slug == slug) for slug in self.kinds}

    def one(self, c: Change) -> float:
        """Of a kind and a place."""
        usual = math.log(c.rarity * max(c.weight, 1e-300) / self.total[c.slug] / len(self.kinds))
        return usual + believed(c.slug)

    def each(self, candidates: Sequence[Change]) -> np.ndarray:
        """Of each of some candidates."""
        return np.array([self.one(c) for c in candidates])

    def of(self, causes: Sequence[Change]) -> float:
        """Of a set."""
        if not causes:
            return math.log(NONE)
        order = math.log((1 - NONE) * (1 - SECOND)) if len(causes) == 1 else math.log(1 - NONE)
        return order + (len(causes) - 1) * math.log(SECOND) + sum(self.one(c) for c in causes)
