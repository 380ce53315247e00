"""Draw hidden-effect cases: ``python experiments/diagnosis/draw.py FOLDER --per-cause 30 --clean 1000``.

Writes ``FOLDER/cases/NAME/measurement.npz`` and ``simulation.npz``, and ``FOLDER/truth/NAME.json``, which only
``score.py`` opens. Cases that are there already are kept, so a longer draw adds to a shorter one.
"""

import argparse
import itertools
import sys
import time
import zlib
from pathlib import Path

import numpy as np
from rich.progress import track

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "hidden"))

from generator import CATALOGUE, OUTSIDE_CATALOGUE, draw_case  # noqa: E402
from generator.case import EFFECTS, VARIANCES  # noqa: E402

SIZES = (3.0, 5.0, 6.5, 8.0, 12.0, 20.0, 30.0, 50.0)
STAGES = (
    ("added_mass", "joint_stiffness", "local_damper", "tuned_mass", "modal_damping", "missing_mode", "gyroscopic"),
    ("channel_gain", "time_delay", "mains_hum", "force_dropout", "sensor_mass"),
    ("elasto_slip", "cubic_stiffness", "gap", "coulomb_friction", "quadratic_damping"),
)


def plan(
    per_cause: int, clean: int, outside: int, pairs: int, causes: list[str] | None, sizes, variances
) -> list[tuple]:
    """``(name, cause, d, variance)`` of every case; ``variance`` None is drawn, ``variances`` are the clean ones'."""
    chosen = causes or CATALOGUE
    cases: list[tuple] = []
    for slug in chosen:
        for k in range(per_cause):
            cases.append((f"{slug.replace(':', '-')}-{k:04d}", slug, sizes[k % len(sizes)], None))
    if not causes:
        for slug in OUTSIDE_CATALOGUE:
            cases += [(f"{slug.replace(':', '-')}-{k:04d}", slug, (30.0, 50.0)[k % 2], None) for k in range(outside)]
    for k in range(clean):
        cases.append((f"clean-{k:04d}", "clean", 0.0, variances[k % len(variances)]))
    for k in range(pairs):
        rng = np.random.default_rng([97, k])
        a, b = rng.choice(len(STAGES), 2) if rng.random() < 0.3 else rng.choice(len(STAGES), 2, replace=False)
        first, second = rng.choice(STAGES[a]), rng.choice(STAGES[b])
        if first == second:
            second = "channel_gain" if first != "channel_gain" else "added_mass"
        cases.append((f"pair-{k:04d}", f"{first}+{second}", (20.0, 30.0)[k % 2], None))
    return cases


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--per-cause", type=int, default=30)
    parser.add_argument("--clean", type=int, default=100)
    parser.add_argument("--outside", type=int, default=6, help="cases of each cause outside the catalogue")
    parser.add_argument("--pairs", type=int, default=40)
    parser.add_argument("--causes", nargs="*", choices=tuple(EFFECTS))
    parser.add_argument("--sizes", nargs="*", type=float, default=SIZES)
    parser.add_argument("--family", default="masses,frame", help="one, or several by commas; third for the exam")
    parser.add_argument("--structures", type=int, nargs="*", help="their seeds, in turn; each case its own by default")
    parser.add_argument("--variance", choices=VARIANCES, help="of all clean cases; each in turn by default")
    parser.add_argument("--runs", type=int)
    parser.add_argument("--inputs", type=int)
    parser.add_argument("--seed", type=int, default=0, help="another seed, another draw")
    args = parser.parse_args()
    families = itertools.cycle(args.family.split(","))
    variances = [args.variance] if args.variance else list(VARIANCES)
    todo = plan(args.per_cause, args.clean, args.outside, args.pairs, args.causes, args.sizes, variances)
    slow: list[tuple[float, str]] = []
    for k, (name, cause, d, variance) in enumerate(track(todo, "drawing")):
        family = next(families)
        structure = args.structures[k % len(args.structures)] if args.structures else None
        if (args.folder / "truth" / f"{name}.json").exists():
            continue
        start = time.perf_counter()
        seed = zlib.crc32(f"{args.seed} {name} {args.family}".encode())
        try:
            case = draw_case(
                seed,
                cause,
                d,
                family,
                variance=variance,
                structure=structure,
                runs=args.runs,
                inputs=args.inputs,
                rivals=True,
            )
        except ValueError as error:  # some causes cannot be as large on some structures
            print(f"{name} is left out: {error}")
            continue
        case.save(args.folder / "cases" / name, args.folder / "truth" / f"{name}.json")
        slow.append((time.perf_counter() - start, name))
    if slow:
        total = sum(s for s, _ in slow)
        print(f"{len(slow)} cases in {total:.0f} s; slowest {max(slow)[0]:.1f} s ({max(slow)[1]})")


if __name__ == "__main__":
    main()
