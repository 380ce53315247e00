"""Harmonic balance against time marching, for every joint of the catalogue and past a fold on both branches.

The two routes share the joint's law and nothing else. Printed: how many harmonics are needed until the largest
difference of the fundamentals, over all outputs and lines, is below 1e-4 of the peak, and that difference there and one
rung lower. ``python experiments/simulate/hb_against_march.py``; with ``--only SLUG ...`` some joints only.
"""

import argparse
import time
from typing import NamedTuple

import jax
import numpy as np

from modalax.model import Structure
from modalax.model.examples import five_dof
from modalax.simulate.harmonic import Response, harmonic_balance
from modalax.simulate.joints import (
    BilinearSpring,
    BoucWen,
    CoulombFriction,
    CubicSpring,
    ElastoSlip,
    Gap,
    Iwan,
    Joint,
    OneSidedGap,
    ParallelJenkins,
    PolynomialDamping,
    PolynomialStiffness,
    PreloadedGap,
    QuadraticDamping,
)
from modalax.simulate.stepped import SteppedSine, stepped_sine

jax.config.update("jax_enable_x64", True)

JOINTS = [
    CubicSpring(2e9),
    QuadraticDamping(200.0),
    PolynomialStiffness([1e3, 4e6, 2e9], (1, 2, 3)),
    PolynomialDamping([3.0, 20.0, 40.0], (1, 2, 3)),
    BilinearSpring(1.5e4, 4e3),
    Gap(2e4, 3e-4),
    OneSidedGap(2e4, 3e-4),
    PreloadedGap(2e4, 2e-4, 6.0),
    ElastoSlip(2e4, 4.0),
    ParallelJenkins([1e4, 6e3, 3e3], [2.0, 3.0, 4.0]),
    Iwan(8.0, 2e4, -0.4, 0.3),
    BoucWen(2e4, 2e-4, 0.1),
    CoulombFriction(2.0),
]


LADDER = (1, 3, 5, 9, 15, 31, 63, 127, 255, 511)
WANTED = 1e-4


class Case(NamedTuple):
    """A structure, where its joint sits, and the sine that drives it."""

    structure: Structure
    place: list[str]
    freq: np.ndarray
    level: float


def balanced(joint: Joint, case: Case, harmonics: int, sweep: str) -> Response:
    """All outputs by harmonic balance."""
    return harmonic_balance(
        case.structure, [joint], [case.place], case.freq, case.level, inputs=[case.structure.dofs[0]],
        harmonics=harmonics, samples=max(512, 32 * harmonics), sweep="down" if sweep == "down" else "up",
    )  # fmt: skip


def needed(
    joint: Joint, case: Case, sweep: str, steps: int, highest: int, limit: bool = False
) -> tuple[dict[int, float], SteppedSine]:
    """Difference over the peak by harmonics: the rung of the ladder that suffices, and its neighbour below.

    ``limit``: of the limit of all harmonics, as told by a rung and the one below.
    """
    marched = stepped_sine(
        case.structure, [joint], [case.place], case.freq, case.level, inputs=[case.structure.dofs[0]], sweep=sweep,
        steps=steps,
    )  # fmt: skip
    X, seen, solved = np.asarray(marched.X), {}, {}

    def by(h: int) -> Response:
        if h not in solved:
            solved[h] = balanced(joint, case, h, sweep)
        return solved[h]

    def difference(rung: int) -> float:
        h = LADDER[rung]
        if h not in seen:
            found = by(h).limit(by(LADDER[rung - 1])) if limit and rung else by(h).fundamental
            seen[h] = float(np.abs(X - np.asarray(found)).max() / np.abs(X).max())
        return seen[h]

    rung = 2
    while difference(rung) >= WANTED and rung + 1 < len(LADDER) and LADDER[rung + 1] <= highest:
        rung += 1
    while rung and difference(rung - 1) < WANTED:
        rung -= 1
    return dict(sorted(seen.items())), marched


def report(name: str, seen: dict[int, float], marched: SteppedSine, began: float) -> None:
    met = [h for h, e in seen.items() if e < WANTED]
    cells = ", ".join(f"{h}: {e:.1e}" for h, e in seen.items())
    settled = "" if bool(np.all(np.asarray(marched.settled))) else ", NOT SETTLED"
    print(
        f"| {name} | {met[0] if met else 'more'} | {cells} | {int(np.asarray(marched.periods).max())}{settled} | "
        f"{time.perf_counter() - began:.0f} |",
        flush=True,
    )


def head(what: str) -> None:
    columns = (what, "harmonics for 1e-4", "difference by highest harmonic", "periods marched", "s")
    print("\n| " + " | ".join(columns) + " |\n" + "| --- " * len(columns) + "|", flush=True)


def catalogue(only: list[str], steps: int, lines: int, highest: int) -> None:
    """Every joint in place of the link 3-5 of the five-DoF system."""
    case = Case(five_dof(), ["3", "5"], np.linspace(33.0, 39.0, lines), 6.0)
    head(f"beside link 3-5, 6 N at DoF 1, {lines} lines 33..39 Hz, {steps} steps a period")
    for joint in [j for j in JOINTS if not only or j.slug in only]:
        began = time.perf_counter()
        report(joint.slug, *needed(joint, case, "each", steps, highest), began)
        if isinstance(joint, CoulombFriction):
            report(f"{joint.slug}, limit", *needed(joint, case, "each", steps, highest, limit=True), began)


def folds(steps: int, highest: int) -> None:
    """Oscillators over their folds: the upper branch going up, the lower one going down."""
    omega, zeta = 2 * np.pi * 20.0, 0.02
    single = Structure([[1.0]], [[2 * zeta * omega]], [[omega**2]], ["mass"])
    head(f"past a fold, 10 N on one mass, 17 lines 20..24 Hz, {steps} steps a period")
    for joint in (CubicSpring(4e8), Gap(1e4, 3e-3), OneSidedGap(1.5e4, 3e-3)):
        case, size = Case(single, ["mass"], np.linspace(20.0, 24.0, 17), 10.0), {}
        for sweep in ("up", "down"):
            began = time.perf_counter()
            seen, marched = needed(joint, case, sweep, steps, highest)
            size[sweep] = np.abs(np.asarray(marched.X))[0, :, 0, 0]
            report(f"{joint.slug}, {sweep}", seen, marched, began)
        two = np.abs(size["up"] - size["down"]) > 0.05 * size["up"].max()
        where = f"{case.freq[two].min():.2f} to {case.freq[two].max():.2f} Hz" if two.any() else "nowhere"
        print(f"| two branches at {int(two.sum())} of {len(case.freq)} lines, {where} | | | | |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=256)
    parser.add_argument("--lines", type=int, default=7)
    parser.add_argument("--highest", type=int, default=255, help="most harmonics tried")
    parser.add_argument("--only", nargs="*", default=[], metavar="SLUG", help="these joints, without the folds")
    given = parser.parse_args()
    if not given.only:
        folds(given.steps, given.highest)
    catalogue(given.only, given.steps, given.lines, given.highest)
