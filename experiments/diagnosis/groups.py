"""Wrong parameters of groups of elements: a grillage on springs, every element off, and one thing wrong beyond that.

    python experiments/diagnosis/groups.py --cases 30 [--first 0] [--known] [-o FILE.jsonl]

The simulation names four groups: outer and inner long beams, cross beams, springs. In two of three cases the stiffness
or mass of one of them is wrong by 8 to 40 %; in the others a spring or a mass is missing, or nothing is wrong. Every
element is off by 1 or 3 % besides, every mass by a third of that, every modal damping by 20 %. ``--known`` looks for
nothing, fits what is hidden where it is, and prints how far its size is off in stated standard deviations.
"""

import argparse
import json
import time
from pathlib import Path

import jax
import numpy as np
import scipy.linalg

from modalax import Measurement, Structure, diagnose
from modalax.diagnose.deadline import NEVER
from modalax.diagnose.modal_domain.causes.places import candidates_of
from modalax.diagnose.modal_domain.fitting.discrepancy import learnt_rest
from modalax.diagnose.modal_domain.fitting.fit import fit
from modalax.diagnose.modal_domain.fitting.inaccuracy import inaccuracy_of
from modalax.diagnose.modal_domain.fitting.state import Setting
from modalax.diagnose.modal_domain.modes.features import whitener_of
from modalax.diagnose.modal_domain.modes.measured import identify
from modalax.diagnose.modal_domain.on_lines.polish import leading_on_lines
from modalax.diagnose.modal_domain.search.explain import Explanation
from modalax.diagnose.modal_domain.structure.coordinates import coordinates_of
from modalax.model.groups import Groups

jax.config.update("jax_enable_x64", True)

ALONG, ACROSS, SPAN = 5, 3, (0.4, 0.3)  # nodes each way, and their distances [m]
BENDING, TORSION, MASS, SPRING = 220.0, 90.0, 1.1, 4e4  # N m^2, N m^2, kg/m, N/m
NAMES = ("outer", "inner", "cross", "springs")
ZETA, NOISE = 0.008, 0.01
DOFS = tuple(f"{k + 1}:+{d}" for k in range(ALONG * ACROSS) for d in ("Z", "RX", "RY"))


def bar(a: int, b: int, length: float, turned: bool) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and mass over all DoFs of a beam along x, or along y if turned, that bends and twists."""
    L, n = length, len(DOFS)
    k = BENDING / L**3 * np.array([[12, 6 * L, -12, 6 * L], [6 * L, 4 * L**2, -6 * L, 2 * L**2],
                                   [-12, -6 * L, 12, -6 * L], [6 * L, 2 * L**2, -6 * L, 4 * L**2]])  # fmt: skip
    m = MASS * L / 420 * np.array([[156, 22 * L, 54, -13 * L], [22 * L, 4 * L**2, 13 * L, -3 * L**2],
                                   [54, 13 * L, 156, -22 * L], [-13 * L, -3 * L**2, -22 * L, 4 * L**2]])  # fmt: skip
    # the slope along the beam: dw/dx = -theta_y, dw/dy = theta_x
    slope, twist, sign = (1, 2, 1.0) if turned else (2, 1, -1.0)
    at, s = [3 * a, 3 * a + slope, 3 * b, 3 * b + slope], np.array([1.0, sign, 1.0, sign])
    K, M = np.zeros((n, n)), np.zeros((n, n))
    K[np.ix_(at, at)] += s[:, None] * k * s
    M[np.ix_(at, at)] += s[:, None] * m * s
    ends = [3 * a + twist, 3 * b + twist]
    K[np.ix_(ends, ends)] += TORSION / L * np.array([[1.0, -1.0], [-1.0, 1.0]])
    M[ends, ends] += MASS * L * 1e-4
    return K, M


def elements() -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Group, stiffness and mass of every element."""
    out = []
    for y in range(ACROSS):
        for x in range(ALONG):
            node = ALONG * y + x
            if x + 1 < ALONG:
                out.append((0 if y in (0, ACROSS - 1) else 1, *bar(node, node + 1, SPAN[0], False)))
            if y + 1 < ACROSS:
                out.append((2, *bar(node, node + ALONG, SPAN[1], True)))
    for node in (0, ALONG - 1, ALONG * (ACROSS - 1), ALONG * ACROSS - 1):
        K = np.zeros((len(DOFS),) * 2)
        K[3 * node, 3 * node] = SPRING
        out.append((3, K, 0 * K))
    return out


def damping(K: np.ndarray, M: np.ndarray, zeta: np.ndarray | float) -> np.ndarray:
    """Damping matrix of modal damping ratios."""
    w2, P = scipy.linalg.eigh(K, M)
    return M @ P @ np.diag(2 * zeta * np.sqrt(np.maximum(w2, 0))) @ P.T @ M


def case(number: int) -> tuple[Measurement, Structure, dict]:
    """Measurement, simulation and what is hidden in a case."""
    rng = np.random.default_rng([number, 22])
    every = elements()
    shares = [
        np.array([sum((e[1 + j] for e in every if e[0] == g), 0 * every[0][1]) for g in range(4)]) for j in (0, 1)
    ]
    K, M = (s.sum(axis=0) for s in shares)
    simulation = Structure(M, damping(K, M, ZETA), K, DOFS, groups=Groups(NAMES, *shares))
    off = float(rng.choice([0.01, 0.03]))
    kind = str(rng.choice(["stiffness"] * 4 + ["mass"] * 2 + ["spring", "lump", "none"]))
    group = int(rng.integers(4 if kind == "stiffness" else 3))
    factor = 1 + float(rng.uniform(0.08, 0.4)) * float(rng.choice([-1, 1]))
    k = 1 + off * rng.standard_normal(len(every))
    m = 1 + off / 3 * rng.standard_normal(len(every))
    of = np.array([e[0] for e in every])
    hidden: dict = {"kind": kind, "off": off}
    if kind == "stiffness":
        k[of == group] *= factor
        hidden |= {"name": "element_group", "where": [NAMES[group]], "size": factor}
    if kind == "mass":
        m[of == group] *= factor
        hidden |= {"name": "element_group_mass", "where": [NAMES[group]], "size": factor}
    K = sum(a * e[1] for a, e in zip(k, every, strict=True))
    M = sum(a * e[2] for a, e in zip(m, every, strict=True))
    at = 3 * int(rng.integers(ALONG * ACROSS))
    if kind == "spring":
        size = float(rng.uniform(0.5, 2.0)) * SPRING
        K[at, at] += size
        hidden |= {"name": "joint_stiffness", "where": [DOFS[at]], "size": size}
    if kind == "lump":
        size = float(rng.uniform(0.03, 0.1)) * MASS * 8
        M[at, at] += size
        hidden |= {"name": "added_mass", "where": [DOFS[at]], "size": size}
    C = damping(K, M, ZETA * np.exp(0.2 * rng.standard_normal(len(K))))
    freq = np.linspace(4.0, 110.0, 500)
    s = 2j * np.pi * freq[:, None, None]
    inputs = [0, 3 * (ALONG + 1)]
    H = s**2 * np.linalg.solve(K + s * C + s**2 * M, np.broadcast_to(np.eye(len(K))[:, inputs], (500, len(K), 2)))
    H = H[:, ::3]
    sigma = NOISE * np.sqrt((np.abs(H) ** 2).mean(axis=0)) * np.ones(H.shape)
    error = rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)
    data = Measurement(
        freq, (H + sigma * error / np.sqrt(2))[None], form="accelerance", outputs=DOFS[::3],
        inputs=[DOFS[i] for i in inputs], variance=sigma[None] ** 2,
    )  # fmt: skip
    return data, simulation, hidden


def answered(number: int) -> dict:
    """One case and how it was answered."""
    data, simulation, hidden = case(number)
    start = time.process_time()
    answer = diagnose(data, simulation).to_dict()
    causes = [(c["name"], c["where"]) for c in answer["causes"]]
    right = causes == ([(hidden["name"], hidden["where"])] if "name" in hidden else [])
    row = {"case": number, **hidden, "verdict": answer["verdict"], "causes": causes, "right": right}
    if right and "name" in hidden:
        value = next(iter(answer["causes"][0]["parameters"].values()))
        row |= {"value": value["value"], "std": value["std"]}
    return row | {"seconds": round(time.process_time() - start, 1)}


def fitted(number: int) -> dict:
    """One case, its cause fitted where it is; empty where nothing is hidden."""
    data, simulation, hidden = case(number)
    if "name" not in hidden:
        return {}
    highest = 2 * np.pi * float(data.freq[-1])
    c = coordinates_of(simulation, data.outputs, data.inputs, highest)
    measured = identify(data, c)
    f = measured.features
    setting = Setting(c, inaccuracy_of(simulation, c, highest), f, whitener_of(f))
    every = candidates_of(simulation, c, data.outputs, data.inputs, None, highest)
    cause = next(k for k in every if k.slug == hidden["name"] and list(k.where) == hidden["where"])
    first = fit(setting, (cause,))
    setting, _ = learnt_rest(setting, [first], [0.0])
    beside = Explanation(fit(setting, (cause,), first, first.u, temperatures=(3.0,)), 0.0, 1.0)
    found = leading_on_lines(setting, [beside], measured, NEVER)[1][0].fit
    value = next(iter(cause.told(found.u, found.covariance).values()))
    return {"case": number, **hidden, "off_by": (value["value"] - hidden["size"]) / value["std"]}


def table(rows: list[dict]) -> str:
    """How often each kind is named right and wrong, and how far sizes are off in their standard deviations."""
    lines = ["| hidden | cases | named right | right, not named | named wrong | no name | within 2 std |",
             "|---|---|---|---|---|---|---|"]  # fmt: skip
    for kind in ("stiffness", "mass", "spring", "lump", "none"):
        some = [r for r in rows if r["kind"] == kind]
        named = [r for r in some if r["verdict"] == "named"]
        sized = [abs(r["value"] - r["size"]) < 2 * r["std"] for r in some if "value" in r]
        right = sum(r["right"] for r in named) if kind != "none" else sum(r["verdict"] == "clean" for r in some)
        also = sum(r["right"] and r["verdict"] == "ambiguous" for r in some)
        wrong = sum(not r["right"] for r in named)
        rest = len(some) - right - also - wrong
        lines.append(f"| {kind} | {len(some)} | {right} | {also} | {wrong} | {rest} | {sum(sized)} of {len(sized)} |")
    return "\n".join(lines)


def main() -> None:
    """Answer cases, print a line each and the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=30, help="number of cases; 0 prints the table of the file")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("-o", type=Path, default=None, help="append the answers to this file")
    parser.add_argument("--known", action="store_true", help="fit what is hidden, without looking for it")
    args = parser.parse_args()
    rows = []
    if args.known:
        told = []
        for number in range(args.first, args.first + args.cases):
            if row := fitted(number):
                told.append(row)
                print(json.dumps(row), flush=True)
        off = np.array([row["off_by"] for row in told])
        print(f"rms {np.sqrt((off**2).mean()):.2f} standard deviations, within 2: {(abs(off) < 2).sum()} of {len(off)}")
        return
    for number in range(args.first, args.first + args.cases):
        rows.append(answered(number))
        print(json.dumps(rows[-1]), flush=True)
        if args.o is not None:
            with args.o.open("a", encoding="utf-8") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    if args.o is not None and args.o.exists():
        rows = [json.loads(line) for line in args.o.read_text(encoding="utf-8").splitlines()]
    print(table(rows))


if __name__ == "__main__":
    main()
