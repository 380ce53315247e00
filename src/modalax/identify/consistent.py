r"""Three estimators that avoid the noise bias of LSCF without iteration, because the noise matrix is known.

In the polynomial basis that is orthonormal under the noise density (Arnoldi's process on the lines), the noise matrix
is the unit matrix: :math:`E[\tilde M] = M_0 + I`. Noise then lifts all eigenvalues evenly and turns no eigenvector.
The estimators differ in what they take from that:

- :func:`subspace` takes the eigenvectors that stand out of the noise, and the poles from their shift invariance;
- :func:`compensated` subtracts what noise has added, :math:`\tilde M - I`, and solves as LSCF does;
- :func:`gtls` takes the eigenvector of the smallest eigenvalue: generalised total least squares.
"""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Complex, Int

from modalax._numerics.checks import as_array
from modalax.data.frf import FRF
from modalax.identify.normal_equations import LinearProblem, linear_problem, noise_density
from modalax.identify.polynomial import limits, without_window
from modalax.identify.tables import PoleTable
from modalax.identify.zoom import check_orders

_DUMMY = 1e3  # magnitude of eigenvalues that only pad the array


def subspace(
    frf: FRF,
    orders: int | Sequence[int],
    *,
    variance: Any = None,
    weights: str = "unit",
    arc: float = 0.9,
    aperture: int | None = None,
    numerator: int | None = None,
) -> PoleTable:
    r"""Poles from the signal space of LSCF's normal matrix: no bias to first order, no iteration.

    Without noise the rows of the problem span the vectors :math:`q(u_r) = [q_0(u_r), \dots, q_n(u_r)]` of the poles.
    White noise leaves that space where it is; the recurrence :math:`\underline{H}^T q(u) = u\,q(u)` gives the poles.

    Parameters
    ----------
    frf
        The FRF, cut to the band of interest.
    orders
        Numbers of poles, one row of the table each.
    variance
        Noise variance, ``(f, o, i)`` or a number; that of ``frf`` by default, and if it has none the same for all.
        Only its ratios matter.
    weights, arc, numerator
        As for :func:`lscf`; the degree of the numerators is that of the aperture by default.
    aperture
        Degree :math:`n` of the polynomials whose space is searched; a tenth of the lines, at least three times the
        largest order, by default.

    Returns
    -------
    PoleTable
        All of them within reach of the noise; computational poles are as likely stable as not.

    Raises
    ------
    ValueError
        If the band holds too few lines for the aperture.

    Notes
    -----
    The frequency-domain relation of ESPRIT (Roy and Kailath, 1989), with Arnoldi's recurrence for the shift.
    """
    found = check_orders(orders, frf.freq.shape[0], limits(frf))
    n = _aperture(frf, found[-1]) if aperture is None else aperture
    if n <= found[-1]:
        raise ValueError(f"order {found[-1]} needs an aperture of at least {found[-1] + 1}, this one is {n}")
    problem, R, H = _whitened(frf, n, variance=variance, weights=weights, arc=arc, numerator=numerator)
    return _table(problem, *_shift_invariant(R, H, found), found, frf, "subspace")


@eqx.filter_jit
def _shift_invariant(
    R: Complex[Array, "k k"], H: Complex[Array, "k j"], orders: tuple[int, ...]
) -> tuple[Complex[Array, "order p"], Bool[Array, "order p"]]:
    n, top = H.shape[1], orders[-1]
    Q = jnp.linalg.svd(R)[2][:top].T
    F = Q[:n].conj().T @ (H.T @ Q)
    last = Q[n]

    def one(p: Int[Array, ""]) -> tuple[Complex[Array, " p"], Bool[Array, " p"]]:
        inside = jnp.arange(top) < p
        r = jnp.where(inside, last, 0.0)
        F_p = jnp.where(inside[:, None] & inside[None, :], F, 0.0)
        # The rows 0..n-1 of Q have the Gram matrix I - r^H r: its inverse in closed form.
        shift = F_p + jnp.outer(r.conj(), r @ F_p) / (1 - jnp.sum(jnp.abs(r) ** 2))
        return _eigenvalues(shift, inside)

    return jax.vmap(one)(as_array(orders))


def compensated(
    frf: FRF,
    orders: int | Sequence[int],
    *,
    variance: Any = None,
    weights: str = "unit",
    arc: float = 0.9,
    numerator: int | None = None,
    keep: float = 1.0,
) -> PoleTable:
    r"""LSCF with the noise matrix subtracted: :math:`(\tilde M - C)\,a = 0` with ``a0 = 1``.

    Parameters
    ----------
    frf, orders, weights, arc, numerator
        As for :func:`lscf`.
    variance
        Noise variance, ``(f, o, i)`` or a number; that of ``frf`` by default. Here its size matters.
    keep
        Directions are solved for where their eigenvalue stands out of the noise by this multiple of the spread that
        noise eigenvalues have (Marchenko and Pastur, 1967); the others get no coefficient, as in LSCF without noise.

    Returns
    -------
    PoleTable
        As :func:`lscf`.

    Raises
    ------
    ValueError
        If there is no variance.
    """
    found = check_orders(orders, frf.freq.shape[0], limits(frf))
    problem, R, H = _whitened(
        frf, found[-1], variance=_known(frf, variance), weights=weights, arc=arc, numerator=numerator
    )
    rows = problem.H.shape[1] * (problem.u.shape[0] - problem.numerator - 1)
    return _table(problem, *_polynomial_roots(R, H, found, (rows, keep)), found, frf, "compensated")


def _compensated(R: Complex[Array, "k k"], n: Int[Array, ""], rows: int, keep: float) -> Complex[Array, " k"]:
    index = jnp.arange(R.shape[0])
    inside, M = index < n, R.conj().T @ R
    block = jnp.where(inside[:, None] & inside[None, :], M, jnp.diag(jnp.where(inside, 0.0, 1e-3)))
    right = jnp.where(inside, lax.dynamic_index_in_dim(M, n, axis=1, keepdims=False), 0.0)
    values, vectors = jnp.linalg.eigh(block)
    edge = (1 + keep * jnp.sqrt(n / rows)) ** 2
    inverse = jnp.where(values > edge, 1 / jnp.where(values > edge, values - 1, 1.0), 0.0)
    x = -vectors @ (inverse * (vectors.conj().T @ right))
    return jnp.where(inside, x, 0.0) + (index == n)


def gtls(
    frf: FRF,
    orders: int | Sequence[int],
    *,
    variance: Any = None,
    weights: str = "unit",
    arc: float = 0.9,
    numerator: int | None = None,
) -> PoleTable:
    r"""Generalised total least squares: the smallest :math:`\mu` of :math:`\tilde M a = \mu C a`.

    Consistent whatever the size of the noise, of which only the ratios must be known. With more poles than the
    structure has, the smallest eigenvalues are all alike and the estimate scatters: for orders close to the number of
    poles.

    Parameters
    ----------
    frf, orders, weights, arc, numerator
        As for :func:`lscf`.
    variance
        Noise variance, ``(f, o, i)`` or a number; that of ``frf`` by default, and if it has none the same for all.

    Returns
    -------
    PoleTable
        As :func:`lscf`.

    Notes
    -----
    Van Huffel and Vandewalle (1989); Pintelon, Guillaume, Vandersteen and Rolain (1998).
    """
    found = check_orders(orders, frf.freq.shape[0], limits(frf))
    problem, R, H = _whitened(frf, found[-1], variance=variance, weights=weights, arc=arc, numerator=numerator)
    return _table(problem, *_polynomial_roots(R, H, found, None), found, frf, "gtls")


def _smallest(R: Complex[Array, "k k"], n: Int[Array, ""]) -> Complex[Array, " k"]:
    inside = jnp.arange(R.shape[0]) <= n
    masked = jnp.where(inside[:, None] & inside[None, :], R, jnp.diag(jnp.where(inside, 0.0, 2 * jnp.linalg.norm(R))))
    c = jnp.linalg.svd(masked)[2][-1].conj()
    return jnp.where(inside, c, 0.0) / c[n]


def _known(frf: FRF, variance: Any) -> Any:
    if variance is None and frf.variance is None:
        raise ValueError(
            "compensated needs the noise variance; this FRF has none: pass variance=, one number or (f, o, i)"
        )
    return variance


def _aperture(frf: FRF, top: int) -> int:
    lines = frf.freq.shape[0]
    return int(min(max(3 * top, lines // 10), (lines - 2) // 3))


def _whitened(frf: FRF, n: int, *, variance: Any, **options: Any) -> tuple[LinearProblem, Array, Array]:
    """The problem, its triangular factor in the basis in which the noise is white, and the recurrence."""
    if variance is None and frf.variance is None:
        variance = jnp.mean(jnp.abs(frf.H) ** 2)
    problem = linear_problem(frf, n, variance=variance, **options)
    return problem, *_white_factor(problem)


@eqx.filter_jit
def _white_factor(problem: LinearProblem) -> tuple[Array, Array]:
    basis, H = _noise_basis(problem)

    def add(R: Array, row: tuple[Array, Array]) -> tuple[Array, None]:
        h, w = row
        Q = common if common is not None else problem.basis_of(w)
        Y = (h * w)[:, None] * basis
        for _ in range(2):
            Y = Y - Q @ (Q.conj().T @ Y)
        return jnp.linalg.qr(jnp.concatenate([R, Y]), mode="r"), None

    common = problem.basis_of(problem.weight[:, 0]) if problem.shared else None
    start = jnp.zeros((problem.order + 1, problem.order + 1), jnp.complex128)
    R, _ = lax.scan(add, start, (problem.H[:, :, 0].T, problem.weight.T))
    return R, H


def _noise_basis(problem: LinearProblem) -> tuple[Complex[Array, "f k"], Complex[Array, "k j"]]:
    r"""Polynomials orthonormal under the noise density, and their recurrence :math:`u\,q = q\,\underline H`."""
    density = jnp.sqrt(noise_density(problem)[:, 0])
    n, f = problem.order, problem.u.shape[0]
    first = density / jnp.linalg.norm(density)
    Q = jnp.zeros((f, n + 1), jnp.complex128).at[:, 0].set(first)

    def body(k: Int[Array, ""], state: tuple[Array, Array]) -> tuple[Array, Array]:
        Q, H = state
        v, h = problem.u * Q[:, k], jnp.zeros(n + 1, jnp.complex128)
        for _ in range(2):
            inner = Q.conj().T @ v
            v, h = v - Q @ inner, h + inner
        size = jnp.linalg.norm(v)
        return Q.at[:, k + 1].set(v / size), H.at[:, k].set(h.at[k + 1].set(size))

    Q, H = lax.fori_loop(0, n, body, (Q, jnp.zeros((n + 1, n), jnp.complex128)))
    return Q / density[:, None], H


def _eigenvalues(A: Complex[Array, "p p"], inside: Bool[Array, " p"]) -> tuple[Complex[Array, " p"], Bool[Array, " p"]]:
    """Eigenvalues of the block ``inside``; the rest gets distinct, far dummies, so that gradients exist."""
    dummies = jnp.diag(jnp.where(inside, 0.0, _DUMMY * (1.0 + jnp.arange(inside.shape[0]))))
    u = jnp.linalg.eigvals(A + dummies)
    return u, jnp.isfinite(u) & (jnp.abs(u) < _DUMMY / 2) & (jnp.abs(u) > 0)


@eqx.filter_jit
def _polynomial_roots(
    R: Complex[Array, "k k"], H: Complex[Array, "k j"], orders: tuple[int, ...], noise: tuple[int, float] | None
) -> tuple[Complex[Array, "order p"], Bool[Array, "order p"]]:
    """Roots of polynomials given in Arnoldi's basis: eigenvalues of the recurrence with its last column changed.

    The polynomials are those of :func:`compensated`, whose rows and margin are in ``noise``, or of :func:`gtls`.
    """
    n = H.shape[1]

    def one(order: Int[Array, ""]) -> tuple[Complex[Array, " p"], Bool[Array, " p"]]:
        c = _smallest(R, order) if noise is None else _compensated(R, order, *noise)
        inside = jnp.arange(n) < order
        block = jnp.where(inside[:, None] & inside[None, :], H[:n], 0.0)
        column = jnp.where(inside, c[:n], 0.0) * H[order, order - 1]
        return _eigenvalues(block - jnp.where((jnp.arange(n) == order - 1)[None, :], column[:, None], 0.0), inside)

    return jax.vmap(one)(as_array(orders))


def _table(problem: LinearProblem, u: Array, valid: Array, orders: tuple[int, ...], frf: FRF, method: str) -> PoleTable:
    poles = problem.zoomed.poles(jnp.where(valid, u, 1.0))
    return without_window(PoleTable(jnp.where(valid, poles, 0.0), valid, None, orders, method), frf)
