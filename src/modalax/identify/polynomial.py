r"""Rows of the linearised problem :math:`H(\omega) A(u) \approx B(u)` and its triangular factor.

Shared by :func:`lscf` (every FRF a row of its own, one reference) and :func:`plscf` (every output a row over all
references). The numerator is eliminated by projecting on the complement of an orthonormal basis of its powers.
"""

import contextlib
from functools import partial
from itertools import pairwise
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float, Inexact

from modalax._numerics.checks import as_array
from modalax._numerics.known import Numbers, by_numpy, by_numpy_beside, scan
from modalax._numerics.powers import powers_of
from modalax._numerics.threads import one_thread
from modalax.data.frf import FRF
from modalax.identify.fraction import check_constraint, coefficients, roots
from modalax.identify.moments import factor_from_moments, with_spare
from modalax.identify.tables import PoleTable
from modalax.identify.zoom import Zoom, check_orders, moved_span, on_circle, zoom
from modalax.model.entry import check_frf

SOLVERS = ("auto", "qr", "moments")
LONG = 100  # poles of the highest order from which on a diagram is done in parts
LARGE = 1e10  # floating-point operations from which on ``auto`` takes the moments
STEPS = 3  # steps that take the ridge of the moments out of the coefficients
WEIGHTS = ("unit", "magnitude", "variance")
LAST = {"a0": "last", "aN": "first", "norm": "norm"}


def weights_of(frf: FRF, kind: str) -> Float[Array, "f o i"]:
    r"""Weight of each sample: 1, :math:`|H|^{-1}` or :math:`\sigma^{-1}`.

    Raises
    ------
    ValueError
        If the kind is unknown, or variance weights are asked for and there is no variance, or a zero one.
    """
    check_frf(frf, "an estimator of poles")
    if kind not in WEIGHTS:
        raise ValueError(f"weights is {kind!r}; it must be one of {', '.join(WEIGHTS)}")
    if kind == "unit":
        return as_array(np.ones(frf.H.shape))
    if kind == "magnitude":
        size = jnp.abs(frf.H)
        return 1 / jnp.maximum(size, 1e-12 * jnp.max(size))
    if frf.variance is None:
        raise ValueError("weights 'variance' needs an FRF with a variance; this one has none")
    if not isinstance(frf.variance, jax.core.Tracer) and bool((np.asarray(frf.variance) <= 0).any()):
        raise ValueError("weights 'variance' needs variances above zero; some are zero, so their weight is infinite")
    return 1 / jnp.sqrt(frf.variance)


@by_numpy
def mean_weight(xp: ModuleType, weight: Numbers, *, over: int | tuple[int, ...]) -> Numbers:
    """One weight in place of those along some axes, from the mean variance that they stand for."""
    return 1 / xp.sqrt(xp.mean(weight**-2, axis=over))


def over_references(weight: Float[Array, "f o i"]) -> Float[Array, "f o"]:
    """One weight a line and output, from those of its references."""
    return mean_weight(weight, over=2)


def triangular_factor(
    xp: ModuleType,
    H: Complex[Numbers, "f row i"],
    weight: Float[Numbers, "f row"],
    u: Complex[Numbers, " f"],
    ridge: Numbers | float,
    also: Inexact[Numbers, "row2 m"] | None = None,
    *,
    order: int,
    numerator: int,
    real: bool,
    shared: bool,
) -> Inexact[Numbers, "m m"]:
    r"""Triangular factor of the projected columns :math:`P^\perp [H u^0, H u^1, \dots]`, all rows stacked.

    One row after the other is added to the factor (a sequential QR), so the memory does not grow with the number
    of outputs. ``ridge`` adds :math:`\rho I` to the normal matrix, relative to its mean diagonal; ``also`` are further
    rows for the factor, such as those that noise adds on average.
    """
    size = H.shape[2]
    m = (order + 1) * size
    common = moved_span(xp, u, weight[:, 0], numerator, real) if shared else None
    energy = xp.sum(xp.abs(H * weight[:, :, None]) ** 2) / size
    columns = powers_of(xp, u, order)
    start = xp.sqrt(ridge * energy) * xp.eye(m)

    def add(R: Numbers, row: tuple[Numbers, Numbers]) -> tuple[Numbers, None]:
        h, w = row
        span = moved_span(xp, u, w, numerator, real) if common is None else common
        Y = projected_columns(xp, h * w[:, None], u, columns, span, real)
        return xp.linalg.qr(xp.concatenate([R, Y]), mode="r"), None

    rows = (xp.swapaxes(H, 0, 1), xp.swapaxes(weight, 0, 1))
    start = start if real else start.astype(np.complex128)
    if also is not None:
        start = xp.linalg.qr(xp.concatenate([start, also]), mode="r")
    R, _ = scan(xp, add, start, rows)
    return R


def projected_columns(
    xp: ModuleType,
    h: Complex[Numbers, "f i"],
    u: Complex[Numbers, " f"],
    columns: Complex[Numbers, "f k"],
    span: tuple[Numbers, Numbers, Numbers],
    real: bool,
) -> Inexact[Numbers, "f2 m"]:
    r"""Columns :math:`y_k = P_n h u^k`, of which only the first is projected; ``columns`` are the powers but the last.

    On the unit circle :math:`u P_n u^{-1}` differs from :math:`P_n` by two directions (see :mod:`.moments`), so that

    .. math:: y_{k+1} = u\,(y_k + \varphi\langle\varphi, h u^k\rangle - \psi\langle\psi, h u^k\rangle) .
    """
    f, size = h.shape
    Q, *ends = span
    stack = lambda x: xp.concatenate([x.real, x.imag]) if real else x
    Q, given = stack(Q), stack(h)
    first = given - Q @ (Q.conj().T @ given)
    first = first[:f] + 1j * first[f:] if real else first
    along = [(end.conj()[:, None] * columns).T @ h for end in ends]
    phi, psi = (end[:, None] for end in ends)

    def following(y: Numbers, parts: tuple[Numbers, Numbers]) -> tuple[Numbers, Numbers]:
        y = u[:, None] * (y + phi * parts[0] - psi * parts[1])
        return y, y

    _, rest = scan(xp, following, first, tuple(a.real if real else a for a in along))
    Y = xp.concatenate([first[None], rest])
    return stack(xp.swapaxes(Y, 0, 1).reshape(f, -1))


def poles_of_factor(
    R: Inexact[Array, "m m"], orders: tuple[int, ...], size: int, constraint: str, real: bool, zoomed: Zoom,
    method: str, added: Float[Array, ""] | None = None, decay: Float[Array, ""] | float = 0.0,
) -> PoleTable:  # fmt: skip
    """All orders of a stabilization diagram from the factor of the largest.

    ``added`` is the ridge in the factor whose effect is to be taken out of the coefficients, ``decay`` the one of an
    exponential window that is taken out of the poles [1/s].
    """
    arrays = (R, zoomed, added, as_array(decay))
    check_constraint(constraint)
    poles, valid, participation = _poles_of(*arrays, orders=orders, size=size, constraint=constraint, real=real)
    return PoleTable(poles, valid, participation if size > 1 else None, orders, method)


def poles_of_orders(
    xp: ModuleType, R: Inexact[Numbers, "m m"], zoomed: Zoom, added: Numbers | None, decay: Numbers | float, *,
    orders: tuple[int, ...], size: int, constraint: str, real: bool,
) -> tuple[Complex[Numbers, "order p"], Bool[Numbers, "order p"], Complex[Numbers, "order p i"]]:  # fmt: skip
    """Poles of every order, which of them mean anything, and their participation of length 1."""
    last, mended = LAST[constraint], {} if added is None else {"added": added, "steps": STEPS}
    u, w, valid = (_roots_together if xp is jnp else _roots_in_turn)(R, orders, size, last, mended)
    valid = valid & (u != 0)  # a root at 0 is no pole
    poles = 1j * zoomed.centre - xp.log(xp.where(valid, u, 1.0)) / zoomed.step
    if real:  # each root has a mirror image below the band, which means nothing
        valid = valid & (poles.imag > zoomed.centre)
    w = w / xp.maximum(xp.linalg.norm(w, axis=-1, keepdims=True), 1e-300)
    return xp.where(valid, poles + decay, 0.0), valid, w


_poles_of = by_numpy_beside(poles_of_orders)


def _roots_together(
    R: Array, orders: tuple[int, ...], size: int, last: str, mended: dict[str, Any]
) -> tuple[Array, Array, Array]:
    """All orders in one program: one vmap for orders of about a size.

    Eigenvalues cost the cube of the size they are padded to, so long diagrams are done in up to four parts.
    """
    count, parts = orders[-1] * size, []
    for part in _parts_of(orders, size):
        m = (part[-1] + 1) * size
        given = jnp.asarray(part)
        A = jax.vmap(lambda n, m=m: coefficients(jnp, R[:m, :m], n, size, last, **mended))(given)
        pad = count - part[-1] * size
        u, w, valid = jax.vmap(partial(roots, jnp))(A, given)
        rows = ((0, 0), (0, pad))
        parts.append((jnp.pad(u, rows), jnp.pad(w, (*rows, (0, 0))), jnp.pad(valid, rows)))
    u, w, valid = (jnp.concatenate([p[k] for p in parts]) for k in range(3))
    return u, w, valid


@one_thread
def _roots_in_turn(
    R: np.ndarray, orders: tuple[int, ...], size: int, last: str, mended: dict[str, Any]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One order after the other by NumPy, each from its own corner of the factor."""
    shape = len(orders), orders[-1] * size
    u, w, valid = np.ones(shape, complex), np.zeros((*shape, size), complex), np.zeros(shape, bool)
    for k, order in enumerate(orders if np.isfinite(R).all() else ()):  # of what is no number there are no roots
        m = order * size
        with contextlib.suppress(np.linalg.LinAlgError):  # of an order whose eigenvalues do not converge neither
            A = coefficients(np, R[: m + size, : m + size], order, size, last, **mended)
            u[k, :m], w[k, :m], valid[k, :m] = roots(np, A, order)
    return u, w, valid


def _parts_of(orders: tuple[int, ...], size: int) -> list[tuple[int, ...]]:
    """Orders in groups that end at 40, 60, 80 and 100 % of the highest; one group where that is low."""
    if orders[-1] * size < LONG:
        return [orders]
    ends = [0.0, 0.4 * orders[-1], 0.6 * orders[-1], 0.8 * orders[-1], orders[-1]]
    groups = [tuple(n for n in orders if low < n <= high) for low, high in pairwise(ends)]
    return [g for g in groups if g]


def matrix_fraction(
    frf: FRF,
    H: Complex[Array, "f row i"],
    weight: Float[Array, "f row"],
    *,
    orders: object,
    constraint: str,
    real: bool,
    arc: float,
    ridge: Float[Array, ""] | float,
    numerator: int | None,
    shared: bool,
    solver: str,
    method: str,
) -> PoleTable:
    """The common part of LSCF and polyreference LSCF; see :func:`lscf` for the arguments."""
    found = check_orders(orders, frf.freq.shape[0], limits(frf))
    if not 0 < arc <= 1:
        raise ValueError(f"arc is {arc:g}; it is the part of the circle that the band covers, above 0 and up to 1")
    moments = use_moments(solver, H.shape, found[-1], shared)
    if numerator is None:
        numerator = with_spare(found[-1], frf.freq.shape[0]) if moments else found[-1]
    R, added, zoomed = _factor(
        frf.omega, H, weight, as_array(ridge), order=found[-1], real=real, arc=arc, numerator=numerator,
        shared=shared, moments=moments,
    )  # fmt: skip
    return poles_of_factor(R, found, H.shape[2], constraint, real, zoomed, method, added, as_array(frf.added_decay))


@by_numpy_beside
def _factor(
    xp: ModuleType, omega: Numbers, H: Numbers, weight: Numbers, ridge: Numbers, *, order: int, real: bool, arc: float,
    numerator: int, shared: bool, moments: bool,
) -> tuple[Numbers, Numbers | float | None, Zoom]:  # fmt: skip
    """Triangular factor of the highest order, its ridge to be taken out, and the map on the circle."""
    zoomed = zoom(omega, arc, real)
    u = on_circle(xp, omega, zoomed.centre, zoomed.step)
    if moments:
        R, added = factor_from_moments(xp, H, weight[:, 0], u, order, numerator, real, ridge)
        return R, added, zoomed
    chosen = dict(order=order, numerator=numerator, real=real, shared=shared)
    return triangular_factor(xp, H, weight, u, ridge, **chosen), None, zoomed


def use_moments(solver: str, shape: tuple[int, ...], order: int, shared: bool) -> bool:
    """Whether to go through the moments: as asked for, or where the orthogonal factorisation would be long.

    Raises
    ------
    ValueError
        If the solver is unknown, or moments are asked for with weights that differ between outputs.
    """
    if solver not in SOLVERS:
        raise ValueError(f"solver is {solver!r}; it must be one of {', '.join(SOLVERS)}")
    if solver == "moments" and not shared:
        raise ValueError(
            "solver 'moments' needs weights 'unit': with other weights every output has a numerator basis of its own"
        )
    lines, rows, size = shape
    return solver == "moments" or (
        solver == "auto" and shared and 8.0 * rows * lines * ((order + 1) * size) ** 2 > LARGE
    )


def without_window(table: PoleTable, frf: FRF) -> PoleTable:
    """Remove the decay that an exponential window added from every pole."""
    return PoleTable(
        jnp.where(table.valid, table.poles + frf.added_decay, table.poles),
        table.valid, table.participation, table.orders, table.method,
    )  # fmt: skip


def limits(frf: FRF) -> tuple[float, float]:
    """First and last frequency of an FRF [Hz], NaN under a transformation, for messages."""
    if isinstance(frf.freq, jax.core.Tracer):
        return float("nan"), float("nan")
    values = np.asarray(frf.freq)  # a constant indexed by JAX inside jit would be traced
    return float(values[0]), float(values[-1])
