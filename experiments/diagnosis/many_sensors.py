"""A stick model of an aeroplane with many sensors, as in a ground vibration test, diagnosed by the command.

``python experiments/diagnosis/many_sensors.py --out FOLDER [--sensors 60] [--effect mass,gain,none] [--seed 1]``
writes ``FOLDER/NAME/measurement.npz`` and ``simulation.npz``, runs ``modalax diagnose`` on what has no ``answer.json``
yet, and prints what was hidden, what was named, and how much processor time that took. Fuselage, wings, fin, tailplane
and two pylons are beams in space, each node with six DoFs; the stiffness of every element is off by 2 %, its mass by a
third of that, every modal damping by 20 %. One run of accelerances has 3,000 lines and 1 % noise. NumPy and SciPy only.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from modalax.cli import main as modalax

OFF, NOISE, LINES, BAND, DAMPING = 0.02, 0.01, 3000, (1.0, 40.0), 0.012
DIRECTIONS = ("X", "Y", "Z", "RX", "RY", "RZ")
# E, G [N/m^2], area [m^2], both second moments and the torsion constant [m^4], density [kg/m^3]
SECTIONS = {
    "fuselage": (7e10, 2.7e10, 0.02, 8e-3, 8e-3, 1.2e-2, 4500.0),
    "wing": (7e10, 2.7e10, 0.012, 6e-4, 6e-3, 1.2e-3, 4000.0),
    "tail": (7e10, 2.7e10, 0.006, 2e-4, 1e-3, 3e-4, 3000.0),
    "pylon": (7e10, 2.7e10, 0.006, 6e-5, 6e-5, 8e-5, 3000.0),
}


def beam(d: np.ndarray, section: str, up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and mass of a beam in space along ``d``, (x, y, z, rx, ry, rz) at either end."""
    E, G, A, Iy, Iz, J, rho = SECTIONS[section]
    L = float(np.linalg.norm(d))
    k, m = np.zeros((12, 12)), np.zeros((12, 12))
    pair, half = np.array([[1, -1], [-1, 1]]), np.array([[2, 1], [1, 2]])
    k[np.ix_([0, 6], [0, 6])], m[np.ix_([0, 6], [0, 6])] = E * A / L * pair, rho * A * L / 6 * half
    k[np.ix_([3, 9], [3, 9])], m[np.ix_([3, 9], [3, 9])] = G * J / L * pair, rho * (Iy + Iz) * L / 6 * half
    for at, inertia, s in (([1, 5, 7, 11], Iz, 1), ([2, 4, 8, 10], Iy, -1)):
        k[np.ix_(at, at)] = E * inertia / L**3 * np.array(
            [[12, 6 * L * s, -12, 6 * L * s], [6 * L * s, 4 * L**2, -6 * L * s, 2 * L**2],
             [-12, -6 * L * s, 12, -6 * L * s], [6 * L * s, 2 * L**2, -6 * L * s, 4 * L**2]]
        )  # fmt: skip
        m[np.ix_(at, at)] = rho * A * L / 420 * np.array(
            [[156, 22 * L * s, 54, -13 * L * s], [22 * L * s, 4 * L**2, 13 * L * s, -3 * L**2],
             [54, 13 * L * s, 156, -22 * L * s], [-13 * L * s, -3 * L**2, -22 * L * s, 4 * L**2]]
        )  # fmt: skip
    x = d / L
    z = up - (up @ x) * x
    z /= np.linalg.norm(z)
    R = np.kron(np.eye(4), np.vstack([x, np.cross(z, x), z]))
    return R.T @ k @ R, R.T @ m @ R


class Aeroplane:
    """Nodes, elements and parts of the model."""

    def __init__(self, count: int):
        self.nodes: list[np.ndarray] = []
        self.elements: list[tuple[int, int, np.ndarray, np.ndarray]] = []
        fuselage = self.line((0, 0, 0), (16, 0, 0), count, None, "fuselage")
        root, end = fuselage[count * 2 // 5], fuselage[-1]
        right, left = (self.away(root, (1.5, 8 * side, 0.4), count, "wing") for side in (1, -1))
        fin = self.away(end, (1, 0, 3), count // 3, "tail", (1, 0, 0))
        plane = [self.away(fin[-1], (0.5, 2.5 * side, 0), count // 4, "tail") for side in (1, -1)]
        pylons = [self.away(wing[count // 3], (-1.2, 0, -0.8), 2, "pylon", (0, 1, 0)) for wing in (right, left)]
        self.fuselage, self.wings, self.fin, self.plane, self.pylons = fuselage, (right, left), fin, plane, pylons
        self.count = 6 * len(self.nodes)

    def line(
        self, begin: ArrayLike, end: ArrayLike, count: int, first: int | None, section: str, up: ArrayLike = (0, 0, 1)
    ) -> list[int]:
        """A row of elements; numbers of its nodes."""
        a, b, numbers = np.array(begin, float), np.array(end, float), [] if first is None else [first]
        for t in np.linspace(0, 1, count + 1)[len(numbers) :]:
            self.nodes.append(a + (b - a) * t)
            numbers.append(len(self.nodes) - 1)
        for i, j in zip(numbers, numbers[1:], strict=False):
            self.elements.append((i, j, *beam(self.nodes[j] - self.nodes[i], section, np.array(up, float))))
        return numbers

    def away(self, node: int, move: ArrayLike, count: int, section: str, up: ArrayLike = (0, 0, 1)) -> list[int]:
        """A row of elements that begins at a node."""
        return self.line(self.nodes[node], self.nodes[node] + np.array(move), count, node, section, up)

    def matrices(self, stiffer: np.ndarray, heavier: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Stiffness and mass with a factor on each element; engines, a lump at the nose and soft cords as they are."""
        K, M = np.zeros((2, self.count, self.count))
        for (i, j, k, m), a, b in zip(self.elements, stiffer, heavier, strict=True):
            at = np.ix_(*2 * [np.r_[6 * i : 6 * i + 6, 6 * j : 6 * j + 6]])
            K[at] += a * k
            M[at] += b * m
        for node, mass in ((self.pylons[0][-1], 900.0), (self.pylons[1][-1], 900.0), (self.fuselage[0], 300.0)):
            for d in range(6):
                M[6 * node + d, 6 * node + d] += mass if d < 3 else 0.15 * mass
        n = len(self.fuselage) - 1
        for node in (self.fuselage[n // 5], self.wings[0][n // 6], self.wings[1][n // 6]):
            for d, k in enumerate((2e4, 2e4, 8e4)):
                K[6 * node + d, 6 * node + d] += k
        for d in (3, 4, 5):
            K[6 * self.fuselage[n // 2] + d, 6 * self.fuselage[n // 2] + d] += 2e4
        return K, M

    def name(self, dof: int) -> str:
        """Name of a DoF."""
        return f"{dof // 6 + 1}:+{DIRECTIONS[dof % 6]}"


def damped(w: np.ndarray, zeta: np.ndarray) -> np.ndarray:
    """Damping ratios, twice as large of the rigid body on its cords."""
    return zeta * np.where(w < 2 * np.pi, 2.0, 1.0)


def case(folder: Path, effect: str, sensors: int, seed: int, count: int) -> dict:
    """Write one test; what is hidden in it."""
    rng, a = np.random.default_rng(seed), Aeroplane(count)
    one, told = np.ones(len(a.elements)), {"effect": effect}
    simulated = a.matrices(one, one)
    K, M = a.matrices(*(1 + off * rng.standard_normal(len(one)) for off in (OFF, OFF / 3)))
    tip = a.wings[0][-1]
    if effect == "mass":
        for d in range(3):
            M[6 * tip + d, 6 * tip + d] += 8.0
        told |= {"where": [a.name(6 * tip + 2)], "size": 8.0}
    if effect == "element":
        i, j, k, _ = next(e for e in a.elements if e[1] == a.pylons[0][1])
        K[np.ix_(*2 * [np.r_[6 * i : 6 * i + 6, 6 * j : 6 * j + 6]])] -= 0.5 * k
        told |= {"where": [a.name(6 * i + 2), a.name(6 * j + 2)], "size": -0.5}
    seen = [6 * n + 2 for wing in (*a.wings, *a.plane) for n in wing] + [6 * n + d for n in a.fuselage for d in (1, 2)]
    seen += [6 * n + 1 for n in a.fin] + [6 * n + d for p in a.pylons for n in p[1:] for d in range(3)]
    seen += [6 * n + d for wing in a.wings for n in wing for d in (0, 1)] if sensors > 60 else []
    some = np.unique(seen)
    outputs = np.sort(rng.choice(some, min(sensors, len(some)), replace=False))
    inputs = [6 * tip + 2, 6 * a.fin[-1] + 1]
    squares, V = scipy.linalg.eigh(K, M)
    w, s = np.sqrt(squares), 2j * np.pi * np.linspace(*BAND, LINES)
    zeta = damped(w, DAMPING * np.exp(0.2 * rng.standard_normal(len(w))))
    D = s[:, None] ** 2 + 2 * zeta * w * s[:, None] + squares
    H = np.einsum("or,fr,ir->foi", V[outputs], s[:, None] ** 2 / D, V[inputs], optimize=True)
    if effect == "gain":
        which = int(rng.integers(len(outputs)))
        H[:, which] *= 1.15
        told |= {"where": [a.name(outputs[which])], "size": 0.15}
    sigma = NOISE * np.sqrt((np.abs(H) ** 2).mean(axis=0))
    H = H + sigma * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
    K, M = simulated
    squares, V = scipy.linalg.eigh(K, M, subset_by_index=[0, 59])
    w = np.sqrt(squares)
    C = M @ V @ np.diag(2 * damped(w, DAMPING * np.ones(len(w))) * w) @ V.T @ M
    folder.mkdir(parents=True, exist_ok=True)
    names = {key: np.array([a.name(k) for k in dofs]) for key, dofs in (("outputs", outputs), ("inputs", inputs))}
    variance = np.broadcast_to(sigma**2, H.shape)[None]
    np.savez(
        folder / "measurement.npz", freq=np.abs(s) / 2 / np.pi, H=H[None], variance=variance, level=[np.nan],
        form="accelerance", **names,
    )  # fmt: skip
    np.savez(folder / "simulation.npz", M=M, C=C, K=K, dofs=np.array([a.name(k) for k in range(a.count)]))
    return told | {"dofs": a.count, "sensors": len(outputs)}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--effect", default="mass,gain,none", help="of mass, element, gain, none")
    parser.add_argument("--sensors", type=int, default=60)
    parser.add_argument("--nodes", type=int, default=20, help="elements of the fuselage and of each wing")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--time", type=float, default=120)
    args = parser.parse_args()
    for effect in args.effect.split(","):
        folder = args.out / f"{effect}-{args.sensors}-{args.seed}"
        answer = folder / "answer.json"
        if not answer.exists():
            told = case(folder, effect, args.sensors, args.seed, args.nodes)
            begun = time.process_time()
            data, simulation = (str(folder / f"{name}.npz") for name in ("measurement", "simulation"))
            modalax(["diagnose", data, "--simulation", simulation, "--time", str(args.time), "--json", str(answer)])
            told["cpu_s"] = round(time.process_time() - begun, 1)
            (folder / "truth.json").write_text(json.dumps(told))
        told, said = (json.loads((folder / name).read_text()) for name in ("truth.json", "answer.json"))
        causes = [(c["name"], c["where"], {k: v["value"] for k, v in c["parameters"].items()}) for c in said["causes"]]
        print(told, "->", said["verdict"], causes)
