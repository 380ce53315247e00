"""Frequency domain direct parameter identification (FDPI), and real normal modes from it."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Bool, Complex, Float, Int

from modalax._numerics.checks import as_array
from modalax._numerics.known import Numbers
from modalax._numerics.powers import powers
from modalax.data.frf import FRF
from modalax.identify.fraction import polish
from modalax.identify.polynomial import limits, mean_weight, weights_of, without_window
from modalax.identify.tables import PoleTable
from modalax.identify.zoom import check_orders


class NormalModes(eqx.Module):
    r"""Real normal modes straight from the undamped problem :math:`A_0\phi = \omega^2\phi`.

    Attributes
    ----------
    frequency_hz
        Undamped natural frequencies, rising, shape ``(n,)`` [Hz].
    shapes
        Real shapes at the outputs, largest component 1, shape ``(n, o)``.
    """

    frequency_hz: Float[Array, " n"]
    shapes: Float[Array, "n o"]


def fdpi(
    frf: FRF,
    orders: int | Sequence[int],
    *,
    weights: str = "unit",
    residual: int | None = None,
) -> PoleTable:
    r"""Poles from mass-modified system matrices: :math:`\big(s^2 I + s A_1 + A_0\big) H_c(s) = B(s)` in least squares.

    :math:`H_c = V^T H` are the principal responses: the first ``n`` right singular vectors of the measured FRFs,
    real, so that the matrices stay real. Order ``n`` is the number of mode pairs. Where more modes than outputs are
    asked for, the left-hand side gets further even powers of :math:`s`.

    Parameters
    ----------
    frf
        The FRF, cut to the band of interest.
    orders
        Numbers of modes.
    weights
        ``unit``, ``magnitude`` or ``variance`` (averaged over the outputs).
    residual
        Degree of :math:`B(s)`: 0 is the exact model without modes outside the band; None takes the degree of the
        left-hand side, which holds an upper residual term.

    Returns
    -------
    PoleTable
        Pole pairs by their upper pole.

    Raises
    ------
    ValueError
        If the band holds too few lines for an order.

    Notes
    -----
    Lembregts, Leuridan and Van Brussel (1990); review of modal analysis methods for large aircraft, equations 2-3.
    """
    n_lines, n_out, n_in = frf.shape
    found = check_orders(orders, n_lines * n_in, limits(frf))
    degree = 2 * -(-found[-1] // n_out)
    comps = [-(-2 * n // degree) for n in found]
    terms = degree if residual is None else residual
    return _estimate(frf.without_statistics(), line_weight(frf, weights), found, tuple(comps), degree, terms)


@eqx.filter_jit
def _estimate(
    frf: FRF, weight: Float[Array, "f i"], orders: tuple[int, ...], comps: tuple[int, ...], degree: int, terms: int
) -> PoleTable:
    s, Hc, _, top = principal_responses(frf, weight, comps[-1])
    R = system_factor(s, Hc, weight, degree, terms)
    scaled, valid = jax.vmap(lambda c: system_poles(R, comps[-1], c, degree))(as_array(comps))
    poles = jnp.where(valid, scaled * top, 0.0)
    return without_window(PoleTable(poles, valid & (poles.imag > 0), None, orders, "fdpi"), frf)


def fdpi_normal_modes(frf: FRF, order: int, *, weights: str = "unit", residual: int | None = None) -> NormalModes:
    r"""Real normal modes by FDPI: eigenvectors of the mass-modified stiffness :math:`A_0`, damping neglected.

    Parameters are those of :func:`fdpi`; ``order`` modes come out, those with a positive :math:`\omega^2` first.

    Raises
    ------
    ValueError
        If ``order`` exceeds the number of outputs: the undamped problem has one mode a principal response.
    """
    if order > frf.shape[1]:
        raise ValueError(f"order {order} needs {order} outputs for real normal modes, the FRF has {frf.shape[1]}")
    check_orders(order, frf.shape[0] * frf.shape[2], limits(frf))
    return _normal_modes(frf, line_weight(frf, weights), order, 2 if residual is None else residual)


@eqx.filter_jit
def _normal_modes(frf: FRF, weight: Float[Array, "f i"], order: int, residual: int) -> NormalModes:
    s, Hc, V, top = principal_responses(frf, weight, order)
    R = system_factor(s, Hc, weight, 2, residual)
    A = _blocks(R, order, as_array(order), 2)
    values, vectors = jnp.linalg.eig(lax.stop_gradient(A[0]))
    pencil = jnp.stack([A[0].T, -jnp.eye(order)]).astype(jnp.complex128)  # w^T (A_0^T - u I) = 0
    squares, vectors = polish(jnp, pencil, values, vectors.T)
    rank = jnp.argsort(jnp.where(squares.real > 0, squares.real, jnp.inf))
    shapes = (vectors[rank] @ V.T).real
    top_component = jnp.take_along_axis(shapes, jnp.argmax(jnp.abs(shapes), axis=1)[:, None], axis=1)
    frequency = jnp.sqrt(jnp.maximum(squares.real[rank], 0.0)) * top / (2 * jnp.pi)
    return NormalModes(frequency, shapes / top_component)


def line_weight(frf: FRF, weights: str) -> Float[Array, "f i"]:
    """Weight of each line of each input, from the mean variance that the outputs' weights stand for."""
    return mean_weight(weights_of(frf, weights), over=1)


def principal_responses(frf: FRF, weight: Float[Array, "f i"], count: int) -> tuple[Array, Array, Array, Array]:
    """Scaled variable, the first ``count`` principal responses ``(f, i, c)``, their directions, and the scale."""
    rows = jnp.swapaxes(frf.H * weight[:, None, :], 1, 2).reshape(-1, frf.shape[1])
    V = eigenbasis(rows.real.T @ rows.real + rows.imag.T @ rows.imag)[1][:, :count]
    top = frf.omega[-1]
    return 1j * frf.omega / top, jnp.swapaxes(frf.H, 1, 2) @ V, V, top


@jax.custom_jvp
def eigenbasis(gram: Float[Array, "o o"]) -> tuple[Float[Array, " o"], Float[Array, "o o"]]:
    """Eigenvalues of a symmetric matrix, falling, and its eigenvectors.

    The derivative turns no vectors of one eigenvalue (to 1e-12 of the largest) into each other. Which of them stand
    there is arbitrary, and what is asked of their space does not depend on it.
    """
    values, vectors = jnp.linalg.eigh(gram)
    return values[::-1], vectors[:, ::-1]


@eigenbasis.defjvp
def _turn(primals: tuple[Array], tangents: tuple[Array]) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    values, vectors = eigenbasis(*primals)
    change = vectors.T @ tangents[0] @ vectors
    gap = values[None, :] - values[:, None]
    apart = jnp.abs(gap) > 1e-12 * jnp.abs(values[0])
    turn = jnp.where(apart, change / jnp.where(apart, gap, 1.0), 0.0)
    return (values, vectors), (jnp.diagonal(change), vectors @ turn)


def system_factor(
    s: Complex[Array, " f"], Hc: Complex[Array, "f i c"], weight: Float[Array, "f i"], degree: int, terms: int,
    also: Float[Array, "k m"] | None = None,
) -> Float[Array, "m m"]:  # fmt: skip
    """Triangular factor of the real rows ``[B columns, s^0 Hc, ..., s^degree Hc]``, without its B part.

    ``also`` are further rows in which B has no part.
    """
    f, n_in, _ = Hc.shape
    left = powers(s, degree + 1)[:, None, :, None] * Hc[:, :, None, :]
    left = (left * weight[:, :, None, None]).reshape(f * n_in, -1)
    eye = jnp.eye(n_in)
    right = powers(s, terms + 1)[:, None, :, None] * eye[None, :, None, :]
    right = (right * weight[:, :, None, None]).reshape(f * n_in, -1)
    A = jnp.concatenate([right, left], axis=1)
    A = jnp.concatenate([A.real, A.imag])
    count = right.shape[1]
    if also is not None:
        A = jnp.concatenate([A, jnp.pad(also, ((0, 0), (count, 0)))])
    return jnp.linalg.qr(A, mode="r")[count:, count:]


def _blocks(R: Float[Array, "m m"], comps: int, used: Int[Array, ""], degree: int) -> Float[Array, "k c c"]:
    r"""Blocks :math:`A_0 \dots A_p = I` for the first ``used`` components; the others get distinct real dummies."""
    m = degree * comps
    inside = jnp.arange(comps) < used
    columns = jnp.tile(inside, degree)
    scale = jnp.linalg.norm(R) * 1e-15
    left = jnp.concatenate([jnp.where(columns[None, :], R[:, :m], 0.0), jnp.diag(jnp.where(columns, scale, 1.0))])
    right = jnp.concatenate([-R[:, m:], jnp.zeros((m, comps))])
    Q, T = jnp.linalg.qr(left)
    x = jnp.where(columns[:, None] & inside[None, :], solve_triangular(T, Q.T @ right), 0.0)
    A = jnp.swapaxes(x.reshape(degree, comps, comps), 1, 2)
    dummy = jnp.diag(jnp.where(inside, 0.0, (3.0 + 0.1 * jnp.arange(comps)) ** degree))
    A = A.at[0].add(dummy)
    return jnp.concatenate([A, jnp.eye(comps)[None]])


def system_poles(
    R: Float[Array, "m m"], comps: int, used: Int[Array, ""], degree: int
) -> tuple[Complex[Numbers, " p"], Bool[Array, " p"]]:
    """Eigenvalues in the scaled variable for the first ``used`` components, and which of them belong to these."""
    A = _blocks(R, comps, used, degree)
    fixed = lax.stop_gradient(A)
    m = degree * comps
    C = jnp.diag(jnp.ones(m - comps), comps)
    C = C.at[m - comps :].set(-jnp.concatenate(list(fixed[:-1]), axis=1))
    values, vectors = jnp.linalg.eig(C)
    shapes = vectors[:comps].T
    shapes = shapes / jnp.maximum(jnp.linalg.norm(shapes, axis=1, keepdims=True), 1e-300)
    inside = jnp.arange(comps) < used
    valid = jnp.sum(jnp.abs(shapes) ** 2 * inside, axis=1) > 0.5
    # polish() takes row vectors w with w^T A = 0; the shapes are its columns, so it gets the transposed blocks.
    u, _ = polish(jnp, jnp.swapaxes(A, 1, 2).astype(jnp.complex128), values, shapes)
    return u, valid & jnp.isfinite(u)
