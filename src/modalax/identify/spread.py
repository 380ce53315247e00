r"""Spread of the normal matrix of LSCF and LSCE: the second term of the bias, and the standard deviation of the poles.

The noise :math:`e` enters the normal matrix of LSCF as :math:`\tilde M - E\tilde M = \Phi^H \Delta \Phi` with

.. math:: \Delta = \sum_o D_h^* P D_e + D_e^* P D_h + (D_e^* P D_e - E),

:math:`D_h, D_e` diagonal with the FRF and the noise of one output, :math:`P` the projector off its numerator. The
coefficients move by :math:`-K\delta a_1 + K\delta K\delta a`, :math:`K` the inverse of the expected normal matrix
without the fixed coefficient. Moments of circular Gaussian noise give both moments of the poles in closed form: no
noise is drawn. LSCE's is of the same form, its :math:`P` the window on the impulse response.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Complex, Float

from modalax._numerics.checks import as_double
from modalax.data.frf import FRF
from modalax.identify.fraction import coefficients
from modalax.identify.normal_equations import LinearProblem, expected_factor, linear_problem
from modalax.identify.polynomial import LAST
from modalax.identify.zoom import Zoom

FIXED = {"a0": -1, "aN": 0}


class PoleMoments(eqx.Module):
    r"""First two moments of LSCF poles in noise.

    Attributes
    ----------
    poles
        Poles of the expected normal matrix, shape ``(n,)`` [rad/s].
    shift
        What the spread of the normal matrix adds to their mean, shape ``(n,)`` [rad/s].
    damping
        Expected damping ratios with that shift, shape ``(n,)`` [-].
    damping_std, frequency_std_hz
        Standard deviation of damping ratio and frequency, shape ``(n,)`` [-], [Hz].
    """

    poles: Complex[Array, " n"]
    shift: Complex[Array, " n"]
    damping: Float[Array, " n"]
    damping_std: Float[Array, " n"]
    frequency_std_hz: Float[Array, " n"]

    @property
    def scatter(self) -> Float[Array, " n"]:
        """Standard deviation of each pole in the complex plane [rad/s]."""
        along = self.damping_std * jnp.abs(self.poles + self.shift)
        return jnp.hypot(along, 2 * jnp.pi * self.frequency_std_hz)


def second_order(frf: FRF, expected: Complex[Array, " n"], order: int, **options: Any) -> PoleMoments:
    r"""Mean, to second order, and standard deviation of LSCF poles in noise.

    Parameters
    ----------
    frf
        The FRF without noise.
    expected
        The poles to look at, near those of the expected normal matrix: ``predicted_damping_bias(...).poles``.
    order, options
        As :func:`modalax.identify.bias.predicted_damping_bias`, for ``method="lscf"``.

    Returns
    -------
    PoleMoments
        A shift that is not small beside the standard deviation or the bias says that more terms would count.

    Raises
    ------
    ValueError
        For pLSCF with several references, real coefficients, or the norm as constraint, which are not worked out.
    """
    problem = linear_problem(frf, order, **options)
    if problem.size > 1 or problem.real or problem.constraint not in FIXED:
        raise ValueError(
            f"second_order knows complex coefficients, one reference and the constraints a0 and aN; this is "
            f"real={problem.real}, {problem.size} references, {problem.constraint}"
        )
    return _moments(problem, as_double(expected, "expected", complex_=True), frf.added_decay)


@eqx.filter_jit
def _moments(problem: LinearProblem, expected: Complex[Array, " n"], decay: Float[Array, ""]) -> PoleMoments:
    R = expected_factor(problem)
    outputs = []
    for k in range(problem.H.shape[1]):
        w = problem.weight[:, k]
        h, s = w * problem.H[:, k, 0], w**2 * problem.variance[:, k, 0]
        outputs.append((h, s, OffNumerators(problem.basis_of(w))))
    return moments_of(R, problem.powers(), outputs, problem.constraint, problem.zoomed, expected - decay, decay)


def moments_of(
    R: Array,
    basis: Complex[Array, "f k"],
    outputs: list[tuple[Array, Array, "OffNumerators | Window"]],
    constraint: str,
    zoomed: Zoom,
    expected: Complex[Array, " n"],
    decay: Float[Array, ""],
) -> PoleMoments:
    r"""Moments of the poles of any estimator whose normal matrix is a sum of :math:`\Phi^H D^* P D \Phi`.

    Parameters
    ----------
    R
        Triangular factor of the expected normal matrix, shape ``(k, k)``.
    basis
        :math:`\Phi`, the powers of the variable on the lines, shape ``(f, k)``.
    outputs
        FRF, noise variance (both weighted), shape ``(f,)`` each, and :math:`P` of each output.
    constraint, zoomed
        The constraint of the estimator, and its map on the circle.
    expected
        The poles to look at, with the decay that a window added still in them [rad/s].
    decay
        That decay, taken out of the result [rad/s].
    """
    order = basis.shape[1] - 1
    A = coefficients(jnp, R, jnp.asarray(order), 1, LAST[constraint])[:, 0, 0]
    keep = jnp.delete(jnp.arange(order + 1), FIXED[constraint])
    T = jnp.linalg.qr(R[:, keep], mode="r")
    half = _solve(T, basis[:, keep])  # half half^H = Phi K Phi^H
    b = basis @ A
    rows = [_Row(h, s, P, half, b) for h, s, P in outputs]
    K_mean = solve_triangular(T, half.conj().T @ sum(row.curvature() for row in rows))  # K Phi^H E[Delta Z Delta] b

    def one(pole: Array) -> tuple[Array, Array, Array, Array]:
        u = jnp.exp(-(pole - 1j * zoomed.centre) * zoomed.step)
        for _ in range(3):
            u = u - _value(A, u, 0) / _value(A, u, 1)
        slope, bend = _value(A, u, 1), _value(A, u, 2)
        powers = jnp.arange(order + 1.0)
        g0 = _probe(T, half, (u**powers)[keep])
        g1 = _probe(T, half, (powers * u ** jnp.maximum(powers - 1, 0))[keep])
        square = sum(row.product(g0, g0) for row in rows)
        mixed = sum(row.product(g0, g1) for row in rows)
        second = -(u**powers)[keep] @ K_mean / slope + mixed / slope**2 - bend * square / (2 * slope**3)
        first2 = square / slope**2
        power = sum(row.power(g0) for row in rows) / jnp.abs(slope) ** 2
        step = zoomed.step
        shift = -second / (u * step) + first2 / (2 * u**2 * step)
        here = 1j * zoomed.centre - jnp.log(u) / step + decay
        return here, shift, first2 / (u * step) ** 2, power / jnp.abs(u * step) ** 2

    pole, shift, pseudo, power = jax.vmap(one)(expected)
    mean = pole + shift
    var_real, var_imag = (power + pseudo.real) / 2, (power - pseudo.real) / 2
    size = jnp.abs(mean)
    return PoleMoments(
        pole, shift, -mean.real / size, jnp.sqrt(jnp.maximum(var_real, 0.0)) / size,
        jnp.sqrt(jnp.maximum(var_imag, 0.0)) / (2 * jnp.pi),
    )  # fmt: skip


def _value(A: Array, u: Array, derivative: int) -> Array:
    """A polynomial, or one of its first two derivatives."""
    k = jnp.arange(A.shape[0])
    factor = jnp.ones_like(k)
    for d in range(derivative):
        factor = factor * (k - d)
    return jnp.sum(factor * A * u ** jnp.maximum(k - derivative, 0))


def _solve(T: Array, X: Array) -> Array:
    """The product of X with the inverse of the triangular T."""
    return solve_triangular(T, X.T, trans=1).T


def _probe(T: Array, half: Array, phi: Array) -> Complex[Array, " f"]:
    r"""The vector :math:`\hat g` on the lines with :math:`\phi^T\delta x = -\hat g^T \Delta b`."""
    return half.conj() @ solve_triangular(T, phi, trans=1)


class OffNumerators:
    """LSCF's :math:`P`: the projector off an orthonormal basis of the numerators."""

    def __init__(self, Q: Array):
        self.Q = Q

    def __call__(self, x: Array) -> Array:
        """:math:`P x`."""
        return x - self.Q @ (self.Q.conj().T @ x)

    def squared(self, t: Array) -> Array:
        r""":math:`\sum_b |P_{ab}|^2 t_b`."""
        leverage = jnp.sum(jnp.abs(self.Q) ** 2, axis=1)
        inner = self.Q.conj().T @ (t[:, None] * self.Q)
        return (1 - 2 * leverage) * t + jnp.einsum("ap,pq,aq->a", self.Q, inner, self.Q.conj())


class Window:
    """LSCE's :math:`P`: to the samples of the impulse response that are used, and back; a Toeplitz matrix."""

    def __init__(self, lines: int, first: int, last: int):
        self.mask = jnp.zeros(lines).at[first:last].set(1.0)
        self.spectrum = jnp.fft.fft(jnp.abs(jnp.fft.fft(self.mask) / lines**2) ** 2)

    def __call__(self, x: Array) -> Array:
        """:math:`P x`."""
        mask = self.mask[:, None] if x.ndim == 2 else self.mask
        return jnp.fft.fft(mask * jnp.fft.ifft(x, axis=0), axis=0) / len(self.mask)

    def squared(self, t: Array) -> Array:
        r""":math:`\sum_b |P_{ab}|^2 t_b`, a circular convolution."""
        return jnp.fft.ifft(self.spectrum * jnp.fft.fft(t))


class _Row:
    """Contribution of one output."""

    def __init__(self, h: Array, s: Array, P: OffNumerators | Window, half: Array, b: Array):
        self.h, self.s, self.off, self.half, self.b = h, s, P, half, b
        self.Y = P(h[:, None] * half)
        self.r = P(h * b)

    def curvature(self) -> Array:
        r""":math:`E[\Delta Z \Delta]\,b`."""
        z = jnp.sum(jnp.abs(self.half) ** 2, axis=1)
        own = self.s * jnp.sum(jnp.abs(self.Y) ** 2, axis=1) * self.b
        cross = self.h.conj() * self.off(self.s * z * self.r)
        return own + cross + self.s * self.b * self.off.squared(self.s * z)

    def parts(self, g: Array) -> tuple[Array, Array]:
        return self.b * self.off((g * self.h.conj()).conj()).conj(), g * self.r

    def product(self, g: Array, q: Array) -> Array:
        """Mean of the product of two probes."""
        (a1, b1), (a2, b2) = self.parts(g), self.parts(q)
        return jnp.sum(self.s * (a1 * b2 + b1 * a2)) + jnp.sum(
            self.s * g * self.b * self.off.squared(self.s * self.b * q)
        )

    def power(self, g: Array) -> Array:
        """Mean square of a probe."""
        a, b = self.parts(g)
        linear = jnp.sum(self.s * (jnp.abs(a) ** 2 + jnp.abs(b) ** 2))
        return linear + jnp.sum(self.s * jnp.abs(g) ** 2 * self.off.squared(self.s * jnp.abs(self.b) ** 2).real)
