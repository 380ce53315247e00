r"""A fit to the modes taken on to the FRFs themselves: all lines, with the general inaccuracy beside the causes.

The modal fit is in the basin, so that Gauss-Newton steps about it settle at once; about the simulation itself, whose
peaks are elsewhere, they would not. For a change ``P`` of the dynamic stiffness :math:`Z` the response
:math:`H = \Phi_o Z^{-1}\Phi_i^T` changes by :math:`-\Phi_o Z^{-1} P Z^{-1}\Phi_i^T`. As long as a fit leaves more than
noise, the data count for as much less: an inaccuracy of no element must not be forced upon one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg.blas import dsyrk

from modalax.diagnose.deadline import NEVER, Deadline
from modalax.diagnose.modal_domain.causes.change import Change, hysteretic_share, own_sizes, shown, with_sizes
from modalax.diagnose.modal_domain.causes.further_causes import StructuralDamping
from modalax.diagnose.modal_domain.causes.line_forces import LineForce, bases_of, joined, loaded
from modalax.diagnose.modal_domain.fitting.discrepancy import beside, told_apart
from modalax.diagnose.modal_domain.fitting.explanation import Explanation
from modalax.diagnose.modal_domain.fitting.fit import Fit, fit, scale_of
from modalax.diagnose.modal_domain.fitting.linear import ByUnknowns
from modalax.diagnose.modal_domain.fitting.state import (
    Setting,
    changes_of,
    factors_of,
    hysteretic,
    matrices_of,
    state_at,
)
from modalax.diagnose.modal_domain.modes.measured import Measured
from modalax.diagnose.modal_domain.modes.mode_count import left_by
from modalax.diagnose.modal_domain.on_lines.lines import Lines, lines_of
from modalax.diagnose.modal_domain.structure.coordinates import Coordinates
from modalax.diagnose.modal_domain.structure.factored import Factored, factored
from modalax.diagnose.modal_domain.structure.many_lines import BLOCK, receptance
from modalax.diagnose.modal_domain.structure.slopes import POWER
from modalax.diagnose.thresholds import THRESHOLDS

STEPS = 8  # most Gauss-Newton steps
PARTS = (1.0, 0.3, 0.1)  # of a step that are tried
SETTLED = 0.1  # decrease of half chi-square at which it ends
MATTERS = 2e-4  # relative size of the rest from which it shows on lines: peaks move by half of it
BEYOND_MODES = 1.5  # times what the measured modes leave on the lines, from which an answer's fit is taken on to these
AS_MODES = 1.05  # times what the measured modes leave on the lines, up to which few lines have nothing to add
LIKELY, FEW = 0.01, 3  # probability from which, and most explanations that are taken on to the lines


@dataclass(frozen=True)
class OnLines:
    """Sizes that leave the least on the lines, the chi-square that they leave, and their covariance."""

    x: np.ndarray
    chi2: float
    covariance: np.ndarray


def on_lines(setting: Setting, f: Fit, lines: Lines, late: Deadline) -> Fit:
    """A fit taken on to the lines; as it was where that does not improve it, or leaves far more than the modes do.

    Every so many lines tell less than all modes do: where all lines are left worse by them, or are left as the measured
    modes leave them already, the fit stays as well.
    """
    every = lines.whole
    before = np.inf if every is None else chi2_of(setting, f, every)
    if every is not None and before < AS_MODES * every.left * every.samples:
        return f
    found, n = descended(setting, f, lines, late), len(f.sizes)
    if found is None or found.chi2 > THRESHOLDS.lines_missed * lines.left * max(lines.samples, 1):
        return f
    x = found.x
    if every is not None and chi2_of(setting, replace(f, sizes=x[:n], u=x[n:]), every) > before:
        return f
    try:
        state = state_at(setting, x[:n], f.causes, x[n:])
    except np.linalg.LinAlgError:
        return f
    return replace(f, sizes=x[:n], u=x[n:], covariance=_widened(found.covariance, f, x), state=state)


def descended(setting: Setting, f: Fit, lines: Lines, late: Deadline, steps: int = STEPS) -> OnLines | None:
    """Gauss-Newton steps on the lines from a fit; None where there is no first one."""
    x, n = np.concatenate([f.sizes, f.u]), len(f.sizes)
    scale = scale_of(setting, f)
    chi2, V = chi2_of(setting, f, lines), None
    for _ in range(steps):
        heat = max(1.0, chi2 / max(lines.samples, 1))
        gram, slope = _normal(setting, f.causes, x[:n], x[n:], lines)
        try:
            new, V, _ = ByUnknowns(setting.inaccuracy, gram, slope + gram @ x, f.u).covariance(f.epsilon, heat)
        except np.linalg.LinAlgError:
            return None
        cost = 0.5 * chi2 / heat + 0.5 * float(((x / scale) ** 2).sum())
        for part in PARTS:
            y = x + part * (new - x)
            trial = chi2_of(setting, replace(f, sizes=y[:n], u=y[n:]), lines)
            gained = cost - 0.5 * trial / heat - 0.5 * float(((y / scale) ** 2).sum())
            if gained > 0:
                x, chi2 = y, trial
                break
        else:
            break
        if gained < SETTLED or late():
            break
    return None if V is None else OnLines(x, chi2, V * np.outer(scale, scale))


def _widened(covariance: np.ndarray, f: Fit, x: np.ndarray) -> np.ndarray:
    """Covariance of the causes' sizes by the lines, no narrower than by the modes, and as wide as both are apart.

    Lines know of noise and elements only; the modes also allow for the rest that no element explains
    (:mod:`modalax.diagnose.modal_domain.fitting.discrepancy`).
    """
    n = len(f.sizes)
    own, moved = covariance[n:, n:], x[n:] - f.u
    wider = np.sqrt(np.maximum(np.diag(own), np.diag(f.covariance)) / np.maximum(np.diag(own), 1e-300))
    return own * np.outer(wider, wider) + np.outer(moved, moved)


def leading_on_lines(
    setting: Setting, explanations: list[Explanation], measured: Measured, late: Deadline
) -> tuple[Setting, list[Explanation]]:
    """The likely explanations taken on to the lines; their probabilities stay those by the modes.

    A rest that no element explains is fitted there beside all else: the setting that is given back holds it. What an
    explanation leaves of the modes is no more than it leaves on the lines beyond what these leave there: modes that lie
    close together may be told wrongly, and all lines be explained.
    """
    out, apart = list(explanations), setting.rest > MATTERS
    if apart:
        setting = told_apart(setting, out[0].fit)
        out = [replace(e, fit=beside(setting, e.fit)) for e in out]
    lines, own = lines_of(measured.channels, setting, measured.misfit), left_by(measured.modes, measured.channels)
    for k, e in enumerate(out[: 1 if setting.inaccuracy.between_modes else FEW]):
        if k and (e.probability < LIKELY or late()):
            break
        again = fit(setting, e.causes, e.fit, e.fit.u, temperatures=()) if apart else None
        nearer = again is not None and chi2_of(setting, again, lines) < chi2_of(setting, e.fit, lines)
        start = again if nearer and again is not None else e.fit
        taken = on_lines(setting, start, lines, late if k else NEVER)
        every = lines.whole or lines
        beyond = max(chi2_of(setting, taken, every) - own * every.samples, 0.0)
        out[k] = replace(e, fit=taken, misfit=min(e.misfit, beyond / max(taken.state.difference.size, 1)))
    return setting, out


def taken_on(setting: Setting, e: Explanation, measured: Measured) -> Explanation:
    """An explanation taken on to the lines where it leaves more there than the modes do."""
    lines = lines_of(measured.channels, setting, measured.misfit)
    if chi2_of(setting, e.fit, lines) < BEYOND_MODES * measured.misfit * lines.samples:
        return e
    return replace(e, fit=on_lines(setting, e.fit, lines, NEVER))


def without_spare(setting: Setting, e: Explanation, spare: list[Change], measured: Measured) -> Explanation:
    """An explanation without causes that may be none, where the lines are explained as well without them."""
    kept = [k for k, c in enumerate(e.causes) if c not in spare]
    if not spare or not kept:
        return e
    own = np.concatenate([np.arange(len(e.fit.u))[own_sizes(e.causes, k)] for k in kept])
    causes, u = tuple(e.causes[k] for k in kept), e.fit.u[own]
    lines = lines_of(measured.channels, setting, measured.misfit)
    try:
        state = state_at(setting, e.fit.sizes, causes, u)
    except np.linalg.LinAlgError:
        return e
    bare = replace(e.fit, causes=causes, u=u, covariance=e.fit.covariance[np.ix_(own, own)], state=state)
    bare = on_lines(setting, bare, lines, NEVER)
    more = chi2_of(setting, bare, lines) - chi2_of(setting, e.fit, lines)
    beyond = max(chi2_of(setting, e.fit, lines) / max(lines.samples, 1), 1.0)
    few = more < THRESHOLDS.stands_out**2 * beyond * (len(e.fit.u) - len(u))
    return replace(e, fit=bare) if few else e


def unforeseen(setting: Setting, f: Fit, fitted: Lines, left_out: Lines) -> float:
    r"""Part of the chi-square on lines that were left out that errors of a fit to others do not explain.

    With whitened residual e and derivatives J there, and the covariance V of all sizes by the lines ``fitted`` and by
    what is known beforehand, it is :math:`e^T(I + JVJ^T)^{-1}e = e^Te - e^TJ(V^{-1} + J^TJ)^{-1}J^Te`, of as many
    degrees of freedom as e has numbers.
    """
    scale = scale_of(setting, f)
    known, _ = _normal(setting, f.causes, f.sizes, f.u, fitted)
    gram, slope = _normal(setting, f.causes, f.sizes, f.u, left_out)
    inner = np.eye(len(scale)) + scale[:, None] * (known + gram) * scale
    right = scale * slope
    return chi2_of(setting, f, left_out) - float(right @ np.linalg.solve(inner, right))


def _responses(
    setting: Setting, causes: tuple[Change, ...], sizes: np.ndarray, u: np.ndarray, s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Receptances of all coordinates to forces at the outputs and at the inputs, ``(f, n, o)`` and ``(f, n, i)``."""
    c = setting.coordinates
    M, C, K = matrices_of(setting, sizes, causes, u)
    forces = _forces(causes, u)
    every = np.concatenate([c.outputs.T, c.inputs.T, *(cause.basis for cause, _ in forces)], axis=1)
    Z = K + s[:, None, None] * C + s[:, None, None] ** 2 * M
    solved = np.linalg.solve(Z, np.broadcast_to(every, (len(s), *every.shape)))
    o, i = len(c.outputs), len(c.inputs)
    outer, inner = solved[:, :, :o], solved[:, :, o : o + i]
    return loaded(forces, s, solved[:, :, o + i :], outer, inner) if forces else (outer, inner)


def _forces(causes: tuple[Change, ...], u: np.ndarray) -> list[tuple[LineForce, np.ndarray]]:
    return [(cause, size) for cause, size in with_sizes(causes, u) if isinstance(cause, LineForce)]


def frf_on_lines(
    setting: Setting, causes: tuple[Change, ...], sizes: np.ndarray, u: np.ndarray, s: np.ndarray, order: int
) -> np.ndarray:  # fmt: skip
    """FRFs ``(f, o, i)`` as the channels show them."""
    c, rows, columns = setting.coordinates, setting.coordinates.outputs, setting.coordinates.inputs
    forces = _forces(causes, u)
    if forces:
        B = bases_of(forces).T
        rows, columns = np.concatenate([rows, B]), np.concatenate([columns, B])
    H = receptance(*matrices_of(setting, sizes, causes, u), rows, columns, s)
    if forces:
        o, i = len(c.outputs), len(c.inputs)
        H = H[:, :o, :i] - H[:, :o, i:] @ joined(forces, s, H[:, o:, i:]) @ H[:, o:, :i]
    H = shown(causes, u, s, H * s[:, None, None] ** order)
    for k, cause in enumerate(causes):
        if isinstance(cause, LineForce) and cause.row is not None:
            kept, own = _apart(causes, u, k)
            alone = frf_on_lines(setting, kept, sizes, own, s, order)
            alone[:, cause.row] = H[:, cause.row]
            return alone
    return H


def _apart(causes: tuple[Change, ...], u: np.ndarray, which: int) -> tuple[tuple[Change, ...], np.ndarray]:
    """Causes and sizes without one of them."""
    return causes[:which] + causes[which + 1 :], np.delete(u, np.r_[own_sizes(causes, which)])


def blocks(setting: Setting, s: np.ndarray, each: int) -> list[slice]:
    """Lines worked on at once, so that ``each`` numbers a line stay within what is held."""
    size = max(1, int(BLOCK / max(each, setting.coordinates.size**2)))
    return [slice(k, k + size) for k in range(0, len(s), size)]


def chi2_of(setting: Setting, f: Fit, lines: Lines) -> float:
    """Chi-square that a fit leaves on the lines."""
    H = frf_on_lines(setting, f.causes, f.sizes, f.u, lines.s, lines.order)
    return float((lines.weight * np.abs(lines.H - H) ** 2).sum())


def _normal(
    setting: Setting, causes: tuple[Change, ...], sizes: np.ndarray, u: np.ndarray, lines: Lines
) -> tuple[np.ndarray, np.ndarray]:
    """Information of all sizes, and the gradient of half chi-square against them."""
    count = len(sizes) + len(u)
    gram, slope = np.zeros((count, count)), np.zeros(count)
    c = setting.coordinates
    directions = sum(len(f.sign) for f in setting.inaccuracy.factors)
    for part in blocks(setting, lines.s, directions * (c.size + lines.H[0].size)):
        H, J = slopes_on_lines(setting, causes, sizes, u, lines.s[part], lines.order)
        root = np.sqrt(lines.weight[part])
        J *= root
        J = J.reshape(count, -1).view(float)
        e = (root * (lines.H[part] - H)).ravel().view(float)
        gram += dsyrk(1.0, J.T, trans=1)
        slope += J @ e
    return np.triu(gram) + np.triu(gram, 1).T, slope


def slopes_on_lines(
    setting: Setting, causes: tuple[Change, ...], sizes: np.ndarray, u: np.ndarray, s: np.ndarray, order: int
) -> tuple[np.ndarray, np.ndarray]:
    """FRFs ``(f, o, i)`` and their derivatives by all sizes, ``(p, f, o, i)``."""
    H, J = _slopes_of_all(setting, causes, sizes, u, s, order)
    for k, cause in enumerate(causes):
        if isinstance(cause, LineForce) and cause.row is not None:
            kept, own = _apart(causes, u, k)
            alone, slopes = _slopes_of_all(setting, kept, sizes, own, s, order)
            slopes = np.insert(slopes, len(sizes) + own_sizes(causes, k).start, 0.0, axis=0)
            alone[:, cause.row], slopes[:, :, cause.row] = H[:, cause.row], J[:, :, cause.row]
            return alone, slopes
    return H, J


def _slopes_of_all(
    setting: Setting, causes: tuple[Change, ...], sizes: np.ndarray, u: np.ndarray, s: np.ndarray, order: int
) -> tuple[np.ndarray, np.ndarray]:
    """The same with a force that one output alone shows in all outputs."""
    outer, inner = _responses(setting, causes, sizes, u, s)
    between = _Between(setting.coordinates, s, order, outer, inner, hysteretic_share(causes, u))
    plain = (setting.coordinates.outputs @ inner) * between.form
    told = list(with_sizes(causes, u))

    def seen(H: np.ndarray, by: int = -1) -> np.ndarray:
        """As the channels show it, or its derivative by the size of one channel's fault."""
        for k, (cause, size) in enumerate(told):
            act = cause.transform_slope if k == by else cause.transform
            H = act(size, s, H)
        return H

    J = np.empty((len(sizes) + len(u), *plain.shape), complex)
    start = 0
    for kind, patterns in setting.patterns(causes, u):
        between.columns(kind, patterns, J[start : start + len(patterns.first)])
        start += len(patterns.first)
    J[:start] *= factors_of(setting, sizes)[:, None, None, None]
    if any(k.in_channels for k in causes):
        for one in J[:start]:
            one[:] = seen(one)
    for k, (cause, size) in enumerate(told):
        if isinstance(cause, StructuralDamping):
            damping = setting.coordinates.damping + changes_of(setting, sizes, causes, u)["dC"]
            rows = [seen(between.of_share(damping))]
        else:
            rows = [seen(one) for one in between.by_sizes(cause, size)]
            if cause.in_channels:
                rows = [*rows[:-1], sum(rows[-1:]) + seen(plain, k)]
        J[start : start + len(rows)] = rows
        start += len(rows)
    return shown(causes, u, s, plain), J


@dataclass(frozen=True)
class _Between:
    """What changes of the matrices do between responses ``(f, n, o)`` and ``(f, n, i)``.

    Attributes
    ----------
    share
        Of the damping, how much is a loss of stiffness.
    """

    coordinates: Coordinates
    s: np.ndarray
    order: int
    outer: np.ndarray
    inner: np.ndarray
    share: float

    @property
    def form(self) -> np.ndarray:
        """What makes the measured quantity of a displacement."""
        return self.s[:, None, None] ** self.order

    def columns(self, kind: str, P: Factored, out: np.ndarray) -> None:
        """Derivatives of FRFs ``(p, f, o, i)`` by the sizes of changes of one matrix."""
        viscous = 1 - self.share if kind == "C" else 1.0
        factor = -self.form * self.s[:, None, None] ** POWER[kind] * viscous
        np.multiply(P.between(self.outer, self.inner), factor, out=out)
        if kind == "C" and self.share:
            lossy = P.scaled(np.sqrt(self.coordinates.frequencies))
            out += lossy.between(self.outer, self.inner) * (-1j * self.form * self.share)

    def of_share(self, C: np.ndarray) -> np.ndarray:
        """Derivative by the share of the damping ``C`` that is hysteretic, shape ``(f, o, i)``."""
        moved = hysteretic(self.coordinates, C) * 1j - self.s[:, None, None] * C
        return -self.form * (self.outer.transpose(0, 2, 1) @ moved @ self.inner)

    def by_sizes(self, cause: Change, u: np.ndarray) -> list[np.ndarray]:
        """Derivatives by the sizes of what a cause changes in the structure, ``(f, o, i)`` each."""
        if isinstance(cause, LineForce):
            return force_slopes(cause, u, self.s, self.outer, self.inner, self.form)
        return [self.all(by) for by in cause.slopes(u)] if cause.local else []

    def all(self, changes: dict[str, np.ndarray]) -> np.ndarray:
        """Derivative by one size that changes several matrices ``(n, n)``, shape ``(f, o, i)``."""
        each = np.empty((len(changes), len(self.s), self.outer.shape[2], self.inner.shape[2]), complex)
        for (kind, P), out in zip(changes.items(), each, strict=True):
            self.columns(kind, factored(P[None]), out[None])
        return each.sum(axis=0)


def force_slopes(
    cause: LineForce, u: np.ndarray, s: np.ndarray, outer: np.ndarray, inner: np.ndarray, form: np.ndarray
) -> list[np.ndarray]:  # fmt: skip
    """Derivatives of FRFs ``(f, o, i)`` by each size of a force, from responses with it."""
    left, right = outer.transpose(0, 2, 1) @ cause.basis, cause.basis.T @ inner
    return [-(left @ by @ right) * form for by in cause.slopes_of_stiffness(u, s)]


def force_columns(
    setting: Setting, f: Fit, forces: Sequence[LineForce], s: np.ndarray, order: int
) -> np.ndarray:  # fmt: skip
    """Derivatives of FRFs by strengths of forces of one size that are none yet, shape ``(force, f, o, i)``."""
    outer, inner = _responses(setting, f.causes, f.sizes, f.u, s)
    form, out = s[:, None, None] ** order, []
    for cause in forces:
        column = force_slopes(cause, np.zeros(1), s, outer, inner, form)[0]
        for fault, size in with_sizes(f.causes, f.u):
            column = fault.transform(size, s, column)
        if cause.row is not None:
            column = np.where(np.arange(column.shape[1])[:, None] == cause.row, column, 0.0)
        out.append(column)
    return np.stack(out)
