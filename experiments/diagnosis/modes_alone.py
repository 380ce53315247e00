"""Simulations that come as modes alone: what ``modalax diagnose`` says where one effect is hidden in the data.

``python experiments/diagnosis/modes_alone.py [--seeds 2] [--only mass-off ...] [--shapes sensors|all]`` draws lattices
of 30 to 60 masses on springs with modal damping, writes the modes of a simulation to a file as an engineer would export
them, hides one effect in FRFs of 10 to 13 sensors and two inputs with 1 % noise, and asks. The simulation is exact or
has every spring 2 % off (every mass 0.7 %). ``sensors`` exports shapes at the sensors and inputs only. The modes reach
1.6 times the band; with ``--static`` the static correction of those above goes with them.

All of the structure and its slipping joint (one harmonic) is written here, in NumPy.
"""

import argparse
import tempfile
import time
from pathlib import Path

import jax
import numpy as np
import scipy.linalg

import modalax
from modalax.model.modal import ModalModel, poles_from

jax.config.update("jax_enable_x64", True)

EFFECTS = ("none", "gain", "sign", "delay", "mass", "spring", "slip", "damping")
SLUGS = {
    "gain": "channel_gain", "sign": "channel_sign", "delay": "time_delay", "mass": "added_mass",
    "spring": "joint_stiffness", "slip": "elasto_slip", "damping": "modal_damping",
}  # fmt: skip
OFF, NOISE, LINES, MODES = 0.02, 0.01, 400, 8


class Lattice:
    """Masses in two rows on springs along, across and to ground."""

    def __init__(self, rng: np.random.Generator):
        half = int(rng.integers(15, 31))
        self.n = n = 2 * half
        along = [(row * half + k, row * half + k + 1) for row in (0, 1) for k in range(half - 1)]
        self.pairs = along + [(k, half + k) for k in range(half)] + [(k, half + k + 1) for k in range(half - 1)]
        self.k = 1e6 * np.exp(0.4 * rng.standard_normal(len(self.pairs)))
        self.ground = {0: 2e5, half: 2e5, half - 1: 1e5, n - 1: 1e5}
        self.m = 2.0 * np.exp(0.3 * rng.standard_normal(n))

    def matrices(self, k: np.ndarray, m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Stiffness and mass."""
        K = np.zeros((self.n, self.n))
        for (a, b), stiffness in zip(self.pairs, k, strict=True):
            K[a, a] += stiffness
            K[b, b] += stiffness
            K[a, b] -= stiffness
            K[b, a] -= stiffness
        for a, stiffness in self.ground.items():
            K[a, a] += stiffness
        return K, np.diag(m)


def case_of(effect: str, off: bool, seed: int, shapes: str, static: bool) -> tuple:  # noqa: C901 - one effect each
    """Measurement, modes of the simulation, and the truth."""
    rng = np.random.default_rng([7, seed, EFFECTS.index(effect), int(off)])
    lattice = Lattice(rng)
    K, M = lattice.matrices(lattice.k, lattice.m)
    w2, phi = scipy.linalg.eigh(K, M)
    f = np.sqrt(w2) / 2 / np.pi
    highest = 0.5 * (f[MODES - 1] + f[MODES])
    zeta = 0.01 * np.exp(0.2 * rng.standard_normal(lattice.n))
    count = int(rng.integers(10, 14))
    sensors = np.sort(rng.choice(lattice.n, count, replace=False))
    inputs = rng.choice(sensors, 2, replace=False)
    names = [f"{k + 1}:+Z" for k in range(lattice.n)]
    kept = int(np.count_nonzero(f < 1.6 * highest))
    at = sensors if shapes == "sensors" else np.arange(lattice.n)
    poles = poles_from(f[:kept], zeta[:kept])
    part = phi[inputs].T[:kept] / (2j * poles.imag)[:, None] if shapes == "sensors" else None
    upper = None
    if static:
        columns = inputs if shapes == "sensors" else at
        upper = (phi[at][:, kept:] / w2[kept:]) @ phi[columns][:, kept:].T
    simulation = ModalModel(
        poles, phi[at][:, :kept].T, phi[at].T[:kept] / (2j * poles.imag)[:, None] if part is None else part,
        outputs=[names[k] for k in at], inputs=[names[k] for k in (inputs if part is not None else at)], upper=upper,
    )  # fmt: skip
    k, m = lattice.k.copy(), lattice.m.copy()
    zeta_true = zeta.copy()
    if off:
        k *= 1 + OFF * rng.standard_normal(len(k))
        m *= 1 + OFF / 3 * rng.standard_normal(len(m))
        zeta_true *= np.exp(0.2 * rng.standard_normal(lattice.n))
    truth: dict = {"effect": effect, "where": []}
    spot = int(rng.choice(sensors))
    pair = rng.choice(sensors, 2, replace=False)
    if effect == "mass":
        m[spot] += 0.08 * m.sum()
        truth["where"] = [names[spot]]
    K, M = lattice.matrices(k, m)
    b = np.zeros(lattice.n)
    b[pair[0]], b[pair[1]] = 1.0, -1.0
    strength = 0.3 / float((b @ phi[:, 1:MODES]) ** 2 @ (1 / w2[1:MODES]))  # as stiff as what it bridges, about
    if effect in ("spring", "slip"):
        truth["where"] = [names[p] for p in pair]
    if effect == "spring":
        K = K + strength * np.outer(b, b)
    if effect == "damping":
        zeta_true = zeta.copy() if not off else zeta_true
        mode = int(rng.integers(1, MODES - 1))
        zeta_true[mode] *= 2.5
        truth["where"] = [mode + 1]
    w2t, phit = scipy.linalg.eigh(K, M)
    w = 2 * np.pi * np.linspace(0.6 * f[0], highest, LINES)
    D = 1 / (w2t - w[:, None] ** 2 + 2j * w[:, None] * zeta_true * np.sqrt(w2t))
    H0 = np.einsum("fr,or,ir->foi", D, phit[sensors], phit[inputs])
    level, runs = [np.nan], H0[None]
    if effect == "slip":
        hb = np.einsum("fr,or,r->fo", D, phit[sensors], phit.T @ b)
        bi = np.einsum("fr,r,ir->fi", D, phit.T @ b, phit[inputs])
        bb = np.einsum("fr,r->f", D, (phit.T @ b) ** 2)
        slip = 0.5 * strength * np.abs(bi).max() / np.abs(1 + strength * bb).max()
        level = [0.1, 1.0, 3.0]
        runs = np.stack([_slipping(H0, hb, bi, bb, strength, slip, F) for F in level])
    if effect == "gain":
        runs = runs.copy()
        runs[:, :, list(sensors).index(spot)] *= 1.15
        truth["where"] = [names[spot]]
    if effect == "sign":
        runs = runs.copy()
        runs[:, :, list(sensors).index(spot)] *= -1
        truth["where"] = [names[spot]]
    if effect == "delay":
        runs = runs.copy()
        runs[:, :, list(sensors).index(spot)] *= np.exp(-1j * w * 0.15 / w[-1])[:, None]
        truth["where"] = [names[spot]]
    runs = -(w[:, None, None] ** 2) * runs
    sigma = NOISE * np.sqrt((np.abs(runs) ** 2).mean(axis=(0, 1)))
    noise = rng.standard_normal(runs.shape) + 1j * rng.standard_normal(runs.shape)
    measurement = modalax.Measurement(
        w / 2 / np.pi, runs + sigma * noise / np.sqrt(2), form="accelerance",
        variance=np.broadcast_to(sigma**2, runs.shape), level=level,
        outputs=[names[s] for s in sensors], inputs=[names[s] for s in inputs],
    )  # fmt: skip
    return measurement, simulation, truth


def _slipping(
    H: np.ndarray, hb: np.ndarray, bi: np.ndarray, bb: np.ndarray, k: float, slip: float, force: float
) -> np.ndarray:
    """FRFs with a spring and a slider in series: stiff below its slip, then a describing function of one harmonic."""
    out = np.empty_like(H)
    for i in range(H.shape[2]):
        for line in range(len(H)):
            free = force * abs(bi[line, i])
            low, high = 0.0, 2 * free + 1e-300
            grid = np.linspace(low, high, 400)[1:]
            z = _law(grid, k, slip)
            gap = grid * np.abs(1 + z * bb[line]) - free
            at = int(np.argmax(gap >= 0)) if (gap >= 0).any() else len(grid) - 1
            a, b = (grid[at - 1] if at else 1e-300), grid[at]
            for _ in range(40):
                middle = 0.5 * (a + b)
                if middle * abs(1 + _law(np.array([middle]), k, slip)[0] * bb[line]) >= free:
                    b = middle
                else:
                    a = middle
            z = _law(np.array([b]), k, slip)[0]
            out[line, :, i] = H[line, :, i] - hb[line] * z * bi[line, i] / (1 + z * bb[line])
    return out


def _law(amplitude: np.ndarray, k: float, slip: float) -> np.ndarray:
    """Dynamic stiffness of spring and slider at an amplitude."""
    ratio = np.minimum(slip / np.maximum(amplitude, 1e-300), 1.0)
    theta = np.arccos(1 - 2 * ratio)
    return k / np.pi * (theta - np.sin(2 * theta) / 2) + 4j * k * slip * (amplitude - slip).clip(0) / (
        np.pi * np.maximum(amplitude, 1e-300) ** 2
    )


def main() -> None:
    """Ask, and tell each answer."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", nargs="*", default=[], help="such as mass-off or none-exact")
    parser.add_argument("--shapes", choices=("sensors", "all"), default="sensors")
    parser.add_argument("--static", action="store_true")
    parser.add_argument("--time", type=float, default=120.0)
    options = parser.parse_args()
    right = total = 0
    for seed in range(options.first, options.first + options.seeds):
        for effect in EFFECTS:
            for off in (False, True):
                name = f"{effect}-{'off' if off else 'exact'}"
                if options.only and name not in options.only:
                    continue
                measurement, simulation, truth = case_of(effect, off, seed, options.shapes, options.static)
                with tempfile.TemporaryDirectory() as folder:
                    modalax.save(simulation, Path(folder) / "modes.npz")
                    simulation = modalax.load(Path(folder) / "modes.npz")
                began = time.process_time()
                question = "fixed" if options.static else "auto"
                said = modalax.diagnose(measurement, simulation, time=options.time, question=question).to_dict()
                cpu = time.process_time() - began
                causes = [(c["name"], tuple(map(str, c["where"]))) for c in said["causes"]]
                want = [] if effect == "none" else [(SLUGS[effect], set(map(str, truth["where"])))]
                ok = said["verdict"] == ("clean" if effect == "none" else "named")
                ok &= [(n, set(w)) for n, w in causes] == want
                right, total = right + ok, total + 1
                print(
                    f"{seed} {name:14s} {'ok ' if ok else '-- '} {said['verdict']:9s} {causes} hidden {truth['where']} "
                    f"{said['gain']['chi2_before']:.3g}->{said['gain']['chi2_after']:.3g} {cpu:.0f} s",
                    flush=True,
                )  # fmt: skip
    print(f"{right} of {total} right")


if __name__ == "__main__":
    main()
