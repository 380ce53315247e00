"""A small frame whose elements can be off, and its FRFs, by plain NumPy."""

from functools import cache

import numpy as np
import scipy.linalg

from modalax.data import Measurement
from modalax.diagnose.modal_domain.answer import ModalDiagnosis
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.model import Structure

ELEMENTS, LENGTH, BENDING, MASS = 8, 0.15, 60.0, 0.8  # a number, m, N m^2, kg/m
DAMPING = 0.01


def beam() -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and mass of a plane Bernoulli beam element, DoFs w and rotation at both ends (w = -theta' x)."""
    L = LENGTH
    k = np.array([[12, 6 * L, -12, 6 * L], [6 * L, 4 * L**2, -6 * L, 2 * L**2],
                  [-12, -6 * L, 12, -6 * L], [6 * L, 2 * L**2, -6 * L, 4 * L**2]])  # fmt: skip
    m = np.array([[156, 22 * L, 54, -13 * L], [22 * L, 4 * L**2, 13 * L, -3 * L**2],
                  [54, 13 * L, 156, -22 * L], [-13 * L, -3 * L**2, -22 * L, 4 * L**2]])  # fmt: skip
    return BENDING / L**3 * k, MASS * L / 420 * m


def cantilever(stiffness: np.ndarray | None = None, mass: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Matrices of a clamped beam, each element's stiffness and mass times a factor."""
    size = 2 * (ELEMENTS + 1)
    K, M = np.zeros((size, size)), np.zeros((size, size))
    k, m = beam()
    for e in range(ELEMENTS):
        at = np.ix_(range(2 * e, 2 * e + 4), range(2 * e, 2 * e + 4))
        K[at] += k * (1.0 if stiffness is None else stiffness[e])
        M[at] += m * (1.0 if mass is None else mass[e])
    return K[2:, 2:], M[2:, 2:]


DOFS = tuple(f"{k}:+{d}" for k in range(1, ELEMENTS + 1) for d in ("Z", "RY"))
# A rotation about y moves a beam along x downwards, so this beam's rotations count against it.
FLIP = np.array([1.0, -1.0] * ELEMENTS)


def modal_damping(M: np.ndarray, K: np.ndarray, zeta: np.ndarray | float) -> np.ndarray:
    """Damping matrix of modal damping ratios."""
    w2, P = scipy.linalg.eigh(K, M)
    return M @ P @ np.diag(2 * zeta * np.sqrt(w2)) @ P.T @ M


def simulation(**claims) -> Structure:
    """The beam as its author has it."""
    K, M = cantilever()
    C = modal_damping(M, K, DAMPING)
    turned = [FLIP[:, None] * A * FLIP for A in (M, C, K)]
    return Structure(*turned, DOFS, **claims)


def measured(
    seed: int, off: float, *, mass: tuple[str, float] | None = None, spring: tuple[str, str, float] | None = None,
    noise: float = 0.01, lines: int = 120, top: float = 230.0, runs: int = 1, given: bool = True,
    shifts: tuple[float, ...] = (0.0,), damping: tuple[int, float] | None = None,
    oscillator: tuple[str, float, float, float] | None = None, hysteretic: float = 0.0, extra: float | None = None,
    decay: float = 0.0, ground: tuple[str, float] | None = None, stray: tuple[str, float] | None = None,
    tilted: tuple[str, str, float] | None = None,
) -> tuple[Measurement, np.ndarray]:  # fmt: skip
    """Accelerances of a beam whose elements are off, and the true stiffness matrix.

    All frequencies are shifted from run to run by ``shifts``, damping ratios and shapes are not; ``damping`` is a mode
    counted from 1 and how many times its damping ratio it has; ``oscillator`` is a DoF, a mass [kg], a frequency [Hz]
    and a damping ratio; ``extra`` the frequency [Hz] of a mode of 1 % damping and a shape that nobody expected;
    ``decay`` that of an impact window [1/s]; ``hysteretic`` the share of the damping that is;
    ``stray`` a DoF that the first input's force also acts on, and what share of it; ``tilted`` an
    output, a DoF that it also measures and what share of that.
    """
    rng = np.random.default_rng(seed)
    K, M = cantilever(1 + off * rng.standard_normal(ELEMENTS), 1 + off / 3 * rng.standard_normal(ELEMENTS))
    if ground is not None:
        K[DOFS.index(ground[0]), DOFS.index(ground[0])] += ground[1]
    zeta = DAMPING * np.exp(10 * off * rng.standard_normal(len(K)))
    if damping is not None:
        zeta[damping[0] - 1] = DAMPING * damping[1]
    C = modal_damping(M, K, zeta)
    K, M, C = (FLIP[:, None] * A * FLIP for A in (K, M, C))
    true = K.copy()
    if mass is not None:
        M[DOFS.index(mass[0]), DOFS.index(mass[0])] += mass[1]
    if spring is not None:
        b = np.zeros(len(K))
        b[[DOFS.index(spring[0]), DOFS.index(spring[1])]] = 1, -1
        K += spring[2] * np.outer(b, b)
    freq = np.linspace(4.0, top, lines)
    outputs, inputs = DOFS[::2], (DOFS[4], DOFS[14])
    rows, columns = [DOFS.index(n) for n in outputs], [DOFS.index(n) for n in inputs]
    s = 2j * np.pi * freq[:, None, None] / (1 + np.array(shifts)[:, None, None, None]) + decay
    Z = K + s * C + s**2 * M
    if hysteretic:
        w2, P = scipy.linalg.eigh(K, M)
        lossy = 2j * (M @ P @ np.diag(zeta[: len(w2)] * w2) @ P.T @ M)
        Z = K + hysteretic * lossy + (1 - hysteretic) * s * C + s**2 * M
    if oscillator is not None:
        dof, own, f, ratio = oscillator
        spring = (2 * np.pi * f) ** 2 + 2 * ratio * 2 * np.pi * f * s[..., 0, 0]
        at = DOFS.index(dof)
        Z[..., at, at] += own * s[..., 0, 0] ** 2 * spring / (s[..., 0, 0] ** 2 + spring)
    forces = np.eye(len(K))[:, columns]
    if stray is not None:
        forces[DOFS.index(stray[0]), 0] = stray[1]
    motions = np.eye(len(K))[rows]
    if tilted is not None:
        motions[outputs.index(tilted[0]), DOFS.index(tilted[1])] = tilted[2]
    receptance = motions @ np.linalg.inv(Z) @ forces
    if extra is not None:
        shape, w = 0.5 * rng.standard_normal(len(DOFS)), 2 * np.pi * extra
        receptance = receptance + np.outer(shape[rows], shape[columns]) / (s**2 + 2 * 0.01 * w * s + w**2)
    every = s**2 * receptance
    H = every[0] if len(shifts) == 1 else every
    sigma = noise * np.sqrt((np.abs(every[0]) ** 2).mean(axis=0)) * np.ones(every[0].shape)
    runs = max(runs, len(shifts))
    error = rng.standard_normal((runs, *sigma.shape)) + 1j * rng.standard_normal((runs, *sigma.shape))
    data = Measurement(
        freq, H + sigma * error / np.sqrt(2), form="accelerance", outputs=outputs, inputs=inputs,
        variance=np.broadcast_to(sigma**2, (runs, *sigma.shape)) if given else None,
    )  # fmt: skip
    return data, true


@cache
def heavier() -> tuple[Measurement, ModalDiagnosis | None]:
    """A beam whose elements are off by 1 %, with 50 g at node 5, and its diagnosis, for several tests to look at."""
    data, _ = measured(2, 0.01, mass=("5:+Z", 0.05))
    return data, diagnose_modes(data, simulation())
