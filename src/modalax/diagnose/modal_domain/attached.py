"""Oscillators that may be attached to the structure, fitted where a measured mode is one too many."""

from collections.abc import Callable

import numpy as np

from modalax.diagnose.modal_domain.attempts import attempt, explains, key_of, without
from modalax.diagnose.modal_domain.causes import Change, own_sizes
from modalax.diagnose.modal_domain.explanation import ranked_by
from modalax.diagnose.modal_domain.fit import Fit, without_causes
from modalax.diagnose.modal_domain.further_causes import TunedMass
from modalax.diagnose.modal_domain.oscillators import alike, oscillators
from modalax.diagnose.modal_domain.prior import Prior
from modalax.diagnose.modal_domain.starts import in_place_of_one
from modalax.diagnose.modal_domain.state import Setting


def attached(
    setting: Setting, found: dict[tuple[Change, ...], Fit], candidates: list[Change], prior: Prior,
    late: Callable[[], bool],
) -> None:  # fmt: skip
    """Where a measured mode is one too many, try what may have moved one so far, and oscillators as what makes it."""
    ranked = ranked_by(found, prior)
    if not explains(ranked[0].fit):  # which mode is too many shows beside other errors that are too large as well
        ranked = [e for e in ranked if any(c.freed is not None for c in e.causes)]
    freed = [c for c in ranked[0].causes if c.freed is not None] if ranked else []
    if not freed:
        return
    best = ranked[0].fit
    for cause, u, start in in_place_of_one(setting, best, candidates, prior.each(candidates)):
        if late():
            return
        attempt(setting, found, (cause,), cause.of_size(u), start, gentle=False)
    for cause, u in oscillators(setting, candidates, freed[0]):
        if late():
            return
        attempt(setting, found, (cause,), u, None)
    acting_alike(setting, found, candidates, prior, late)


def acting_alike(
    setting: Setting, found: dict[tuple[Change, ...], Fit], candidates: list[Change], prior: Prior,
    late: Callable[[], bool],
) -> None:  # fmt: skip
    """Fit an oscillator that leads at places that act like its own, until none of them is likelier."""
    while True:
        best = ranked_by(found, prior)[0].fit
        k = next((k for k, c in enumerate(best.causes) if isinstance(c, TunedMass)), None)
        if k is None:
            return
        kept, own = tuple(c for j, c in enumerate(best.causes) if j != k), best.u[own_sizes(best.causes, k)]
        for cause in alike(setting, candidates, best.causes[k], own):
            if late():
                return
            if key_of((*kept, cause)) not in found:
                u = np.append(without(best, k), own)
                attempt(setting, found, (*kept, cause), u, without_causes(best), gentle=False)
        if ranked_by(found, prior)[0].fit is best:
            return
