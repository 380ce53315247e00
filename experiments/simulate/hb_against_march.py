"""Harmonic balance against time marching, for every joint of the catalogue and past a fold on both branches.

The two routes share the joint's law and nothing else. Printed: the largest difference of the fundamentals over all
outputs and lines, over the peak, at rising numbers of harmonics.
"""

import argparse
import time
from typing import Any

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

from modalax.model import Structure  # noqa: E402
from modalax.model.examples import five_dof  # noqa: E402
from modalax.simulate.harmonic import harmonic_balance  # noqa: E402
from modalax.simulate.joints import (  # noqa: E402
    BilinearSpring,
    BoucWen,
    CoulombFriction,
    CubicSpring,
    ElastoSlip,
    Gap,
    Iwan,
    OneSidedGap,
    ParallelJenkins,
    PolynomialDamping,
    PolynomialStiffness,
    PreloadedGap,
    QuadraticDamping,
)
from modalax.simulate.stepped import stepped_sine  # noqa: E402

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


def compare(joint: Any, harmonics: list[int], freq: Any, structure: Any, place: list[str], level: float, **march: Any):
    """Difference over the peak at each number of harmonics, both answers, and the marching's own report."""
    marched = stepped_sine(structure, [joint], [place], freq, level, inputs=[structure.dofs[0]], **march)
    answers = [
        harmonic_balance(
            structure, [joint], [place], freq, level, inputs=[structure.dofs[0]], harmonics=h,
            samples=max(1024, 32 * h), sweep="down" if march.get("sweep") == "down" else "up",
        ).fundamental
        for h in harmonics
    ]  # fmt: skip
    peak = np.abs(marched.X).max()
    return [float(np.abs(marched.X - a).max() / peak) for a in answers], answers, marched


def catalogue(harmonics: list[int], steps: int, lines: int, only: list[str]) -> None:
    freq = np.linspace(33.0, 39.0, lines)
    print(f"joint 3-5 of the five-DoF system, 6 N at DoF 1, {lines} lines 33..39 Hz, {steps} steps a period")
    print(
        f"{'joint':22}"
        + "".join(f"{f'H = {h}':>10}" for h in harmonics)
        + f"{'last two, 1/H':>16}{'periods':>9}{'s':>6}"
    )
    for joint in [j for j in JOINTS if not only or j.slug in only]:
        began = time.perf_counter()
        errors, answers, marched = compare(
            joint, harmonics, freq, five_dof(), ["3", "5"], 6.0, sweep="each", steps=steps
        )  # fmt: skip
        # where the error falls as 1/H (dry friction that sticks), the limit of the last two is the answer
        a, b = harmonics[-2:]
        limit = (b * answers[-1] - a * answers[-2]) / (b - a)
        extrapolated = np.abs(marched.X - limit).max() / np.abs(marched.X).max()
        print(
            f"{joint.slug:22}"
            + "".join(f"{e:10.1e}" for e in errors)
            + f"{extrapolated:16.1e}{int(marched.periods.max()):9d}{time.perf_counter() - began:6.0f}"
            + ("" if bool(marched.settled.all()) else "  NOT SETTLED"),
            flush=True,
        )


def fold(harmonics: list[int], steps: int) -> None:
    """A Duffing oscillator over its fold: the upper branch going up, the lower one going down."""
    omega, zeta = 2 * np.pi * 20.0, 0.02
    duffing = Structure([[1.0]], [[2 * zeta * omega]], [[omega**2]], ["mass"])
    freq = np.linspace(20.0, 24.0, 17)
    joint = CubicSpring(4e8)
    found = {}
    for sweep in ("up", "down"):
        errors, _, marched = compare(joint, harmonics, freq, duffing, ["mass"], 10.0, sweep=sweep, steps=steps)
        found[sweep] = np.abs(np.asarray(marched.X))[0, :, 0, 0]
        print(
            f"Duffing, {sweep:5}" + "".join(f"  H = {h}: {e:.1e}" for h, e in zip(harmonics, errors, strict=True)),
            f" settled {bool(marched.settled.all())}",
            flush=True,
        )
    two = np.abs(found["up"] - found["down"]) > 0.05 * found["up"].max()
    print(f"two branches at {int(two.sum())} of {len(freq)} lines, {freq[two].min():.2f} to {freq[two].max():.2f} Hz")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--harmonics", type=int, nargs="+", default=[1, 5, 15, 31])
    parser.add_argument("--steps", type=int, default=256)
    parser.add_argument("--lines", type=int, default=7)
    parser.add_argument("--only", nargs="*", default=[], metavar="SLUG", help="these joints, without the fold")
    given = parser.parse_args()
    if not given.only:
        fold(given.harmonics, given.steps)
    catalogue(given.harmonics, given.steps, given.lines, given.only)
