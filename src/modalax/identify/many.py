r"""Stabilization diagrams of thousands of noisy copies of one set of FRFs at once.

Three properties of LSCF with :math:`A_n = 1` make a diagram cheap where many of the same size are wanted:

* The normal matrix follows from the moments :math:`c(d) = \sum_f h u^d`, since :math:`X^H\mathrm{diag}(h)X` with
  :math:`u^k` as columns has one value a diagonal. For all copies they are one product. Small sets with noise need not
  the digits of :mod:`modalax.identify.moments`.
* With its triangular factor :math:`R` the coefficients of every order are the columns of :math:`R^{-1}`, each divided
  by its diagonal entry.
* The roots of copies lie near each other. The Ehrlich-Aberth iteration moves all roots of all copies and orders
  together from the roots of a typical copy, and converges cubically to the same roots as eigenvalues give.

Ehrlich (1967), CACM 10, 107; Aberth (1973), Math. Comp. 27, 339.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Complex, Float, Inexact

from modalax._numerics.checks import as_array
from modalax._numerics.devices import over_devices
from modalax._numerics.known import Numbers
from modalax._numerics.powers import powers
from modalax.identify.lscf import ARC
from modalax.identify.zoom import check_orders, zoom

CUT = 1e-12  # eigenvalues of the numerator's Gram matrix below this part of the largest are not seen on the arc
LEAST = 1e-6  # least noise, relative to the FRFs, that their squares still show
STEPS = 60  # most steps of the iteration; roots that still move after them are taken from eigenvalues
STILL = 1e-6  # step, relative to the unit circle, after which the next one, a cube of it, is below rounding
GROUPS = (0.4, 0.6, 0.8, 1.0)  # parts of the highest order up to which orders are computed together
FAR = 1e3  # where roots are put that only fill the array


def many_poles(
    omega: Float[np.ndarray, " f"], H: Float[np.ndarray, "draw 2 row f"], order: int
) -> tuple[Complex[Array, "draw n order"], np.ndarray]:
    r"""Poles of the orders 2 to ``order`` of LSCF for every copy, as :func:`modalax.identify.lscf` finds them.

    Parameters
    ----------
    omega
        Circular frequency of the lines [rad/s].
    H
        Real and imaginary parts of the FRFs of each copy, one row for each. Their noise must be above ``LEAST`` of
        their size, for the moments square it.
    order
        Highest order, 2 or more.

    Returns
    -------
    poles
        Shape ``(draw, order - 1, order)`` [rad/s]; entries beyond an order are 0.
    valid
        Which entries are poles, shape ``(order - 1, order)``.

    Raises
    ------
    ValueError
        If there are too few lines for the order, or the noise is too small for the normal matrix.
    """
    ends = (float(omega[0]) / (2 * np.pi), float(omega[-1]) / (2 * np.pi))
    orders = check_orders(range(2, order + 1), len(omega), ends)
    A = _coefficients(over_devices(H), as_array(omega), order)
    A = np.asarray(A)
    if not np.isfinite(A).all():
        raise ValueError("the normal matrix of some copies is singular; they have too little noise for moments")
    roots = [_roots(A[: high + 1, low : high + 1], low) for low, high in _groups(orders)]
    valid = np.arange(order) < np.asarray(orders)[:, None]
    return _poles(roots, as_array(omega), as_array(valid)), valid


@partial(jax.jit, static_argnums=2)
def _coefficients(H: Array, omega: Array, order: int) -> Complex[Array, "k order draw"]:
    """Coefficients of every order in the columns of a matrix for each copy, by real products."""
    draws, _, rows, f = H.shape
    m = order + 1
    span = powers(zoom(omega, ARC, False).circle(omega), m)
    parts = jnp.concatenate([span.real, span.imag], axis=1)
    first = (H.reshape(-1, f) @ parts).reshape(draws, 2, rows, 2, m)
    real, imag = first[:, 0], first[:, 1]
    ahead = real[:, :, 0] - imag[:, :, 1] + 1j * (real[:, :, 1] + imag[:, :, 0])
    behind = real[:, :, 0] + imag[:, :, 1] + 1j * (imag[:, :, 0] - real[:, :, 1])
    second = jnp.sum(H**2, axis=(1, 2)) @ parts
    power = second[:, :m] + 1j * second[:, m:]
    index = np.arange(m)[None, :] - np.arange(m)[:, None] + order  # entry (j, k) is the moment k - j
    T = jnp.concatenate([power[:, :0:-1].conj(), power], axis=1)[:, index]
    ones = jnp.sum(span, axis=0)
    W = _inverse_root(jnp.concatenate([ones[:0:-1].conj(), ones])[index])
    # Real products, which are several times as fast as complex ones; entry (draw, column, row, line) of S.
    c = jnp.concatenate([behind[..., :0:-1], ahead], axis=-1)
    S = jnp.swapaxes(c[:, :, index.T], 1, 2)
    S = jnp.concatenate([S.real, S.imag], axis=-1).reshape(-1, 2 * m)
    X = (S @ jnp.concatenate([W.real.T, -W.imag.T])).reshape(draws, m, -1)
    Y = (S @ jnp.concatenate([W.imag.T, W.real.T])).reshape(draws, m, -1)
    across = X @ jnp.swapaxes(Y, 1, 2)
    explained = X @ jnp.swapaxes(X, 1, 2) + Y @ jnp.swapaxes(Y, 1, 2) + 1j * (across - jnp.swapaxes(across, 1, 2))
    G = T - explained + 1e-14 * m * T[:, :1, :1].real * jnp.eye(m)
    L = jnp.linalg.cholesky(G)
    inverse = jax.scipy.linalg.solve_triangular(L, jnp.broadcast_to(jnp.eye(m, dtype=L.dtype), L.shape), lower=True)
    A = jnp.transpose(inverse.conj(), (2, 1, 0))
    return A / jnp.diagonal(A).T


def _inverse_root(gram: Array) -> Array:
    """``W`` with ``W^H W`` the inverse of the Gram matrix on the directions that the arc can see."""
    values, vectors = jnp.linalg.eigh(gram)
    seen = values > CUT * values[-1]
    scale = jnp.where(seen, 1 / jnp.sqrt(jnp.where(seen, values, 1.0)), 0.0)
    return scale[:, None] * vectors.conj().T


@jax.jit
def _poles(roots: list[Array], omega: Array, valid: Array) -> Complex[Array, "draw n order"]:
    """Poles of all groups of orders in one array."""
    zoomed = zoom(omega, ARC, False)
    pad = lambda u: jnp.pad(jnp.transpose(u, (2, 1, 0)), ((0, 0), (0, 0), (0, valid.shape[1] - len(u))))
    u = jnp.concatenate([pad(u) for u in roots], axis=1)
    return jnp.where(valid, zoomed.poles(jnp.where(valid, u, 1.0)), 0.0)


def _groups(orders: tuple[int, ...]) -> list[tuple[int, int]]:
    """First and last order of groups that are padded to one size."""
    ends = sorted({max(orders[0], round(part * orders[-1])) for part in GROUPS})
    return list(zip([orders[0], *(e + 1 for e in ends[:-1])], ends, strict=True))


def _roots(A: Complex[Numbers, "k order draw"], low: int) -> Complex[Array, "root order draw"]:
    """Roots of the orders from ``low`` on, whose coefficients are the columns of ``A``."""
    count, last = A.shape[1], len(A) - 1
    orders = range(low, low + count)
    used = np.arange(last)[:, None] < np.asarray(orders)
    start = np.where(used, 1.0, FAR + np.arange(last)[:, None]).astype(complex)
    typical = np.mean(A, axis=2)
    for k, n in enumerate(orders):
        start[:n, k] = companion_roots(typical[None, :n, k])[0]
    found, step = _aberth(over_devices(A, axis=2), start, used.astype(float))
    late = np.flatnonzero(~(np.asarray(step) <= STILL))
    if not late.size:
        return found
    settled, lower = np.array(found), np.asarray(A)
    for k, n in enumerate(orders):
        settled[:n, k, late] = companion_roots(lower[:n, k, late].T).T
    return as_array(settled)


def companion_roots(a: Inexact[np.ndarray, "draw n"]) -> Complex[np.ndarray, "draw n"]:
    """Roots of monic polynomials from their lower coefficients, as eigenvalues."""
    draws, n = a.shape
    C = np.zeros((draws, n, n), dtype=complex)
    C[:, np.arange(1, n), np.arange(n - 1)] = 1
    C[:, :, -1] = -a
    return np.linalg.eigvals(C)


@jax.jit
def _aberth(A: Complex[Array, "k order draw"], start: Array, used: Array) -> tuple[Array, Array]:
    """Ehrlich-Aberth iteration from the roots ``start``, shape ``(root, order)``, the same for all copies.

    A step is written with real and imaginary parts apart, for complex arithmetic is not vectorised, and has one array
    as its result: from several the compiler makes several programs, each of which computes the whole step.

    Returns
    -------
    Roots, shape ``(root, order, draw)``, and the largest last step of each copy, shape ``(draw,)``.
    """
    count, shape = len(start), (*start.shape, A.shape[-1])
    real, imag, used = A.real, A.imag, used[..., None]

    def step(z: Array) -> Array:
        x, y = z.real, z.imag
        p, q = jnp.broadcast_to(real[count], shape), jnp.broadcast_to(imag[count], shape)
        dp, dq = jnp.zeros(shape), jnp.zeros(shape)
        for k in range(count - 1, -1, -1):
            dp, dq = dp * x - dq * y + p, dp * y + dq * x + q
            p, q = p * x - q * y + real[k], p * y + q * x + imag[k]
        s, t = jnp.zeros(shape), jnp.zeros(shape)
        for k in range(count):
            ax, ay = x - x[k], y - y[k]
            size = ax**2 + ay**2
            weight = used[k] / jnp.where(size > 0, size, jnp.inf)
            s, t = s + ax * weight, t - ay * weight
        e, f = dp - (p * s - q * t), dq - (p * t + q * s)
        size = e**2 + f**2
        weight = used / jnp.where(size > 0, size, jnp.inf)
        return lax.complex(x - (p * e + q * f) * weight, y - (q * e - p * f) * weight)

    moved = lambda state: jnp.max(jnp.abs(state[1] - state[2]), axis=(0, 1))
    go = lambda state: (state[0] < STEPS) & (jnp.max(moved(state)) > STILL)
    first = jnp.broadcast_to(start[..., None], shape)
    state = lax.while_loop(go, lambda state: (state[0] + 1, step(state[1]), state[1]), (0, first, first + 1.0))
    return state[1], moved(state)
