r"""Laws of a joint fitted to its force against displacement, read off the change from level to level.

With the describing function ``N`` of a law and :math:`\Delta N = N(A_l) - N(A_1)` at the measured amplitudes,

.. math:: q_l = \frac{\Delta N\,x_1}{1 + \Delta N\,b^T D^{-1} b},

so that no equation has to be solved for the amplitude, and no jump of the response is in the way.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize

from modalax.diagnose.causes.base import JointCause
from modalax.diagnose.causes.joints import CoulombFriction, CubicStiffness, ElastoSlip, GapContact, QuadraticDamping
from modalax.diagnose.causes.power_laws import IwanMicroSlip, PowerDamper, PowerSpring
from modalax.diagnose.fitting.hypothesis import bounds_of, to_search
from modalax.diagnose.modal_domain.levels.change import Base, Levels, Projection, beyond_noise
from modalax.diagnose.modal_domain.levels.series import SERIES, apart, in_series

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
EXPONENTS = (-0.5, 0.5, 1.0, 2.0)  # of power laws, likewise
FARTHEST = 30.0  # factor on a displacement
TOLERANCE = 0.02  # relative error of a force by its first harmonic alone, before that is learnt
HARMONIC = 60  # lines at whose third harmonic the compliance across a place is read
FEW = 1500  # forces that starts are compared on
STEPS = 15  # most steps of one fit
PAD = 2048  # amplitudes that a compiled law takes at once, or a multiple


@dataclass(frozen=True)
class Motion:
    """What a law is fitted to at one place.

    Attributes
    ----------
    force, root, least
        Of the projection: forces ``(f, i, level - 1)``, a square root of their information where a law is exact to
        ``TOLERANCE``, chi-square of the rest.
    first
        Force that the lowest level asks for beyond the linear model, shape ``(f, i)``.
    still
        Displacement across the place at the lowest level, shape ``(f, i)`` [m/N].
    turn
        That over the linear model's, shape ``(f, i)``: so much of a force there is left once the lowest level's own
        force is part of the structure.
    drive
        Receptance across the place at the lowest level, less its compliance, shape ``(f, i)`` [m/N].
    amplitude
        Measured less what noise pretends, of all levels, of the displacement and what the compliance takes, shape
        ``(level, f, i)`` [m].
    seen
        The forces less what noise pretends, shape ``(f, i, level - 1)``.
    omega
        Shape ``(f,)`` [rad/s].
    compliance
        Across the place, to the harmonics of the lines [m/N].
    """

    force: np.ndarray
    root: np.ndarray
    least: float
    first: np.ndarray
    still: np.ndarray
    turn: np.ndarray
    drive: np.ndarray
    amplitude: np.ndarray
    seen: np.ndarray
    omega: np.ndarray
    compliance: float

    @cached_property
    def measured(self) -> tuple[jax.Array, jax.Array]:
        """Measured amplitudes and the circular frequency of each, as compiled laws take them."""
        return _padded(self.amplitude, self.omega[:, None])

    def thinned(self, step: int) -> "Motion":
        """Every so many lines."""
        return Motion(
            self.force[::step], self.root[::step], self.least, self.first[::step], self.still[::step],
            self.turn[::step], self.drive[::step], self.amplitude[:, ::step], self.seen[::step], self.omega[::step],
            self.compliance,
        )  # fmt: skip

    def behind(self, compliance: float, levels: np.ndarray) -> "Motion":
        """The same behind a compliance, at force levels [N]."""
        drive = self.drive - compliance
        moved = replace(self, drive=drive, compliance=compliance)
        return replace(moved, amplitude=levels[:, None, None] * np.abs(moved.moved(self.seen)))

    def moved(self, force: np.ndarray) -> np.ndarray:
        """Displacement at all levels that forces of the levels above the lowest go with, shape ``(level, f, i)``."""
        above = self.still[..., None] - (self.drive / self.turn)[..., None] * force
        return np.concatenate([self.still[..., None], above], axis=2).transpose(2, 0, 1)


def motions_of(levels: Levels, base: Base, b: np.ndarray, p: Projection, law: JointCause | None = None) -> list[Motion]:
    """What laws are fitted to at places of directions ``b``, shape ``(p, n)``.

    Parameters
    ----------
    law
        One that is to be told behind the place's compliance, if its kind can be.
    """
    across = base.across(b)
    compliance = np.zeros(len(b))
    if isinstance(law, SERIES):
        high = base.across(b, 3.0, max(1, len(base.s) // HARMONIC)).real
        compliance = np.maximum(np.median(high, axis=0), 0.0)
    still = np.einsum("pn,fni->pfi", b, base.inn)
    out = []
    for k in range(len(b)):
        seen = p.force[k] * (seen_force(p, k) / np.maximum(np.abs(p.force[k]) ** 2, 1e-300))
        d = across[:, k, None]
        turn = _bounded(1 - d * p.first[k] / np.where(still[k] == 0, 1e-300, still[k]))
        root = np.linalg.cholesky(softened(p.Q[k], seen_force(p, k), TOLERANCE)).transpose(0, 1, 3, 2)
        plain = Motion(
            p.force[k], root, float(p.least[k]), p.first[k], still[k] * turn, turn, d * turn,
            np.zeros(0), seen, base.s.imag, 0.0,
        )  # fmt: skip
        out.append(plain.behind(float(compliance[k]), levels.force))
    return out


def _bounded(turn: np.ndarray) -> np.ndarray:
    """A factor on a displacement, within bounds that no joint's motion leaves where it can be seen."""
    size = np.maximum(np.abs(turn), 1e-300)
    return turn / size * np.clip(size, 1 / FARTHEST, FARTHEST)


def seen_force(p: Projection, k: int) -> np.ndarray:
    """Square of the force of a place, less the noise, where it is more than noise at any line; ``(f, i, level - 1)``.

    A law told at an amplitude that noise has made would explain that noise.
    """
    return beyond_noise(p.force[k], 2 * np.diagonal(np.linalg.inv(p.Q[k]), axis1=-2, axis2=-1))


def softened(Q: np.ndarray, square: np.ndarray, rho: float) -> np.ndarray:
    """Information on forces that a law gives to a relative error ``rho``; ``square`` are the forces squared."""
    count = Q.shape[-1]
    return np.linalg.solve(np.eye(count) + 0.5 * rho**2 * Q * square[..., None, :], Q)


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
        return error * np.array([v if q.log else 1.0 for v, q in zip(self.p, self.law.parameters, strict=True)])


@partial(jax.jit, static_argnums=0)
def _stiffness(law: JointCause, A: Any, omega: Any, p: Any, g: Any) -> Any:
    return in_series(law, A, omega, p, g)


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
    a, w = m.measured if amplitude is None else _padded(A, m.omega[:, None])
    N = np.broadcast_to(np.asarray(_stiffness(law, a, w, p, m.compliance)), a.shape)
    return N[: A.size].reshape(A.shape)


def _padded(A: np.ndarray, omega: np.ndarray) -> tuple[jax.Array, jax.Array]:
    size = -(-A.size // PAD) * PAD
    a, w = np.ones(size), np.ones(size)
    a[: A.size], w[: A.size] = np.maximum(A.ravel(), 1e-300), np.broadcast_to(omega, A.shape).ravel()
    return jnp.asarray(a), jnp.asarray(w)


def force_of(law: JointCause, m: Motion, p: np.ndarray) -> np.ndarray:
    """Change of the force from the lowest level, at the measured amplitudes, shape ``(f, i, level - 1)``."""
    N = stiffness_of(law, m, p)
    dN = (N[1:] - N[0]).transpose(1, 2, 0)
    return dN * (m.still * m.turn)[..., None] / (1 + dN * m.drive[..., None])


def _difference(law: JointCause, m: Motion, p: np.ndarray) -> np.ndarray:
    r = (m.root @ (force_of(law, m, p) - m.force)[..., None]).ravel()
    return np.nan_to_num(np.concatenate([r.real, r.imag]), nan=1e6, posinf=1e6, neginf=-1e6)


def _jacobian(law: JointCause, m: Motion, p: np.ndarray) -> np.ndarray:
    """Derivatives of the difference by the parameters as searched."""
    size, shape = m.amplitude.size, m.amplitude.shape
    D, N = map(np.asarray, _slopes(law, *m.measured, p, m.compliance))
    N, D = N[:size].reshape(shape), (D[0] + 1j * D[1])[:size].reshape(*shape, len(p))
    dN = (N[1:] - N[0]).transpose(1, 2, 0)
    at = (m.still * m.turn)[..., None] / (1 + dN * m.drive[..., None]) ** 2
    by = (D[1:] - D[0]).transpose(1, 2, 0, 3) * at[..., None]
    r = (m.root @ by).reshape(-1, len(p))
    log = np.array([q.log for q in law.parameters])
    return np.nan_to_num(np.concatenate([r.real, r.imag]) * np.where(log, p, 1.0))


def _from_search(law: JointCause, u: np.ndarray) -> np.ndarray:
    return np.array([np.exp(min(v, 600.0)) if q.log else v for v, q in zip(u, law.parameters, strict=True)])


def _shapes(law: JointCause, top: float) -> list[tuple[float, ...]]:
    """Parameters beside the strength that a fit starts from; ``top`` is the largest amplitude."""
    if len(law.parameters) < 2:
        return [()]
    q = law.parameters[1]
    return [(f * top,) for f in FRACTIONS] if q.log else [(v,) for v in EXPONENTS if q.lower <= v <= q.upper]


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

    shapes = _shapes(law, float(m.amplitude.max()))[::every]
    found = sorted((at(shape) for shape in shapes), key=lambda c: c[0])
    if len(law.parameters) > 1 and law.parameters[1].log:
        apart_by = math.log(shapes[-1][0] / shapes[0][0]) / (len(shapes) - 1)
        for k in range(halvings):
            middle, factor = found[0][1][1], math.exp(apart_by / 2 ** (k + 1))
            found = sorted([*found, at((middle / factor,)), at((middle * factor,))], key=lambda c: c[0])
    return [one for one in found if np.isfinite(one[0])]


def fit_law(law: JointCause, m: Motion) -> LawFit | None:
    """The parameters of least chi-square; None where the law does nothing at these amplitudes."""
    few = m.thinned(max(1, m.force.size // FEW))
    starts = [p for _, p in regressed(law, few) if p[0] != 0]
    if not starts:
        return None
    low, high = bounds_of([law])
    best: tuple[float, np.ndarray] | None = None
    for start in starts[:2]:
        x = to_search(law, start)
        scale = np.array([abs(v) if not q.log else 1.0 for v, q in zip(x, law.parameters, strict=True)])
        scale = np.maximum(scale, 1e-12 * scale.max())
        found = scipy.optimize.least_squares(
            lambda y, m=few, scale=scale: _difference(law, m, _from_search(law, y * scale)),
            np.clip(x / scale, low / scale + 1e-12, high / scale - 1e-12),
            lambda y, m=few, scale=scale: _jacobian(law, m, _from_search(law, y * scale)) * scale,
            bounds=(low / scale, high / scale), max_nfev=STEPS,
        )  # fmt: skip
        if best is None or found.cost < best[0]:
            best = found.cost, found.x * scale
    if best is None:
        return None
    p = _from_search(law, best[1])
    r, J = _difference(law, m, p), _jacobian(law, m, p)
    for _ in range(3):  # on all lines, from where the few have led
        size = np.maximum(np.linalg.norm(J, axis=0), 1e-300)
        step = np.linalg.lstsq(J / size, -r, rcond=1e-8)[0] / size
        trial = _from_search(law, np.clip(to_search(law, p) + step, low, high))
        moved = _difference(law, m, trial)
        if moved @ moved >= r @ r:
            break
        p, r, J = trial, moved, _jacobian(law, m, trial)
    size = np.maximum(np.linalg.norm(J, axis=0), 1e-300)
    covariance = np.linalg.pinv((J / size).T @ (J / size)) / size[:, None] / size
    return LawFit(law, p, covariance, m.least + float(r @ r))
