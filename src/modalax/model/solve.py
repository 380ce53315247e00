"""The receptance of matrices along given directions, at many frequencies, with exact derivatives."""

from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from modalax._numerics.checks import as_array, is_traced
from modalax._numerics.known import Numbers

DIRECT_DOFS = 16
"""Up to this size one dense solve a frequency is the quickest; above, real modes are tried first."""
PROPORTIONAL = 1e-11
"""Largest coupling of modes through damping, over the largest damping of a mode, that is taken for rounding."""
SOLVES_AT_ONCE = 64
"""Frequencies at which dense systems are solved together."""


def receptance_along(M: Any, C: Any, K: Any, D: Any, omega: Any, rows: Any, columns: Any) -> Complex[Array, "f l r"]:
    r""":math:`L\,(K + jD\,\mathrm{sign}\,\omega + j\omega C - \omega^2 M)^{-1} R` [m/N]; see :func:`compiled_along`.

    Of few DoFs by NumPy where all numbers are known, so that no program is compiled for these lines and directions.
    """
    given = (M, C, K, D, omega, rows, columns)
    if is_traced(*given) or len(M) > DIRECT_DOFS:
        return compiled_along(*given)
    M, C, K, D, omega, rows, columns = (np.asarray(a) for a in given)
    try:
        return as_array(rows @ np.linalg.solve(_dynamic_stiffness(np, M, C, K, D, omega), columns + 0j))
    except np.linalg.LinAlgError:  # infinite at a line
        return compiled_along(*given)


@jax.jit
@jax.custom_jvp
def compiled_along(
    M: Float[Array, "n n"],
    C: Float[Array, "n n"],
    K: Float[Array, "n n"],
    D: Float[Array, "n n"],
    omega: Float[Array, " f"],
    rows: Float[Array, "l n"],
    columns: Float[Array, "n r"],
) -> Complex[Array, "f l r"]:
    r""":math:`L\,(K + jD\,\mathrm{sign}\,\omega + j\omega C - \omega^2 M)^{-1} R` [m/N].

    Proportionally damped structures are taken apart into real modes once, others solved line by line. The derivative is
    exact either way, :math:`dH = -Y^T\,dZ\,X` with the solutions X and Y of both sides, so that close or equal
    natural frequencies do not harm it.
    """
    n = M.shape[0]
    if n <= DIRECT_DOFS:
        Z = _dynamic_stiffness(jnp, M, C, K, D, omega)
        right = jnp.broadcast_to(columns.astype(complex), (omega.shape[0], *columns.shape))
        return rows.astype(complex) @ jnp.linalg.solve(Z, right)
    shift = jnp.max(omega) ** 2 + jnp.max(jnp.abs(jnp.diag(K))) / jnp.max(jnp.diag(M)) * 1e-12
    square, modes = _modes(M, K, shift)
    damping, hysteretic = modes.T @ C @ modes, modes.T @ D @ modes
    proportional = _is_diagonal(damping) & _is_diagonal(hysteretic) & jnp.all(jnp.isfinite(modes))

    def by_modes() -> Complex[Array, "f l r"]:
        w = omega[:, None]
        own = square - w**2 + 1j * (w * jnp.diag(damping) + jnp.sign(w) * jnp.diag(hysteretic))
        left, right = (rows @ modes).astype(complex), (modes.T @ columns).astype(complex)
        return (left[None] / own[:, None, :]) @ right

    def line_by_line() -> Complex[Array, "f l r"]:
        def one(w: Float[Array, ""]) -> Complex[Array, "l r"]:
            return rows @ jnp.linalg.solve(_dynamic_stiffness(jnp, M, C, K, D, w[None])[0], columns.astype(complex))

        return jax.lax.map(one, omega, batch_size=SOLVES_AT_ONCE)

    return jax.lax.cond(proportional, by_modes, line_by_line)


@compiled_along.__wrapped__.defjvp
def _compiled_along_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    M, C, K, D, omega, rows, columns = primals
    dM, dC, dK, dD, domega, drows, dcolumns = tangents
    eye = jnp.eye(M.shape[0])
    X = compiled_along(M, C, K, D, omega, eye, columns)
    Y = compiled_along(M, C, K, D, omega, rows, eye)
    w = omega[:, None, None]
    sign = 1j * jnp.sign(w)

    def between(A: Array) -> Complex[Array, "f l r"]:
        return (Y @ A.astype(complex)) @ X

    change = between(dK) + sign * between(dD) + 1j * w * between(dC) - w**2 * between(dM)
    change = change + domega[:, None, None] * (1j * between(C) - 2 * w * between(M))
    moved = drows.astype(complex) @ X + Y @ dcolumns.astype(complex) - change
    return rows.astype(complex) @ X, moved


def _dynamic_stiffness(xp: ModuleType, M: Any, C: Any, K: Any, D: Any, omega: Any) -> Complex[Numbers, "f n n"]:
    w = omega[:, None, None]
    return K + 1j * xp.sign(w) * D + 1j * w * C - w**2 * M


def _modes(
    M: Float[Array, "n n"], K: Float[Array, "n n"], shift: Float[Array, ""]
) -> tuple[Float[Array, " m"], Float[Array, "n m"]]:
    r"""Squares of natural frequencies [rad^2/s^2] and mass-normalised shapes, from :math:`M\phi = \mu(K+\sigma M)\phi`.

    In this inverse form low modes are exact to rounding even where the highest lies many decades above, and the shift
    allows for free bodies. NaN where the factorisation fails; the caller then solves line by line.
    """
    lower = jnp.linalg.cholesky(K + shift * M)
    half = jax.scipy.linalg.solve_triangular(lower, M, lower=True)
    inner = jax.scipy.linalg.solve_triangular(lower, half.T, lower=True)
    values, vectors = jnp.linalg.eigh(0.5 * (inner + inner.T))
    shapes = jax.scipy.linalg.solve_triangular(lower, vectors, lower=True, trans=1)
    return 1 / values - shift, shapes / jnp.sqrt(values)


def _is_diagonal(A: Float[Array, "m m"]) -> Array:
    own = jnp.diag(A)
    return jnp.max(jnp.abs(A - jnp.diag(own))) <= PROPORTIONAL * jnp.max(jnp.abs(own))
