r"""Fitting causes to the data: whitened residuals, nuisances with priors, damped Gauss-Newton over many candidates.

A nuisance :math:`\theta` (relative changes of the modal frequencies and damping ratios) has the spread that the author
of the simulation claims as its prior; the FREE question gives it a wide one and projects the modes' residues and the
residual terms of every channel out as well.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from modalax.diagnose.causes.base import Cause, Place
from modalax.diagnose.causes.lines import HumLines
from modalax.diagnose.predict import predict
from modalax.diagnose.problem import Problem, bucket

WIDE = 0.2  # prior spread of log frequency and log damping when the modes are free
ROUNDS, SETTLED = 14, 5e-3  # steps of the search; change of chi-square at which it ends
NEGLIGIBLE = 3e-4  # squared length of a modal parameter's effect, in standard deviations, below which it is left out
UNSEEN = 1e-12  # share of the information below which a combination of unknowns is not seen
NOWHERE = np.zeros((0, 3), np.int64)
BATCH_SAMPLES = 400_000  # complex numbers times unknowns that one batch of candidates may hold


@dataclass(frozen=True)
class Nuisance:
    """Spread of the modal parameters, shape ``(2, n)``, and directions of each channel that do not count.

    Attributes
    ----------
    spread
        Standard deviations of log frequency and log damping; 0 where they are exact.
    basis
        Orthonormal whitened directions, shape ``(o, i, run f 2, k)``, or None.
    live
        Which modal parameters can show in the data within their spread, as numbers in the flat order of ``spread``.
    """

    spread: np.ndarray
    basis: Any
    live: np.ndarray

    @property
    def active(self) -> bool:
        """Whether there is any modal parameter to adapt."""
        return len(self.live) > 0

    @property
    def chooser(self) -> np.ndarray:
        """One row a live parameter (and empty ones up to a common size), shape ``(k, 2 n)``."""
        rows = np.zeros((bucket(len(self.live)) if self.active else 0, self.spread.size))
        rows[np.arange(len(self.live)), self.live] = 1.0
        return rows


def make_nuisance(spread: np.ndarray, basis: Any, problem: Problem) -> Nuisance:
    """Find out which modal parameters matter."""
    if not (spread > 0).any():
        return Nuisance(spread, basis, np.zeros(0, np.int64))
    G = np.asarray(modal_directions(np.zeros(spread.shape), spread, basis, problem))
    # data far larger than was expected (wrong units) shows a modal parameter by as much more
    miss = residual_of((), NOWHERE, (), np.zeros(0), np.zeros(spread.shape), spread, None, problem)
    measured = float(np.sum(np.abs(np.asarray(problem.weight * problem.data)) ** 2))
    predicted = np.asarray(projected(problem.weight * problem.data, None)) - np.asarray(miss)
    larger = max(1.0, measured / max(float(np.sum(predicted**2)), 1e-300))
    return Nuisance(spread, basis, np.flatnonzero((G.reshape(len(G), -1) ** 2).sum(axis=1) * larger > NEGLIGIBLE))


@partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})
def modal_directions(theta, spread, basis, problem):
    """Change of the whitened prediction by each modal parameter times its spread, shape ``(2 n, o, i, run f 2)``."""

    def one(t):
        H = predict((), np.zeros((0, 3), np.int64), (), (), t * spread, problem)
        return projected(problem.weight * H, basis)

    J = jax.jacfwd(one)(theta)
    return jnp.moveaxis(J.reshape(*J.shape[:3], -1), -1, 0)


@dataclass(frozen=True)
class Hypothesis:
    """Causes at places, with parameters that were fitted.

    Attributes
    ----------
    causes, places, extras, params
        One entry a cause.
    theta
        Modal nuisances in units of their spread, shape ``(2, n)``.
    chi2
        Smallest chi-square, prior terms included.
    covariance
        Of the searched parameters (logarithms where a parameter is searched so), nuisances integrated out.
    freedom
        Number of unknowns that the causes cost.
    reason
        Why the search ended.
    hum
        Lines that mains hum reaches, left out of the fit; None without hum.
    """

    causes: tuple[Cause, ...] = ()
    places: tuple[Place, ...] = ()
    extras: tuple[Any, ...] = ()
    params: tuple[np.ndarray, ...] = ()
    theta: np.ndarray | None = None
    chi2: float = np.inf
    covariance: np.ndarray | None = None
    freedom: float = 0.0
    reason: str = ""
    hum: HumLines | None = None

    @property
    def names(self) -> frozenset[tuple[str, tuple[Any, ...]]]:
        """Slugs and places, as the answer tells them."""
        found = {(c.slug, p.where) for c, p in zip(self.causes, self.places, strict=True)}
        return frozenset(found | ({("mains_hum", ())} if self.hum is not None else set()))

    @property
    def per_run(self) -> bool:
        """Whether any effect depends on the run."""
        return any(c.per_run for c in self.causes)

    @property
    def index(self) -> np.ndarray:
        """Places as numbers, shape ``(cause, 3)``."""
        return np.array([p.index for p in self.places], dtype=np.int64).reshape(-1, 3)

    def with_cause(self, cause: Cause, place: Place, extra: Any, p: np.ndarray) -> "Hypothesis":
        """The same and one more cause, not fitted yet."""
        return replace(
            self, causes=(*self.causes, cause), places=(*self.places, place), extras=(*self.extras, extra),
            params=(*self.params, np.asarray(p, float)), chi2=np.inf, covariance=None,
        )  # fmt: skip


def to_search(cause: Cause, p: np.ndarray) -> np.ndarray:
    """Parameters as searched: logarithms where declared."""
    log = np.array([q.log for q in cause.parameters], bool)
    return np.where(log, np.log(np.maximum(p, 1e-300)), p) if len(log) else np.zeros(0)


def from_search(cause: Cause, u: Any) -> Any:
    """Parameters from what is searched."""
    log = np.array([q.log for q in cause.parameters], bool)
    if not len(log):
        return jnp.zeros(0)
    return jnp.where(log, jnp.exp(jnp.where(log, u, 0.0)), u)


def split(causes: Sequence[Cause], u: Any) -> list[Any]:
    """Searched unknowns of each cause."""
    out, k = [], 0
    for cause in causes:
        n = len(cause.parameters)
        out.append(u[k : k + n])
        k += n
    return out


def bounds_of(causes: Sequence[Cause]) -> tuple[np.ndarray, np.ndarray]:
    """Limits of the searched unknowns."""
    low, high = [], []
    for q in (q for cause in causes for q in cause.parameters):
        low.append(np.log(max(q.lower, 1e-300)) if q.log else q.lower)
        high.append(np.log(q.upper) if q.log else q.upper)
    return np.array(low), np.array(high)


def projected(r: Array, basis: Any) -> Array:
    """Real and imaginary parts of whitened residuals, shape ``(o, i, run f 2)``, free directions taken out."""
    real = jnp.stack([r.real, r.imag], axis=-1)
    real = jnp.moveaxis(real, (2, 3), (0, 1)).reshape(*r.shape[2:], -1)
    if basis is None:
        return real
    return real - jnp.einsum("oink,oik->oin", basis, jnp.einsum("oink,oin->oik", basis, real))


def whitened(
    causes: Sequence[Cause], index: Array, extras: Any, u: Array, theta: Array, spread: Array, basis: Any,
    problem: Problem,
) -> Array:  # fmt: skip
    """Whitened, projected residuals of a hypothesis."""
    params = [from_search(c, v) for c, v in zip(causes, split(causes, u), strict=True)]
    H = predict(causes, index, extras, params, theta * spread, problem)
    return projected(problem.weight * (problem.data - H), basis)


@partial(jax.jit, static_argnames=("causes",))
def _normal_one(causes, index, extras, x, chooser, spread, basis, problem):
    count = x.shape[0] - chooser.shape[0]

    def residual(x):
        theta = (x[count:] @ chooser).reshape(spread.shape)
        return whitened(causes, index, extras, x[:count], theta, spread, basis, problem).ravel()

    r = residual(x)
    if not x.shape[0]:
        return r @ r, jnp.zeros((0, 0)), jnp.zeros(0)
    J = jax.jacfwd(residual)(x)
    chi2, A, g = r @ r, J.T @ J, J.T @ r
    prior = jnp.concatenate([jnp.zeros(count), jnp.ones(chooser.shape[0])])
    return chi2 + jnp.sum(prior * x**2), A + jnp.diag(prior), g + prior * x


@partial(jax.jit, static_argnames=("causes",))
def _normal_many(causes, index, extras, x, chooser, spread, basis, problem):
    return jax.vmap(lambda k, e, v: _normal_one(causes, k, e, v, chooser, spread, basis, problem))(index, extras, x)


@partial(jax.jit, static_argnames=("causes",))
def residual_of(causes, index, extras, u, theta, spread, basis, problem):
    """Whitened residuals, shape ``(o, i, run f 2)``."""
    return whitened(causes, index, extras, u, theta, spread, basis, problem)


def searched(h: Hypothesis) -> np.ndarray:
    """All unknowns of a hypothesis as searched."""
    parts = [to_search(c, p) for c, p in zip(h.causes, h.params, strict=True)]
    return np.concatenate([np.zeros(0), *parts])


def fit_many(
    starts: Sequence[Hypothesis], problem: Problem, nuisance: Nuisance, rounds: int = ROUNDS
) -> list[Hypothesis]:
    """Fit hypotheses of one kind (same causes, different places and starts), in batches of a fixed size."""
    if not starts:
        return []
    unknowns = max(1, len(searched(starts[0])) + len(nuisance.chooser))
    size = 4 if problem.data.size * unknowns * 4 <= 40 * BATCH_SAMPLES and len(starts) > 1 else 1
    out: list[Hypothesis] = []
    for k in range(0, len(starts), size):
        part = list(starts[k : k + size])
        out += _fit_batch(part + [part[-1]] * (size - len(part)), problem, nuisance, rounds)[: len(part)]
    return out


def _fit_batch(starts: list[Hypothesis], problem: Problem, nuisance: Nuisance, rounds: int) -> list[Hypothesis]:
    causes = starts[0].causes
    n = problem.plant.stiffness.shape[0]
    u = np.stack([searched(h) for h in starts])
    theta = np.stack([np.zeros((2, n)) if h.theta is None else h.theta for h in starts])
    index = np.stack([h.index for h in starts])
    extras = tuple(
        None if starts[0].extras[k] is None else np.stack([h.extras[k] for h in starts]) for k in range(len(causes))
    )
    low, high = bounds_of(causes)
    count = u.shape[1]

    chooser = nuisance.chooser

    def normal(x: np.ndarray, _: np.ndarray) -> Any:
        return _normal_many(causes, index, extras, x, chooser, nuisance.spread, nuisance.basis, problem)

    free = np.full(len(chooser), np.inf)
    start = np.concatenate([u, theta.reshape(len(u), -1) @ chooser.T], axis=1)
    x, chi2, A, open_ = damped(normal, start, np.concatenate([low, -free]), np.concatenate([high, free]), rounds)
    u, theta = x[:, :count], (x[:, count:] @ chooser).reshape(theta.shape)
    out = []
    for b, h in enumerate(starts):
        params = [np.asarray(from_search(c, v)) for c, v in zip(causes, split(causes, u[b]), strict=True)]
        out.append(
            replace(
                h, params=tuple(params), theta=theta[b], chi2=float(chi2[b]),
                covariance=covariance_of(A[b])[:count, :count],
                reason="still moving" if open_[b] else "settled",
            )
        )  # fmt: skip
    return out


def damped(
    normal: Any, x: np.ndarray, low: np.ndarray, high: np.ndarray, rounds: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Levenberg's and Marquardt's search for many starts side by side.

    Parameters
    ----------
    normal
        Gives chi-square, normal matrix and gradient of half the chi-square at each row of ``x``, from ``x`` and which
        rows are still moving; what it gives for the others is not looked at.

    Returns
    -------
    tuple
        Unknowns, chi-squares, normal matrices, and which were still moving.
    """

    def checked(x: np.ndarray, moving: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        chi2, A, g = (np.asarray(a) for a in normal(x, moving))
        bad = ~(np.isfinite(chi2) & np.isfinite(A).all(axis=(1, 2)) & np.isfinite(g).all(axis=1))
        return np.where(bad, np.inf, chi2), np.nan_to_num(A), np.nan_to_num(g)

    chi2, A, g = checked(x, np.ones(len(x), bool))
    damping = np.full(len(x), 1e-3)
    moving = np.isfinite(chi2) & (x.shape[1] > 0)
    for _ in range(rounds):
        if not moving.any():
            break
        # what stands at a bound and is pushed against it stays there; the others do not step as if it moved
        held = ((x <= low) & (g > 0)) | ((x >= high) & (g < 0))
        step = np.stack([_step(A[b], g[b], damping[b], held[b]) for b in range(len(x))])
        trial = np.where(moving[:, None], np.clip(x + step, low, high), x)
        new_chi2, new_A, new_g = checked(trial, moving)
        better = moving & (new_chi2 <= chi2)
        drop = np.where(better, chi2 - new_chi2, np.inf)
        x = np.where(better[:, None], trial, x)
        A = np.where(better[:, None, None], new_A, A)
        g = np.where(better[:, None], new_g, g)
        chi2 = np.where(better, new_chi2, chi2)
        damping = np.where(better, damping / 8, damping * 6)
        moving &= (drop > SETTLED) & (damping < 1e6)
    return x, chi2, A, moving


def _step(A: np.ndarray, g: np.ndarray, damping: float, held: np.ndarray) -> np.ndarray:
    free, out = ~held, np.zeros(len(g))
    scale = np.sqrt(np.maximum(np.diag(A)[free], 1e-300))
    scaled = A[np.ix_(free, free)] / scale[:, None] / scale[None]
    scaled[np.diag_indices_from(scaled)] += damping + 1e-12
    out[free] = -np.linalg.lstsq(scaled, g[free] / scale, rcond=None)[0] / scale
    return out


def covariance_of(A: np.ndarray) -> np.ndarray:
    """Inverse of a normal matrix; along what it does not show the variance is all but infinite, not nothing."""
    diagonal = np.diag(A)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    value, V = np.linalg.eigh(A / scale[:, None] / scale[None])
    return (V / np.maximum(value, UNSEEN)) @ V.T / scale[:, None] / scale[None]


@partial(jax.jit, static_argnames=("causes",))
def jacobian_of(causes, index, extras, u, theta, spread, basis, problem):
    """Derivatives of the whitened residual by the searched unknowns, shape ``(unknown, o, i, run f 2)``."""
    J = jax.jacfwd(lambda v: whitened(causes, index, extras, v, theta, spread, basis, problem))(u)
    return jnp.moveaxis(J, -1, 0)


def free_basis(problem: Problem) -> np.ndarray:
    """Whitened directions that any linear modal model with the same poles can take, orthonormal in each channel."""
    s = 1j * np.asarray(problem.omega)[:, None]
    poles = np.asarray(problem.plant.poles)
    live = np.abs(np.asarray(problem.plant.shapes)).max(axis=1) > 0
    near, far = 1 / (s - poles[live]), 1 / (s - poles[live].conj())
    columns = np.concatenate(
        [near + far, 1j * (near - far), np.ones_like(s), 1j * np.ones_like(s), 1 / s**2, 1j / s**2], axis=1
    )
    weight = np.asarray(problem.weight)
    A = weight.transpose(2, 3, 0, 1)[..., None] * columns
    real = np.stack([A.real, A.imag], axis=-2).reshape(*A.shape[:2], -1, A.shape[-1])
    norm = np.linalg.norm(real, axis=-2, keepdims=True)
    Q, R = np.linalg.qr(real / np.where(norm > 0, norm, 1.0))
    strong = np.abs(np.diagonal(R, axis1=-2, axis2=-1)) > 1e-9
    return Q * strong[..., None, :]
