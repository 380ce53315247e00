"""Sizes in the channels of a mode that the simulation lacks, settled with its frequency."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from modalax.diagnose.causes.base import PatternCause
from modalax.diagnose.comparison import Comparison
from modalax.diagnose.fitting.hypothesis import Hypothesis, with_item
from modalax.diagnose.screening.patterns import screen_pattern
from modalax.diagnose.screening.score_state import score_state_of

FIRST_ROUNDS = 4


def settle_pattern(comparison: Comparison, h: Hypothesis) -> Hypothesis:
    """Estimate the sizes in the channels again at the fitted shape, and fit again."""
    which = [k for k, c in enumerate(h.causes) if isinstance(c, PatternCause)]
    for _ in range(3):
        if not which or not np.isfinite(h.chi2):
            return h
        before = h.chi2
        for k in which:
            cause = h.causes[k]
            assert isinstance(cause, PatternCause)
            off = np.concatenate([np.zeros(cause.terms), h.params[k][cause.terms :]])
            bare = replace(h, params=with_item(h.params, k, off))
            fixed = _Fixed(cause, h.params[k][cause.terms :])
            side = score_state_of(comparison, bare).sides[False]
            t = screen_pattern(fixed, comparison.scene, side, comparison.pooled)
            trial = replace(h, extras=with_item(h.extras, k, t.extra), params=with_item(h.params, k, t.start))
            new = comparison.fit([trial], FIRST_ROUNDS)[0]
            h = new if new.chi2 < h.chi2 else h
        if before - h.chi2 < 0.1:
            break
    return h


@dataclass
class _Fixed(PatternCause):
    """A pattern cause at one shape."""

    cause: PatternCause
    q: np.ndarray

    @property
    def several(self) -> bool:
        return self.cause.several

    @property
    def terms(self) -> int:
        return self.cause.terms

    def shapes(self, scene: Any) -> np.ndarray:
        return self.q[None]

    def curves(self, s: Any, q: Any) -> Any:
        return self.cause.curves(s, q)
