"""What may explain measured modes, and how likely each explanation is.

Before the data, half of the probability is that nothing stands out; the rest is shared by kind, then by place.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from modalax.diagnose.decision.beliefs import believed
from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.fitting.fit import Fit

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


@dataclass(frozen=True)
class Explanation:
    """A set of causes, fitted.

    Attributes
    ----------
    log_posterior
        Log evidence and log prior.
    probability
        Among all explanations that were fitted.
    misfit
        Chi-square per feature of the modes that was left, before all lines were looked at.
    """

    fit: Fit
    log_posterior: float
    probability: float
    misfit: float = 1.0

    @property
    def causes(self) -> tuple[Change, ...]:
        """What stands out."""
        return self.fit.causes


def ranked_by(found: Mapping[tuple[Change, ...], Fit], prior: Prior) -> list[Explanation]:
    """Explanations by falling probability, of fits by their causes."""
    left = {key: f.chi2 / max(f.state.difference.size, 1) for key, f in found.items()}
    return weighed([Explanation(f, f.log_evidence + prior.of(key), 0.0, left[key]) for key, f in found.items()])


def weighed(explanations: Sequence[Explanation]) -> list[Explanation]:
    """Explanations by falling probability, which follows from what each is worth."""
    top = max(e.log_posterior for e in explanations)
    total = sum(math.exp(e.log_posterior - top) for e in explanations)
    ranked = [replace(e, probability=math.exp(e.log_posterior - top) / total) for e in explanations]
    return sorted(ranked, key=lambda e: -e.log_posterior)
