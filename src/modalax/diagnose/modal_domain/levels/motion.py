"""The motion across a place at every level, line and input, to which laws of joints are fitted."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np

from modalax.diagnose.causes.base import JointCause
from modalax.diagnose.causes.joints import CubicStiffness, ElastoSlip, GapContact, QuadraticDamping
from modalax.diagnose.modal_domain.levels.balance import ORDERS
from modalax.diagnose.modal_domain.levels.change import Base, Levels, Projection, beyond_noise, projected

BALANCED = (ElastoSlip, CubicStiffness, GapContact, QuadraticDamping)  # laws that are told with all harmonics
FARTHEST = 30.0  # factor on a displacement
TOLERANCE = 0.02  # relative error of a force by its first harmonic alone, before that is learnt
HARMONIC = 60  # lines at whose third harmonic the compliance across a place is read
STATIC, MOST = 1e-3, 2.0  # part of the lowest line that is as good as static, and of the stiffness there
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
    harmonic
        Receptance across the place at the higher harmonics of each line, shape ``(f, h)`` [m/N], where a law is to be
        told with these; else None.
    scatter
        Relative standard deviation of natural frequencies, half of that of stiffnesses and motions.
    aside
        What the higher harmonics meet where natural frequencies are lower and higher by their scatter.
    most
        Stiffness that can be taken out of the structure there [N/m].
    within
        Whether the linear model has the spring that may slip; it meets itself then, too.
    error
        Standard deviation of the forces' parts by noise, shape ``(f, i, level - 1)``; the motion is as uncertain.
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
    harmonic: np.ndarray | None = None
    scatter: float = 0.0
    aside: tuple[np.ndarray, ...] = ()
    most: float = math.inf
    within: bool = True
    error: np.ndarray | None = None

    @property
    def blurred(self) -> np.ndarray:
        """Relative standard deviation of each amplitude by noise, ``(level, f, i)``; none of the lowest level's."""
        if self.error is None:
            return np.zeros(self.amplitude.shape)
        size = np.abs(self.moved(self.seen))
        by = np.abs(self.drive / self.turn)[..., None] * self.error
        by = np.concatenate([np.zeros_like(by[..., :1]), by], axis=2).transpose(2, 0, 1)
        return np.minimum(by / np.maximum(size, 1e-300), 1.0)

    @property
    def others(self) -> tuple["Motion", ...]:
        """What the motion may be as well, in pairs of one error each way."""
        if self.harmonic is None:
            return ()
        more, less = 1 + 2 * self.scatter, 1 - 2 * self.scatter
        met = *self.aside, self.harmonic * more, self.harmonic * less
        blur = self.blurred
        moved = (replace(self, amplitude=self.amplitude * by) for by in (more, less, 1 + blur, 1 - blur))
        return *(replace(self, harmonic=g) for g in met), *moved

    @cached_property
    def measured(self) -> tuple[jax.Array, jax.Array]:
        """Measured amplitudes and the circular frequency of each, as compiled laws take them."""
        return padded(self.amplitude, self.omega[:, None])

    def some(self, count: int) -> "Motion":
        """At lines that hold about so many forces, half of which are seen where so many are."""
        each = max(1, count // (2 * self.force[0].size))
        shown = (self.seen != 0).any(axis=(1, 2))
        parts = [np.flatnonzero(shown), np.flatnonzero(~shown)]
        lines = np.sort(np.concatenate([p[:: -(-len(p) // each) or 1] for p in parts]))
        return Motion(
            self.force[lines], self.root[lines], self.least, self.first[lines], self.still[lines], self.turn[lines],
            self.drive[lines], self.amplitude[:, lines], self.seen[lines], self.omega[lines], self.compliance,
            None if self.harmonic is None else self.harmonic[lines], self.scatter,
            tuple(g[lines] for g in self.aside), self.most, self.within,
            None if self.error is None else self.error[lines],
        )  # fmt: skip

    def along(self, other: "Motion", levels: np.ndarray) -> "Motion":
        """Another motion at the same lines and force levels [N] that meets the same at its higher harmonics."""
        return replace(
            other.behind(self.compliance, levels), harmonic=self.harmonic, scatter=self.scatter, aside=self.aside,
            most=self.most, within=self.within,
        )  # fmt: skip

    def loosened(self, variance: np.ndarray) -> "Motion":
        """The same with an error of a law's forces of its own, of a variance ``(f, i, level - 1)``."""
        Q = softened(self.root.transpose(0, 1, 3, 2) @ self.root, variance)
        return replace(self, root=np.linalg.cholesky(Q).transpose(0, 1, 3, 2))

    def behind(self, compliance: float, levels: np.ndarray) -> "Motion":
        """The same behind a compliance, at force levels [N]."""
        drive = self.drive - compliance
        moved = replace(self, drive=drive, compliance=compliance)
        return replace(moved, amplitude=levels[:, None, None] * np.abs(moved.moved(self.seen)))

    def moved(self, force: np.ndarray) -> np.ndarray:
        """Displacement at all levels that forces of the levels above the lowest go with, shape ``(level, f, i)``."""
        above = self.still[..., None] - (self.drive / self.turn)[..., None] * force
        return np.concatenate([self.still[..., None], above], axis=2).transpose(2, 0, 1)


def motions_of(levels: Levels, base: Base, b: np.ndarray, p: Projection) -> list[Motion]:
    """What laws are fitted to at places of directions ``b``, shape ``(p, n)``."""
    across = base.across(b)
    still = np.einsum("pn,fni->pfi", b, base.inn)
    out = []
    for k in range(len(b)):
        seen = p.force[k] * (seen_force(p, k) / np.maximum(np.abs(p.force[k]) ** 2, 1e-300))
        d = across[:, k, None]
        turn = _bounded(1 - d * p.first[k] / np.where(still[k] == 0, 1e-300, still[k]))
        root = np.linalg.cholesky(softened(p.Q[k], TOLERANCE**2 * seen_force(p, k))).transpose(0, 1, 3, 2)
        plain = Motion(
            p.force[k], root, float(p.least[k]), p.first[k], still[k] * turn, turn, d * turn,
            np.zeros(0), seen, base.s.imag, 0.0, error=error_of(p, k),
        )  # fmt: skip
        out.append(plain.behind(0.0, levels.force))
    return out


def compliances_of(base: Base, b: np.ndarray) -> np.ndarray:
    """Compliances that harmonics of the lines meet across places of directions ``b`` [m/N], shape ``(p,)``."""
    high = base.across(b, 3.0, max(1, len(base.s) // HARMONIC)).real
    return np.maximum(np.median(high, axis=0), 0.0)


def motion_of(levels: Levels, base: Base, b: np.ndarray, law: JointCause, within: bool = True) -> Motion:
    """What one law is told from at the place of direction ``b``; ``within`` as of :class:`Motion`."""
    m = motions_of(levels, base, b[None], projected(levels, base, b[None]))[0]
    return for_law(m, levels, base, b, law, within)


def for_law(m: Motion, levels: Levels, base: Base, b: np.ndarray, law: JointCause, within: bool = True) -> Motion:
    """A motion across a place as a law is told from it: with what its higher harmonics meet, if it is told with these.

    A stop, whose harmonics are endless, is told behind what those left out meet.
    """
    if not isinstance(law, BALANCED):
        return m
    (m,) = in_harmonics([m], base, b[None], [within])
    assert m.harmonic is not None
    stops = isinstance(law, GapContact)
    return m.behind(max(float(np.median(m.harmonic[:, -1].real)), 0.0), levels.force) if stops else m


def in_harmonics(motions: list[Motion], base: Base, b: np.ndarray, within: Sequence[bool]) -> list[Motion]:
    """Motions across places of directions ``b`` with what the higher harmonics meet there."""
    off = base.scatter
    high, more, less = (base.at_harmonics(b, times * ORDERS) for times in (1.0, 1 + off, 1 - off))
    static = np.abs(base.across(b, STATIC, len(base.s))[0])
    most = np.where(within, MOST / np.maximum(static, 1e-300), np.inf)
    return [
        replace(m, harmonic=high[:, k], scatter=off, aside=(more[:, k], less[:, k]), most=float(most[k]), within=held)
        for k, (m, held) in enumerate(zip(motions, within, strict=True))
    ]


def _bounded(turn: np.ndarray) -> np.ndarray:
    """A factor on a displacement, within bounds that no joint's motion leaves where it can be seen."""
    size = np.maximum(np.abs(turn), 1e-300)
    return turn / size * np.clip(size, 1 / FARTHEST, FARTHEST)


def seen_force(p: Projection, k: int) -> np.ndarray:
    """Square of the force of a place, less the noise, where it is more than noise at any line; ``(f, i, level - 1)``.

    A law told at an amplitude that noise has made would explain that noise.
    """
    return beyond_noise(p.force[k], 2 * error_of(p, k) ** 2)


def error_of(p: Projection, k: int) -> np.ndarray:
    """Standard deviation of each part of the force of a place, shape ``(f, i, level - 1)``."""
    return np.sqrt(np.diagonal(np.linalg.inv(p.Q[k]), axis1=-2, axis2=-1))


def softened(Q: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Information on forces that a law gives up to an error of its own, of a variance."""
    return np.linalg.solve(np.eye(Q.shape[-1]) + 0.5 * Q * variance[..., None, :], Q)


def padded(A: np.ndarray, omega: np.ndarray) -> tuple[jax.Array, jax.Array]:
    """Amplitudes and the circular frequency of each, in one of few lengths."""
    size = -(-A.size // PAD) * PAD
    a, w = np.ones(size), np.ones(size)
    a[: A.size], w[: A.size] = np.maximum(A.ravel(), 1e-300), np.broadcast_to(omega, A.shape).ravel()
    return jnp.asarray(a), jnp.asarray(w)
