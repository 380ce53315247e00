"""Draw cases of simulations that are off everywhere: ``python experiments/diagnosis/draw_inaccurate.py --out FOLDER``.

Writes ``FOLDER/cases/NAME/measurement.npz`` and ``simulation.npz``, and ``FOLDER/truth/NAME.json``, which only
``score_inaccurate.py`` opens. Cases that are there already are kept. ``--set development`` and ``--set final`` draw
from structures that have none in common. ``--invariance 40`` draws as many tests, each measured with 2, 4, 8 and 16
lines to a half-power bandwidth and over 1, 1.5 and 2 times the band; with ``--kind small --linear`` the structures have
6 to 12 degrees of freedom and no joint is hidden, so that each answer takes seconds.
"""

import argparse
import sys
import zlib
from pathlib import Path

import numpy as np
from rich.progress import track

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "hidden"))

from inaccurate import CAUSES, KINDS, draw_case  # noqa: E402
from inaccurate.case import CLAIMS, JOINTS, VARIANCES, WEIGHTS  # noqa: E402
from inaccurate.structures import SMALL  # noqa: E402

SETS = {"development": 0, "final": 1_000_000}
LINES, BANDS = (2.0, 4.0, 8.0, 16.0), (1.0, 1.5, 2.0)


def seeds(which: str, seed: int, name: str, structures: int | None) -> tuple[int, int]:
    """Seed of the case and of its structure; those of the two sets are a million apart, so they never meet."""
    case = zlib.crc32(f"{which} {seed} {name}".encode())
    own = case if structures is None else zlib.crc32(f"{seed} structure {case % structures}".encode())
    return case, SETS[which] + own % 1_000_000


def gross_cause(case: int, linear: bool = False) -> str:
    """A kind of gross error, structural ones more often."""
    names = [c for c in CAUSES if c != "none" and not (linear and c in JOINTS)]
    weights = np.array([WEIGHTS.get(c, 1) for c in names], float)
    return names[int(np.random.default_rng([case, 3]).choice(len(names), p=weights / weights.sum()))]


def plan(args: argparse.Namespace) -> list[tuple[str, str, str | None, dict]]:
    """``(name, what the seed is of, cause, settings)`` of every case."""
    given = {k: getattr(args, k) for k in ("kind", "spread", "claim", "variance", "noise", "lines", "widen")}
    cases: list[tuple[str, str, str | None, dict]] = []
    for k in range(args.count):
        cases.append((f"gross-{k:04d}", f"gross-{k:04d}", args.cause, given))
    for k in range(args.none):
        cases.append((f"none-{k:04d}", f"none-{k:04d}", "none", given))
    for k in range(args.invariance):
        base = f"same-{k:04d}"
        for lines in LINES:
            for widen in BANDS:
                settings = {**given, "lines": lines, "widen": widen}
                cases.append((f"{base}-l{lines:g}-w{widen:g}", base, args.cause, settings))
    return cases


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--set", choices=tuple(SETS), default="development")
    parser.add_argument("--count", type=int, default=0, help="cases with a gross error")
    parser.add_argument("--none", type=int, default=0, help="cases without one")
    parser.add_argument("--invariance", type=int, default=0, help="tests to be measured in twelve ways each")
    parser.add_argument("--structures", type=int, help="so many structures shared by all; each case its own by default")
    parser.add_argument("--cause", choices=CAUSES[1:])
    parser.add_argument("--kind", choices=(*KINDS, SMALL))
    parser.add_argument("--linear", action="store_true", help="gross errors other than joints at force levels")
    parser.add_argument("--spread", type=float, help="0, 0.003, 0.01 or 0.03 by default")
    parser.add_argument("--claim", choices=tuple(CLAIMS))
    parser.add_argument("--variance", choices=VARIANCES)
    parser.add_argument("--noise", type=float)
    parser.add_argument("--lines", type=float)
    parser.add_argument("--widen", type=float)
    parser.add_argument("--damping", choices=("kept", "follows", "either"), default="kept",
                        help="whether damping follows stiffness or mass that is grossly wrong")  # fmt: skip
    args = parser.parse_args()
    for name, of, cause, settings in track(plan(args), "drawing"):
        truth = args.out / "truth" / f"{name}.json"
        if truth.exists():
            continue
        case, structure = seeds(args.set, args.seed, of, args.structures)
        try:
            follows = args.damping == "follows" or args.damping == "either" and case % 2 == 0
            drawn = draw_case(
                case, cause or gross_cause(case, args.linear), structure=structure, damping_follows=follows, **settings
            )
        except ValueError as error:  # on some structures a joint has several answers wherever it sits
            print(f"{name} is left out: {error}")
            continue
        drawn.save(args.out / "cases" / name, truth)


if __name__ == "__main__":
    main()
