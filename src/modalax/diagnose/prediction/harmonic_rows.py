r"""What a fit by one harmonic needs of the higher harmonics of a joint's motion.

It is the factor :math:`\rho` on the describing function that :func:`~modalax.diagnose.prediction.frf.factor_at` takes.
The force f is balanced with its harmonics line by line (:mod:`~modalax.diagnose.prediction.balanced_force`), or, of dry
friction, followed at instants (:mod:`~modalax.diagnose.prediction.friction`), and leaves the motion :math:`z = u - Gf`,
with which :math:`\rho = f/(N(|z|)\,z)`, or stands itself where that is no number of order one.
"""

from typing import Any

import numpy as np
from jaxtyping import Complex, Float

from modalax._numerics.checks import as_array
from modalax.diagnose.causes.base import JointCause
from modalax.diagnose.prediction.balanced_force import balanced, harmonics_of
from modalax.diagnose.prediction.harmonics import (
    FEWER_INSTANTS,
    HIGHEST,
    INSTANTS,
    MOSTLY,
    beside_joints,
    sliding_factor,
)
from modalax.diagnose.prediction.impedances import impedances
from modalax.diagnose.prediction.one_harmonic import described
from modalax.diagnose.setup.problem import Problem

SLOPE = 1e-3  # relative change of a parameter by which slopes of a factor are taken


def factor_rows(
    cause: JointCause, p: np.ndarray, force: np.ndarray, slopes: np.ndarray | None, sound: np.ndarray, G: np.ndarray,
    free: np.ndarray, omega: np.ndarray, level: np.ndarray,
) -> np.ndarray:  # fmt: skip
    r"""Factor :math:`\rho_0` and its slopes, or the force and its own, which of both, and compliance and amplitude.

    The shape is ``(4 + p, n)``; the compliance in series is in m/N, the amplitude in m.

    Parameters
    ----------
    cause, p
        The joint and its parameters.
    force, slopes
        Its force at the fundamental [N], shape ``(n,)``, and that by its parameters, ``(p, n)``; None where the factor
        is to have no slopes.
    sound
        Where a motion was found, shape ``(n,)``; elsewhere the factor is 1.
    G
        Receptance across the joint at the fundamental [m/N], shape ``(n,)``.
    free, omega
        Motion across it without its force [m], and circular frequency [rad/s], shape ``(n,)``.
    level
        Force at the input [N], shape ``(n,)``.
    """
    force = np.where(sound, force, 0.0)
    series = np.abs(G) if cause.rigid else np.zeros(len(G))

    def factor(p: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The factor, the amplitude, and where the force is no multiple of that of the fundamental alone."""
        z = free - (G - series) * force
        if cause.rigid:
            Z = np.asarray(cause.impedance_in_series(as_array(np.abs(z)), as_array(omega), as_array(p), series))
        else:
            Z = impedances(cause, p, omega, np.abs(z)[None, :, None])[0, :, 0]
        with np.errstate(all="ignore"):
            rho = force / (Z * z)
        rho = np.where(sound & np.isfinite(rho) & (np.abs(Z * z) > 0), rho, 1.0)
        return rho, np.abs(z), sound & (level > 0) & (np.abs(force) > MOSTLY * np.abs(Z * z))

    rho, amplitude, direct = factor(p, force)
    by_p = by_force = np.zeros((len(p), len(force)), complex)
    if slopes is not None:
        by_force, size = np.where(sound, slopes, 0.0), SLOPE * np.maximum(np.abs(np.asarray(p, float)), 1e-300)
        moved, _, no_factor = zip(*(factor(p + step, force + step @ by_force) for step in np.diag(size)), strict=True)
        by_p, direct = (np.stack(moved) - rho) / size[:, None], direct | np.any(no_factor, axis=0)
    a_unit = np.where(direct, level, 1.0)
    by_p = np.where(direct, by_force / a_unit, by_p)
    middle = np.where(direct, force / a_unit, rho) - np.asarray(p) @ by_p
    return np.stack([middle, *by_p, direct, series, amplitude])


def linear_factor(
    causes: Any, index: Any, extras: Any, params: Any, theta: Float[np.ndarray, "two n"], problem: Problem,
    kept: int = HIGHEST, rows: Any = None, follows: bool = True,
) -> Complex[np.ndarray, "five_p run f i"]:  # fmt: skip
    r"""Factor :math:`\rho`, linear in the parameters, and what else a joint needs of its harmonics.

    Parameters
    ----------
    causes, index, extras, params, theta
        As :func:`~modalax.diagnose.prediction.frf.predict` takes them; one cause is a joint.
    problem
        The data and the simulation.
    kept
        Highest harmonic of which the structure is let move.
    rows
        Amplitude [m] and force that were measured, shape ``(2, run, f, i)``; none if None.
    follows
        Whether the factor has slopes by the parameters.
    """
    k = next(k for k, c in enumerate(causes) if isinstance(c, JointCause))
    cause, p = causes[k], np.asarray(params[k], float)
    if cause.rigid:
        instants = FEWER_INSTANTS if kept < HIGHEST else INSTANTS
        found = sliding_factor(causes, index, extras, params, theta, problem, instants)
        middle, slope, series, amplitude = (np.asarray(a) for a in found)
        given = np.zeros(middle.shape) if rows is None else rows[1]
        slope = slope if follows else np.zeros_like(slope)
        # it has one steady motion, whatever was measured
        return np.stack([middle - slope * p[0], slope, np.zeros(middle.shape), series, amplitude, given])
    orders = harmonics_of(cause, p)
    linear = [beside_joints(causes, index, extras, params, theta, problem, h)[2:] for h in orders]
    (motion, _), level, omega = linear[orders.index(1)], np.asarray(problem.level), np.asarray(problem.omega)
    free = level[:, :, None] * np.asarray(motion)[:, :, 0]
    shape = free.shape
    rows = np.zeros((2, *shape)) if rows is None else np.asarray(rows)
    spread = lambda a: np.broadcast_to(a, shape)
    G = np.stack([spread(np.asarray(drive)[:, :, 0, :1]) for _, drive in linear], axis=-1)
    near = np.abs(rows[0].real)
    start = np.zeros(G.shape, complex)
    start[..., orders.index(1)] = described(cause, p, G[..., orders.index(1)], free, omega, near)[3]
    flat = lambda a: a.reshape(free.size, *a.shape[3:])
    lines = flat(spread(omega[:, None]))
    moved = flat(np.where(np.array(orders) <= kept, G, 0.0))
    force, slopes, sound, _ = balanced(cause, p, moved, flat(free), lines, np.nan_to_num(flat(start)))
    own = slopes[:-1] if follows else None
    levels = flat(spread(level[:, :, None]))
    made = factor_rows(cause, p, force, own, sound, flat(G)[:, orders.index(1)], flat(free), lines, levels)
    return np.concatenate([made[:-1].reshape(-1, *shape), rows])
