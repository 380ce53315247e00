"""Faults found and false alarms of `modalax.check`: ``python experiments/check/score.py [--clean N] [--each N]``.

Virtual tests are drawn at random, one fault of known size is put into each, or none, and what the check says is
counted. Structures are ``frames``: beams, crosses, aeroplanes, plates and trees of shafts that no threshold was chosen
on; or those of development, ``matrices`` (``tests/check/virtual_tests.py``) and ``modes`` (``other_tests.py``).
*found*: the fault's word is among the findings; *place*: with the right channel; *holds*: of the intervals given, those
with the true size; *others*: tests in which another word stands beside it. Sizes are split at their median. Last, how
often findings were right, by how sure they are: of the fault that was put in, with a right channel.
"""

import argparse
import sys
import time
from collections import Counter, defaultdict
from pathlib import Path

import jax
import numpy as np
import scipy.linalg

TESTS = Path(__file__).parents[2] / "tests"
sys.path += [str(TESTS / "check"), str(TESTS / "hidden")]
from generator.systems import draw_system  # noqa: E402
from other_faults import FAULTS, draw_other  # noqa: E402
from other_structures import Modal  # noqa: E402
from virtual_tests import draw_test  # noqa: E402

from modalax.check import Findings, check  # noqa: E402
from modalax.data import Measurement  # noqa: E402

jax.config.update("jax_enable_x64", True)
WORDS = (*FAULTS, "record_too_short")
SURE = (0.5, 0.75, 0.9, 0.95, 0.99)  # bins of how sure findings are


def frames(rng, count: int) -> Modal:
    """A structure of matrices that hidden effects are drawn on, as poles and shapes of some of its places."""
    system = draw_system(rng, str(rng.choice(["frame", "frame", "third"])))
    n = system.n
    inverse = np.linalg.inv(system.M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ system.K, -inverse @ system.C]])
    poles, vectors = scipy.linalg.eig(A)
    up = np.flatnonzero(poles.imag > 1e-3)
    up = up[np.argsort(poles[up].imag)]
    poles, q = poles[up], vectors[:n, up]
    norm = np.einsum("ar,ab,br->r", q, system.C, q) + 2 * poles * np.einsum("ar,ab,br->r", q, system.M, q)
    shapes = (q * np.sqrt(2j * np.abs(poles) / norm)).T
    keep = np.sort(rng.choice(n, min(n, count), replace=False))
    names = tuple(system.dofs[k] for k in keep)
    return Modal(poles, shapes[:, keep], np.zeros((0, len(keep))), names)


def draw(kind: str, seed: int, fault: str | None) -> tuple[dict, dict]:
    """Arrays of a file and the truth."""
    if kind == "matrices" or fault == "record_too_short":
        test = draw_test(seed, fault)
        return dict(test.arrays), {"size": None, "where": [], **test.truth}
    arrays, truth, _ = draw_other(seed, fault, frames if kind == "frames" else None)
    return arrays, truth


def ask(arrays: dict) -> Findings:
    arrays = dict(arrays)
    return check(Measurement(arrays.pop("freq"), arrays.pop("H"), **arrays))


def holds(fault: str, interval, truth: dict) -> bool:
    """Whether an interval has the true size; which of two channels is at fault is a matter of sign or inverse.

    A shift of frequency is that of one mode, and modes may shift differently.
    """
    size = truth["size"]
    shifts = [100 * sign * s for s in truth.get("sizes", ()) for sign in (1, -1)]
    same = {"calibration": (size, 1 / size), "frequency_shift": shifts}.get(fault, (size,))
    return any(interval[0] <= s <= interval[1] for s in same)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clean", type=int, default=500)
    parser.add_argument("--each", type=int, default=20)
    parser.add_argument("--first", type=int, default=100_000, help="first seed; below 100000 were used to develop")
    parser.add_argument("--kind", choices=("frames", "matrices", "modes"), default="frames")
    parser.add_argument("--faults", nargs="*", default=list(WORDS))
    parser.add_argument("--show", action="store_true", help="one line for every miss and every false alarm")
    given = parser.parse_args()
    start = time.process_time()
    sure: dict[float, list[tuple[float, bool]]] = defaultdict(list)
    alarms, words = 0, Counter()
    for seed in range(given.first, given.first + given.clean):
        found = ask(draw(given.kind, seed, None)[0])
        alarms += len(found) > 0
        words.update({f.what for f in found})
        if given.show:
            for f in found:
                print("   alarm", seed, f.what, f.where, f.size, round(f.sure, 3), f.evidence, flush=True)
    if given.clean:
        spent = (time.process_time() - start) / given.clean
        print(f"\nSound tests with a finding: {alarms} of {given.clean} ({100 * alarms / given.clean:.2g} %), "
              f"{spent:.2g} CPU s each. {dict(words)}\n", flush=True)  # fmt: skip
    if not given.each:
        return
    print("| fault | found [%] | smaller half | larger half | place [%] | interval holds | others |")
    print("|---|---|---|---|---|---|---|", flush=True)
    for fault in given.faults:
        row = score(given, fault, sure)
        print(f"| {fault} | {row} |", flush=True)
    print("\n| sure | findings | mean of sure [%] | of them right [%] |\n|---|---|---|---|")
    for low in sorted(sure):
        said, right = np.array(sure[low]).T
        print(f"| {low:.2f} and more | {len(right)} | {100 * said.mean():.1f} | {100 * right.mean():.1f} |")
    print(f"\n{time.process_time() - start:.0f} CPU s", flush=True)


def score(given, fault: str, sure: dict) -> str:
    """One row: tests with a fault and what was said of them."""
    rows, others, intervals = [], Counter(), []
    for seed in range(given.first, given.first + given.each):
        arrays, truth = draw(given.kind, seed, fault)
        found = ask(arrays)
        want = set(truth["where"])
        right = [f for f in found if f.what == fault]
        placed = [f for f in right if not want or set(f.where) & want]
        for f in found:
            sure[max(s for s in SURE if f.sure >= s - 1e-9)].append((f.sure, f in placed))
        size = truth.get("size")
        step = abs(np.log(abs(size))) if fault == "calibration" and size else abs(size or 0)
        rows.append((step, bool(right), bool(placed)))
        if placed and placed[0].interval and size:
            intervals.append(holds(fault, placed[0].interval, truth))
        others.update({f.what for f in found} - {fault})
        if given.show and not placed:
            said = [f.what for f in found]
            print("   missed", fault, seed, arrays["H"].shape, truth["where"], size, said, flush=True)
    table = np.array(rows)
    small = table[:, 0] <= np.median(table[:, 0])
    part = lambda use: f"{100 * table[use, 1].mean():.0f}" if 0 < use.sum() < len(table) else "-"
    told = f"{sum(intervals)} of {len(intervals)}" if intervals else "-"
    beside = ", ".join(f"{k} {v}" for k, v in others.items())
    seen, place = (f"{100 * table[:, k].mean():.0f}" for k in (1, 2))
    return f"{seen} | {part(small)} | {part(~small)} | {place} | {told} | {beside}"


if __name__ == "__main__":
    main()
