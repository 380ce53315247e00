r"""Matrix fractions in one variable: from a triangular factor to the poles of every order.

All three polynomial estimators end in the same problem: find blocks :math:`A_k` (``i x i``) so that

.. math:: \Big\|\sum_{k=0}^{n} Y_k A_k\Big\| \to \min

under a constraint that excludes :math:`A = 0`. With the columns ordered by degree, the triangular factor of the
largest order holds that of every smaller one in its leading corner, so that one orthogonal factorisation serves a
whole stabilization diagram, and nothing is squared.
"""

from types import ModuleType
from typing import Any

import numpy as np
from jaxtyping import Bool, Complex, Inexact, Int

from modalax._numerics.known import Numbers, constant, solved, triangular_solved
from modalax._numerics.powers import powers_of

CONSTRAINTS = ("a0", "aN", "norm")


def check_constraint(constraint: str) -> str:
    """Return ``constraint`` if it is known; ``ValueError`` lists the known ones."""
    if constraint not in CONSTRAINTS:
        raise ValueError(f"constraint is {constraint!r}; it must be one of {', '.join(CONSTRAINTS)}")
    return constraint


def coefficients(
    xp: ModuleType,
    R: Inexact[Numbers, "m m"],
    order: Int[Numbers, ""] | int,
    size: int,
    constraint: str,
    added: Numbers | float = 0.0,
    steps: int = 0,
) -> Inexact[Numbers, "k i i"]:
    r"""Blocks :math:`A_0 \dots A_n` of order ``order``, padded with zeros to the largest.

    Where :math:`R^HR` is a normal matrix with a ridge :math:`\rho I` added, each of ``steps`` steps takes the effect of
    the ridge out of the solution, :math:`x \leftarrow x_0 + \rho\,(R^HR)^{-1} x` (iterated Tikhonov regularisation).

    Parameters
    ----------
    xp
        JAX, with which ``order`` may be traced, or NumPy.
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

    def without_ridge(T: Numbers, x: Numbers) -> Numbers:
        start = x
        for _ in range(steps):
            x = start + added * triangular_solved(xp, T, triangular_solved(xp, T, x, adjoint=True))
        return x

    def inside_or(count: Any, square: Numbers, diagonal: Any) -> Numbers:
        """The leading corner of a matrix, and ``diagonal`` outside."""
        inside = np.arange(len(square)) < count
        return xp.where(inside[None, :] & inside[:, None], square, 0.0) + xp.diag(xp.where(inside, 0.0, diagonal))

    column = np.arange(m)
    low, high = order * size, (order + 1) * size
    if constraint == "norm":
        # Unused columns get singular values above all others, so that the smallest belong to the model.
        A = xp.linalg.svd(inside_or(high, R, 2 * xp.linalg.norm(R)))[2][::-1][:size].conj().T
        return A.reshape(m // size, size, size)
    one = xp.eye(size, dtype=R.dtype)
    if constraint == "first":
        # Columns size..high-1 explain columns 0..size-1: an upper Hessenberg problem, made triangular again for the
        # largest order, whose factors hold those of every smaller one in their leading columns.
        Q, T = xp.linalg.qr(R[:, size:])
        T = inside_or(low, T, 1.0)
        x = triangular_solved(xp, T, xp.where((column[: m - size] < low)[:, None], -Q.conj().T @ R[:, :size], 0.0))
        return xp.concatenate([one, without_ridge(T, x)]).reshape(m // size, size, size)
    square, block = inside_or(low, R, 1.0), low + np.arange(size)
    right = xp.where((column < low)[:, None], xp.take(R, block, axis=1), 0.0)
    x = without_ridge(square, triangular_solved(xp, square, -right))
    return xp.where(column[:, None] == block[None, :], 1.0, x).reshape(m // size, size, size)


def roots(
    xp: ModuleType, A: Inexact[Numbers, "k i i"], order: Int[Numbers, ""] | int
) -> tuple[Complex[Numbers, " p"], Complex[Numbers, "p i"], Bool[Numbers, " p"]]:
    r"""Values :math:`u` and row vectors :math:`w` with :math:`w^T A(u) = 0`, from eigenvalues, then Newton's method.

    The eigenvalues of the block companion matrix are taken as constants and polished by two Newton steps on
    :math:`(u, w)`, which gives them exact first and second derivatives with respect to the coefficients
    and saves differentiating an eigenvector basis. Entries beyond ``order`` are not valid.
    """
    start_u, start_w = _companion(xp, constant(xp, A), order)
    u, w = polish(xp, A.astype(np.complex128), start_u, start_w)
    return u, w, xp.isfinite(u) & (xp.abs(start_u) < _DUMMY / 2)


_DUMMY = 1e6  # magnitude of eigenvalues that only pad the array


def _companion(xp: ModuleType, A: Numbers, order: Numbers | int) -> tuple[Numbers, Numbers]:
    """Eigenvalues and left null vectors by the block companion matrix; unused rows get far, distinct eigenvalues."""
    k, size, _ = A.shape
    m = (k - 1) * size
    # w^T A(u) = 0 is A(u)^T w = 0; the leading block is that of the order asked for.
    transposed = xp.swapaxes(A, 1, 2)
    lead = xp.take(transposed, order, axis=0)
    body = -solved(xp, lead, xp.swapaxes(transposed[:-1], 0, 1).reshape(size, m))  # one row of blocks
    shift = xp.diag(xp.ones(m - size, A.dtype), size) if m > size else xp.zeros((m, m), A.dtype)
    low = order * size
    index = np.arange(m)
    inside = index < low
    C = xp.where(inside[:, None] & inside[None, :], shift, 0.0)
    last = (index[:, None] >= low - size) & inside[:, None] & inside[None, :]
    C = xp.where(last, xp.take(body, xp.mod(index - low, size), axis=0), C)
    C = C + xp.diag(xp.where(inside, 0.0, _DUMMY * (1.0 + index)))
    if xp is np and not np.isfinite(C).all():  # of which LAPACK has no eigenvalues
        return np.full(m, np.nan + 0j), np.ones((m, size), complex)
    if size == 1:
        values = xp.linalg.eigvals(C).astype(np.complex128)
        return values, xp.ones((m, 1), np.complex128)
    values, vectors = xp.linalg.eig(C)
    w = vectors[:size].T.astype(np.complex128)
    return values.astype(np.complex128), w / xp.maximum(xp.linalg.norm(w, axis=1, keepdims=True), 1e-300)


def polish(
    xp: ModuleType, A: Complex[Numbers, "k i i"], u: Complex[Numbers, " p"], w: Complex[Numbers, "p i"]
) -> tuple[Complex[Numbers, " p"], Complex[Numbers, "p i"]]:
    r"""Two Newton steps on :math:`A(u)^T w = 0,\ c^H w = 1` with the start as :math:`c`; the start if they diverge."""
    size = A.shape[1]
    u, w = constant(xp, u), constant(xp, w)
    c = w.conj()
    exponent = np.arange(1, A.shape[0])
    # Outside the disc high powers overflow: there the reversed polynomial in 1/u is the one to evaluate.
    outside, far = xp.abs(u) > 1, xp.abs(u) > _DUMMY / 2
    start = v = xp.where(far, 1.0, xp.where(outside, 1 / u, u))

    def value(v: Numbers) -> tuple[Numbers, Numbers]:
        """The transposed polynomial and its derivative at each number, ``(p, i, i)``."""
        p = powers_of(xp, v, A.shape[0])
        both = lambda q, up, down: xp.where(
            outside[:, None, None], xp.tensordot(q, down, 1), xp.tensordot(q, up, 1)
        ).swapaxes(1, 2)
        return both(p, A, A[::-1]), both(exponent * p[:, :-1], A[1:], A[::-1][1:])

    for _ in range(2):
        P, dP = value(v)
        if size == 1:
            v = v - (P / dP)[:, 0, 0]
        else:
            corner = xp.zeros((len(v), 1, 1), np.complex128)
            system = xp.block([[P, dP @ w[:, :, None]], [c[:, None, :], corner]])
            right = xp.concatenate([(P @ w[:, :, None])[:, :, 0], (xp.sum(c * w, axis=1) - 1)[:, None]], axis=1)
            delta = solved(xp, system, -right[:, :, None])[:, :, 0]
            w, v = w + delta[:, :size], v + delta[:, size]
    # A multiple root has no Newton step: keep the eigenvalue there.
    good = xp.isfinite(v) & (xp.abs(v - start) < 1e-3)
    v = xp.where(good, v, start)
    return xp.where(far, u, xp.where(outside, 1 / v, v)), w
