r"""Bias of LSCF and pLSCF due to noise: the damping comes out too low, the frequency hardly changes.

The poles of the expected problem :math:`M_0 + C` (see :mod:`modalax.identify.normal_equations`) are found by the whole
solve, because in over-modelled orders :math:`M_0` is singular and no expansion about it exists. Each mode is followed
from small noise to the full one, so that its pole is known even where it ends far from where it began.
"""

from types import ModuleType
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from modalax._numerics.checks import as_array, as_double
from modalax._numerics.cuts import cut
from modalax._numerics.known import Numbers, by_numpy, by_numpy_beside, over_first, scan
from modalax.data.frf import FRF
from modalax.identify.normal_equations import LinearProblem, expected_factor, factor_of, linear_problem, rows_of_noise
from modalax.identify.overview import of_bias
from modalax.identify.polynomial import poles_of_factor, poles_of_orders, without_window
from modalax.identify.tables import PoleTable
from modalax.identify.zoom import check_orders

SMALLEST, STEPS = 1e-6, 33  # first factor on the noise variance of a path, and the number of factors up to 1


class DampingBias(eqx.Module):
    r"""Predicted bias of each mode's estimate: expected value minus true value.

    All of shape ``(n,)`` where one order was asked for, ``(order, n)`` for a sequence of orders.

    Attributes
    ----------
    poles
        Poles that the estimator gives on average [rad/s].
    damping
        Bias of the damping ratio [-].
    relative_damping
        The same divided by the damping ratio.
    relative_frequency
        Bias of the frequency divided by it.
    valid
        False where the prediction cannot be trusted: the mode is lost in the noise on average (its pole left the
        stable half, or another root came as close), or it is not among the noise-free poles of this order.
    """

    poles: Complex[Numbers, "*order n"]
    damping: Float[Numbers, "*order n"]
    relative_damping: Float[Numbers, "*order n"]
    relative_frequency: Float[Numbers, "*order n"]
    valid: Bool[Numbers, "*order n"]

    def __str__(self) -> str:
        """A table of the biases."""
        return of_bias(self)

    @classmethod
    def between(
        cls, true: Complex[Numbers, " n"], expected: Complex[Numbers, " n"], known: Bool[Numbers, " n"]
    ) -> "DampingBias":
        """The bias of the expected poles; not valid either where they are unstable."""
        zeta, mean = -true.real / abs(true), -expected.real / abs(expected)
        shift = abs(expected) / abs(true) - 1
        return cls(expected, mean - zeta, mean / zeta - 1, shift, known & (mean > 0))


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
    R = expected_factor(problem, scale)
    chosen = problem.constraint, problem.real, problem.zoomed, problem.method
    return without_window(poles_of_factor(R, found, problem.size, *chosen), frf)


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
    along, valid = _along(problem, as_array(scales), orders=(order,))
    found, certain = follow_poles(along[:, 0], valid[:, 0], poles - frf.added_decay)
    return found + frf.added_decay, certain


def predicted_damping_bias(frf: FRF, poles: Complex[Array, " n"], orders: Any, **options: Any) -> DampingBias:
    r"""Bias that noise gives the damping of each mode in LSCF or pLSCF, without drawing any noise.

    Parameters
    ----------
    frf
        The FRF without noise, at the lines of the measurement: ``model.frf(freq, form=...)`` of a refined model,
        not the measurement itself, whose noise would count twice.
    poles
        The model's poles, shape ``(n,)`` [rad/s].
    orders
        The orders of the diagram, ``table.orders``, or the one that the estimate was read off. If that is one of
        several whose numerators had the highest degree, as is the default, pass that degree as ``numerator``.
    **options
        ``variance``: :math:`E|e|^2` of each sample, ``(f, o, i)`` or a number; that of ``frf`` by default.
        ``method``: ``lscf`` (default) or ``plscf``. And the options of that method as they were used: ``weights``,
        ``constraint``, ``real``, ``arc``, ``ridge``, ``numerator``.

    Returns
    -------
    DampingBias
        Expected minus true value of each mode, beside the poles of every order if there are several, with a flag
        where it cannot be trusted.

    Raises
    ------
    ValueError
        If there is no variance, or an option is unknown.

    Notes
    -----
    :func:`modalax.identify.fit` has a model and carries this beside each of its dampings; a bare :class:`PoleTable` has
    none, and the derivative of its own poles with respect to the noise is too far from the whole bias to stand for it.

    The poles of the mean normal matrix, not the mean of the poles: the spread of the normal matrix adds a term of
    second order, see :func:`modalax.identify.spread.second_order`. With ``magnitude`` weights, which depend on the
    noise, the prediction takes the weights of the noise-free FRF.
    """
    found = check_orders(orders, frf.freq.shape[0], (float("nan"), float("nan")))
    problem = linear_problem(frf, found[-1], **options)
    poles = as_double(poles, "poles", complex_=True)
    bias = _bias(problem, poles, as_array(frf.added_decay), orders=found)
    return jax.tree.map(lambda a: cut(a, 0), bias) if np.ndim(orders) == 0 else bias


@by_numpy_beside
def _bias(
    xp: ModuleType, problem: LinearProblem, poles: Numbers, decay: Numbers, *, orders: tuple[int, ...]
) -> DampingBias:
    along, valid = along_scales(xp, problem, np.geomspace(SMALLEST, 1.0, STEPS), orders=orders)

    def one(along: Numbers, valid: Numbers) -> DampingBias:
        found, certain = paths_from(xp, along, valid, poles - decay)
        return DampingBias.between(poles, found[-1] + decay, certain[-1])

    return over_first(xp, one, xp.swapaxes(along, 0, 1), xp.swapaxes(valid, 0, 1))


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


def along_scales(
    xp: ModuleType, problem: LinearProblem, scales: Float[Numbers, " t"], *, orders: tuple[int, ...]
) -> tuple[Complex[Numbers, "t order p"], Bool[Numbers, "t order p"]]:
    """Expected poles of every order at every scale, and which are poles; signal and noise are factorised once."""
    # The ridge of the signal alone: it only decides where signal and noise leave the coefficients open.
    signal, noise = factor_of(xp, problem), xp.linalg.qr(rows_of_noise(xp, problem), mode="r")
    chosen = dict(orders=orders, size=problem.size, constraint=problem.constraint, real=problem.real)

    def at(_: None, scale: Any) -> tuple[None, tuple[Numbers, Numbers]]:
        R = xp.linalg.qr(xp.concatenate([signal, xp.sqrt(scale) * noise]), mode="r")
        return None, poles_of_orders(xp, R, problem.zoomed, None, 0.0, **chosen)[:2]

    return scan(xp, at, None, scales)[1]


_along = by_numpy_beside(along_scales)


def paths_from(
    xp: ModuleType, poles: Complex[Numbers, "t p"], valid: Bool[Numbers, "t p"], start: Complex[Numbers, " n"]
) -> tuple[Complex[Numbers, "t n"], Bool[Numbers, "t n"]]:
    """Follow roots along the first axis from ``start``; a path is certain while no other root is nearly as close."""

    def step(state: tuple[Numbers, Numbers, Numbers], row: tuple[Numbers, Numbers]) -> tuple[Any, Any]:
        last, drift, certain = state
        here, good = row
        aim = last + drift
        distance = xp.where(good, xp.abs(here[None, :] - aim[:, None]), np.inf)
        near = xp.argmin(distance, axis=1)
        best = xp.min(distance, axis=1)
        second = xp.min(xp.where(np.arange(here.shape[0])[None, :] == near[:, None], np.inf, distance), axis=1)
        certain = certain & (best < 0.5 * second)
        now = here[near]
        return (now, now - last, certain), (now, certain)

    first = (start, xp.zeros_like(start), xp.ones(start.shape, bool))
    _, (found, certain) = scan(xp, step, first, (poles, valid))
    return found, certain & ~is_shared(xp, found)


follow_poles = by_numpy(paths_from)


def is_shared(xp: ModuleType, poles: Complex[Numbers, "t n"]) -> Bool[Numbers, "t n"]:
    """Whether each mode ended on the same root as another one."""
    same = xp.abs(poles[:, :, None] - poles[:, None, :]) == 0
    return xp.sum(same, axis=2) > 1
