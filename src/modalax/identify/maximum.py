r"""Refinement by maximum likelihood on the host, as :mod:`modalax.identify.refine` does it, without compiling.

The likelihood, its unknowns, its start and its reasons are those of :func:`modalax.identify.refine`; the arithmetic is
that of :mod:`modalax.identify.projection`. Error bars are left to :mod:`modalax.identify.host`.
"""

from typing import NamedTuple

import numpy as np

from modalax.identify.ascent import STATISTICAL, Ascent, climb
from modalax.identify.estimate import participation_of
from modalax.identify.information import solution
from modalax.identify.kernels import GROWING, UNDAMPED, kernels, pack, pairs, residual_terms, unpack
from modalax.identify.projection import Projection
from modalax.identify.shared_noise import shared_noise
from modalax.identify.whiteness import whiteness_of

UNIT = 1e-9  # standard deviation assumed where none is known, relative to the FRF
REACH = 2.0  # distance from the band, in half-bandwidths, beyond which a mode keeps the damping of its start


class Samples(NamedTuple):
    """FRFs as plain arrays, and the kind of model to fit to them.

    Attributes
    ----------
    s, H
        Where they were measured, shape ``(f,)`` [1/s], and their values ``(f, o, i)``.
    power
        Number of time derivatives.
    residuals, real_modes
        As for :func:`modalax.identify.refine`.
    """

    s: np.ndarray
    H: np.ndarray
    power: int
    residuals: str
    real_modes: bool

    @property
    def omega(self) -> np.ndarray:
        """Circular frequency of each line [rad/s]."""
        return self.s.imag

    @property
    def turned(self) -> bool:
        """Whether there are more inputs than outputs, so that these change their roles."""
        return self.H.shape[2] > self.H.shape[1]

    def weight(self, sigma: np.ndarray) -> np.ndarray:
        """Weights of real and imaginary parts for standard deviations of complex samples."""
        weight = np.sqrt(2) / sigma
        if self.power < 2 and self.residuals != "none":  # the lower residual term is infinite at 0 Hz
            weight = np.where((self.omega == 0)[:, None, None], 0.0, weight)
        return weight

    def projection(self, sigma: np.ndarray) -> Projection:
        """The data as the search needs them, outputs and inputs exchanged where :attr:`turned` is set."""
        H, weight = self.H, self.weight(sigma)
        if self.turned:
            H, weight = np.swapaxes(H, 1, 2), np.swapaxes(weight, 1, 2)
        terms = residual_terms(self.s, self.power, self.residuals)
        return Projection(self.s, H, weight, power=self.power, terms=terms, real_modes=self.real_modes)


class Modal(NamedTuple):
    """A modal model as plain arrays: the attributes of :class:`modalax.model.ModalModel` of the same names."""

    poles: np.ndarray
    shapes: np.ndarray
    participation: np.ndarray
    upper: np.ndarray
    lower: np.ndarray

    def normalised(self) -> "Modal":
        """Each shape scaled to a largest component of 1."""
        top = np.take_along_axis(self.shapes, np.argmax(np.abs(self.shapes), axis=1)[:, None], axis=1)
        return self._replace(shapes=self.shapes / top, participation=self.participation * top)

    def transpose(self) -> "Modal":
        """Outputs and inputs exchanged."""
        return Modal(self.poles, self.participation, self.shapes, self.upper.T, self.lower.T)

    def pick(self, which: np.ndarray) -> "Modal":
        """The model with some of its modes only."""
        return self._replace(
            poles=self.poles[which], shapes=self.shapes[which], participation=self.participation[which]
        )


def response(model: Modal, samples: Samples) -> np.ndarray:
    """The model's FRF where the samples were taken, shape ``(f, o, i)``; without the lower term at 0 Hz."""
    columns, real = columns_of(model, samples.s, samples.power)
    H = np.empty((len(samples.s), real.shape[1]), complex)
    H.real, H.imag = columns.real @ real, columns.imag @ real
    return H.reshape(len(samples.s), *model.upper.shape)


def columns_of(model: Modal, s: np.ndarray, power: int) -> tuple[np.ndarray, np.ndarray]:
    """Columns ``(f, 2 n + 4)`` and the real coefficients ``(2 n + 4, o i)`` that make the model's FRF of them."""
    flat = (model.shapes[:, :, None] * model.participation[:, None, :]).reshape(len(model.poles), -1)
    lower = np.where((s == 0) & (power < 2), 0, np.where(s == 0, 1, s) ** (power - 2))
    terms = np.stack([s**power, 1j * s**power, lower, 1j * lower], axis=1)
    columns = np.concatenate([kernels(s, power, model.poles, squares=False), terms], axis=1)
    flat = np.concatenate([flat, model.upper.reshape(1, -1), model.lower.reshape(1, -1)])
    return columns, np.swapaxes(pairs(flat), 1, 2).reshape(-1, flat.shape[1])


class Maximum(NamedTuple):
    """The end of a search, as :class:`modalax.identify.Refined` without standard deviations.

    Attributes
    ----------
    samples, projection, at
        What was fitted, and where the search ended; with roles exchanged where ``samples.turned``.
    sigma, known
        Standard deviations that weighed the samples, and whether they are known, ``(f, o, i)``.
    model
        The modal model, shapes with their largest component 1.
    kept
        Which of the given modes were not dropped on the way, as indices.
    residual
        Whitened residual, complex with unit variance, ``(f, o, i)``.
    shared
        By how much noise that the outputs share counts more than as much of each one's own, of
        :func:`modalax.identify.shared_noise.shared_noise`.
    inflate
        Factor on the variances: one where they are known and explain the residual, times ``shared``.
    chi2, dof, whiteness, evidence, reason
        As in :class:`modalax.identify.Refined`.
    """

    samples: Samples
    projection: Projection
    at: Ascent
    sigma: np.ndarray
    known: bool
    model: Modal
    residual: np.ndarray
    chi2: float
    dof: int
    shared: float
    inflate: float
    whiteness: float
    evidence: np.ndarray
    reason: int

    @property
    def frequency_hz(self) -> np.ndarray:
        """Natural frequencies [Hz]."""
        return np.abs(self.model.poles) / (2 * np.pi)

    @property
    def damping_ratio(self) -> np.ndarray:
        """Damping ratios [-]."""
        return -self.model.poles.real / np.abs(self.model.poles)

    @property
    def error(self) -> np.ndarray:
        """The FRFs less those of the model, in their unit."""
        return self.residual * self.sigma


def maximise(
    samples: Samples,
    poles: np.ndarray,
    participation: np.ndarray | None,
    sigma: np.ndarray,
    *,
    known: bool,
    max_steps: int = 60,
    tol: float = STATISTICAL,
    heavy: float | None = None,
) -> Maximum:
    r"""Maximise the likelihood, as :func:`modalax.identify.refine` does.

    Parameters
    ----------
    samples
        The FRFs.
    poles, participation
        The start, shapes ``(n,)`` and ``(n, k)`` with ``k`` the shorter of outputs and inputs; participation from the
        FRFs if None.
    sigma
        Standard deviations; where they are not ``known`` only their course over the samples counts.
    max_steps, tol
        As for :func:`modalax.identify.ascent.climb`.
    heavy
        Damping ratio above which a mode is dropped on the way, as one far outside the band is; none if None.
    """
    if not known:  # far below the data, so that a search for the last digit ends at rounding whatever the unit
        sigma = sigma * UNIT * np.sqrt(np.mean(np.abs(samples.H / sigma) ** 2))
    projection = samples.projection(sigma)
    omega0 = np.abs(poles)
    zeta0 = -poles.real / omega0
    zeta0 = np.where(poles.real < 0, np.maximum(zeta0, UNDAMPED), GROWING)
    poles = omega0 * (-zeta0 + 1j * np.sqrt(1 - zeta0**2))
    if participation is None:
        participation = participation_of(projection, poles)
    pivot = np.argmax(np.abs(participation), axis=1)
    reach = REACH * zeta0 * omega0
    held = ((omega0 + reach < samples.omega.min()) | (omega0 - reach > samples.omega.max())).astype(float)
    start = pack(poles, participation.real.astype(complex) if samples.real_modes else participation, pivot)
    runaway = None if heavy is None else _Runaway(samples, heavy)
    at = climb(projection, start, pivot, held, max_steps=max_steps, tol=tol, runaway=runaway)
    start = start[at.kept]
    omega = np.exp(at.theta[:, 0])
    inside = (omega > samples.omega.min()) & (omega < samples.omega.max())
    if (inside & (at.held > 0)).any():  # one that came into the band: there the data tell its damping
        held = np.where(inside, 0.0, at.held)
        at = climb(projection, at.theta, at.pivot, held, max_steps=max_steps, tol=tol, runaway=runaway)
        start = start[at.kept]
    return _maximum(samples, projection, at, start, sigma, known)


def linear_fit(
    samples: Samples, projection: Projection, poles: np.ndarray, participation: np.ndarray | None = None
) -> tuple[Modal, np.ndarray]:
    """Shapes and residual terms at given poles, as :func:`modalax.identify.residues`, and what they leave, whitened.

    Parameters
    ----------
    samples, projection
        The FRFs, and the same weighed as :meth:`Samples.projection` does.
    poles
        Shape ``(n,)`` [rad/s].
    participation
        Along the shorter side, shape ``(n, i)``; of the FRFs themselves if None.
    """
    part = participation_of(projection, poles) if participation is None else participation
    pivot = np.argmax(np.abs(part), axis=1)
    theta = pack(poles, part, pivot)
    modes = unpack(theta, pivot, samples.real_modes)
    blocks = projection.blocks(theta, pivot, np.zeros(len(poles)), squares=False)
    x = np.concatenate([block.unknowns() for block in blocks])
    terms, left = projection.remainder(x, modes)
    shapes = np.einsum("onc,nc->no", x.reshape(len(x), *modes.unit.shape), modes.unit)
    model = _modal(samples, modes.poles, shapes, modes.participation, terms)
    return model, _as_measured(samples, left)


class _Runaway:
    """Modes whose damping ratio leaves the range of modes, or that are far outside the band."""

    def __init__(self, samples: Samples, heavy: float):
        low, high = samples.omega.min(), samples.omega.max()
        self.low, self.high = max(low - 0.5 * (high - low), 0.1 * low), high + 0.5 * (high - low)
        self.heavy = heavy

    def __call__(self, theta: np.ndarray) -> np.ndarray:
        omega, zeta = np.exp(theta[:, 0]), np.exp(theta[:, 1])
        return (zeta > self.heavy) | (omega < self.low) | (omega > self.high)


def _maximum(
    samples: Samples, projection: Projection, at: Ascent, start: np.ndarray, sigma: np.ndarray, known: bool
) -> Maximum:
    modes = unpack(at.theta, at.pivot, samples.real_modes)
    with np.errstate(all="ignore"):
        try:
            x, left, evidence, terms = solution(projection, at)
        except np.linalg.LinAlgError:
            n, c = modes.unit.shape
            x, left = np.full((projection.outputs, n, c), np.nan), np.full(projection.y.shape, np.nan + 0j)
            evidence, terms = np.full(n, np.nan), np.full((*left.shape[:2], projection.terms.shape[1]), np.nan)
        model = _modal(samples, modes.poles, np.einsum("onc,nc->no", x, modes.unit), modes.participation, terms)
        residual = _as_measured(samples, left)
        chi2, dof = 2 * at.sums.cost, max(projection.degrees_of_freedom(len(at.theta)), 1)
        white, shared = whiteness_of(residual), shared_noise(samples.H / sigma - residual, residual)
    variance = chi2 / dof
    inflate = shared * (1.0 if known and not variance > 1 + 5 * np.sqrt(2 / dof) else variance)
    evidence = evidence / inflate
    reason = _reason(at, start, chi2, samples.omega)
    return Maximum(
        samples, projection, at, sigma, known, model, residual, chi2, dof, shared, inflate, white, evidence, reason
    )


def _as_measured(samples: Samples, left: np.ndarray) -> np.ndarray:
    """A residual in the order of the samples, complex with unit variance, in the place of the given one."""
    left /= np.sqrt(2)
    left = np.moveaxis(left, 2, 0)
    return np.swapaxes(left, 1, 2) if samples.turned else left


def _modal(
    samples: Samples, poles: np.ndarray, shapes: np.ndarray, participation: np.ndarray, terms: np.ndarray
) -> Modal:
    """The modal model of linear unknowns: the terms' columns are those of :func:`residual_terms`."""
    top = np.max(samples.omega)
    zero = np.zeros(terms.shape[:2], complex)
    upper, lower = zero, zero
    if samples.residuals != "none":
        z = terms[..., :2] + (1j * terms[..., 2:] if samples.residuals == "complex" else 0)
        upper, lower = z[..., 0] / top**samples.power, z[..., 1] / top ** (samples.power - 2)
    model = Modal(poles, shapes, participation, upper.astype(complex), lower.astype(complex)).normalised()
    return model.transpose().normalised() if samples.turned else model


def _reason(at: Ascent, start: np.ndarray, chi2: float, omega: np.ndarray) -> int:
    """Index of the reason among those of :mod:`modalax.identify.refine`."""
    theta = at.theta
    if not (np.isfinite(chi2) and np.isfinite(theta).all()):
        return 2
    if not at.finished:
        return 1
    reach = 5 * np.maximum(np.exp(start[:, 1]), np.exp(theta[:, 1])) + 0.02
    moved = np.abs(theta[:, 0] - start[:, 0]) > reach
    low, high = (np.log(v) if v > 0 else -np.inf for v in (omega.min(), omega.max()))
    # A mode that lies outside the band, and did from the start, the data need not tell.
    began, inside = ((log > low) & (log < high) for log in (start[:, 0], theta[:, 0]))
    if (inside & (theta[:, 1] <= np.log(UNDAMPED))).any():
        return 3
    return 4 if (moved & (began | inside)).any() else 0
