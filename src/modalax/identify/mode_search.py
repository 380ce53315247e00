"""Rounds of maximum likelihood: modes that the residual asks for are added, modes without evidence dropped."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
import scipy.special
from jaxtyping import Array, Float

from modalax.data.frf import FRF
from modalax.identify.likelihood import UNDAMPED
from modalax.identify.local import fit_where_dominant
from modalax.identify.noise import residual_sigma
from modalax.identify.refine import CORRELATED, HELD, Refined, refine
from modalax.identify.residues import residues
from modalax.identify.search import NEAR, missing_modes
from modalax.model.indicators import mac
from modalax.model.modal import ModalModel

ROUNDS, LAST = 8, 3  # most rounds of adding and dropping modes, and of weighing them anew
IDLE = 2  # rounds without a further mode after which no more are sought
STEPS = 60  # most iterations of one search
HEAVY = 0.25  # damping ratio above which a pole is background, not a mode
NARROW = 0.01  # half-bandwidth in lines below which a pole is one bad line, not a mode
MANY_DOFS, ALIKE, CLOSE = 10, 0.9, 3.0  # fewest DoFs, MAC, and distance in half-bandwidths, of halves of a mode
DROP, ADD = 1e-6, 1e-6  # chances of keeping, or of adding, a mode that is not there
SHARP = 1e-6  # change of the diagram's poles from order to order below which they are kept where the model lacks modes


def synthesis(model: ModalModel, frf: FRF) -> FRF:
    """The model's FRF where and as ``frf`` was measured."""
    return model.frf(frf.freq, form=frf.form, outputs=frf.outputs, inputs=frf.inputs, added_decay=frf.added_decay)


class _Search:
    """A modal model under way; ``sigma`` is what weighed its last refinement."""

    def __init__(self, frf: FRF, model: ModalModel, tell: Callable[[str], None], options: dict[str, Any]):
        self.frf, self.tell, self.options = frf, tell, options
        self.known = frf.variance is not None
        # Weights that are only guessed call for errors that do not rely on them.
        self.kind = "gauss-newton" if self.known else "robust"
        self.sigma: Any = "auto"
        self.refined = self._maximise(model, self.sigma)

    def _maximise(self, model: ModalModel, sigma: Any) -> Refined:
        """Refine in slots of eight, so that adding or dropping a mode seldom compiles anew."""
        self.tell(f"maximum likelihood, {model.poles.size} modes")
        slots = 8 * -(-model.poles.size // 8)
        return refine(
            self.frf, model, weights=sigma, covariance=self.kind, slots=slots, max_steps=STEPS, **self.options
        )

    def again(self, sigma: Any) -> None:
        """Refine from where it is with other weights."""
        self.refined, self.sigma = self._maximise(self.refined.model, sigma), sigma

    def restart(self, poles: Any, sigma: Any) -> None:
        """Refine from other poles."""
        poles = jnp.asarray(poles)
        model = residues(self.frf, poles[jnp.argsort(jnp.abs(poles))], weights=sigma, **self.options)
        self.refined, self.sigma = self._maximise(model, sigma), sigma

    def weights(self, **how: Any) -> Any:
        """Weights for the next refinement: those given, or by the residual of the last one."""
        return "auto" if self.known else residual_sigma(self.frf, self.refined, self.sigma, **how)

    def deviations(self) -> list[Array]:
        """What the noise may be: a mode must stand out of each."""
        if self.frf.variance is not None:
            return [jnp.sqrt(self.frf.variance)]
        return [self.weights(), self.weights(proportional=True)]

    def exact(self) -> bool:
        """Whether only rounding is left, in which no mode can be looked for."""
        made = synthesis(self.refined.model, self.frf)
        return float(jnp.sum(jnp.abs(self.frf.H - made.H) ** 2)) < 1e-22 * float(jnp.sum(jnp.abs(self.frf.H) ** 2))

    def prune(self, sigma: Any) -> bool:
        """Drop modes without need and refine the others; whether there were any."""
        drop = _without_need(self.frf, self.refined)
        if not drop.any() or drop.all():
            return False
        self.restart(self.refined.model.poles[~drop], sigma)
        return True


def diagram_poles(
    frf: FRF, model: ModalModel, spread: Float[Array, " n"], tell: Callable[[str], None], **options: Any
) -> Refined | None:
    r"""The model with its poles as they are, where the diagram knows them better than the likelihood can.

    With next to no noise, modes beyond the band are all that keeps a modal model of the band from the FRFs, and the
    likelihood bends those inside to make what they do. The diagram's polynomials hold them. So where its poles repeat
    within ``SHARP`` and the likelihood leaves a residual that is not white, the poles stay; their deviation is the
    change from order to order (forty modes, noise of 0 to 1e-6: errors were a fifth of that, root mean square).

    Parameters
    ----------
    spread
        Change of each pole from order to order of the diagram, relative to its size, shape ``(n,)``.
    frf, model, tell, options
        As for :func:`likelihood_rounds`.

    Returns
    -------
    Refined or None
        None where the likelihood is the better judge.
    """
    if float(jnp.median(spread)) > SHARP:
        return None
    search = _Search(frf, model, tell, options)
    if search.exact() or float(search.refined.whiteness) >= CORRELATED:
        return None
    tell("the diagram's poles are kept")
    held = refine(frf, model, covariance=search.kind, max_steps=0, **options)
    old = jnp.sqrt(jnp.diag(held.covariance))
    scale = jnp.stack([spread, spread / model.damping_ratio], axis=1).ravel() / jnp.where(old > 0, old, 1.0)
    return dataclasses.replace(
        held, frequency_std_hz=spread * model.frequency_hz, damping_std=spread,
        covariance=scale[:, None] * held.covariance * scale, success=jnp.array(True), reason_code=jnp.array(HELD),
    )  # fmt: skip


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
    lower, upper = float(frf.freq[0]), float(frf.freq[-1])
    beyond = 0.2 * (upper - lower)
    window = [max(lower - beyond, 0.0), upper + beyond]
    extra, avoid = jnp.zeros(0), []
    count, idle = 0, 0
    for turn in range(ROUNDS):
        sigma = search.weights()
        if search.prune(sigma):
            sigma = search.weights()
        tried = np.abs(np.asarray(extra)) / (2 * np.pi)
        _close_sides(window, tried, search, (lower, upper))
        have = np.asarray(search.refined.model.frequency_hz)
        avoid += [f for f in tried if (np.abs(have - f) > NEAR * f).all()]
        if search.refined.model.poles.size > count:
            idle, count = 0, search.refined.model.poles.size
        elif ((tried > lower) & (tried < upper)).any():
            idle += 1
        extra = jnp.zeros(0)
        if turn < ROUNDS - 1 and idle < IDLE and not search.exact():
            extra = missing_modes(
                frf, search.refined.model, search.deviations(), level=ADD, inside=(window[0], window[1]), avoid=avoid
            )
        if extra.size:
            search.restart(jnp.concatenate([search.refined.model.poles, extra]), sigma)
        elif search.known or turn > 0:
            break
        else:
            search.again(sigma)
    search.prune(search.weights())
    if not search.known and not search.exact():
        _weigh_again(search)
    order = np.argsort(np.asarray(search.refined.model.frequency_hz))
    if (np.diff(order) < 0).any():
        search.restart(search.refined.model.poles, search.sigma)
    return search.refined


def _close_sides(window: list[float], tried: np.ndarray, search: _Search, band: tuple[float, float]) -> None:
    """Seek no further beyond an end of the band where a mode was tried and did not stay."""
    have = np.asarray(search.refined.model.frequency_hz)
    if (tried <= band[0]).any() and not (have <= band[0]).any():
        window[0] = band[0]
    if (tried >= band[1]).any() and not (have >= band[1]).any():
        window[1] = band[1]


def _weigh_again(search: _Search) -> None:
    """Modes were sought where the data is quiet; now the peaks get their own weight, and modes must stand that too.

    A residual that is not white is model error. Where rows contradict each other, modes that then leave much of the
    response unexplained are fitted anew where they dominate.
    """
    for _ in range(LAST):
        search.again(search.weights(proportional=True))
        if not search.prune(search.sigma):
            break
    if float(search.refined.whiteness) >= CORRELATED:
        return
    search.tell("modes where they dominate")
    search.refined = fit_where_dominant(search.frf, search.refined, **search.options)


def _without_need(frf: FRF, refined: Refined) -> np.ndarray:
    """Modes whose shape could be noise, whose damping left the range of modes, or that lie far outside."""
    model = refined.model
    # A residue matrix of rank one and a pole: what noise alone would fit to itself as a further mode.
    dof = 2 * (frf.shape[1] + frf.shape[2] - 1) + 2
    weak = np.asarray(refined.evidence) < scipy.special.chdtri(dof, DROP)
    zeta, f = np.asarray(model.damping_ratio), np.asarray(model.frequency_hz)
    lower, upper = float(frf.freq[0]), float(frf.freq[-1])
    away = (f < max(lower - 0.5 * (upper - lower), 0.1 * lower)) | (f > upper + 0.5 * (upper - lower))
    step = (upper - lower) / max(len(frf.freq) - 1, 1)
    bare = (f > lower) & (f < upper) & ((zeta <= 1.01 * UNDAMPED) | (zeta * f < NARROW * step))
    return weak | (zeta > HEAVY) | bare | away | _halves(frf, refined)


def _halves(frf: FRF, refined: Refined) -> np.ndarray:
    """Weaker parts of modes that model error split: two close poles of one shape, in a residual that is not white.

    With fewer than ``MANY_DOFS`` DoFs different modes may look alike, so there nothing is taken for split.
    """
    none = np.zeros(refined.model.poles.size, bool)
    if max(frf.shape[1:]) < MANY_DOFS or float(refined.whiteness) >= CORRELATED:
        return none
    shapes = refined.model.participation if frf.shape[2] > frf.shape[1] else refined.model.shapes
    alike = np.asarray(mac(shapes, shapes)) > ALIKE
    poles, evidence = np.asarray(refined.model.poles), np.asarray(refined.evidence)
    width = -poles.real
    close = np.abs(poles[:, None] - poles) < CLOSE * (width[:, None] + width)
    weaker = evidence[:, None] < evidence
    return (alike & close & weaker).any(axis=1)
