"""Fits of explanations that a search has tried, by their causes: the likeliest fit of each is kept."""

from collections.abc import Sequence

import numpy as np

from modalax.diagnose.modal_domain.causes.change import Change, own_sizes, with_sizes
from modalax.diagnose.modal_domain.fitting.fit import BASIN, Fit, Found, fit
from modalax.diagnose.modal_domain.fitting.state import Setting
from modalax.diagnose.modal_domain.fitting.throughout import all_scaled
from modalax.diagnose.thresholds import THRESHOLDS


def attempt(
    setting: Setting, found: Found, causes: tuple[Change, ...], u: np.ndarray,
    start: Fit | None, gentle: bool = True, basin: float = BASIN,
) -> None:  # fmt: skip
    """Fit causes from sizes ``u`` and the inaccuracy of a start, gently from far off, and keep what is likelier."""
    if all_scaled(setting) and any(c.scales_all for c in causes):
        return
    temperatures = {} if gentle else {"temperatures": (3.0,)}
    best = max((f.log_evidence for f in found.values()), default=-np.inf)
    trial = fit(setting, causes, start, u, **temperatures, best_else=best, basin=basin)
    key = key_of(causes)
    if trial is not None and possible(trial) and (key not in found or trial.log_evidence > found[key].log_evidence):
        found[key] = trial


def possible(f: Fit) -> bool:
    """Whether every cause may have the sizes that it has."""
    return all(c.possible(u) for c, u in with_sizes(f.causes, f.u))


def explains(f: Fit) -> bool:
    """Whether a fit explains the modes."""
    return f.chi2 < THRESHOLDS.misfit * f.state.difference.size


def key_of(causes: Sequence[Change]) -> tuple[Change, ...]:
    """Causes in an order of their own, by which their fit is kept."""
    return tuple(sorted(causes, key=lambda c: (c.slug, c.where, c.pattern is not None, c.along)))


def without(f: Fit, which: int) -> np.ndarray:
    """Sizes of all causes but one."""
    return np.delete(f.u, np.arange(len(f.u))[own_sizes(f.causes, which)])
