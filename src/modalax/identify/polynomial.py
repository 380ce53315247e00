r"""Rows of the linearised problem :math:`H(\omega) A(u) \approx B(u)` and its triangular factor.

Shared by :func:`lscf` (every FRF a row of its own, one reference) and :func:`plscf` (every output a row over all
references). The numerator is eliminated by projecting on the complement of an orthonormal basis of its powers.
"""

from functools import partial
from itertools import pairwise
from types import ModuleType

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Complex, Float, Inexact

from modalax._numerics.checks import as_array
from modalax._numerics.known import Numbers, by_numpy
from modalax._numerics.powers import powers
from modalax.data.frf import FRF
from modalax.identify.fraction import check_constraint, coefficients, roots
from modalax.identify.moments import factor_from_moments, with_spare
from modalax.identify.tables import PoleTable
from modalax.identify.zoom import Zoom, check_orders, moved_span, zoom
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


@partial(jax.jit, static_argnames=("order", "numerator", "real", "shared"))
def triangular_factor(
    H: Complex[Array, "f row i"],
    weight: Float[Array, "f row"],
    u: Complex[Array, " f"],
    order: int,
    numerator: int,
    real: bool,
    ridge: Float[Array, ""],
    shared: bool,
    also: Inexact[Array, "row2 m"] | None = None,
) -> Inexact[Array, "m m"]:
    r"""Triangular factor of the projected columns :math:`P^\perp [H u^0, H u^1, \dots]`, all rows stacked.

    One row after the other is added to the factor (a sequential QR), so the memory does not grow with the number
    of outputs. ``ridge`` adds :math:`\rho I` to the normal matrix, relative to its mean diagonal; ``also`` are further
    rows for the factor, such as those that noise adds on average.
    """
    size = H.shape[2]
    m = (order + 1) * size
    common = moved_span(u, weight[:, 0], numerator, real) if shared else None
    energy = jnp.sum(jnp.abs(H * weight[:, :, None]) ** 2) / size
    start = jnp.sqrt(ridge * energy) * jnp.eye(m)

    def add(R: Array, row: tuple[Array, Array]) -> tuple[Array, None]:
        h, w = row
        span = moved_span(u, w, numerator, real) if common is None else common
        Y = projected_columns(h * w[:, None], u, order, span, real)
        return jnp.linalg.qr(jnp.concatenate([R, Y]), mode="r"), None

    rows = (jnp.swapaxes(H, 0, 1), jnp.swapaxes(weight, 0, 1))
    start = start if real else start.astype(jnp.complex128)
    if also is not None:
        start = jnp.linalg.qr(jnp.concatenate([start, also]), mode="r")
    R, _ = lax.scan(add, start, rows)
    return R


def projected_columns(
    h: Complex[Array, "f i"], u: Complex[Array, " f"], order: int, span: tuple[Array, Array, Array], real: bool
) -> Inexact[Array, "f2 m"]:
    r"""Columns :math:`y_k = P_n h u^k`, of which only the first is projected.

    On the unit circle :math:`u P_n u^{-1}` differs from :math:`P_n` by two directions (see :mod:`.moments`), so that

    .. math:: y_{k+1} = u\,(y_k + \varphi\langle\varphi, h u^k\rangle - \psi\langle\psi, h u^k\rangle) .
    """
    f, size = h.shape
    Q, *ends = span
    stack = lambda x: jnp.concatenate([x.real, x.imag]) if real else x
    Q, given = stack(Q), stack(h)
    first = given - Q @ (Q.conj().T @ given)
    first = first[:f] + 1j * first[f:] if real else first
    along = [(end.conj()[:, None] * powers(u, order)).T @ h for end in ends]
    phi, psi = (end[:, None] for end in ends)

    def following(y: Array, parts: tuple[Array, Array]) -> tuple[Array, Array]:
        y = u[:, None] * (y + phi * parts[0] - psi * parts[1])
        return y, y

    _, rest = lax.scan(following, first, tuple(a.real if real else a for a in along))
    Y = jnp.concatenate([first[None], rest])
    return stack(jnp.swapaxes(Y, 0, 1).reshape(f, -1))


@eqx.filter_jit
def poles_of_factor(
    R: Inexact[Array, "m m"], orders: tuple[int, ...], size: int, constraint: str, real: bool, zoomed: Zoom,
    method: str, added: Float[Array, ""] | None = None, decay: Float[Array, ""] | float = 0.0,
) -> PoleTable:  # fmt: skip
    """All orders of a stabilization diagram from the factor of the largest: one vmap for orders of about a size.

    ``added`` is the ridge in the factor whose effect is to be taken out of the coefficients, ``decay`` the one of an
    exponential window that is taken out of the poles [1/s]. Eigenvalues cost the cube of the size they are padded to,
    so long diagrams are done in up to four parts.
    """
    count = orders[-1] * size
    last = LAST[check_constraint(constraint)]
    mended = {} if added is None else {"added": added, "steps": STEPS}
    parts = []
    for part in _parts_of(orders, size):
        m = (part[-1] + 1) * size
        given = jnp.asarray(part)
        A = jax.vmap(lambda n, m=m: coefficients(R[:m, :m], n, size, last, **mended))(given)
        pad = count - part[-1] * size
        u, w, valid = jax.vmap(roots)(A, given)
        rows = ((0, 0), (0, pad))
        parts.append((jnp.pad(u, rows), jnp.pad(w, (*rows, (0, 0))), jnp.pad(valid, rows)))
    u, w, valid = (jnp.concatenate([p[k] for p in parts]) for k in range(3))
    poles = zoomed.poles(jnp.where(valid, u, 1.0))
    if real:  # each root has a mirror image below the band, which means nothing
        valid = valid & (poles.imag > zoomed.centre)
    w = w / jnp.maximum(jnp.linalg.norm(w, axis=-1, keepdims=True), 1e-300)
    return PoleTable(jnp.where(valid, poles + decay, 0.0), valid, w if size > 1 else None, orders, method)


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
    R, added, zoomed, decay = _factor(
        frf.without_statistics(), H, weight, jnp.asarray(ridge), found[-1], real, arc, numerator, shared, moments
    )
    return poles_of_factor(R, found, H.shape[2], constraint, real, zoomed, method, added, decay)


@eqx.filter_jit
def _factor(
    frf: FRF, H: Array, weight: Array, ridge: Array, order: int, real: bool, arc: float, numerator: int, shared: bool,
    moments: bool,
) -> tuple[Array, Array | None, Zoom, Array]:  # fmt: skip
    """Triangular factor of the highest order, its ridge to be taken out, the map on the circle, and the added decay.

    A program of its own: diagrams of other lines share that of the poles, which takes longest to compile.
    """
    zoomed = zoom(frf.omega, arc, real)
    u, decay = zoomed.circle(frf.omega), jnp.asarray(frf.added_decay)
    if moments:
        R, added = factor_from_moments(H, weight[:, 0], u, order, numerator, real, ridge)
        return R, added, zoomed, decay
    return triangular_factor(H, weight, u, order, numerator, real, ridge, shared), None, zoomed, decay


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
