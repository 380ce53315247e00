r"""What noise does to the mean of LSCF and pLSCF: damping falls, frequency stays.

The poles of the expected problem :math:`M_0 + C` (see :mod:`modalax.identify.normal`) are found by the whole solve,
because in over-modelled orders :math:`M_0` is singular and no expansion about it exists. Each mode is followed from
small noise to the full one, so that its pole is known even where it ends far from where it began.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Complex, Float

from modalax._numerics.checks import as_double
from modalax.data.frf import FRF
from modalax.identify.normal import LinearProblem, expected_factor, factor, linear_problem, noise_rows
from modalax.identify.polynomial import poles_of_factor, without_window
from modalax.identify.tables import PoleTable
from modalax.identify.zoom import check_orders

SMALLEST, STEPS = 1e-6, 33


class DampingBias(eqx.Module):
    r"""Predicted bias of each mode's LSCF or pLSCF estimate: expected value minus true value.

    Attributes
    ----------
    poles
        Poles that the estimator gives on average, shape ``(n,)`` [rad/s].
    damping
        Bias of the damping ratio, shape ``(n,)`` [-].
    relative_damping
        The same divided by the damping ratio, shape ``(n,)``.
    relative_frequency
        Bias of the frequency divided by it, shape ``(n,)``.
    valid
        False where the prediction cannot be trusted: the mode is lost in the noise on average (its pole left the
        stable half, or another root came as close), or it is not among the noise-free poles of this order.
    """

    poles: Complex[Array, " n"]
    damping: Float[Array, " n"]
    relative_damping: Float[Array, " n"]
    relative_frequency: Float[Array, " n"]
    valid: Bool[Array, " n"]


def expected_poles(frf: FRF, orders: Any, *, scale: Any = 1.0, **options: Any) -> PoleTable:
    r"""Poles of the expected normal matrix :math:`M_0 + C`: what LSCF or pLSCF finds, on average, in noise.

    Parameters
    ----------
    frf
        The FRF without noise: of a model, at the lines of the measurement.
    orders
        Orders as in :func:`lscf`.
    scale
        Factor on the noise variance.
    **options
        ``variance`` (``(f, o, i)`` or a number; that of ``frf`` by default), ``method`` (``lscf`` or ``plscf``), and
        the options of that method.

    Returns
    -------
    PoleTable
        Differentiable with respect to the FRF, the variance, its scale and the ridge, twice.

    Raises
    ------
    ValueError
        As :func:`lscf`, and if there is no variance.
    """
    found = check_orders(orders, frf.freq.shape[0], (float("nan"), float("nan")))
    problem = linear_problem(frf, found[-1], **options)
    return without_window(_table(problem, expected_factor(problem, scale), found), frf)


def pole_paths(
    frf: FRF, poles: Complex[Array, " n"], order: int, scales: Float[Array, " t"], **options: Any
) -> tuple[Complex[Array, "t n"], Bool[Array, "t n"]]:
    r"""Paths of the expected poles of some modes as the noise variance grows along ``scales``.

    Parameters
    ----------
    frf, options
        As :func:`expected_poles`.
    poles
        Where the modes are without noise, shape ``(n,)`` [rad/s].
    order
        One order.
    scales
        Factors on the noise variance, rising, the first small enough that each mode is still at its place.

    Returns
    -------
    poles, certain
        Shape ``(t, n)``; ``certain`` is False from where a mode's successor was in doubt.
    """
    problem = linear_problem(frf, order, **options)
    table = _along(problem, scales)
    found, certain = follow_poles(table.poles, table.valid, poles - frf.added_decay)
    return found + frf.added_decay, certain


def predicted_damping_bias(frf: FRF, poles: Complex[Array, " n"], order: int, **options: Any) -> DampingBias:
    r"""Bias that noise gives the damping of each mode in LSCF or pLSCF, without drawing any noise.

    Parameters
    ----------
    frf
        The FRF without noise, at the lines of the measurement: ``model.frf(freq, form=...)`` of a refined model,
        not the measurement itself, whose noise would count twice.
    poles
        The model's poles, shape ``(n,)`` [rad/s].
    order
        The order at which the estimate was read off. If it was one row of a diagram of several orders, pass that
        diagram's highest order as ``numerator``.
    **options
        ``variance``: :math:`E|e|^2` of each sample, ``(f, o, i)`` or a number; that of ``frf`` by default.
        ``method``: ``lscf`` (default) or ``plscf``. And the options of that method as they were used: ``weights``,
        ``constraint``, ``real``, ``arc``, ``ridge``, ``numerator``.

    Returns
    -------
    DampingBias
        Expected minus true value of each mode, with a flag where it cannot be trusted.

    Raises
    ------
    ValueError
        If there is no variance, or an option is unknown.

    Notes
    -----
    The poles of the mean normal matrix, not the mean of the poles: the spread of the normal matrix adds a term of
    second order, see :func:`modalax.identify.spread.second_order`. With ``magnitude`` weights, which depend on the
    noise, the prediction takes the weights of the noise-free FRF.
    """
    problem = linear_problem(frf, order, **options)
    poles = as_double(poles, "poles", complex_=True)
    return _bias(problem, poles, frf.added_decay)


@eqx.filter_jit
def _bias(problem: LinearProblem, poles: Complex[Array, " n"], decay: Float[Array, ""]) -> DampingBias:
    table = _along(problem, jnp.concatenate([jnp.geomspace(SMALLEST, 1.0, STEPS)]))
    found, certain = follow_poles(table.poles, table.valid, poles - decay)
    end = found[-1] + decay
    zeta, expected = -poles.real / jnp.abs(poles), -end.real / jnp.abs(end)
    valid = certain[-1] & (expected > 0)
    return DampingBias(end, expected - zeta, expected / zeta - 1, jnp.abs(end) / jnp.abs(poles) - 1, valid)


def one_pole_shift(noise: Any, energy: Any, step: Any) -> Float[Array, ""]:
    r"""Shift of a single pole in closed form, :math:`\Delta\lambda = \ln(1 + \rho/M_{11})/T`: real, so frequency stays.

    With ``a0 = 1`` and one pole, :math:`u = -M_{01}/M_{11}` in powers of :math:`u^{-1}`; a ridge :math:`\rho` on
    :math:`M_{11}` shrinks the coefficient and moves the root outward by :math:`1 + \rho/M_{11}`.

    Parameters
    ----------
    noise
        The ridge :math:`\rho`: the noise matrix C where the lines fill the circle.
    energy
        :math:`M_{11}` without noise.
    step
        :math:`T` of the map on the circle [s].

    Returns
    -------
    Float[Array, ""]
        Shift of the real part of the pole [rad/s], positive: less damping.
    """
    return jnp.log1p(jnp.asarray(noise) / energy) / step


def _table(problem: LinearProblem, R: Array, orders: tuple[int, ...]) -> PoleTable:
    return poles_of_factor(R, orders, problem.size, problem.constraint, problem.real, problem.zoomed, problem.method)


def _along(problem: LinearProblem, scales: Float[Array, " t"]) -> PoleTable:
    """Expected poles at every scale, one row a scale; signal and noise are factorised once."""
    # The ridge of the signal alone: it only decides where signal and noise leave the coefficients open.
    signal, noise = factor(problem), jnp.linalg.qr(noise_rows(problem), mode="r")

    def at(scale: Array) -> PoleTable:
        R = jnp.linalg.qr(jnp.concatenate([signal, jnp.sqrt(scale) * noise]), mode="r")
        return _table(problem, R, (problem.order,))

    tables = lax.map(at, scales)
    return PoleTable(tables.poles[:, 0], tables.valid[:, 0], None, (problem.order,), problem.method)


def follow_poles(
    poles: Complex[Array, "t p"], valid: Bool[Array, "t p"], start: Complex[Array, " n"]
) -> tuple[Complex[Array, "t n"], Bool[Array, "t n"]]:
    """The successors of ``start`` along the first axis; certain while no other root is nearly as close."""

    def step(state: tuple[Array, Array, Array], row: tuple[Array, Array]) -> tuple[Any, Any]:
        last, drift, certain = state
        here, good = row
        aim = last + drift
        distance = jnp.where(good, jnp.abs(here[None, :] - aim[:, None]), jnp.inf)
        near = jnp.argmin(distance, axis=1)
        best = jnp.min(distance, axis=1)
        second = jnp.min(jnp.where(jnp.arange(here.shape[0])[None, :] == near[:, None], jnp.inf, distance), axis=1)
        certain = certain & (best < 0.5 * second)
        now = here[near]
        return (now, now - last, certain), (now, certain)

    first = (start, jnp.zeros_like(start), jnp.ones(start.shape, bool))
    _, (found, certain) = lax.scan(step, first, (poles, valid))
    return found, certain & ~is_shared(found)


def is_shared(poles: Complex[Array, "t n"]) -> Bool[Array, "t n"]:
    """Which modes ended on the same root as another one."""
    same = jnp.abs(poles[:, :, None] - poles[:, None, :]) == 0
    return jnp.sum(same, axis=2) > 1
