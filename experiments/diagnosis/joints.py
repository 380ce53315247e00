"""Non-linear joints of any strength: how often one is named, and how often its stated intervals hold the truth.

usage: python experiments/diagnosis/joints.py FOLDER [--first 0] [--count 60] [--seed 1] [--time 120] [--workers 2]
       python experiments/diagnosis/joints.py --report RESULTS.jsonl

Draws joint cases on small spring-mass structures (5 to 10 degrees of freedom, three force levels, one input), all
laws in turn, d from 10 to 10,000 (``--sizes``) and noise from 0.1 to 5 % in logarithmic steps at random, marched in
time by the generator of hidden effects, which shares no code with the package and knows no harmonics. Each is diagnosed
once, in at most ``--time`` seconds plus what a begun step takes; truth and answer go to a file of the folder, and a
run that was stopped at any time goes on where it was. ``--first 60 --count 60`` answers the second sixty of a draw;
``--keep FILE`` writes all of the folder into one file, one a line. Cases of which more than a hundredth of the lines
have no steady motion (``unsettled_rows`` in the truth) are left out: there is no FRF to answer to.
"""

import argparse
import sys
import tempfile
import zlib
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "hidden"))

import answer  # noqa: E402
from generator import draw_case  # noqa: E402
from generator.case import Case  # noqa: E402
from generator.effects_joint import JOINTS  # noqa: E402
from generator.systems import draw_system  # noqa: E402
from marks import Mark, Share, coverage, distance, reliability, right  # noqa: E402

SMALL = (5, 10)  # degrees of freedom
SIZES = (10.0, 10_000.0)  # distance in standard deviations
NOISE = (0.001, 0.05)
DECADES = (10.0, 100.0, 1000.0, 20_000.0)
SPRING_LIKE = "bilinear_stiffness"  # whose fundamental is a spring's
UNSETTLED = 0.01  # share of lines without a steady motion beyond which a case is left out
KEPT = ("verdict", "causes", "alternatives", "reasons", "gain", "error")  # of an answer; the rest is long


def small_structure(rng: np.random.Generator) -> int:
    """The seed of a small structure."""
    while True:
        seed = int(rng.integers(10**6, 10**9))
        if SMALL[0] <= draw_system(np.random.default_rng([seed, 20]), "masses").n <= SMALL[1]:
            return seed


def draw(seed: int, k: int, sizes: tuple[float, float] = SIZES) -> Case | None:
    """Case ``k`` of a draw; None where no small structure shows that law at such a size in a few attempts."""
    slug = list(JOINTS)[k % len(JOINTS)]
    for attempt in range(4):
        rng = np.random.default_rng([zlib.crc32(b"joints"), seed, k, attempt])
        d, noise = (float(np.exp(rng.uniform(*np.log(range_)))) for range_ in (sizes, NOISE))
        variance = str(rng.choice(["exact", "16"]))
        plan = {"noise_level": noise, "variance": variance, "runs": 3, "inputs": 1, "structure": small_structure(rng)}
        try:
            case = draw_case(int(rng.integers(2**32)), slug, d, "masses", **plan)
        except ValueError:  # this law cannot be as large on this structure
            continue
        remarks = case.truth["remarks"]
        steady = remarks.get("unsettled_rows", 0) <= UNSETTLED * remarks.get("rows", 1)
        if case.truth["dofs"] <= SMALL[1] and steady:
            return case
    return None


def one(
    seed: int, number: int, todo: list[int], folder: str, draw_seed: int, seconds: float, sizes: tuple[float, float]
) -> dict:
    """One draw of the study: draw a case, answer it, and write truth and answer down."""
    del seed
    answer.prepare()
    k = todo[number]
    case = draw(draw_seed, k, sizes)
    if case is None:
        return {"case": k, "verdict": "left out: no small structure shows this law at that size"}
    with tempfile.TemporaryDirectory() as held:
        case.save(Path(held))
        said = answer.diagnosed(Path(held), seconds=seconds)
    said = {key: said[key] for key in KEPT if key in said} | {"seconds": said["seconds"], "cpu": said["cpu_seconds"]}
    answer.write(Path(folder) / f"{name_of(draw_seed, k)}.json", {"truth": case.truth, "said": said})
    return {"case": k, "verdict": said["verdict"]}


def name_of(seed: int, k: int) -> str:
    """The name of a case."""
    return f"{list(JOINTS)[k % len(JOINTS)]}-{seed}-{k:04d}"


def run(folder: Path, cases: range, seed: int, seconds: float, workers: int, sizes: tuple[float, float]) -> None:
    """Draw and answer what has no answer yet."""
    folder.mkdir(parents=True, exist_ok=True)
    todo = [k for k in cases if not (folder / f"{name_of(seed, k)}.json").exists()]
    given = {"todo": todo, "folder": str(folder.resolve()), "draw_seed": seed, "seconds": seconds, "sizes": sizes}
    answer.shared_out(one, len(todo), given, workers)


def outcomes(marks: list[Mark]) -> list[Share]:
    """Named right with place, ambiguous with the truth first, in the set, wrong name or place, none, intervals."""
    return [
        Share.of(marks, lambda m: m.named and right(m)),
        Share.of(marks, lambda m: m.verdict == "ambiguous" and right(m)),
        Share.of(marks, lambda m: m.verdict in ("named", "ambiguous") and m.within),
        Share.of(marks, lambda m: m.named and not m.name_right),
        Share.of(marks, lambda m: m.named_right and not m.place_right),
        Share.of(marks, lambda m: m.verdict in ("unknown", "clean", "error")),
        coverage(marks)["all"],
    ]


HEADER = (
    "| cases | named right, with place | ambiguous, truth leads | in the set | wrong name | wrong place | no name "
    "| truth in intervals |"
)


def report(rows: list[dict]) -> None:
    """Print what the answers are worth, by decade of d and by law."""
    marks = [Mark(row["name"], row["truth"], row["said"]) for row in rows]
    groups = {
        f"d = {low:g} to {high:g}": [m for m in marks if low <= distance(m) < high]
        for low, high in zip(DECADES[:-1], DECADES[1:], strict=True)
    }
    groups |= {law: [m for m in marks if m.cause == law] for law in JOINTS}
    groups["all but bilinear"] = [m for m in marks if m.cause != SPRING_LIKE]
    groups["all"] = marks
    print(HEADER + "\n|" + "---|" * (HEADER.count("|") - 1))
    for name, some in groups.items():
        print(f"| {name} ({len(some)}) | " + " | ".join(str(share) for share in outcomes(some)) + " |")
    print("\n| stated probability | mean | right name and place |\n|---|---|---|")
    for low, high, mean, share in reliability(marks):
        print(f"| {low:g} to {min(high, 1):g} | {mean:.3f} | {share} |")
    spent = [m.said["cpu"] for m in marks]
    if spent:
        print(f"\nCPU seconds: median {np.median(spent):.0f}, longest {max(spent):.0f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1, help="another seed, another draw")
    parser.add_argument("--sizes", type=float, nargs=2, default=SIZES, help="range of d, another one, another draw")
    parser.add_argument("--time", type=float, default=120.0, help="seconds for each answer")
    parser.add_argument("--workers", type=int, default=1, help="processes on this machine")
    parser.add_argument("--keep", type=Path, help="file for all of the folder")
    parser.add_argument("--report", type=Path, nargs="+", help="print the marks of kept answers")
    args = parser.parse_args()
    if args.report:
        return report([row for path in args.report for row in answer.answered(path)])
    if args.folder is None:
        parser.error("a folder for the answers is needed, or --report with kept ones")
    run(args.folder, range(args.first, args.first + args.count), args.seed, args.time, args.workers, tuple(args.sizes))
    if args.keep:
        answer.keep(args.folder, args.keep)
    report(answer.answered(args.folder))


if __name__ == "__main__":
    main()
