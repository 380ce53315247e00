r"""Whether damping is hysteretic, which the lines tell in full and the modes only in part.

Modes are identified as viscous ones. What is hysteretic shows in them by the phases of residues; between the
resonances, where a viscous force falls with the frequency and a hysteretic one does not, the lines show the rest. The
likeliest explanation with hysteretic damping and the likeliest without are both taken on to the lines, and the part of
their odds that the modes gave, :math:`-\tfrac12(\chi^2 + x^T\Sigma^{-1}x)` with sizes :math:`x` and what is known of
these beforehand, is replaced by that of the lines. What the sizes' own uncertainty adds stays. All odds stay where even
the better of both leaves more on the lines than the measured modes do together with what it leaves of these: what
nobody explains, as of modes far beyond the band, may prefer either.
"""

from dataclasses import dataclass, replace

import numpy as np

from modalax.diagnose.deadline import Deadline
from modalax.diagnose.modal_domain.causes.change import hysteretic_share
from modalax.diagnose.modal_domain.fitting.discrepancy import beside, told_apart
from modalax.diagnose.modal_domain.fitting.explanation import Explanation, weighed
from modalax.diagnose.modal_domain.fitting.fit import Fit, scale_of
from modalax.diagnose.modal_domain.fitting.state import Setting
from modalax.diagnose.modal_domain.modes.measured import Measured
from modalax.diagnose.modal_domain.on_lines.lines import Lines, lines_of
from modalax.diagnose.modal_domain.on_lines.polish import MATTERS, descended

CLOSE = 60.0  # nats by the modes up to which the lines are asked; measured ones were within 14


def damping_by_lines(
    setting: Setting, explanations: list[Explanation], measured: Measured, late: Deadline
) -> list[Explanation]:
    """Explanations by falling probability, those with hysteretic damping against those without by the lines."""
    of_kind = {is_hysteretic(e.fit): e for e in reversed(explanations)}  # the likeliest of each
    best = explanations[0]
    if len(of_kind) < 2 or not best.causes or late():
        return explanations
    if abs(of_kind[True].log_posterior - of_kind[False].log_posterior) > CLOSE:
        return explanations
    apart = told_apart(setting, best.fit) if setting.rest > MATTERS else setting
    lines = lines_of(measured.channels, apart, measured.misfit)
    found = {kind: _on_lines(apart, setting, e.fit, lines, late) for kind, e in of_kind.items()}
    if late() or None in found.values():
        return explanations
    least = min(found, key=lambda kind: found[kind].chi2)
    if found[least].chi2 > lines.left * lines.samples + of_kind[least].fit.chi2:
        return explanations
    heat = max(1.0, found[least].chi2 / max(lines.samples, 1))
    gained = {
        kind: _worth(found[kind].chi2 / heat, found[kind].known) - _worth(e.fit.chi2, _beforehand(setting, e.fit))
        for kind, e in of_kind.items()
    }
    more = gained[True] - gained[False]
    return weighed([
        replace(e, log_posterior=e.log_posterior + more) if is_hysteretic(e.fit) else e for e in explanations
    ])  # fmt: skip


def is_hysteretic(f: Fit) -> bool:
    """Whether a part of all damping is hysteretic in a fit."""
    return hysteretic_share(f.causes, f.u) > 0


@dataclass(frozen=True)
class _Least:
    """Chi-square on the lines, and of the sizes by what is known beforehand, at the least of both."""

    chi2: float
    known: float


def _on_lines(apart: Setting, setting: Setting, f: Fit, lines: Lines, late: Deadline) -> _Least | None:
    """What a fit comes to on the lines; None where there is no step."""
    start = f if apart is setting else beside(apart, f)
    found = descended(apart, start, lines, late)
    if found is None:
        return None
    n = len(start.sizes)
    return _Least(found.chi2, _beforehand(apart, replace(start, sizes=found.x[:n], u=found.x[n:])))


def _beforehand(setting: Setting, f: Fit) -> float:
    """Chi-square of a fit's sizes by what is known of them before the data."""
    return float(((np.concatenate([f.sizes, f.u]) / scale_of(setting, f)) ** 2).sum())


def _worth(chi2: float, known: float) -> float:
    return -0.5 * (chi2 + known)
