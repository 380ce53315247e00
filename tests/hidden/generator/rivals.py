"""How well a perfect namer could do: the angle between a hidden effect and its nearest look-alike of another name.

Every cause of the catalogue at every place is linearised (joints by their describing function at the linear motion,
at a few thresholds), whitened, and freed from what the claimed spread of the simulation could imitate. An effect at
distance ``d`` and angle ``psi`` from a rival is taken for it with probability ``Phi(-d sin(psi/2))`` at best.
"""

import numpy as np
import scipy.stats

from .effect import Setup
from .noise import Yardstick
from .plant import DERIVATIVES, hann_kernel, sweep_kernel, through_kernel

FRACTIONS = np.array([0.03, 0.1, 0.2, 0.35, 0.6])


class Closest:
    """Keeps the largest share of an effect that the directions of each name explain."""

    def __init__(self, yard: Yardstick, change: np.ndarray):
        self.yard, self.best = yard, {}
        self.effect = self._white(change)
        self.size = self._dot(self.effect, self.effect)

    def _white(self, g):
        g = (self.yard.weight * np.broadcast_to(g, self.yard.weight.shape)).ravel()
        return g, (self.yard.J.conj().T @ g).real

    def _dot(self, a, b) -> float:
        return float(np.vdot(a[0], b[0]).real - a[1] @ self.yard.core @ b[1])

    def offer(self, slug: str, *directions) -> None:
        """A name with directions whose sizes are all free."""
        white = [self._white(g) for g in directions]
        gram = np.array([[self._dot(a, b) for a in white] for b in white])
        side = np.array([self._dot(a, self.effect) for a in white])
        scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        keep = scale > 1e-12 * scale.max()
        gram, side = (gram / scale[:, None] / scale)[np.ix_(keep, keep)], (side / scale)[keep]
        explained = float(side @ np.linalg.pinv(gram, rcond=1e-10) @ side) / max(self.size, 1e-300)
        self.best[slug] = max(self.best.get(slug, 0.0), min(explained, 1.0))


def describing(setup: Setup, q: np.ndarray):
    """``(slug, stiffness)`` of each joint law at relative amplitudes, shape (run, f, i)."""
    A, w = np.maximum(np.abs(q), 1e-300), setup.omega[None, :, None]
    yield "cubic_stiffness", A**2
    yield "coulomb_friction", 1j / A
    yield "quadratic_damping", 1j * w**2 * A
    for x in FRACTIONS * A.max():
        rho = np.minimum(x / A, 1.0)
        theta = np.arccos(1 - 2 * rho)
        slip = (theta - np.sin(2 * theta) / 2) / np.pi + 4j * rho * (1 - rho) / np.pi
        yield "elasto_slip", slip
        yield "elasto_slip", slip - 1
        yield "gap", 1 - 2 / np.pi * (np.arcsin(rho) + rho * np.sqrt(1 - rho**2))


def _local(setup: Setup, near: Closest) -> None:
    n, w = setup.system.n, setup.omega
    every = np.eye(n)
    U = setup.plant.receptance(1j * w, setup.rows, every) * setup.factor  # (f, o, n)
    V = setup.plant.receptance(1j * w, every, setup.columns)  # (f, n, i)
    level = np.where(np.isfinite(setup.level), setup.level, 1.0)
    for a in range(n):
        for b in range(-1, n):
            if a == b or 0 <= b < a:
                continue
            u = U[:, :, a] - (U[:, :, b] if b >= 0 else 0)
            v = V[:, a] - (V[:, b] if b >= 0 else 0)
            unit = u[:, :, None] * v[:, None, :]
            near.offer("joint_stiffness", unit)
            near.offer("bilinear_stiffness", unit)
            near.offer("local_damper", 1j * w[:, None, None] * unit)
            q = v[None] * level[:, None, None]
            for slug, Z in describing(setup, q):
                near.offer(slug, Z[:, :, None, :] * unit[None])
            if b >= 0:
                turn = U[:, :, a, None] * V[:, b, None, :] - U[:, :, b, None] * V[:, a, None, :]
                near.offer("gyroscopic", 1j * w[:, None, None] * turn)
                continue
            inertia = w[:, None, None] ** 2 * unit
            near.offer("added_mass", inertia)
            for f in np.linspace(setup.freq[0], setup.freq[-1], 14)[1:-1]:
                x = w / (2 * np.pi * f)
                split = (1 + 0.03j * x) / (1 + 0.03j * x - x**2)
                near.offer("tuned_mass", inertia * split[:, None, None])
    for o, a in enumerate(setup.outputs):
        row = np.zeros((len(w), len(setup.outputs), len(setup.inputs)), complex)
        row[:, o] = w[:, None] ** 2 * U[:, o, a, None] * V[:, a]
        near.offer("sensor_mass", row)


def _channels(setup: Setup, near: Closest, H: np.ndarray) -> None:
    lag = -1j * setup.omega[:, None, None]
    near.offer("time_delay", lag * H)
    for o in range(len(setup.outputs)):
        row = np.zeros_like(H)
        row[:, o] = H[:, o]
        near.offer("channel_gain", row)
        near.offer("time_delay", lag * row)
    poles, R = setup.plant.residues(setup.rows, setup.columns)
    through = lambda kernel: through_kernel(poles, R, setup.omega, DERIVATIVES[setup.form], kernel) - H
    slowest = 1 / np.abs(poles.real).min()
    for T in (3 * slowest, 30 * slowest):
        near.offer("leakage", through(lambda s, T=T: hann_kernel(s, T)))
    near.offer("fast_sweep", through(lambda s: sweep_kernel(s, 1e-2 / slowest**2)))
    s = 1j * setup.omega + 1e-3 / slowest
    shifted = setup.plant.receptance(s, setup.rows, setup.columns) * s[:, None, None] ** DERIVATIVES[setup.form]
    near.offer("exponential_window", shifted - H)


def _modal(setup: Setup, near: Closest, H: np.ndarray) -> None:
    omega, zeta, shapes = setup.system.modes()
    s = 1j * setup.omega[:, None]
    D = omega**2 + 2 * zeta * omega * s + s**2
    pairs = np.einsum("or,ir->oir", shapes[setup.outputs], shapes[setup.inputs])
    damping = 2 * zeta * omega * s / D**2
    for r in np.flatnonzero(omega < 1.5 * setup.omega[-1]):
        near.offer("modal_damping", damping[:, r, None, None] * pairs[None, :, :, r] * setup.factor)
    hysteretic = (2j * zeta * omega**2 - 2 * zeta * omega * s) / D**2
    near.offer("structural_damping", np.einsum("fr,oir->foi", hysteretic, pairs) * setup.factor)
    drift = np.einsum("fr,oir->foi", omega**2 / D**2, pairs) * setup.factor
    runs = len(setup.level)
    if runs > 1:
        near.offer("time_varying", *(np.eye(runs)[r][:, None, None, None] * drift[None] for r in range(1, runs)))
    cells = [(o, i) for o in range(H.shape[1]) for i in range(H.shape[2])]

    def pattern(*curves):
        for o, i in cells:
            for curve in curves:
                g = np.zeros_like(H)
                g[:, o, i] = curve * setup.factor[:, 0, 0]
                yield g

    for f in np.linspace(setup.freq[0], setup.freq[-1], 14)[1:-1]:
        x = s[:, 0] / (2 * np.pi * f)
        near.offer("missing_mode", *pattern(1 / (1 + 0.03 * x + x**2)))
    near.offer("out_of_band", *pattern(np.ones_like(setup.omega), 1 / setup.omega**2))


def shares(setup: Setup, yard: Yardstick, change: np.ndarray) -> dict[str, float]:
    """Share of an effect's squared distance that each name could explain, at its best place."""
    near = Closest(yard, change)
    H = setup.frf(setup.plant)
    _local(setup, near)
    _channels(setup, near, H)
    _modal(setup, near, H)
    return near.best


def confusion(d: float, share: float) -> float:
    """Chance that a perfect namer takes an effect for a rival: ``Phi(-d sin(psi/2))``, ``cos^2 psi = share``."""
    psi = np.arccos(np.sqrt(min(max(share, 0.0), 1.0)))
    return float(scipy.stats.norm.cdf(-d * np.sin(psi / 2)))
