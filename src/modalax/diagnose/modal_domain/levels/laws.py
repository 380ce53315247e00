r"""Laws of a joint fitted to its force against displacement, read off the change from level to level.

With the describing function ``N`` of a law and :math:`\Delta N = N(A_l) - N(A_1)` at the measured amplitudes,

.. math:: q_l = \frac{\Delta N\,x_1}{1 + \Delta N\,b^T D^{-1} b},

so that no equation has to be solved for the amplitude, and no jump of the response is in the way.
"""

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize

from modalax.diagnose.causes.base import JointCause
from modalax.diagnose.causes.joints import CoulombFriction, CubicStiffness, ElastoSlip, GapContact, QuadraticDamping
from modalax.diagnose.causes.power_laws import IwanMicroSlip, PowerDamper, PowerSpring
from modalax.diagnose.fitting.hypothesis import bounds_of, from_search, slopes, to_search
from modalax.diagnose.modal_domain.levels.balance import ORDERS, balanced
from modalax.diagnose.modal_domain.levels.motion import Motion, padded
from modalax.diagnose.modal_domain.levels.play import Cube, Drag, Play, Stop
from modalax.diagnose.modal_domain.levels.series import apart, in_series

# A bilinear spring's first harmonic does not know the level. Seen from the lowest level, a spring that slips beside
# others and one that slips in the stead of another are the same.
NAMED: tuple[Any, ...] = (
    CoulombFriction(), ElastoSlip(True), CubicStiffness(), GapContact(), QuadraticDamping(), IwanMicroSlip()
)  # fmt: skip
NAMELESS: tuple[Any, ...] = (PowerSpring(), PowerDamper())
# Exponents of power laws that are next to a named law's, drag and a cubic spring: such a fit is no rival of that name,
# since errors of the motion bend an exponent.
NEXT_TO = {"power_damper": (0.5, 1.5), "power_spring": (1.2, 3.0)}
FRACTIONS = (0.03, 0.1, 0.2, 0.3, 0.4, 0.55, 0.75)  # thresholds over the largest amplitude that a fit starts from
QUANTILES = (0.02, 0.05, 0.1, 0.3, 0.6)  # of amplitudes at which forces are seen, with all harmonics
EXPONENTS = (-0.5, 0.5, 1.0, 2.0)  # of power laws, likewise
FEW = 1500  # forces that starts are compared on
FEWER = 300  # the same with all harmonics
STRENGTHS = 2.0 ** np.arange(-2, 1.1, 1 / 3)  # factors on the strength by first harmonics, with all harmonics
LOWER = 9  # harmonics up to which the motion is compared with that by all that are kept
SIMPLEX, SOUGHT = 0.1, 60  # relative size of the search about a start, and its most trials
BENT = 1e-5  # relative change of a parameter by which derivatives with all harmonics are taken
BEGUN, STEPS = 2, 15  # starts that are followed, or turns with all harmonics, and most steps of one fit


@dataclass(frozen=True)
class LawFit:
    """One law at one place.

    Attributes
    ----------
    law
        A cause of the catalogue, or one that only imitates them.
    p, covariance
        Parameters, and their covariance as searched.
    chi2
        Of all changes from level to level.
    """

    law: JointCause
    p: np.ndarray
    covariance: np.ndarray
    chi2: float

    @property
    def rival(self) -> bool:
        """Whether it says another thing than the named laws."""
        low, high = NEXT_TO.get(self.law.slug, (np.inf, np.inf))
        return not low <= self.p[-1] <= high

    @property
    def std(self) -> np.ndarray:
        """Standard deviations of the parameters themselves."""
        error = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return error * slopes(self.law, self.p)


_stiffness = jax.jit(in_series, static_argnums=0)


@partial(jax.jit, static_argnums=0)
def _plain(law: JointCause, A: Any, omega: Any, p: Any) -> Any:
    return law.impedance(A, omega, p)


@partial(jax.jit, static_argnums=0)
def _slopes(law: JointCause, A: Any, omega: Any, p: Any, g: Any) -> tuple[Any, Any]:
    """Derivatives by the parameters, real and imaginary parts, and the describing function itself."""

    def parts(p: Any) -> Any:
        N = in_series(law, A, omega, p, g) + 0j * A
        return jnp.stack([N.real, N.imag]), N

    return jax.jacfwd(parts, has_aux=True)(p)


def stiffness_of(law: JointCause, m: Motion, p: np.ndarray, amplitude: np.ndarray | None = None) -> np.ndarray:
    """Describing function at the measured amplitudes, or others of the same lines ``(..., f, i)`` [N/m]."""
    A = m.amplitude if amplitude is None else amplitude
    if m.harmonic is not None:
        return _in_balance(law, m, p, A)[0]
    a, w = m.measured if amplitude is None else padded(A, m.omega[:, None])
    N = np.broadcast_to(np.asarray(_stiffness(law, a, w, p, m.compliance)), a.shape)
    return N[: A.size].reshape(A.shape)


def _in_balance(
    law: JointCause, m: Motion, p: np.ndarray, A: np.ndarray, start: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Describing function with all harmonics [N/m], of a slider what it takes, and those of the displacement."""
    assert m.harmonic is not None
    g, omega = m.harmonic, m.omega[:, None]
    if isinstance(law, ElastoSlip):
        shape, strength = Play(p[1]), -p[0] * np.ones_like(omega)
        g = g if m.within else g / (1 + p[0] * g)
    elif isinstance(law, GapContact):
        shape, strength = Stop(p[1]), p[0] / (1 + m.compliance * p[0]) * np.ones_like(omega)
        g = g - m.compliance
    elif isinstance(law, CubicStiffness):
        shape, strength = Cube(), p[0] * np.ones_like(omega)
    else:
        shape, strength = Drag(), p[0] * omega**2
    pushed = np.broadcast_to((-strength * g)[:, None, :], (*A.shape, len(ORDERS))).reshape(A.size, -1)
    share, X = balanced(shape, A.ravel(), pushed, start)
    return strength * share.reshape(A.shape), X


def derivatives_of(law: JointCause, m: Motion, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Describing function at the measured amplitudes, and its derivatives by the parameters, last axis."""
    size, shape = m.amplitude.size, m.amplitude.shape
    if m.harmonic is None:
        D, N = map(np.asarray, _slopes(law, *m.measured, p, m.compliance))
        return N[:size].reshape(shape), (D[0] + 1j * D[1])[:size].reshape(*shape, len(p))
    N, X = _in_balance(law, m, p, m.amplitude)
    moved = [_in_balance(law, m, p * (1 + BENT * own), m.amplitude, X)[0] for own in np.eye(len(p))]
    return N, np.stack([(n - N) / max(BENT * abs(v), 1e-300) for n, v in zip(moved, p, strict=True)], axis=-1)


def force_of(law: JointCause, m: Motion, p: np.ndarray) -> np.ndarray:
    """Change of the force from the lowest level, at the measured amplitudes, shape ``(f, i, level - 1)``."""
    return force_at(m, stiffness_of(law, m, p))


def force_at(m: Motion, N: np.ndarray) -> np.ndarray:
    """The same by the describing function at these amplitudes."""
    dN = (N[1:] - N[0]).transpose(1, 2, 0)
    return dN * (m.still * m.turn)[..., None] / (1 + dN * m.drive[..., None])


def scattered(law: JointCause, m: Motion, p: np.ndarray) -> np.ndarray:
    """Variance of a law's force by what is not known of the motion, shape ``(f, i, level - 1)``."""
    if m.harmonic is None:
        return np.zeros(m.force.shape)
    N, X = _in_balance(law, m, p, m.amplitude)
    q = force_at(m, N)
    others = (force_at(other, _in_balance(law, other, p, other.amplitude, X)[0]) for other in m.others)
    return 0.5 * sum((np.abs(other - q) ** 2 for other in others), np.zeros(q.shape))


def with_fewer(law: JointCause, m: Motion, p: np.ndarray) -> np.ndarray:
    """Describing function without the highest harmonics that are kept [N/m], shape ``(level, f, i)``.

    Harmonics beyond those that are kept do no more than these.
    """
    if m.harmonic is None:
        return stiffness_of(law, m, p)
    fewer = replace(m, harmonic=np.where(ORDERS <= LOWER, m.harmonic, 0.0))
    return _in_balance(law, fewer, p, m.amplitude)[0]


def _difference(law: JointCause, m: Motion, p: np.ndarray) -> np.ndarray:
    return _off(m, stiffness_of(law, m, p))


def _off(m: Motion, N: np.ndarray) -> np.ndarray:
    """What a describing function misses of the forces, over their errors."""
    r = (m.root @ (force_at(m, N) - m.force)[..., None]).ravel()
    return np.nan_to_num(np.concatenate([r.real, r.imag]), nan=1e6, posinf=1e6, neginf=-1e6)


def _jacobian(law: JointCause, m: Motion, p: np.ndarray) -> np.ndarray:
    """Derivatives of the difference by the parameters as searched."""
    N, D = derivatives_of(law, m, p)
    dN = (N[1:] - N[0]).transpose(1, 2, 0)
    at = (m.still * m.turn)[..., None] / (1 + dN * m.drive[..., None]) ** 2
    by = (D[1:] - D[0]).transpose(1, 2, 0, 3) * at[..., None]
    r = (m.root @ by).reshape(-1, len(p))
    return np.nan_to_num(np.concatenate([r.real, r.imag]) * slopes(law, p))


def _shapes(law: JointCause, m: Motion) -> list[tuple[float, ...]]:
    """Parameters beside the strength that a fit starts from, by rising size."""
    if len(law.parameters) < 2:
        return [()]
    q, top = law.parameters[1], float(m.amplitude.max())
    if not q.log:
        return [(v,) for v in EXPONENTS if q.lower <= v <= q.upper]
    if m.harmonic is None:
        return [(f * top,) for f in FRACTIONS]
    beyond = m.amplitude[1:].transpose(1, 2, 0)[m.seen != 0]
    return [(float(v),) for v in np.quantile(beyond, QUANTILES)] if len(beyond) else []


def regressed(
    law: JointCause, m: Motion, every: int = 1, halvings: int = 0
) -> list[tuple[float, np.ndarray]]:  # fmt: skip
    """Chi-square and parameters at some of a law's shapes, with the strength by linear regression of the force.

    Where ``halvings`` are asked for, a threshold is sought about the best of them, to that part of their distance.
    """
    aim = (m.root @ m.force[..., None]).ravel()
    moved = m.moved(m.seen)[1:].transpose(1, 2, 0) * m.turn[..., None]

    def at(shape: tuple[float, ...]) -> tuple[float, np.ndarray]:
        a, w = m.measured  # at a strength of 1 N/m no compliance matters
        N = np.broadcast_to(np.asarray(_plain(law, a, w, np.array([1.0, *shape]))), a.shape)
        N = N[: m.amplitude.size].reshape(m.amplitude.shape)
        unit = (m.root @ ((N[1:] - N[0]).transpose(1, 2, 0) * moved)[..., None]).ravel()
        size = float((np.abs(unit) ** 2).sum())
        if not np.isfinite(size) or size <= 0:
            return np.inf, np.array([0.0, *shape])
        strength = float((unit.conj() * aim).real.sum() / size)
        strength = float(np.clip(strength, law.parameters[0].lower, law.parameters[0].upper))
        cost = m.least + float((np.abs(aim - strength * unit) ** 2).sum())
        return cost, apart(law, np.array([strength, *shape]), m.compliance)

    shapes = _shapes(law, m)[::every]
    found = sorted((at(shape) for shape in shapes), key=lambda c: c[0])
    if halvings and len(law.parameters) > 1 and law.parameters[1].log:
        apart_by = math.log(shapes[-1][0] / shapes[0][0]) / (len(shapes) - 1)
        for k in range(halvings):
            middle, factor = found[0][1][1], math.exp(apart_by / 2 ** (k + 1))
            found = sorted([*found, at((middle / factor,)), at((middle * factor,))], key=lambda c: c[0])
    return [one for one in found if np.isfinite(one[0])]


def _sought(law: JointCause, m: Motion, begun: np.ndarray | None) -> np.ndarray | None:
    """Parameters of least chi-square with all harmonics, which has many minima, some of them narrow."""
    if begun is not None and not np.all(begun):  # on fewer lines it does nothing
        return None
    harmonics, sign = None, 1.0 if begun is None else np.sign(begun)

    def cost(u: np.ndarray, m: Motion) -> float:
        nonlocal harmonics
        p = sign * np.exp(u)
        if isinstance(law, ElastoSlip) and p[0] >= m.most:
            return np.inf
        N, harmonics = _in_balance(law, m, p, m.amplitude, harmonics)
        return float((_off(m, N) ** 2).sum())

    if begun is None:
        starts = [np.log([f * p[0], *p[1:]]) for _, p in regressed(law, m) if p[0] > 0 for f in STRENGTHS]
        ranked = sorted((cost(u, m), k, u) for k, u in enumerate(starts))
        if not ranked or not np.isfinite(ranked[0][0]):
            return None
        best, turns = ranked[0][2], BEGUN
    else:
        best, turns = np.log(np.abs(begun)), 1
    for _ in range(turns):  # once more with what is not known at the best
        loose = m.loosened(scattered(law, m, sign * np.exp(best)))
        simplex = best + SIMPLEX * np.concatenate([np.zeros((1, len(best))), np.eye(len(best))])
        options = {"initial_simplex": simplex, "maxfev": SOUGHT, "xatol": 1e-4, "fatol": 0.1}
        best = scipy.optimize.minimize(cost, best, (loose,), method="Nelder-Mead", options=options).x
    return sign * np.exp(best)


def _followed(law: JointCause, m: Motion) -> np.ndarray | None:
    """Parameters of least chi-square that the best starts lead to; None where the law does nothing."""
    starts = [p for _, p in regressed(law, m) if p[0] != 0]
    low, high = bounds_of([law])
    best: tuple[float, np.ndarray] | None = None
    for start in starts[:BEGUN]:
        x = to_search(law, start)
        scale = np.array([abs(v) if not q.log else 1.0 for v, q in zip(x, law.parameters, strict=True)])
        scale = np.maximum(scale, 1e-12 * scale.max())
        found = scipy.optimize.least_squares(
            lambda y, scale=scale: _difference(law, m, from_search(law, y * scale)),
            np.clip(x / scale, low / scale + 1e-12, high / scale - 1e-12),
            lambda y, scale=scale: _jacobian(law, m, from_search(law, y * scale)) * scale,
            bounds=(low / scale, high / scale), max_nfev=STEPS,
        )  # fmt: skip
        if best is None or found.cost < best[0]:
            best = found.cost, found.x * scale
    return None if best is None else from_search(law, best[1])


def fit_law(law: JointCause, m: Motion, begun: np.ndarray | None = None) -> LawFit | None:
    """The parameters of least chi-square; None where the law does nothing at these amplitudes.

    A fit with all harmonics may begin where one on fewer lines has ended.
    """
    if m.harmonic is None:
        p = _followed(law, m.some(FEW))
    else:
        p = _sought(law, m.some(FEWER), begun)
    if p is None:
        return None
    low, high = bounds_of([law])
    m = m if m.harmonic is None else m.loosened(scattered(law, m, p))
    r, J = _difference(law, m, p), _jacobian(law, m, p)
    for _ in range(3):  # on all lines, from where the few have led
        size = np.maximum(np.linalg.norm(J, axis=0), 1e-300)
        step = np.linalg.lstsq(J / size, -r, rcond=1e-8)[0] / size
        trial = from_search(law, np.clip(to_search(law, p) + step, low, high))
        moved = _difference(law, m, trial)
        if moved @ moved >= r @ r:
            break
        p, r, J = trial, moved, _jacobian(law, m, trial)
    size = np.maximum(np.linalg.norm(J, axis=0), 1e-300)
    covariance = np.linalg.pinv((J / size).T @ (J / size)) / size[:, None] / size
    return LawFit(law, p, covariance, m.least + float(r @ r))
