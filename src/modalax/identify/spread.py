r"""Spread of LSCF's normal matrix: the second term of the bias, and the standard deviation of the poles.

The noise :math:`e` enters the normal matrix as :math:`\tilde M - E\tilde M = \Phi^H \Delta \Phi` with

.. math:: \Delta = \sum_o D_h^* P D_e + D_e^* P D_h + (D_e^* P D_e - E),

:math:`D_h, D_e` diagonal with the FRF and the noise of one output, :math:`P` the projector off its numerator. The
coefficients move by :math:`-K\delta a_1 + K\delta K\delta a`, :math:`K` the inverse of the expected normal matrix
without the fixed coefficient. Moments of circular Gaussian noise give both moments of the poles in closed form: no
noise is drawn.
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
from modalax.identify.normal import LinearProblem, expected_factor, linear_problem
from modalax.identify.polynomial import LAST

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
    A = coefficients(R, jnp.asarray(problem.order), 1, LAST[problem.constraint])[:, 0, 0]
    keep = jnp.delete(jnp.arange(problem.order + 1), FIXED[problem.constraint])
    T = jnp.linalg.qr(R[:, keep], mode="r")
    basis = problem.powers()
    half = _solve(T, basis[:, keep])  # half half^H = Phi K Phi^H
    b = basis @ A
    rows = [_Row(problem, k, half, b) for k in range(problem.H.shape[1])]
    K_mean = solve_triangular(T, half.conj().T @ sum(row.curvature() for row in rows))  # K Phi^H E[Delta Z Delta] b

    def one(pole: Array) -> tuple[Array, Array, Array, Array]:
        u = jnp.exp(-(pole - decay - 1j * problem.zoomed.centre) * problem.zoomed.step)
        for _ in range(3):
            u = u - _value(A, u, 0) / _value(A, u, 1)
        slope, bend = _value(A, u, 1), _value(A, u, 2)
        powers = jnp.arange(problem.order + 1.0)
        g0 = _probe(T, half, (u**powers)[keep])
        g1 = _probe(T, half, (powers * u ** jnp.maximum(powers - 1, 0))[keep])
        square = sum(row.product(g0, g0) for row in rows)
        mixed = sum(row.product(g0, g1) for row in rows)
        second = -(u**powers)[keep] @ K_mean / slope + mixed / slope**2 - bend * square / (2 * slope**3)
        first2 = square / slope**2
        power = sum(row.power(g0) for row in rows) / jnp.abs(slope) ** 2
        step = problem.zoomed.step
        shift = -second / (u * step) + first2 / (2 * u**2 * step)
        here = 1j * problem.zoomed.centre - jnp.log(u) / step + decay
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


class _Row:
    """What one output contributes; ``P`` acts through an orthonormal basis of the numerators."""

    def __init__(self, problem: LinearProblem, k: int, half: Array, b: Array):
        w = problem.weight[:, k]
        self.h, self.s = w * problem.H[:, k, 0], w**2 * problem.variance[:, k, 0]
        self.Q, self.half, self.b = problem.basis_of(w), half, b
        self.Y = self.off(self.h[:, None] * half)
        self.r = self.off(self.h * b)

    def off(self, x: Array) -> Array:
        return x - self.Q @ (self.Q.conj().T @ x)

    def squared(self, t: Array) -> Array:
        r""":math:`\sum_b |P_{ab}|^2 t_b`."""
        leverage = jnp.sum(jnp.abs(self.Q) ** 2, axis=1)
        inner = self.Q.conj().T @ (t[:, None] * self.Q)
        return (1 - 2 * leverage) * t + jnp.einsum("ap,pq,aq->a", self.Q, inner, self.Q.conj())

    def curvature(self) -> Array:
        r""":math:`E[\Delta Z \Delta]\,b`."""
        z = jnp.sum(jnp.abs(self.half) ** 2, axis=1)
        own = self.s * jnp.sum(jnp.abs(self.Y) ** 2, axis=1) * self.b
        cross = self.h.conj() * self.off(self.s * z * self.r)
        return own + cross + self.s * self.b * self.squared(self.s * z)

    def parts(self, g: Array) -> tuple[Array, Array]:
        return self.b * self.off((g * self.h.conj()).conj()).conj(), g * self.r

    def product(self, g: Array, q: Array) -> Array:
        """Mean of the product of two probes."""
        (a1, b1), (a2, b2) = self.parts(g), self.parts(q)
        return jnp.sum(self.s * (a1 * b2 + b1 * a2)) + jnp.sum(self.s * g * self.b * self.squared(self.s * self.b * q))

    def power(self, g: Array) -> Array:
        """Mean square of a probe."""
        a, b = self.parts(g)
        linear = jnp.sum(self.s * (jnp.abs(a) ** 2 + jnp.abs(b) ** 2))
        return linear + jnp.sum(self.s * jnp.abs(g) ** 2 * self.squared(self.s * jnp.abs(self.b) ** 2).real)
