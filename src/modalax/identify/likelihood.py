r"""The likelihood of measured FRFs, with everything linear eliminated (variable projection).

For one output (row of the FRF matrix) the model is linear in the shape components and residual terms,

.. math:: y_o = w_o \circ \big(C(\theta)\,x_o\big) + e_o, \qquad e_o \sim N(0, I),

where :math:`\theta` holds logarithms of frequency and damping and the participation of the references. So
:math:`x_o = (w_oC)^+ y_o` and the cost :math:`\tfrac12\sum_o\|P_o^\perp y_o\|^2` depends on :math:`\theta` alone
(Golub and Pereyra 1973; Kaufman 1975). Real and imaginary parts are stacked, so all unknowns are real.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Complex, Float, Int

from modalax.data.frf import DERIVATIVES, FRF
from modalax.identify.kernels import FAR, GROWING, UNDAMPED

LAGS = 8  # lines over which a residual that is not white is taken to be correlated


class Problem(eqx.Module):
    r"""The data as the likelihood needs them, with a row for each output.

    Attributes
    ----------
    omega
        Circular frequency, shape ``(f,)`` [rad/s].
    decay
        Decay rate that a window added to the data [1/s]: it was evaluated at :math:`s = j\omega + \sigma`.
    y
        Weighted data, real and imaginary parts of all lines and references stacked, shape ``(o, 2 f i)`` [-].
    weight
        Weights of the same rows, shape ``(o, 2 f i)`` [1 / unit of the FRF].
    pivot
        The reference at which each mode's participation is fixed to one, shape ``(n,)``.
    active
        1 for modes, 0 for empty slots that only keep the shapes of arrays equal from fit to fit, shape ``(n,)``.
    held
        1 for modes whose damping keeps its value, because the band does not tell it, shape ``(n,)``.
    power
        Number of time derivatives of the form: 0, 1, 2 for receptance, mobility, accelerance.
    inputs
        Number of references.
    residuals
        Which residual terms: ``none``, ``real`` or ``complex``.
    real_modes
        Whether the residues of the receptance are purely imaginary (real normal modes).
    shared
        Whether the weights of all outputs are multiples of those of the first, so that one factorisation serves all.
    """

    omega: Float[Array, " f"]
    decay: Float[Array, ""]
    y: Float[Array, "o m"]
    weight: Float[Array, "o m"]
    pivot: Int[Array, " n"]
    active: Float[Array, " n"]
    held: Float[Array, " n"]
    power: int = eqx.field(static=True)
    inputs: int = eqx.field(static=True)
    residuals: str = eqx.field(static=True)
    real_modes: bool = eqx.field(static=True)
    shared: bool = eqx.field(static=True)

    @property
    def s(self) -> Complex[Array, " f"]:
        """Where in the complex plane the data was evaluated [1/s]."""
        return self.decay + 1j * self.omega

    @property
    def samples(self) -> int:
        """Rows that hold data; those after them hold the empty slots at zero."""
        return 2 * self.omega.shape[0] * self.inputs


def make_problem(
    frf: FRF,
    sigma: Float[Array, "f o i"],
    pivot: Int[Array, " n"],
    residuals: str,
    real_modes: bool,
    active: Float[Array, " n"] | None = None,
    shared: bool = False,
    held: Float[Array, " n"] | None = None,
) -> Problem:
    r"""Stack an FRF whose complex samples have standard deviation ``sigma``, each real part :math:`\sigma/\sqrt2`."""
    active = jnp.ones(pivot.shape) if active is None else active
    held = jnp.zeros(pivot.shape) if held is None else held
    weight = jnp.sqrt(2.0) / sigma
    if DERIVATIVES[frf.form] < 2:  # the lower residual term is infinite at 0 Hz unless the form is accelerance
        weight = jnp.where((frf.omega == 0)[:, None, None] & (residuals != "none"), 0.0, weight)
    row = lambda a: jnp.moveaxis(a, 1, 0).reshape(a.shape[1], -1)
    y = row(frf.H * weight)
    w = row(weight)
    extra = jnp.ones((w.shape[0], pivot.shape[0] * (1 if real_modes else 2)))
    return Problem(
        frf.omega, frf.added_decay, jnp.concatenate([y.real, y.imag, 0 * extra], axis=1),
        jnp.concatenate([w, w, extra], axis=1), pivot, active, held, DERIVATIVES[frf.form], frf.H.shape[2], residuals,
        real_modes, shared,
    )  # fmt: skip


def pack(poles: Complex[Array, " n"], participation: Complex[Array, "n i"], pivot: Int[Array, " n"]) -> Array:
    r"""Real unknowns ``(n, 2 + 2 (i - 1))``: :math:`\ln\omega, \ln\zeta`, and participation relative to the pivot's.

    A pole without damping counts as one that has ``GROWING``.
    """
    omega = jnp.abs(poles)
    zeta = jnp.where(poles.real < 0, -poles.real / omega, GROWING)
    n, i = participation.shape
    relative = participation / jnp.take_along_axis(participation, pivot[:, None], axis=1)
    rest = jnp.take_along_axis(relative, _others(pivot, i), axis=1)
    return jnp.concatenate([jnp.log(omega)[:, None], jnp.log(zeta)[:, None], rest.real, rest.imag], axis=1)


def unpack(theta: Float[Array, "n q"], pivot: Int[Array, " n"]) -> tuple[Complex[Array, " n"], Complex[Array, "n i"]]:
    """Poles and participation (one at the pivot) of real unknowns."""
    omega, zeta = jnp.exp(jnp.clip(theta[:, 0], *FAR)), jnp.exp(theta[:, 1])
    # Past critical damping the pole pair would stop vibrating; the square root must not see that during a search.
    # Below the other end the data cannot tell: a mode outside the band may go there and stay.
    zeta = jnp.clip(zeta, UNDAMPED, 0.999)
    poles = -zeta * omega + 1j * omega * jnp.sqrt(1 - zeta**2)
    n, q = theta.shape
    free = (q - 2) // 2
    rest = theta[:, 2 : 2 + free] + 1j * theta[:, 2 + free :]
    index = jnp.arange(free + 1)[None, :]
    source = jnp.clip(index - (index > pivot[:, None]), 0, max(free - 1, 0))
    spread = jnp.take_along_axis(rest, source, axis=1) if free else jnp.zeros((n, 1))
    return poles, jnp.where(index == pivot[:, None], 1.0 + 0j, spread)


def _others(pivot: Int[Array, " n"], count: int) -> Int[Array, "n j"]:
    index = jnp.arange(max(count - 1, 0))[None, :]
    return index + (index >= pivot[:, None])


def mode_columns(
    theta: Float[Array, " q"], pivot: Int[Array, ""], s: Complex[Array, " f"], power: int, real_modes: bool
) -> Float[Array, "m c"]:
    """Responses to the real and the imaginary part of a mode's shape component, stacked; one column for real modes."""
    poles, part = unpack(theta[None], pivot[None])
    pole, L = poles[0], part[0]
    s = s[:, None]
    near, far = L / (s - pole), L.conj() / (s - pole.conj())
    if real_modes:
        columns = [(near - far) / (2j * pole.imag)]
    else:
        columns = [near + far, 1j * (near - far)]
    return jnp.stack([_stacked(c * s**power) for c in columns], axis=1)


def residual_columns(problem: Problem) -> Float[Array, "m c"]:
    r"""Columns of the residual terms of each reference, :math:`(j\omega)^p` (upper) and :math:`(j\omega)^{p-2}`."""
    s = problem.s
    count = problem.inputs
    if problem.residuals == "none":
        return jnp.zeros((2 * s.shape[0] * count, 0))
    top = jnp.max(problem.omega)  # scaled, so that both terms are of a size
    safe = jnp.where(s == 0, 1j * top, s)
    terms = [(s / top) ** problem.power, (safe / top) ** (problem.power - 2)]
    if problem.residuals == "complex":
        terms = terms + [1j * t for t in terms]
    eye = jnp.eye(count)
    return jnp.stack([_stacked(t[:, None] * eye[k]) for k in range(count) for t in terms], axis=1)


def _stacked(a: Complex[Array, "f i"]) -> Float[Array, " m"]:
    return jnp.concatenate([a.real.ravel(), a.imag.ravel()])


def _columns(theta: Float[Array, "n q"], problem: Problem) -> Float[Array, "m k"]:
    """All columns of the linear model: modes first (component by component), then residual terms."""
    per_mode = jax.vmap(mode_columns, in_axes=(0, 0, None, None, None))(
        theta, problem.pivot, problem.s, problem.power, problem.real_modes
    )
    n, m, c = per_mode.shape
    modes = jnp.moveaxis(per_mode * problem.active[:, None, None], 0, 1).reshape(m, n * c)
    C = jnp.concatenate([modes, residual_columns(problem)], axis=1)
    # An empty slot explains a row of its own, where the data is zero, so its component is zero.
    empty = jnp.zeros((n * c, C.shape[1])).at[:, : n * c].set(jnp.diag(jnp.repeat(1 - problem.active, c)))
    return jnp.concatenate([C, empty])


def _column_derivatives(theta: Float[Array, "n q"], problem: Problem) -> Float[Array, "n m c q"]:
    """Derivatives of each mode's columns with respect to its own unknowns (none in empty slots)."""
    d = jax.vmap(jax.jacfwd(mode_columns), in_axes=(0, 0, None, None, None))(
        theta, problem.pivot, problem.s, problem.power, problem.real_modes
    )
    n, _, c, q = d.shape
    d = d.at[..., 1].multiply(1 - problem.held[:, None, None])
    return jnp.concatenate([d * problem.active[:, None, None, None], jnp.zeros((n, n * c, c, q))], axis=1)


class Parts(eqx.Module):
    """Contribution of one output to the cost and its derivatives.

    Attributes
    ----------
    x
        Linear unknowns, shape ``(k,)``.
    residual
        Whitened residual, shape ``(m,)``.
    cost, gradient, matrix
        Half the squared residual, its gradient in the non-linear unknowns, and the Gauss-Newton matrix.
    inverse
        Inverse of the triangular factor of the linear part, shape ``(k, k)``.
    coupling
        Change of ``x`` with the non-linear unknowns, shape ``(k, p)``.
    scores
        Projected derivative times residual a sample pair, summed as an outer product (for the sandwich), ``(p, p)``.
    lagged
        The same with the pairs of up to ``LAGS`` lines on either side, weighted by a triangle, ``(p, p)``.
    """

    x: Float[Array, "... k"]
    residual: Float[Array, "... m"]
    cost: Float[Array, "..."]
    gradient: Float[Array, "... p"]
    matrix: Float[Array, "... p p"]
    inverse: Float[Array, "... k k"]
    coupling: Float[Array, "... k p"]
    scores: Float[Array, "... p p"]
    lagged: Float[Array, "... p p"]


def _linear(C: Array, w: Array, y: Array) -> tuple[Array, Array, Array, Array]:
    """Weighted least squares of one output by QR of columns scaled to unit norm; also usable on dependent columns."""
    A = w[:, None] * C
    norm = jnp.sqrt(jnp.sum(A**2, axis=0))
    norm = jnp.where(norm > 0, norm, 1.0)
    Q, R = jnp.linalg.qr(A / norm)
    R = R + jnp.diag(jnp.where(jnp.abs(jnp.diag(R)) < 1e-14, 1e-14, 0.0))
    x = solve_triangular(R, Q.T @ y) / (norm if y.ndim == 1 else norm[:, None])
    return Q, R, norm, x


def _normal_of_row(
    C: Array, dC: Array, w: Array, y: Array, samples: int, inputs: int, full: bool
) -> tuple[Array, Array, Array] | Parts:
    Q, R, norm, x = _linear(C, w, y)
    residual = y - Q @ (Q.T @ y)
    n, m, c, q = dC.shape
    local = x[: n * c].reshape(n, c)
    D = w[:, None] * jnp.einsum("nmcq,nc->mnq", dC, local).reshape(m, n * q)
    QD = Q.T @ D
    P = D - Q @ QD
    gradient = -P.T @ residual
    matrix = P.T @ P
    cost = 0.5 * residual @ residual
    if not full:
        return cost, gradient, matrix
    inverse = solve_triangular(R, jnp.eye(R.shape[0])) / norm[:, None]
    half = samples // 2
    pairs = P[:half] * residual[:half, None] + P[half:samples] * residual[half:samples, None]
    return Parts(x, residual, cost, gradient, matrix, inverse, inverse @ QD, pairs.T @ pairs, _lagged(pairs, inputs))


def _lagged(pairs: Float[Array, "h p"], inputs: int) -> Float[Array, "p p"]:
    r"""Scores of neighbouring lines together, :math:`\sum_l (1-|l|/L)\sum_k s_ks_{k+l}^T` (Newey, West 1987)."""
    lines = pairs.reshape(-1, inputs, pairs.shape[1]).sum(axis=1)
    padded = jnp.pad(lines, ((LAGS, LAGS), (0, 0)))
    triangle = 1 - jnp.abs(jnp.arange(-LAGS, LAGS + 1)) / (LAGS + 1)
    near = sum(triangle[k] * padded[k : k + lines.shape[0]] for k in range(2 * LAGS + 1))
    return lines.T @ near


def _normal_of_all(C: Array, dC: Array, w: Array, Y: Array) -> tuple[Array, Array, Array]:
    r"""The same sums for outputs of shared weights, at a cost that hardly grows with their number.

    With the projected derivatives :math:`B_{ncq}` of single columns, the Gauss-Newton matrix is
    :math:`\sum_{cc'} B_{ncq}^TB_{n'c'q'} \sum_o x_{onc}x_{on'c'}`.
    """
    Q, _, _, X = _linear(C, w, Y.T)
    residual = Y.T - Q @ (Q.T @ Y.T)
    n, m, c, q = dC.shape
    B = jnp.moveaxis(dC * w[None, :, None, None], 1, 0).reshape(m, n * c * q)
    B = B - Q @ (Q.T @ B)
    x = X[: n * c].reshape(n, c, -1)
    gradient = -jnp.einsum("ncqo,nco->nq", (B.T @ residual).reshape(n, c, q, -1), x)
    pairs = jnp.einsum("nco,mdo->ncmd", x, x)
    matrix = jnp.einsum("ncqmdp,ncmd->nqmp", (B.T @ B).reshape(n, c, q, n, c, q), pairs)
    # One entry each, so that the sums over outputs are those of the general case.
    return 0.5 * jnp.sum(residual**2)[None], gradient.reshape(1, n * q), matrix.reshape(1, n * q, n * q)


def _values(theta: Array, problem: Problem) -> Array:
    C = _columns(theta, problem)
    if problem.shared:
        Q, _, _, _ = _linear(C, problem.weight[0], problem.y[0])
        return 0.5 * jnp.sum((problem.y.T - Q @ (Q.T @ problem.y.T)) ** 2)

    def row(pair: tuple[Array, Array]) -> Array:
        w, y = pair
        Q, _, _, _ = _linear(C, w, y)
        r = y - Q @ (Q.T @ y)
        return 0.5 * r @ r

    return jnp.sum(lax.map(row, (problem.weight, problem.y)))


def objective(flat: Float[Array, " p"], problem: Problem) -> tuple[Array, tuple[Array, Array]]:
    """Cost with its gradient and Gauss-Newton matrix, as :class:`LevenbergMarquardt` wants them."""
    theta = flat.reshape(problem.pivot.shape[0], -1)
    frozen = lax.stop_gradient(theta)
    data = lax.stop_gradient(problem)
    C, dC = _columns(frozen, data), _column_derivatives(frozen, data)

    def row(pair: tuple[Array, Array]) -> tuple[Array, Array, Array]:
        return _normal_of_row(C, dC, *pair, problem.samples, problem.inputs, full=False)  # pyrefly: ignore[bad-return]

    if problem.shared:
        cost, gradient, matrix = _normal_of_all(C, dC, data.weight[0], data.y)
    else:
        cost, gradient, matrix = lax.map(row, (data.weight, data.y))
    return _with_value(jnp.sum(cost), theta, problem), (
        jnp.sum(gradient, axis=0),
        jnp.sum(matrix, axis=0) + frozen_slots(problem, theta),
    )


def frozen_slots(problem: Problem, theta: Float[Array, "n q"]) -> Float[Array, "p p"]:
    """Unit diagonal for unknowns without effect: those of empty slots, and dampings held or at their limits."""
    blind = jnp.broadcast_to((1 - problem.active)[:, None], theta.shape)
    limit = (theta[:, 1] <= jnp.log(UNDAMPED)) | (theta[:, 1] >= jnp.log(0.999))
    gone = (theta[:, 0] <= FAR[0]) | (theta[:, 0] >= FAR[1])
    blind = blind.at[:, 0].max(jnp.where(gone, 1.0, 0.0)).at[:, 1].max(jnp.where(limit, 1.0, problem.held))
    return jnp.diag(blind.ravel())


@jax.custom_jvp
def _with_value(value: Array, theta: Array, problem: Problem) -> Array:
    """The cost already computed; differentiating it goes through the projection itself."""
    del theta, problem
    return value


@_with_value.defjvp
def _with_value_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    value, theta, problem = primals
    _, d_theta, d_problem = tangents
    return value, jax.jvp(_values, (theta, problem), (d_theta, d_problem))[1]


def parts(theta: Float[Array, "n q"], problem: Problem) -> Parts:
    """Contributions of all outputs at the solution, stacked along the outputs."""
    C, dC = _columns(theta, problem), _column_derivatives(theta, problem)

    def row(pair: tuple[Array, Array]) -> Parts:
        return _normal_of_row(C, dC, *pair, problem.samples, problem.inputs, full=True)  # pyrefly: ignore[bad-return]

    return lax.map(row, (problem.weight, problem.y))


def linear_solution(theta: Float[Array, "n q"], problem: Problem) -> tuple[Float[Array, "o k"], Float[Array, "o m"]]:
    """Linear unknowns and whitened residual of every output."""
    C = _columns(theta, problem)

    def row(pair: tuple[Array, Array]) -> tuple[Array, Array]:
        w, y = pair
        Q, _, _, x = _linear(C, w, y)
        return x, y - Q @ (Q.T @ y)

    return lax.map(row, (problem.weight, problem.y))


def shapes_and_residuals(
    x: Float[Array, "o k"], problem: Problem, poles: Complex[Array, " n"]
) -> tuple[Complex[Array, "n o"], Complex[Array, "o i"], Complex[Array, "o i"]]:
    """Shapes, upper and lower residual terms of linear unknowns.

    For real modes the shape is that of the residue ``phi / (2 j omega_d)``.
    """
    n, i = poles.shape[0], problem.inputs
    c = 1 if problem.real_modes else 2
    local = x[:, : n * c].reshape(-1, n, c)
    if problem.real_modes:
        shapes = (local[:, :, 0] / (2j * poles.imag)).T
    else:
        shapes = (local[:, :, 0] + 1j * local[:, :, 1]).T
    zero = jnp.zeros((x.shape[0], i), jnp.complex128)
    if problem.residuals == "none":
        return shapes, zero, zero
    terms = x[:, n * c :].reshape(x.shape[0], i, -1)
    if problem.residuals == "complex":
        terms = terms[..., :2] + 1j * terms[..., 2:]
    top = jnp.max(problem.omega)
    # The columns are (s/top)^p and (s/top)^(p-2); the model has s^p U and s^(p-2) W.
    upper = terms[..., 0] / top**problem.power
    lower = terms[..., 1] / top ** (problem.power - 2)
    return shapes, upper.astype(jnp.complex128), lower.astype(jnp.complex128)
