r"""The normal matrix of the polynomial estimators from moments, for large sets of FRFs.

With :math:`u^k` as basis, :math:`X^H\mathrm{diag}(h)X` has one value a diagonal, the moment
:math:`c(d) = \sum_f w^2 h u^d`. So one matrix product over the lines gives the moments of all outputs, and what
remains is one matrix product over the outputs. The condition number is squared on the way: good for measured
data, whose noise is above :math:`10^{-8}`; exact data go through the orthogonal factorisation.
"""

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Complex, Float, Inexact

from modalax._numerics.powers import powers

CUT = 1e-12  # eigenvalues of the numerator's Gram matrix below this part of the largest are not seen on the arc


def normal_from_moments(
    H: Complex[Array, "f row i"],
    weight: Float[Array, " f"],
    u: Complex[Array, " f"],
    order: int,
    numerator: int,
    real: bool,
) -> tuple[Inexact[Array, "m m"], Float[Array, ""]]:
    r"""Normal matrix :math:`\sum_o D_o^H(I - QQ^H)D_o` of some outputs, and the mean diagonal of it with :math:`Q = 0`.

    Parameters are those of :func:`triangular_factor` with one weight a line for all outputs.
    """
    _, n_rows, size = H.shape
    m = (order + 1) * size
    top = max(order, numerator)
    w2 = weight**2
    ahead = powers(u, top + 1)
    span = jnp.concatenate([ahead[:, :0:-1].conj(), ahead], axis=1)  # |u| = 1: negative powers are conjugates
    gram = toeplitz(w2 @ span, numerator + 1, numerator + 1, top)
    whiten = inverse_root(gram.real if real else gram)
    c = jnp.einsum("fri,fd->rid", H * w2[:, None, None], span)
    # Powers of a column minus powers of a row: entry (j, k) has the moment k - j.
    blocks = lambda r: jnp.stack([toeplitz(c[r, i], numerator + 1, order + 1, top) for i in range(size)], 2)
    second = jnp.einsum("fri,frj,fd->ijd", (H * w2[:, None, None]).conj(), H, span)
    total = jnp.stack(
        [jnp.stack([toeplitz(second[i, j], order + 1, order + 1, top) for j in range(size)], 2) for i in range(size)],
        1,
    )
    G = total.reshape(order + 1, size, order + 1, size).reshape(m, m)
    G = G.real if real else G

    def subtract(r: Array) -> Array:
        S = blocks(r).reshape(numerator + 1, m)
        S = whiten @ (S.real if real else S)
        return S.conj().T @ S

    def add(G: Array, chunk: Array) -> tuple[Array, None]:
        return G - jnp.sum(jax.vmap(subtract)(chunk), axis=0), None

    whole = n_rows // 8 * 8
    if whole:
        G, _ = lax.scan(add, G, jnp.arange(whole).reshape(-1, 8))
    if whole < n_rows:
        G, _ = add(G, jnp.arange(whole, n_rows))
    return G, jnp.trace(total.reshape(m, m)).real / m


def factor_of_normal(
    G: Inexact[Array, "m m"], energy: Float[Array, ""], order: int, ridge: Float[Array, ""]
) -> Inexact[Array, "m m"]:
    """Triangular factor of a normal matrix, kept regular by a ridge relative to its mean diagonal."""
    m = len(G)
    floor = jnp.maximum(ridge * (order + 1), 1e-14 * m) * energy
    return jnp.linalg.cholesky((G + G.conj().T) / 2 + floor * jnp.eye(m)).conj().T


def factor_from_moments(
    H: Complex[Array, "f row i"],
    weight: Float[Array, " f"],
    u: Complex[Array, " f"],
    order: int,
    numerator: int,
    real: bool,
    ridge: Float[Array, ""],
) -> Inexact[Array, "m m"]:
    """Triangular factor of :func:`normal_from_moments`, the same matrix as by QR up to rounding."""
    G, energy = normal_from_moments(H, weight, u, order, numerator, real)
    return factor_of_normal(G, energy, order, ridge)


def toeplitz(moments: Array, rows: int, columns: int, top: int) -> Array:
    """Matrix whose entry ``(j, k)`` is moment ``k - j``; ``moments`` runs from ``-top`` to ``top``."""
    index = jnp.arange(columns)[None, :] - jnp.arange(rows)[:, None] + top
    return moments[index]


def inverse_root(gram: Array) -> Array:
    """``W`` with ``W^H W`` the inverse of the Gram matrix on the directions that the arc can see."""
    values, vectors = jnp.linalg.eigh(gram)
    seen = values > CUT * values[-1]
    scale = jnp.where(seen, 1 / jnp.sqrt(jnp.where(seen, values, 1.0)), 0.0)
    return scale[:, None] * vectors.conj().T
