r"""Bias of LSCE and FDPI due to noise, from their expected normal equations (LSCF: :mod:`.normal_equations`).

**LSCE.** The rows are lagged samples of the band's impulse response, an inverse Fourier transform of the lines, so
noise of variance :math:`\sigma^2_{foi}` on the FRFs adds to their normal matrix

.. math:: C_{kl} = \frac{t-n}{F^2} \sum_f u_f^{l-k} \sum_o \sigma^2_{foi}

for each reference i: with an even noise a ridge and nothing else. That the band is cut, so that the response is no sum
of exponentials, is in the rows of the FRF without noise and needs no term of its own.

**FDPI.** The rows are :math:`s^k H V`, real and imaginary parts stacked, less what the polynomial B(s) takes up:

.. math:: C_{kl} = \sum_{f,i} w_{fi}^2 (1-\ell_{fi})\,\mathrm{Re}(\bar s_f^k s_f^l)\,V^T\mathrm{diag}(\sigma^2_{foi})V,

:math:`\ell` the mean leverage of the two rows of a line; noise also turns the principal directions V, on average to
those of the expected Gram matrix.

As for LSCF these are the poles of the mean matrix, not the mean of the poles. Far above the number of poles both put
computational poles close to the modes; where a mode scatters by a tenth of the way to the next one they mix, the
mean shifts, and the prediction is flagged.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Complex, Float

from modalax._numerics.checks import as_double
from modalax._numerics.powers import powers
from modalax.data.frf import FRF
from modalax.identify.bias import SMALLEST, STEPS, DampingBias, follow_poles
from modalax.identify.fdpi import eigenbasis, line_weight, system_factor, system_poles
from modalax.identify.fraction import check_constraint
from modalax.identify.lsce import impulse_response, prediction_factor
from modalax.identify.lscf import RIDGE
from modalax.identify.normal_equations import variance_of
from modalax.identify.polynomial import limits, poles_of_factor, weights_of
from modalax.identify.spread import FIXED, PoleMoments, Window, moments_of
from modalax.identify.tables import PoleTable
from modalax.identify.zoom import Zoom, check_orders

CROWDED = 0.1  # scatter of a mode, over the distance to the next expected pole, from which on the two mix


def expected_lsce_bias(
    frf: FRF,
    poles: Complex[Array, " n"],
    order: int,
    *,
    variance: Any = None,
    weights: str = "unit",
    constraint: str = "aN",
    real: bool = False,
    part: float = 0.5,
    skip: int = 0,
    ridge: float = RIDGE,
) -> DampingBias:
    r"""Bias that noise and the cut band give the damping of each mode in LSCE, without drawing any noise.

    Parameters
    ----------
    frf
        The FRF without noise, at the lines of the measurement.
    poles
        Where the modes are, shape ``(n,)`` [rad/s].
    order
        The order at which the estimate was read off.
    variance
        :math:`E|e|^2` of each sample, ``(f, o, i)`` or a number; that of ``frf`` by default.
    weights, constraint, real, part, skip, ridge
        As in :func:`modalax.identify.lsce`.

    Returns
    -------
    DampingBias
        Expected minus true value of each mode. The poles of the mean normal matrix, not the mean of the poles. Not
        ``valid`` also where a mode scatters (:func:`lsce_moments`) by a tenth of the distance to the next expected
        pole; that is known for one reference, complex coefficients and the constraints ``a0`` and ``aN``.

    Raises
    ------
    ValueError
        As :func:`modalax.identify.lsce`, and if there is no variance.
    """
    poles, sigma2 = as_double(poles, "poles", complex_=True), variance_of(frf, variance)
    problem = _lsce_problem(frf, sigma2, order, weights, constraint, real, part, skip, ridge)
    bias, others = _lsce_bias(problem, poles)
    if real or frf.shape[2] > 1 or constraint not in FIXED:
        return bias
    crowded = _lsce_moments(problem, bias.poles).scatter > CROWDED * others
    return eqx.tree_at(lambda b: b.valid, bias, bias.valid & ~crowded)


def lsce_moments(
    frf: FRF,
    expected: Complex[Array, " n"],
    order: int,
    *,
    variance: Any = None,
    weights: str = "unit",
    constraint: str = "aN",
    part: float = 0.5,
    skip: int = 0,
    ridge: float = RIDGE,
) -> PoleMoments:
    """Mean, to second order, and standard deviation of LSCE poles in noise, as :func:`.spread.second_order` for LSCF.

    Parameters
    ----------
    frf
        The FRF without noise, with one reference.
    expected
        The poles to look at: ``expected_lsce_bias(...).poles``.
    order, variance, weights, constraint, part, skip, ridge
        As :func:`expected_lsce_bias`; complex coefficients.

    Returns
    -------
    PoleMoments
        Trustworthy where the scatter is small beside the distance to the next pole.

    Raises
    ------
    ValueError
        As :func:`expected_lsce_bias`; for several references, or the norm as constraint, which are not worked out.
    """
    if frf.shape[2] > 1 or constraint not in FIXED:
        raise ValueError(
            f"lsce_moments knows one reference and the constraints a0 and aN; this is {frf.shape[2]} references, "
            f"{constraint}"
        )
    problem = _lsce_problem(frf, variance_of(frf, variance), order, weights, constraint, False, part, skip, ridge)
    return _lsce_moments(problem, as_double(expected, "expected", complex_=True))


class _LinearPrediction(eqx.Module):
    """What both need of LSCE: FRF, variance and the samples of the impulse response in use."""

    frf: FRF
    sigma2: Float[Array, "f o i"]
    ridge: Float[Array, ""]
    order: int = eqx.field(static=True)
    constraint: str = eqx.field(static=True)
    real: bool = eqx.field(static=True)
    skip: int = eqx.field(static=True)
    samples: int = eqx.field(static=True)

    def factors(self) -> tuple[Array, Array, Zoom]:
        """Triangular factors of the normal matrix without noise and of what noise adds, and the map on the circle."""
        lines, _, size = self.frf.shape
        h, zoomed = impulse_response(self.frf, self.real)
        signal = prediction_factor(h[self.skip : self.samples], self.order, self.ridge)
        # the transform spreads each line evenly over the samples; of the two end lines irfft takes the real part alone
        share = jnp.full(lines, 2.0).at[jnp.array([0, -1])].set(0.5) if self.real else jnp.ones(lines)
        length = 2 * (lines - 1) if self.real else lines
        used = self.samples - self.skip - self.order
        density = used / length**2 * share[:, None] * jnp.sum(self.sigma2, axis=1)
        columns = powers(zoomed.circle(self.frf.omega), self.order + 1)
        rows = columns[None, :, :, None] * (jnp.sqrt(density).T[:, :, None, None] * jnp.eye(size)[:, None, None, :])
        rows = rows.reshape(size * lines, -1)
        noise = jnp.linalg.qr(jnp.concatenate([rows.real, rows.imag]) if self.real else rows, mode="r")
        return signal, noise, zoomed


def _lsce_problem(
    frf: FRF, sigma2: Array, order: int, weights: str, constraint: str, real: bool, part: float, skip: int, ridge: float
) -> _LinearPrediction:
    samples = int(round(part * (2 * (frf.shape[0] - 1) if real else frf.shape[0])))
    (order,) = check_orders(order, samples - skip, limits(frf))
    weight = 1 / jnp.sqrt(jnp.mean(weights_of(frf, weights) ** -2, axis=(0, 2), keepdims=True))
    frf, sigma2 = eqx.tree_at(lambda f: f.H, frf, frf.H * weight), sigma2 * weight**2
    return _LinearPrediction(frf, sigma2, jnp.asarray(ridge), order, check_constraint(constraint), real, skip, samples)


@eqx.filter_jit
def _lsce_moments(problem: _LinearPrediction, expected: Array) -> PoleMoments:
    signal, noise, zoomed = problem.factors()
    frf, first = problem.frf, problem.skip + problem.order
    P = Window(frf.shape[0], first, problem.samples)
    outputs = [(frf.H[:, k, 0], problem.sigma2[:, k, 0], P) for k in range(frf.shape[1])]
    R = jnp.linalg.qr(jnp.concatenate([signal, noise]), mode="r")
    basis = powers(zoomed.circle(frf.omega), problem.order + 1)
    decay = frf.added_decay
    return moments_of(R, basis, outputs, problem.constraint, zoomed, expected - decay, decay)


@eqx.filter_jit
def _lsce_bias(problem: _LinearPrediction, poles: Array) -> tuple[DampingBias, Float[Array, " n"]]:
    """The bias, and how far the next expected pole is from each mode's [rad/s]."""
    signal, noise, zoomed = problem.factors()
    size, decay = problem.frf.shape[2], problem.frf.added_decay

    def found(R: Array) -> PoleTable:
        return poles_of_factor(R, (problem.order,), size, problem.constraint, problem.real, zoomed, "lsce")

    followed = lax.stop_gradient(_bias(signal, noise, found, poles, decay))
    table = found(jnp.linalg.qr(jnp.concatenate([signal, noise]), mode="r"))
    ends, others = _nearest(table, followed.poles - decay)
    return DampingBias.between(poles, ends + decay, followed.valid), others


def expected_fdpi_bias(
    frf: FRF,
    poles: Complex[Array, " n"],
    order: int,
    *,
    variance: Any = None,
    weights: str = "unit",
    residual: int | None = None,
) -> DampingBias:
    """Bias that noise gives the damping of each mode in FDPI, without drawing any noise.

    Parameters
    ----------
    frf, poles, order, variance
        As :func:`expected_lsce_bias`.
    weights, residual
        As in :func:`modalax.identify.fdpi`.

    What it returns and raises is as there, with the messages of :func:`modalax.identify.fdpi`. The scatter by which
    crowded modes are told is of first order in the noise, the turn of the principal directions included.
    """
    sigma2 = variance_of(frf, variance)
    n_lines, n_out, n_in = frf.shape
    (order,) = check_orders(order, n_lines * n_in, limits(frf))
    degree = 2 * -(-order // n_out)
    terms = degree if residual is None else residual
    poles = as_double(poles, "poles", complex_=True)
    comps = -(-2 * order // degree)
    problem = _DirectIdentification(frf, sigma2, line_weight(frf, weights), order, comps, degree, terms)
    return _fdpi_bias(problem, poles)


class _DirectIdentification(eqx.Module):
    """What is fixed of FDPI while the FRF varies."""

    frf: FRF
    sigma2: Float[Array, "f o i"]
    weight: Float[Array, "f i"]
    order: int = eqx.field(static=True)
    comps: int = eqx.field(static=True)
    degree: int = eqx.field(static=True)
    terms: int = eqx.field(static=True)

    def directions(self, H: Complex[Array, "f o i"]) -> tuple[Array, Array]:
        """The variable, and the principal directions of these FRFs in the noise."""
        weight = self.weight
        rows = jnp.swapaxes(H * weight[:, None, :], 1, 2).reshape(-1, H.shape[1])
        gram = (rows.conj().T @ rows).real + jnp.diag(jnp.sum(weight[:, None, :] ** 2 * self.sigma2, axis=(0, 2)))
        return 1j * self.frf.omega / self.frf.omega[-1], eigenbasis(gram)[1][:, : self.comps]

    def factor(self, H: Complex[Array, "f o i"], noise: Array | None = None) -> Array:
        """Triangular factor of the normal matrix of these FRFs, with the factor of what noise adds if there is one."""
        s, V = self.directions(H)
        return system_factor(s, jnp.swapaxes(H, 1, 2) @ V, self.weight, self.degree, self.terms, noise)

    def noise(self) -> Array:
        """Triangular factor of what noise adds to the normal matrix."""
        weight, (s, V) = self.weight, self.directions(self.frf.H)
        kept = weight**2 * (1 - _numerator_leverage(s, weight, self.terms))
        columns = powers(s, self.degree + 1)

        def one(s2: Array) -> Array:
            Y = columns * jnp.sqrt(jnp.maximum(jnp.sum(kept * s2, axis=1), 0.0))[:, None]
            return jnp.linalg.qr(jnp.concatenate([Y.real, Y.imag]), mode="r")

        # every factor of full rank: that of some of the outputs alone would have no derivative
        factors = lax.map(one, jnp.swapaxes(self.sigma2, 0, 1))
        rows = factors[:, :, :, None] * V[:, None, None, :]
        return jnp.linalg.qr(rows.reshape(-1, (self.degree + 1) * self.comps), mode="r")

    def found(self, R: Array) -> PoleTable:
        """The poles of a triangular factor [rad/s]."""
        scaled, valid = system_poles(R, self.comps, jnp.asarray(self.comps), self.degree)
        at = jnp.where(valid, scaled * self.frf.omega[-1], 0.0)
        return PoleTable(at[None], (valid & (at.imag > 0))[None], None, (self.order,), "fdpi")


@eqx.filter_jit
def _fdpi_bias(problem: _DirectIdentification, poles: Array) -> DampingBias:
    frf, decay = problem.frf, problem.frf.added_decay
    noise = problem.noise()
    # the followed modes only tell which poles are meant: without noise the FRFs may leave nothing of the normal matrix,
    # and that has no derivative; all rows in one factorisation have one
    followed = lax.stop_gradient(_bias(problem.factor(frf.H), noise, problem.found, poles, decay))

    def near(H: Array) -> tuple[Array, tuple[Array, Array]]:
        """Real and imaginary parts of each mode's pole; the pole again, and how far the next one is [rad/s]."""
        pole, other = _nearest(problem.found(problem.factor(H, noise)), followed.poles - decay)
        return jnp.stack([pole.real, pole.imag]), (pole, other)

    slopes, (ends, others) = jax.jacrev(near, has_aux=True)(frf.H)
    scatter = jnp.sqrt(jnp.sum(jnp.abs(slopes) ** 2 * problem.sigma2 / 2, axis=(0, 2, 3, 4)))
    return DampingBias.between(poles, ends + decay, followed.valid & (scatter < CROWDED * others))


def _numerator_leverage(s: Complex[Array, " f"], weight: Float[Array, "f i"], terms: int) -> Float[Array, "f i"]:
    """Part of a line's noise that the polynomial B takes up: the mean of its real and its imaginary row."""

    def one(w: Array) -> Array:
        columns = powers(s, terms + 1) * w[:, None]
        Q = jnp.linalg.qr(jnp.concatenate([columns.real, columns.imag]))[0]
        return jnp.sum(Q**2, axis=1).reshape(2, -1).mean(axis=0)

    return jnp.stack([one(w) for w in weight.T], axis=1)


def _nearest(table: PoleTable, targets: Complex[Array, " n"]) -> tuple[Complex[Array, " n"], Float[Array, " n"]]:
    """The pole next to each target, and how far from the target the one after it is [rad/s]."""
    apart = jnp.where(table.valid[0], jnp.abs(table.poles[0] - targets[:, None]), jnp.inf)
    distance, index = lax.top_k(-apart, 2)
    return table.poles[0][index[:, 0]], -distance[:, 1]


def _bias(
    signal: Array, noise: Array, found: Callable[[Array], PoleTable], poles: Complex[Array, " n"], decay: Array
) -> DampingBias:
    """Each mode followed from hardly any noise to all of it; which pole it ends on is what this is for."""

    def at(scale: Array) -> tuple[Array, Array]:
        table = found(jnp.linalg.qr(jnp.concatenate([signal, jnp.sqrt(scale) * noise]), mode="r"))
        return table.poles[0], table.valid[0]

    along, valid = lax.map(at, jnp.geomspace(SMALLEST, 1.0, STEPS))
    path, certain = follow_poles(along, valid, poles - decay)
    return DampingBias.between(poles, path[-1] + decay, certain[-1])
