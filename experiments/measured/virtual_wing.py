"""Virtual tests of a real flying wing's matrices, with every element off and one gross error hidden in them.

``MODALAX_DATA=... python experiments/measured/virtual_wing.py [--cases 60] [--first 0] [--only N ...]
[--out FILE]`` asks ``modalax.diagnose`` about each test with the matrices as imported, appends one line a case to the
file of answers, and prints the counts of all that it holds.

The wing is that of the finite-element model mAEWing1 (74 beams, springs and rigid arms, 71 lumps of mass). Every
element's stiffness is off by 1 or 3 % (standard deviation, each by itself), every mass by a third of that, every modal
damping by 20 %. The gross error is the stiffness of one element by 5 to 60 %, or a mass of 1 to 10 % of the total at
one node. Ten stations along the wings have two accelerometers each, of which mean and tilt are taken; seven more
stand on the centre body and at the tips; two shakers, at a wing and at the nose. 5 to 65 Hz, noise of 1 %.

The true matrices are put together here, in NumPy, from the file's blocks between two nodes; nothing of how the package
reads elements is used.
"""

import argparse
import itertools
import json
import os
import time
import warnings
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np
import scipy.linalg
from rich.console import Console
from rich.table import Table

import modalax
from modalax.data import FRF, Measurement
from modalax.files.finite_elements import UNITS, dof_name, import_finite_elements
from modalax.files.nastran import read_dmig, read_grids

jax.config.update("jax_enable_x64", True)

RESULTS = Path(__file__).parent / "results" / "virtual_wing.jsonl"
STATIONS = (101, 102, 103, 104, 105, 201, 202, 203, 204, 205)
SINGLE = (1010, 2010, 3001, 3004, 3006, 1080, 2080)
OUTPUTS = [f"{n}:+{way}" for n in STATIONS for way in ("Z", "RY")] + [f"{n}:+Z" for n in SINGLE]
INPUTS = ["105:+Z", "3006:+Z"]
FREQ = np.arange(50, 651) / 10
DAMPING, NOISE = 0.01, 0.01
TOLD = 10.0  # nats


class Wing:
    """The wing as the sum of its elements: free in space to rounding, with the file's coupling blocks."""

    def __init__(self, folder: Path):
        length, force = UNITS["in-lbf"]
        found = read_dmig(folder / "stiffness_mass.pch")
        grids = read_grids(folder / "sol103_mAEWing1_FEMv5p2.bdf")
        dofs = tuple(sorted({*found["KAAX"].dofs, *found["MAAX"].dofs}))
        self.names = [dof_name(*d) for d in dofs]
        unit = np.array([1.0 if way > 3 else 1 / length for _, way in dofs]) * np.sqrt(force * length)
        K, self.M = (found[k].on(dofs).toarray() * np.outer(unit, unit) for k in ("KAAX", "MAAX"))
        self.nodes = sorted({p for p, _ in dofs})
        self.at = {p: [k for k, d in enumerate(dofs) if d[0] == p] for p in self.nodes}
        size = np.sqrt(np.diag(K))
        self.elements = []
        for a, b in itertools.combinations(self.nodes, 2):
            i, j = self.at[a], self.at[b]
            block = K[np.ix_(i, j)]
            if np.abs(block / size[i][:, None] / size[j]).max() < 1e-9:
                continue
            ra, rb = (_rigid(grids[p].xyz * length) for p in (a, b))
            own = [-block @ rb @ np.linalg.inv(ra), -block.T @ ra @ np.linalg.inv(rb)]
            matrix = np.block([[own[0], block], [block.T, own[1]]])
            self.elements.append(((a, b), i + j, (matrix + matrix.T) / 2))
        self.mass = float(sum(self.M[k, k] for k, d in enumerate(dofs) if d[1] == 3))

    def matrices(self, stiffness: np.ndarray, mass: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Stiffness and mass with a factor on each element and on each node's lump."""
        K = np.zeros_like(self.M)
        for factor, (_, i, matrix) in zip(stiffness, self.elements, strict=True):
            K[np.ix_(i, i)] += factor * matrix
        root = np.ones(len(K))
        for factor, p in zip(mass, self.nodes, strict=True):
            root[self.at[p]] = np.sqrt(factor)
        return K, self.M * np.outer(root, root)


def _rigid(x: np.ndarray) -> np.ndarray:
    """Motion of a node in a rigid motion about the origin."""
    out = np.eye(6)
    out[:3, 3:] = [[0, x[2], -x[1]], [-x[2], 0, x[0]], [x[1], -x[0], 0]]
    return out


def modes(K: np.ndarray, M: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Modal masses, modal stiffnesses and shapes of a free structure, some directions of which have no mass."""
    shift = (2 * np.pi * 20.0) ** 2
    mass, phi = scipy.linalg.eigh(M, K + shift * M)
    return mass, 1 - shift * mass, phi


def accelerances(wing: Wing, K: np.ndarray, M: np.ndarray, zeta: np.ndarray) -> np.ndarray:
    """Exact accelerances at sensors and shakers, shape ``(f, o, i)``."""
    mass, k, phi = modes(K, M)
    c = 2 * zeta * np.sqrt(np.maximum(mass * k, 0.0))
    w = 2 * np.pi * FREQ[:, None]
    rows, columns = ([wing.names.index(n) for n in names] for names in (OUTPUTS, INPUTS))
    dynamic = 1 / (k - w**2 * mass + 1j * w * c)
    return -(w[:, :, None] ** 2) * np.einsum("fr,or,ir->foi", dynamic, phi[rows], phi[columns], optimize=True)


def band_modes(K: np.ndarray, M: np.ndarray) -> np.ndarray:
    """Natural frequencies in the band [Hz]."""
    mass, k, _ = modes(K, M)
    real = mass > 1e-12 * mass.max()
    f = np.sort(np.sqrt(np.maximum(k[real] / mass[real], 0.0)) / (2 * np.pi))
    return f[f > 1.0][:10]


@dataclass(frozen=True)
class Hidden:
    """The true structure of a case: factors of elements and lumps, matrices, modal damping, FRFs and their noise."""

    truth: dict
    stiffness: np.ndarray
    mass: np.ndarray
    K: np.ndarray
    M: np.ndarray
    zeta: np.ndarray
    H: np.ndarray
    noisy: np.ndarray
    sigma: np.ndarray

    def measurement(self) -> Measurement:
        """What is measured."""
        variance = np.broadcast_to(self.sigma**2, self.H.shape)
        frf = FRF(FREQ, self.noisy, form="accelerance", variance=variance, outputs=OUTPUTS, inputs=INPUTS)
        return Measurement.from_frfs([frf])


def draw(wing: Wing, case: int) -> Hidden:
    """Hide a gross error, and measure."""
    rng = np.random.default_rng([1, case])
    spread = (0.01, 0.03)[case % 2]
    stiffness = 1 + spread * rng.standard_normal(len(wing.elements))
    mass = 1 + spread / 3 * rng.standard_normal(len(wing.nodes))
    truth = {"case": case, "spread": spread}
    sound = band_modes(*wing.matrices(stiffness, mass))
    if case % 3 < 2:
        which = int(rng.integers(len(wing.elements)))
        size = float(np.exp(rng.uniform(np.log(0.05), np.log(0.6)))) * float(rng.choice([-1, 1]))
        stiffness[which] = 1 + size
        K, M = wing.matrices(stiffness, mass)
        truth |= {"name": "joint_stiffness", "nodes": list(wing.elements[which][0]), "size": size}
    else:
        node = int(rng.choice(wing.nodes))
        size = float(np.exp(rng.uniform(np.log(0.01), np.log(0.1))))
        K, M = wing.matrices(stiffness, mass)
        lump = [k for k in wing.at[node] if not wing.names[k].split("+")[1].startswith("R")]
        M[lump, lump] += size * wing.mass
        truth |= {"name": "added_mass", "nodes": [node], "size": size, "kg": size * wing.mass}
    truth["moved"] = float(np.abs(band_modes(K, M) / sound - 1).max())
    zeta = DAMPING * np.exp(0.2 * rng.standard_normal(len(K)))
    H = accelerances(wing, K, M, zeta)
    sigma = NOISE * np.sqrt((np.abs(H) ** 2).mean(axis=0))
    noisy = H + sigma * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
    return Hidden(truth, stiffness, mass, K, M, zeta, H, noisy, sigma)


class Visible:
    """How much the data can tell of an error whose place is known, to first order, in nats.

    With FRFs y of variance R, their derivatives J by all elements, lumps and modal dampings, and the sizes S of the
    general inaccuracy, an error of size u makes a difference of :math:`u^2 [A - A(A + S^{-1})^{-1}A]/2` for
    :math:`A = J^TR^{-1}J`. Below some ten nats no method can name the right one of the wing's places.
    """

    def __init__(self, wing: Wing):
        one = wing.matrices(np.ones(len(wing.elements)), np.ones(len(wing.nodes)))
        mass, k, phi = modes(*one)
        c = 2 * DAMPING * np.sqrt(np.maximum(mass * k, 0.0))
        rows, columns = (phi[[wing.names.index(n) for n in names]] for names in (OUTPUTS, INPUTS))
        slopes = []
        for w in 2 * np.pi * FREQ:
            D = 1 / (k - w**2 * mass + 1j * w * c)
            left, right = (phi * D) @ rows.T, (phi * D) @ columns.T
            of = [-(left[i].T @ matrix @ right[i]) for _, i, matrix in wing.elements]
            of += [w**2 * (left[d].T @ one[1][np.ix_(d, d)] @ right[d]) for d in wing.at.values()]
            of += [w**2 * (left[d].T @ right[d]) for d in self.lumps(wing)]
            damped = np.argsort(np.where(mass > 1e-12 * mass.max(), np.abs(k / np.maximum(mass, 1e-300)), np.inf))[:30]
            of += [-1j * w * c[r] * D[r] ** 2 * np.outer(rows[:, r], columns[:, r]) for r in damped]
            slopes.append(-(w**2) * np.array(of))
        H = accelerances(wing, *one, np.full(len(k), DAMPING))
        sigma = NOISE * np.sqrt((np.abs(H) ** 2).mean(axis=0))
        J = (np.array(slopes) / sigma).transpose(1, 0, 2, 3).reshape(len(slopes[0]), -1)
        self.A, self.wing = 2 * np.real(J @ J.conj().T), wing

    @staticmethod
    def lumps(wing: Wing) -> list[list[int]]:
        """Translations of each node, where a mass may be added."""
        return [[k for k in d if not wing.names[k].split("+")[1].startswith("R")] for d in wing.at.values()]

    def nats(self, truth: dict) -> float:
        """Of the error hidden in one case."""
        wing, n, m = self.wing, len(self.wing.elements), len(self.wing.nodes)
        if truth["name"] == "added_mass":
            which, u = n + m + wing.nodes.index(truth["nodes"][0]), truth["kg"]
        else:
            which, u = [list(ends) for ends, _, _ in wing.elements].index(list(truth["nodes"])), truth["size"]
        known = np.r_[np.arange(n + m), np.arange(n + 2 * m, len(self.A))]
        spread = np.r_[np.full(n, truth["spread"]), np.full(m, truth["spread"] / 3), np.full(len(known) - n - m, 0.2)]
        A = self.A[np.ix_(known, known)] * np.outer(spread, spread)
        a = self.A[which, known] * spread
        return float(0.5 * u**2 * (self.A[which, which] - a @ np.linalg.solve(A + np.eye(len(A)), a)))


def judged(wing: Wing, truth: dict, said: dict) -> str:
    """``right``, ``leading`` (right but not named), ``near`` (an element away), ``wrong``, ``set`` or ``no name``."""
    causes = said["causes"]
    named = said["verdict"] == "named"
    nodes = [sorted({int(str(w).split(":")[0]) for w in c["where"]}) for c in causes]
    right = len(causes) == 1 and causes[0]["name"] == truth["name"] and nodes[0] == sorted(truth["nodes"])
    if right:
        return "right" if named else "leading"
    joined = [set(ends) for ends, _, _ in wing.elements]
    if named and len(causes) == 1 and causes[0]["name"] == truth["name"] and all(
        any({a, b} <= e for e in joined) or a == b for a in nodes[0] for b in truth["nodes"]
    ):  # fmt: skip
        return "near"
    if named:
        return "wrong"
    held = [[(c["name"], c["where"]) for c in s] for s in said["alternatives"]]
    if any(
        len(s) == 1 and s[0][0] == truth["name"]
        and sorted({int(str(w).split(":")[0]) for w in s[0][1]}) == sorted(truth["nodes"]) for s in held
    ):  # fmt: skip
        return "set"
    return "no name"


def tell(console: Console, wing: Wing, lines: list[dict]) -> None:
    """Every case, and counts: of all, and of those that the data can tell of."""
    rows = Table("case", "spread", "hidden", "at", "size", "moves a mode by", "nats", "answer", "said", "CPU s")
    visible = Visible(wing)
    for line in lines:
        line["truth"]["nats"] = visible.nats(line["truth"])
        t, said = line["truth"], line["said"]
        found = "; ".join(f"{c['name']} {'-'.join(map(str, c['where']))}" for c in said["causes"])
        where = "-".join(map(str, t["nodes"]))
        rows.add_row(
            str(t["case"]), f"{100 * t['spread']:.0f} %", t["name"], where, f"{100 * t['size']:+.0f} %",
            f"{100 * t['moved']:.2f} %", f"{t['nats']:.3g}", line["judged"], f"{said['verdict']} {found}",
            f"{line['cpu']:.0f}",
        )  # fmt: skip
    console.print(rows)
    sure = (
        ("all", lambda _: True),
        ("the data can tell of it (above ten nats)", lambda t: t["nats"] > TOLD),
        ("they can hardly (below)", lambda t: t["nats"] <= TOLD),
    )
    for what, chosen in sure:
        some = [line for line in lines if chosen(line["truth"])]
        counts = Counter(line["judged"] for line in some)
        console.print(f"{what}: {len(some)} cases; " + ", ".join(f"{k} {v}" for k, v in counts.most_common()))


def main() -> None:
    """Answer what has no answer yet, and count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=60)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", type=int, nargs="*", help="these cases, in the place of --first and --cases")
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--time", type=float, default=150.0, help="seconds for one case, by the clock")
    options = parser.parse_args()
    folder = Path(os.environ["MODALAX_DATA"]) / "nastran" / "mAEWing1_v5p2"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        model = import_finite_elements(
            folder / "stiffness_mass.pch", grids=folder / "sol103_mAEWing1_FEMv5p2.bdf", units="in-lbf",
            damping_ratio=DAMPING, keep=OUTPUTS,
        ).simulation  # fmt: skip
    wing = Wing(folder)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    lines = [json.loads(text) for text in options.out.read_text().splitlines()] if options.out.exists() else []
    done = {line["truth"]["case"] for line in lines}
    for case in options.only or range(options.first, options.first + options.cases):
        if case in done:
            continue
        hidden = draw(wing, case)
        truth, measurement = hidden.truth, hidden.measurement()
        began = time.process_time()
        said = modalax.diagnose(measurement, model, time=options.time).to_dict()
        line = {
            "truth": truth, "judged": judged(wing, truth, said), "cpu": time.process_time() - began,
            "said": {key: said[key] for key in ("verdict", "causes", "alternatives", "inaccuracy")},
        }  # fmt: skip
        lines.append(line)
        with options.out.open("a") as file:
            file.write(json.dumps(line) + "\n")
        print(case, truth["name"], truth["nodes"], f"{truth['size']:+.3f}", line["judged"], f"{line['cpu']:.0f} s")
    tell(Console(width=175), wing, sorted(lines, key=lambda line: line["truth"]["case"]))


if __name__ == "__main__":
    main()
