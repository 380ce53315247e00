r"""Matrix fractions in one variable: from a triangular factor to the poles of every order.

All three polynomial estimators end in the same problem: find blocks :math:`A_k` (``i x i``) so that

.. math:: \Big\|\sum_{k=0}^{n} Y_k A_k\Big\| \to \min

under a constraint that excludes :math:`A = 0`. With the columns ordered by degree, the triangular factor of the
largest order holds that of every smaller one in its leading corner, so that one orthogonal factorisation serves a
whole stabilization diagram, and nothing is squared.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Bool, Complex, Float, Inexact, Int

from modalax._numerics.powers import powers

CONSTRAINTS = ("a0", "aN", "norm")


def check_constraint(constraint: str) -> str:
    """Return ``constraint`` if it is known; ``ValueError`` lists the known ones."""
    if constraint not in CONSTRAINTS:
        raise ValueError(f"constraint is {constraint!r}; it must be one of {', '.join(CONSTRAINTS)}")
    return constraint


@partial(jax.jit, static_argnames=("size", "constraint", "steps"))
def coefficients(
    R: Inexact[Array, "m m"],
    order: Int[Array, ""],
    size: int,
    constraint: str,
    added: Float[Array, ""] | float = 0.0,
    steps: int = 0,
) -> Inexact[Array, "k i i"]:
    r"""Blocks :math:`A_0 \dots A_n` of order ``order``, padded with zeros to the largest.

    Where :math:`R^HR` is a normal matrix with a ridge :math:`\rho I` added, each of ``steps`` steps takes the effect of
    the ridge out of the solution, :math:`x \leftarrow x_0 + \rho\,(R^HR)^{-1} x` (iterated Tikhonov regularisation).

    Parameters
    ----------
    R
        Triangular factor of the columns :math:`Y_0, Y_1, \dots`, blocks of ``size`` columns.
    constraint
        ``last`` fixes :math:`A_n = I`; ``first`` :math:`A_0 = I`; ``norm`` takes the smallest singular vectors, which a
        ridge leaves as they are.
    added
        The ridge :math:`\rho`.
    steps
        Number of such steps.
    """
    m = R.shape[0]

    def without_ridge(T: Array, x: Array) -> Array:
        start = x
        for _ in range(steps):
            x = start + added * solve_triangular(T, solve_triangular(T, x, trans="C"))
        return x

    column = jnp.arange(m)
    low, high = order * size, (order + 1) * size
    if constraint == "norm":
        inside = column < high
        masked = jnp.where(inside[None, :] & inside[:, None], R, 0.0)
        # Unused columns get singular values above all others, so that the smallest belong to the model.
        masked = masked + jnp.diag(jnp.where(inside, 0.0, 2 * jnp.linalg.norm(R)))
        A = jnp.linalg.svd(masked)[2][::-1][:size].conj().T
        return A.reshape(m // size, size, size)
    if constraint == "first":
        # Columns size..high-1 explain columns 0..size-1: an upper Hessenberg problem, made triangular again for the
        # largest order, whose factors hold those of every smaller one in their leading columns.
        Q, T = jnp.linalg.qr(R[:, size:])
        inside = column[: m - size] < low
        T = jnp.where(inside[None, :] & inside[:, None], T, 0.0) + jnp.diag(jnp.where(inside, 0.0, 1.0))
        x = solve_triangular(T, jnp.where(inside[:, None], -Q.conj().T @ R[:, :size], 0.0))
        A = jnp.concatenate([jnp.eye(size, dtype=R.dtype), without_ridge(T, x)])
        return A.reshape(m // size, size, size)
    inside = column < low
    square = jnp.where(inside[None, :] & inside[:, None], R, 0.0) + jnp.diag(jnp.where(inside, 0.0, 1.0))
    right = jnp.where(inside[:, None], lax.dynamic_slice(R, (jnp.zeros_like(low), low), (m, size)), 0.0)
    x = without_ridge(square, solve_triangular(square, -right))
    A = lax.dynamic_update_slice(x, jnp.eye(size, dtype=R.dtype), (low, jnp.zeros_like(low)))
    return A.reshape(m // size, size, size)


@jax.jit
def roots(
    A: Inexact[Array, "k i i"], order: Int[Array, ""]
) -> tuple[Complex[Array, " p"], Complex[Array, "p i"], Bool[Array, " p"]]:
    r"""Values :math:`u` and row vectors :math:`w` with :math:`w^T A(u) = 0`, from eigenvalues, then Newton's method.

    The eigenvalues of the block companion matrix are taken as constants and polished by two Newton steps on
    :math:`(u, w)`, which gives them exact first and second derivatives with respect to the coefficients
    and saves differentiating an eigenvector basis. Entries beyond ``order`` are not valid.
    """
    k, size, _ = A.shape
    count = (k - 1) * size
    start_u, start_w = _companion(lax.stop_gradient(A), order)
    u, w = jax.vmap(polish, in_axes=(None, 0, 0))(A.astype(jnp.complex128), start_u, start_w)
    valid = jnp.isfinite(u) & (jnp.abs(start_u) < _DUMMY / 2)
    return u, w, valid & (jnp.arange(count) < count)


_DUMMY = 1e6  # magnitude of eigenvalues that only pad the array


def _companion(A: Array, order: Array) -> tuple[Array, Array]:
    """Eigenvalues and left null vectors by the block companion matrix; unused rows get far, distinct eigenvalues."""
    k, size, _ = A.shape
    m = (k - 1) * size
    # w^T A(u) = 0 is A(u)^T w = 0; the leading block is that of the order asked for.
    transposed = jnp.swapaxes(A, 1, 2)
    lead = lax.dynamic_index_in_dim(transposed, order, keepdims=False)
    body = -jnp.linalg.solve(lead, transposed[:-1])
    shift = jnp.diag(jnp.ones(m - size, A.dtype), size) if m > size else jnp.zeros((m, m), A.dtype)
    row = jnp.swapaxes(body, 0, 1).reshape(size, m)
    low = order * size
    index = jnp.arange(m)
    inside = index < low
    C = jnp.where(inside[:, None] & inside[None, :], shift, 0.0)
    last = (index[:, None] >= low - size) & inside[:, None] & inside[None, :]
    placed = jnp.where(last, jnp.take(row, jnp.mod(index - low, size), axis=0), 0.0)
    C = jnp.where(last, placed, C)
    C = C + jnp.diag(jnp.where(inside, 0.0, _DUMMY * (1.0 + index)))
    if size == 1:
        values = jnp.linalg.eigvals(C)
        return values, jnp.ones((m, 1), jnp.complex128)
    values, vectors = jnp.linalg.eig(C)
    w = vectors[:size].T
    return values, w / jnp.maximum(jnp.linalg.norm(w, axis=1, keepdims=True), 1e-300)


def polish(A: Array, u: Array, w: Array) -> tuple[Array, Array]:
    r"""Two Newton steps on :math:`A(u)^T w = 0,\ c^H w = 1` with the start as :math:`c`; the start if they diverge."""
    size = A.shape[1]
    u, w = lax.stop_gradient(u), lax.stop_gradient(w)
    c = w.conj()
    exponent = np.arange(1, A.shape[0])
    outside = jnp.abs(u) > 1
    # Outside the disc high powers overflow: there the reversed polynomial in 1/u is the one to evaluate.
    B = jnp.where(outside, A[::-1], A)
    v = jnp.where(outside, 1 / u, u)
    far = jnp.abs(u) > _DUMMY / 2
    v = jnp.where(far, 1.0, v)

    def value(v: Array) -> tuple[Array, Array]:
        p = powers(v, A.shape[0])
        return jnp.tensordot(p, B, 1).T, jnp.tensordot(exponent * p[:-1], B[1:], 1).T

    start = v
    for _ in range(2):
        P, dP = value(v)
        if size == 1:
            step = P[0, 0] / dP[0, 0]
            v = v - step
        else:
            system = jnp.block([[P, (dP @ w)[:, None]], [c[None, :], jnp.zeros((1, 1))]])
            delta = jnp.linalg.solve(system, -jnp.concatenate([P @ w, (c @ w - 1)[None]]))
            w, v = w + delta[:size], v + delta[size]
    # A multiple root has no Newton step: keep the eigenvalue there.
    good = jnp.isfinite(v) & (jnp.abs(v - start) < 1e-3)
    v = jnp.where(good, v, start)
    return jnp.where(far, u, jnp.where(outside, 1 / v, v)), w
