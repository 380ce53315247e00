r"""Force of a law at one place, line by line, by harmonic balance across the place.

The motion :math:`x_h + H_{bb}(h\omega)\,f_h(x) = u_h` is sought from the one that was measured, which tells several
steady motions apart, and its slopes by the parameters follow from the same equations (the implicit function theorem).
"""

from dataclasses import dataclass, replace

import numpy as np

from modalax._numerics.checks import as_array
from modalax.diagnose.causes.base import ElementCause, JointCause, LocalCause
from modalax.diagnose.causes.joints import CubicStiffness
from modalax.diagnose.comparison import Comparison
from modalax.diagnose.prediction.balanced_force import NEIGHBOURS, balanced, harmonics_of, has_law
from modalax.diagnose.prediction.friction import sliding, with_more_instants
from modalax.diagnose.prediction.harmonics import (
    HIGHEST,
    INSTANTS,
    MORE_INSTANTS,
    receptance_across,
)
from modalax.diagnose.prediction.impedances import linear_impedances
from modalax.diagnose.prediction.one_harmonic import described
from modalax.diagnose.screening.modes_beside import Beside
from modalax.diagnose.search.measured_force import MeasuredForce

FEWER = 5  # highest harmonic of a second balance, which shows the error of truncation


@dataclass(frozen=True)
class Following:
    r"""How what is measured at a place changes with the modal parameters that a claimed spread leaves open.

    A step :math:`\delta` of them, in units of their spread, leaves :math:`\chi^2 - 2g^T\delta + \delta^T A\delta`.

    Attributes
    ----------
    force, free, receptance
        Changes of the measured force, of the motion without it, and of the receptance across the place at the line, by
        each parameter, shape ``(n, m)``.
    downhill, curvature
        g, shape ``(m,)``, and A, shape ``(m, m)``.
    """

    force: np.ndarray
    free: np.ndarray
    receptance: np.ndarray
    downhill: np.ndarray
    curvature: np.ndarray


@dataclass(frozen=True)
class Seen:
    """The force at one place and what a law needs to be compared with it; one entry a line, run and input, ``(n,)``.

    Attributes
    ----------
    force
        As measured [N].
    precision
        Inverse standard deviation of its parts, times the root of 2 [1/N]; 0 where nothing was measured.
    motion
        Displacement across the place as measured [m].
    free
        The same without any force there [m].
    receptance
        Across the place at harmonics 0 to the highest, shape ``(n, h)`` [m/N].
    omega
        Circular frequency [rad/s].
    level
        Force at the input [N].
    left
        Chi-square that the measured force leaves, with the modes where they are.
    least
        The same where they leave least.
    samples
        Number of real samples of the measurement.
    theta
        Modal parameters in units of their spread, shape ``(2, n)``.
    shape
        Numbers of runs, lines and inputs; None of some lines alone.
    several
        Whether harmonics above the first count.
    follow
        What changes with them; None where modes are exact.
    """

    force: np.ndarray
    precision: np.ndarray
    motion: np.ndarray
    free: np.ndarray
    receptance: np.ndarray
    omega: np.ndarray
    level: np.ndarray
    left: float
    least: float
    samples: int
    theta: np.ndarray
    shape: tuple[int, int, int]
    several: bool = True
    follow: Following | None = None

    def moved(self, step: np.ndarray) -> "Seen":
        """The same with the modal parameters a little further, to first order; ``step`` has the shape ``(m,)``."""
        f = self.follow
        if f is None or not step.any():
            return self
        receptance = self.receptance.copy()
        receptance[:, 1] += f.receptance @ step
        further = replace(f, downhill=f.downhill - f.curvature @ step)
        return replace(
            self, force=self.force + f.force @ step, free=self.free + f.free @ step, receptance=receptance,
            left=self.left - float((f.downhill + further.downhill) @ step), follow=further,
            theta=self.theta + step.reshape(self.theta.shape),
        )  # fmt: skip

    def telling(self, count: int) -> "Seen":
        """Some lines alone: evenly taken of the louder half by the size of the force over its deviation."""
        size = self.precision * np.abs(self.force)
        loud = np.argsort(-size, kind="stable")[: max(len(size) // 2, count)]
        kept = np.sort(loud[:: -(-len(loud) // count)])
        take = lambda x: x[kept]
        f = self.follow
        lines = ("force", "precision", "motion", "free", "receptance", "omega", "level")
        of_lines = {name: take(getattr(self, name)) for name in lines}
        if f is not None:
            f = replace(f, force=take(f.force), free=take(f.free), receptance=take(f.receptance))
        return replace(self, **of_lines, shape=(1, len(kept), 1), follow=f)


def seen_at(comparison: Comparison, force: MeasuredForce, least: float | None = None, several: bool = True) -> Seen:
    """Lay out what was measured at a place line by line.

    Parameters
    ----------
    comparison
        Data and simulation.
    force
        The force that was measured at the place.
    least
        Chi-square that a free force leaves there at best; that of this one if None.
    several
        Whether harmonics above the first count.
    """
    problem = comparison.problem
    shape, lines = force.motion.shape, problem.lines
    theta = as_array(np.asarray(force.theta) * comparison.nuisance.spread)
    orders = [*range(HIGHEST + 1), *range(HIGHEST + 2, MORE_INSTANTS, 2)] if several else [0, 1]
    found = {h: np.asarray(receptance_across(CubicStiffness(), force.place, theta, problem, h)) for h in orders}
    # Even orders beyond the highest are those of no law.
    across = [found[h] if h in found else np.zeros_like(found[1]) for h in range(orders[-1] + 1)]
    G = np.stack([a[:lines] for a in across], axis=-1)
    spread = lambda a: np.broadcast_to(a[None, :, None], (*shape, *a.shape[1:])).reshape(-1, *a.shape[1:])
    motion, q = force.motion.ravel(), (force.impedance * force.motion).ravel()
    level, G = np.broadcast_to(np.asarray(problem.level)[:, :lines, None], shape).ravel(), spread(G)
    left = force.chi2 - 2 * motion.size
    return Seen(
        q, force.weight.ravel() / np.maximum(np.abs(motion), 1e-300), motion, motion + G[:, 1] * q, G,
        spread(comparison.scene.omega), level, left, left if least is None else least, problem.samples, force.theta,
        shape, several, _following(comparison, force, level) if comparison.nuisance.active else None,
    )  # fmt: skip


def _following(comparison: Comparison, force: MeasuredForce, level: np.ndarray) -> Following:
    """How the force at a place follows the modal parameters; ``level`` is the force at the input, ``(n,)`` [N]."""
    beside = Beside.at(comparison, force.theta)
    _, g, A, Q = beside.linear(beside.direction(force.place), beside.turned(force.place))
    free, drive = beside.across_by_parameters(force.place)
    shape = (len(g), *force.motion.shape)
    by_line = lambda x: np.broadcast_to(x, shape).reshape(len(g), -1).T
    return Following(
        level[:, None] * by_line(Q), level[:, None] * by_line(free[:, None]), by_line(drive[:, None, :, None]), g, A
    )


def beyond(highest: int) -> float:
    """What harmonics above the highest may do over those above ``FEWER`` up to it, of a force with corners at most."""
    return (FEWER + 1) / (highest - FEWER)


def force_of(
    cause: ElementCause,
    p: np.ndarray,
    seen: Seen,
    near: np.ndarray | None = None,
    fewer: bool = False,
    instants: int = INSTANTS,
    highest: int = HIGHEST,
    neighbours: int = NEIGHBOURS,
) -> tuple[np.ndarray, ...]:
    """A law's force [N], its slopes by the parameters, whether a motion was found, and that motion.

    Parameters
    ----------
    cause, p
        The law and its parameters.
    seen
        What was measured.
    near
        Motions from which the balance begins, shape ``(n, h)``; the measured ones if None. Of fewer harmonics than are
        balanced the others begin at nothing.
    fewer
        Whether fewer harmonics are balanced, which shows how much those left out may do.
    instants
        Of half a cycle, at which dry friction is followed.
    highest
        Highest harmonic of other laws that are odd.
    neighbours
        Times that motions which were not found start from those of neighbouring lines.

    Returns
    -------
    tuple
        Shapes ``(n,)``, ``(parameter, n)``, ``(n,)`` and ``(n, h)``. Slopes by modal parameters follow those by the
        law's own, where these are open.
    """
    nothing = np.zeros((len(seen.force), 1), complex)
    if isinstance(cause, LocalCause):
        force, slopes, sound = _linear(cause, p, seen)
        return force, _of_all(force, slopes, seen), sound, nothing
    assert isinstance(cause, JointCause)
    if cause.rigid and seen.several:
        force, slopes, sound = _sliding(p, seen, instants)
        return force, _of_all(force, slopes, seen), sound, nothing
    if not seen.several or not has_law(cause):
        lay = lambda x: x.reshape(seen.shape)
        across, omega = np.abs(seen.motion if near is None else near[:, 0]), lay(seen.omega)[0, :, 0]
        made = described(cause, p, lay(seen.receptance[:, 1]), lay(seen.free), omega, lay(across))
        force, slopes, sound, motion = (x.reshape(*x.shape[:-3], -1) for x in made)
        return force, _of_all(force, slopes, seen), sound, motion[:, None]
    orders = harmonics_of(cause, p, highest)
    start = nothing * np.zeros(len(orders))
    if near is None:
        start[:, orders.index(1)] = seen.motion
    else:
        start[:, : near.shape[1]] = near
    G = np.where(np.array(orders) > (FEWER if fewer else orders[-1]), 0.0, seen.receptance[:, list(orders)])
    force, slopes, sound, motion = balanced(cause, p, G, seen.free, seen.omega, start, highest, neighbours)
    return force, _of_all(force, slopes, seen), sound, motion


def _of_all(force: np.ndarray, slopes: np.ndarray, seen: Seen) -> np.ndarray:
    r"""Slopes of a law's force by its own parameters and by the modal ones, where these are open.

    A change :math:`\delta G` of the receptance is one of the motion without the force, :math:`\delta u = -q\,\delta
    G`. Of a change :math:`\delta u/u = a + ib` the part b is a shift in time, which turns the force alike; a scales the
    motion, and the last of ``slopes`` is what the force does then.
    """
    f = seen.follow
    if f is None:
        return slopes[:-1]
    share = (f.free - force[:, None] * f.receptance) / np.where(seen.free != 0, seen.free, 1.0)[:, None]
    return np.concatenate([slopes[:-1], share.real.T * slopes[-1] + 1j * share.imag.T * force])


def _linear(cause: LocalCause, p: np.ndarray, seen: Seen) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Force of a linear element, which grows with the motion, and its slopes."""
    G = seen.receptance[:, 1]
    Z, slope = linear_impedances(cause, p, seen.omega)
    with np.errstate(all="ignore"):
        here = Z / (1 + G * Z) * seen.free
        slopes = np.stack([*(slope.T / (1 + G * Z) ** 2 * seen.free), here])
    return here, slopes, np.isfinite(here) & np.isfinite(slopes).all(axis=0)


def _sliding(p: np.ndarray, seen: Seen, instants: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Force of dry friction, and its slopes: with motion and limit alike it grows as they do."""
    given = seen.receptance[:, 1::2], seen.free, seen.omega, float(p[0])
    force, slope, sound = with_more_instants(*(sliding(*given, count) for count in (instants // 2, instants)))
    return force, np.stack([slope, force - p[0] * slope]), sound
