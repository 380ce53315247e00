"""Rounds of maximum likelihood: modes that the residual asks for are added, modes without evidence dropped."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
import scipy.special

from modalax.data.frf import FRF
from modalax.identify.host import PRECISE, refine_on_host, refined_of
from modalax.identify.kernels import UNDAMPED
from modalax.identify.local import fit_where_dominant
from modalax.identify.maximum import Maximum, Samples, maximise
from modalax.identify.noise import left_by_fit, several, sigma_of_error
from modalax.identify.plain import modal_of, samples_of, shorter_side
from modalax.identify.refine import CORRELATED, HELD, Refined
from modalax.identify.residues import residues
from modalax.identify.sample_weights import sigma_of
from modalax.identify.scan import NEAR, Grid, poles_missing
from modalax.identify.select import SHARP, Selection
from modalax.identify.tables import PoleTable
from modalax.model.modal import ModalModel

ROUNDS, LAST = 8, 3  # most rounds of adding and dropping modes, and of refinements with new weights
FINE = 1e-6  # tolerance of the last search of large sets, where one for the last digit would take long
IDLE = 2  # rounds without a further mode after which no more are sought
STEPS, TRIAL = 60, 20  # most iterations of one search, and of one with modes that may not stay
HEAVY = 0.25  # damping ratio above which a pole is background, not a mode
GONE = 0.9  # damping ratio above which a mode is given up
NARROW = 0.01  # half-bandwidth in lines below which a pole is one bad line, not a mode
MANY_DOFS, ALIKE, CLOSE = 10, 0.9, 3.0  # fewest DoFs, MAC, and distance in half-bandwidths, of halves of a mode
DROP, ADD = 1e-6, 1e-6  # chances of keeping, or of adding, a mode that is not there


def synthesis(model: ModalModel, frf: FRF) -> FRF:
    """FRF of the model at the lines and in the form of ``frf``."""
    return model.frf(frf.freq, form=frf.form, outputs=frf.outputs, inputs=frf.inputs, added_decay=frf.added_decay)


class _Search:
    """A modal model during the search."""

    def __init__(self, frf: FRF, model: ModalModel, tell: Callable[[str], None], options: dict[str, Any]):
        self.frf, self.tell, self.options, self.dropped = frf, tell, options, False
        self.samples = samples_of(frf, **options)
        self.grid: Grid | None = None
        self.known = frf.variance is not None
        # Weights that are only guessed call for errors that do not rely on them.
        self.kind = "gauss-newton" if self.known else "robust"
        self.sigma = np.asarray(sigma_of(frf, "auto"))
        modal = modal_of(model)
        # While modes are missing, others run off to stand in for them; of a large set that takes most of the time.
        steps = TRIAL if several(self.samples.H.size, len(modal.poles)) else STEPS
        self.found = self._maximise(modal.poles, shorter_side(modal, self.samples), self.sigma, steps)

    def _maximise(
        self, poles: np.ndarray, participation: np.ndarray | None, sigma: np.ndarray, steps: int = STEPS, **how: Any
    ) -> Maximum:
        self.tell(f"maximum likelihood, {len(poles)} modes")
        if steps == TRIAL and several(self.samples.H.size, len(poles)):
            # Modes that may not stay drift on for little. What noise gives a mode, half of chi-square, is o + i.
            how.setdefault("tol", float(sum(self.samples.H.shape[1:])))
        found = maximise(
            self.samples, poles, participation, sigma, known=self.known, max_steps=steps, heavy=GONE, **how
        )
        self.dropped = len(found.model.poles) < len(poles)
        return found

    @property
    def poles(self) -> np.ndarray:
        """Poles of the present model."""
        return self.found.model.poles

    def again(self, sigma: np.ndarray, **how: Any) -> None:
        """Refine the present model with other weights."""
        model, self.sigma = self.found.model, sigma
        self.found = self._maximise(model.poles, shorter_side(model, self.samples), sigma, **how)

    def restart(self, poles: np.ndarray, sigma: np.ndarray) -> None:
        """Refine a model that starts from other poles; fully only once they are known to stay."""
        self.found, self.sigma = self._maximise(poles[np.argsort(np.abs(poles))], None, sigma, TRIAL), sigma

    def weights(self, proportional: bool = False) -> np.ndarray:
        """Weights for the next refinement: those given, or by the residual of the last one."""
        if self.known:
            return self.sigma
        samples, poles = self.samples, self.poles
        left: Any = 1.0
        if not several(samples.H.size, len(poles)):
            left = left_by_fit(samples.s, samples.power, poles, samples.H.shape, self.sigma, self.samples.residuals)
        return sigma_of_error(samples.H, self.found.error, proportional, len(poles), left)

    def deviations(self) -> list[np.ndarray]:
        """Possible noise levels, as noise that outputs share counts; a mode must stand out of each of them."""
        if self.frf.variance is not None:
            levels = [np.sqrt(np.asarray(self.frf.variance))]
        else:
            levels = [self.weights(), self.weights(proportional=True)]
        return [np.sqrt(self.found.shared) * level for level in levels]

    def missing(self, window: list[float], avoid: list[float]) -> np.ndarray:
        """Poles at which the residual asks for a further mode."""
        if self.grid is None:
            self.grid = Grid(self.samples.s, self.samples.power, (window[0], window[1]))
        return poles_missing(
            self.grid, self.found.error, self.deviations(), self.poles, level=ADD, inside=(window[0], window[1]),
            avoid=avoid,
        )  # fmt: skip

    def exact(self) -> bool:
        """Whether the residual is rounding only, in which no mode can be found."""
        return float(np.sum(np.abs(self.found.error) ** 2)) < 1e-22 * float(np.sum(np.abs(self.samples.H) ** 2))

    def prune(self, sigma: np.ndarray) -> bool:
        """Drop modes without evidence and refine the others; True if any mode was dropped, now or before."""
        drop = _without_need(self.samples, self.found)
        if drop.all() or not (drop.any() or self.dropped):
            return False
        model, self.sigma = self.found.model.pick(~drop), sigma
        self.found = self._maximise(model.poles, shorter_side(model, self.samples), sigma, TRIAL)
        return True

    def refined(self) -> Refined:
        """The end of the search with its standard deviations."""
        return refined_of(self.frf, self.found, self.kind)


def diagram_poles(
    frf: FRF, model: ModalModel, table: PoleTable, selection: Selection, tell: Callable[[str], None], **options: Any
) -> Refined | None:
    r"""The model with the poles of the diagram, where these are more accurate than maximum likelihood can be.

    With next to no noise, modes beyond the band are all that keeps a modal model of the band from the FRFs, and the
    likelihood bends those inside to make what they do. The diagram's polynomials hold them. So where its poles repeat
    within ``SHARP`` and the likelihood leaves a residual that is not white, the poles stay; their deviation is the
    change from order to order (forty modes, noise of 0 to 1e-6: errors were a fifth of that, root mean square). The
    diagram's poles beyond the band take up what the modes there make inside it, so that shapes are as exact as poles.

    Parameters
    ----------
    table, selection
        The diagram, and the modes that were taken from it, whose poles the model has.
    frf, model, tell, options
        As for :func:`likelihood_rounds`.

    Returns
    -------
    Refined or None
        None where the likelihood is the better judge.
    """
    if not selection.sharp:
        return None
    search = _Search(frf, model, tell, options)
    if search.exact() or search.found.whiteness >= CORRELATED:
        return None
    tell("the diagram's poles are kept")
    both = with_poles_beyond(table, frf.ends, np.asarray(selection.poles), np.asarray(selection.spread))
    poles, spread = map(jnp.asarray, both)
    held = refine_on_host(frf, residues(frf, poles, **options), covariance=search.kind, max_steps=0, **options)
    old = jnp.sqrt(jnp.diag(held.covariance))
    scale = jnp.stack([spread, spread / held.model.damping_ratio], axis=1).ravel() / jnp.where(old > 0, old, 1.0)
    return dataclasses.replace(
        held, frequency_std_hz=spread * held.model.frequency_hz, damping_std=spread,
        covariance=scale[:, None] * held.covariance * scale, success=jnp.array(True), reason_code=jnp.array(HELD),
    )  # fmt: skip


def with_poles_beyond(
    table: PoleTable, band: tuple[float, float], poles: np.ndarray, spread: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    r"""The modes of a diagram, and its poles beyond a band [Hz] of the order that its modes are nearest to.

    Both by rising frequency with their relative changes from order to order, shapes ``(n,)``. What is not damped, or
    above ``GONE``, makes no steady response; it is left out.
    """
    rows = [np.asarray(row)[np.asarray(valid)] for row, valid in zip(table.poles, table.valid, strict=True)]
    off = [np.median(_nearest(poles, row)) for row in rows]
    k = int(np.argmin(off))
    there = rows[k]
    hz, damping = np.abs(there) / (2 * np.pi), -there.real / np.abs(there)
    beyond = (there.imag > 0) & ((hz < band[0]) | (hz > band[1])) & (damping > 0) & (damping < GONE)
    further = there[beyond]
    further = further[_nearest(further, poles) > np.sqrt(SHARP)]
    both = np.append(poles, further)
    change = np.append(np.zeros(len(poles)) if spread is None else spread, _nearest(further, rows[max(k - 1, 0)]))
    order = np.argsort(np.abs(both))
    return both[order], change[order]


def _nearest(poles: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Distance of each pole to the nearest of others, relative to its size, shape ``(n,)``."""
    return np.abs(poles[:, None] - others).min(axis=1, initial=np.inf) / np.abs(poles)


def likelihood_rounds(frf: FRF, model: ModalModel, tell: Callable[[str], None], **options: Any) -> Refined:
    """The modal model of largest likelihood with as many modes as the data call for.

    Parameters
    ----------
    frf
        The FRF, with its variance where it is known.
    model
        The start.
    tell
        Called with a word on each step.
    options
        ``residuals`` and ``real_modes``, as for :func:`refine`.
    """
    search = _Search(frf, model, tell, options)
    lower, upper = frf.ends
    beyond = 0.2 * (upper - lower)
    window = [max(lower - beyond, 0.0), upper + beyond]
    extra, avoid = np.zeros(0), []
    count, idle = 0, 0
    for turn in range(ROUNDS):
        sigma = search.weights()
        if search.prune(sigma):
            sigma = search.weights()
        tried = np.abs(extra) / (2 * np.pi)
        have = search.found.frequency_hz
        _close_sides(window, tried, have, (lower, upper))
        avoid += [f for f in tried if (np.abs(have - f) > NEAR * f).all()]
        if len(have) > count:
            idle, count = 0, len(have)
        elif ((tried > lower) & (tried < upper)).any():
            idle += 1
        extra = np.zeros(0)
        if turn < ROUNDS - 1 and idle < IDLE and not search.exact():
            extra = search.missing(window, avoid)
        if extra.size:
            search.restart(np.concatenate([search.poles, extra]), sigma)
        elif search.known or turn > 0:
            break
        else:
            search.again(sigma)
    return _settled(search)


def _settled(search: _Search) -> Refined:
    """The modes refined fully with their final weights, by rising frequency, with standard deviations.

    A residual that is not white is model error. Where rows contradict each other, modes that then leave much of the
    response unexplained are fitted anew where they dominate.
    """
    search.prune(search.weights())
    guessed = not search.known and not search.exact()
    if guessed:
        _weigh_again(search)
    order = np.argsort(search.found.frequency_hz)
    if (np.diff(order) < 0).any():
        search.restart(search.poles, search.sigma)
    search.again(search.sigma, tol=FINE if several(search.samples.H.size, len(search.poles)) else PRECISE)
    if not guessed or search.found.whiteness >= CORRELATED:
        return search.refined()
    search.tell("modes where they dominate")
    return fit_where_dominant(search.frf, search.refined(), **search.options)


def _close_sides(window: list[float], tried: np.ndarray, have: np.ndarray, band: tuple[float, float]) -> None:
    """Exclude the range beyond an end of the band where a mode was tried and not kept."""
    if (tried <= band[0]).any() and not (have <= band[0]).any():
        window[0] = band[0]
    if (tried >= band[1]).any() and not (have >= band[1]).any():
        window[1] = band[1]


def _weigh_again(search: _Search) -> None:
    """Add noise in proportion to the FRF to the weights, and drop the modes that have no evidence then."""
    for _ in range(LAST):
        search.again(search.weights(proportional=True))
        if not search.prune(search.sigma):
            break


def _without_need(samples: Samples, found: Maximum) -> np.ndarray:
    """Modes whose shape could be noise, whose damping left the range of modes, or that lie far outside."""
    # A residue matrix of rank one and a pole: what noise alone would fit to itself as a further mode.
    lines, n_out, n_in = samples.H.shape
    dof = 2 * (n_out + n_in - 1) + 2
    weak = found.evidence < scipy.special.chdtri(dof, DROP)
    zeta, f = found.damping_ratio, found.frequency_hz
    lower, upper = samples.omega[0] / (2 * np.pi), samples.omega[-1] / (2 * np.pi)
    away = (f < max(lower - 0.5 * (upper - lower), 0.1 * lower)) | (f > upper + 0.5 * (upper - lower))
    step = (upper - lower) / max(lines - 1, 1)
    bare = (f > lower) & (f < upper) & ((zeta <= 1.01 * UNDAMPED) | (zeta * f < NARROW * step))
    return weak | (zeta > HEAVY) | bare | away | _halves(samples, found)


def _halves(samples: Samples, found: Maximum) -> np.ndarray:
    """Weaker parts of modes that model error split: two close poles of one shape, in a residual that is not white.

    With fewer than ``MANY_DOFS`` DoFs different modes may look alike, so there nothing is taken for split.
    """
    model = found.model
    if max(samples.H.shape[1:]) < MANY_DOFS or found.whiteness >= CORRELATED:
        return np.zeros(len(model.poles), bool)
    shapes = model.participation if samples.turned else model.shapes
    shapes = shapes / np.linalg.norm(shapes, axis=1, keepdims=True)
    alike = np.abs(shapes.conj() @ shapes.T) ** 2 > ALIKE
    width = -model.poles.real
    close = np.abs(model.poles[:, None] - model.poles) < CLOSE * (width[:, None] + width)
    weaker = found.evidence[:, None] < found.evidence
    return (alike & close & weaker).any(axis=1)
