r"""The band mapped on an arc of the unit circle, so that the same mode comes out of any band that holds it.

With :math:`u(\omega) = e^{-j(\omega-\omega_c)T}`, :math:`\omega_c` the centre of the band and :math:`T` such that the
band covers a chosen part of the circle, every power of :math:`u` has magnitude one on the lines whatever the band,
and a pole follows from a root by :math:`\lambda = j\omega_c - \ln(u)/T`.
"""

from types import ModuleType
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, Inexact

from modalax._numerics.known import Numbers, by_numpy, host, scan


class Zoom(eqx.Module):
    r"""The map from circular frequency to the unit circle.

    Attributes
    ----------
    centre
        :math:`\omega_c`, the frequency that goes to :math:`u = 1`, a number of JAX or NumPy [rad/s].
    step
        :math:`T`, the sampling time of the zoomed signal [s].
    """

    centre: Any
    step: Any

    def circle(self, omega: Float[Array, " f"]) -> Complex[Array, " f"]:
        r""":math:`u = e^{-j(\omega-\omega_c)T}` of each line."""
        return _circle(omega, self.centre, self.step)

    def poles(self, roots: Complex[Array, "..."]) -> Complex[Array, "..."]:
        r"""Poles :math:`\lambda = j\omega_c - \ln(u)/T` [rad/s] of roots :math:`u`."""
        return 1j * self.centre - jnp.log(roots) / self.step


def on_circle(xp: ModuleType, omega: Numbers, centre: Any, step: Any) -> Numbers:
    """:meth:`Zoom.circle` by JAX or NumPy."""
    return xp.exp(-1j * (omega - centre) * step)


_circle = by_numpy(on_circle)


def zoom(omega: Float[Numbers, " f"], arc: float, real: bool) -> Zoom:
    r"""The map that spreads the band of ``omega`` over the part ``arc`` of the circle.

    With complex coefficients the band's centre goes to :math:`u = 1`. With real ones the roots come in conjugate
    pairs, so the band must lie on the upper half of the circle, and its mirror image on the lower half.
    """
    omega = host(omega)
    span = omega[-1] - omega[0]
    if real:
        step = np.pi * arc / span
        margin = (np.pi - step * span) / 2
        return Zoom(omega[0] - margin / step, step)
    return Zoom((omega[0] + omega[-1]) / 2, 2 * np.pi * arc / span)


def orthonormal_powers(
    xp: ModuleType, u: Complex[Numbers, " f"], weight: Float[Numbers, " f"], degree: int, real: bool
) -> Complex[Numbers, "f k"] | Float[Numbers, "f2 k"]:
    r"""Orthonormal basis of :math:`w\,u^k, k = 0 \dots` ``degree``, by Szegő's recurrence.

    Powers on an arc are nearly dependent, so the plain Vandermonde matrix loses all digits at a few dozen degrees.
    Arnoldi's process keeps them (Brubeck, Nakatsukasa and Trefethen, 2021), and as multiplication by :math:`u` is
    unitary on the circle it needs two vectors only, :math:`\phi_k` and :math:`\phi_k^* = u^k \bar\phi_k` (Gragg, 1993):

    .. math:: \rho\,\phi_{k+1} = u\phi_k - \gamma\phi_k^*, \quad
        \rho\,\phi_{k+1}^* = \phi_k^* - \bar\gamma u\phi_k, \quad \gamma = \langle\phi_k^*, u\phi_k\rangle

    What orthogonality rounding has cost (1e-7 at most) one step of Newton's method for the polar factor restores,
    :math:`\tfrac12 Q(3I - Q^HQ)`, within the same space. With ``real`` the basis spans real combinations: real and
    imaginary parts are stacked, shape ``(2 f, k)``.
    """
    return _recurrence(xp, u, weight, degree + 1, real)[0]


def moved_span(
    xp: ModuleType, u: Complex[Numbers, " f"], weight: Float[Numbers, " f"], degree: int, real: bool
) -> tuple[Complex[Numbers, "f k"], Complex[Numbers, " f"], Complex[Numbers, " f"]]:
    r"""Orthonormal basis of the powers 0 to ``degree``, and what their span gains and loses when it is moved.

    The span of :math:`w\,u^{-1} \dots w\,u^{n-1}` has all of that of :math:`w\,u^0 \dots w\,u^n` but :math:`\varphi`,
    the last vector of the basis, and beyond it :math:`\psi`, in Szegő's recurrence :math:`u^{-1}\phi_n^*`.

    Returns
    -------
    basis, phi, psi
        The basis, its last vector, and the vector beyond it, orthonormal to all of the basis but the last. With
        ``real`` orthonormal in the real part of the scalar product.
    """
    common, (phi, reverse) = _recurrence(xp, u, weight, degree, real)
    stack = lambda x: xp.concatenate([x.real, x.imag]) if real else x

    def beyond(x: Numbers) -> Numbers:
        x = stack(x)
        for _ in range(2):  # what rounding left along the basis, and then what the first pass left
            x = x - common @ (common.conj().T @ x)
            x = x / xp.linalg.norm(x)
        return x

    whole = lambda x: x[: len(u)] + 1j * x[len(u) :] if real else x
    last = beyond(phi)
    return whole(xp.concatenate([common, last[:, None]], axis=1)), whole(last), whole(beyond(reverse / u))


def _recurrence(
    xp: ModuleType, u: Complex[Numbers, " f"], weight: Float[Numbers, " f"], count: int, real: bool
) -> tuple[Inexact[Numbers, "row k"], tuple[Complex[Numbers, " f"], Complex[Numbers, " f"]]]:
    """The first ``count`` vectors of Szegő's recurrence, and the pair that follows them."""

    def step(pair: tuple[Numbers, Numbers], _: None) -> tuple[tuple[Numbers, Numbers], Numbers]:
        phi, reverse = pair
        turned = u * phi
        gamma = xp.vdot(reverse, turned)
        gamma = gamma.real if real else gamma
        following, reverse = turned - gamma * reverse, reverse - xp.conj(gamma) * turned
        return (following / xp.linalg.norm(following), reverse / xp.linalg.norm(reverse)), phi

    first = (weight / xp.linalg.norm(weight)).astype(np.complex128)
    after, rows = scan(xp, step, (first, first), length=count)
    rows = xp.concatenate([rows.real, rows.imag], axis=1) if real else rows
    return (1.5 * rows - 0.5 * (rows @ rows.conj().T) @ rows).T, after


def check_orders(orders: object, n_lines: int, band: tuple[float, float], floor: int = 1) -> tuple[int, ...]:
    """Return the orders, rising; ``ValueError`` says why they cannot be used with ``n_lines`` lines.

    Raises
    ------
    ValueError
        With the order asked for and the number of lines it needs.
    """
    try:
        given = np.atleast_1d(np.asarray(orders))
        found = tuple(sorted({int(n) for n in given}))
    except (TypeError, ValueError) as error:
        raise ValueError(f"orders is {orders!r}; it must be an integer or a sequence of integers") from error
    if given.size and (given.dtype.kind not in "iuf" or (given != given.astype(int)).any()):
        raise ValueError(f"orders is {orders!r}; it must be an integer or a sequence of integers")
    if not found:
        raise ValueError("orders is empty; at least one order is needed")
    if found[0] < floor:
        raise ValueError(f"order {found[0]} is below {floor}, the smallest that makes a model")
    need = 2 * (found[-1] + 1)
    if n_lines < need:
        raise ValueError(f"order {found[-1]} needs {need} lines, the band {band[0]:g}-{band[1]:g} Hz holds {n_lines}")
    return found
