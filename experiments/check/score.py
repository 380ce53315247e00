"""Faults found and false alarms of `modalax.check`: ``python experiments/check/score.py [--clean N] [--each N]``.

Virtual tests of ``tests/check/virtual_tests.py``: structures, layouts, noise and lines are drawn at random, one fault
is put into each (or none), and what the check says is counted. *found*: the fault's word is among the findings;
*place*: with the right channel; *others*: tests in which another word stands beside it.
"""

import argparse
import sys
import time
from collections import Counter
from pathlib import Path

import jax
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "check"))
from virtual_tests import FAULTS, Test, draw_test  # noqa: E402

from modalax.check import Findings, check  # noqa: E402
from modalax.data import Measurement  # noqa: E402

jax.config.update("jax_enable_x64", True)


def ask(test: Test) -> Findings:
    arrays = dict(test.arrays)
    return check(Measurement(arrays.pop("freq"), arrays.pop("H"), **arrays))


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--clean", type=int, default=500)
    parser.add_argument("--each", type=int, default=60)
    parser.add_argument("--first", type=int, default=100_000, help="first seed; below 100000 were used to develop")
    parser.add_argument("--faults", nargs="*", default=list(FAULTS))
    parser.add_argument("--show", action="store_true", help="one line for every miss and every false alarm")
    given = parser.parse_args()
    start = time.process_time()
    alarms, words = 0, Counter()
    for seed in range(given.first, given.first + given.clean):
        test = draw_test(seed)
        found = ask(test)
        alarms += len(found) > 0
        words.update({f.what for f in found})
        if given.show and len(found):
            print(seed, {k: test.truth[k] for k in ("layout", "noise", "level")}, test.arrays["H"].shape)
            for f in found:
                print("    ", f.what, f.where, f.size, round(f.sure, 3), f.evidence)
    spent = (time.process_time() - start) / max(given.clean, 1)
    if given.clean:
        share = alarms / given.clean
        print(f"sound tests with a finding: {alarms} of {given.clean} ({100 * share:.2g} %), {spent:.2g} s each")
        print("   ", dict(words))
    print(f"{'fault':18} found   place   others")
    for fault in given.faults:
        count = np.zeros(3, int)
        others = Counter()
        for seed in range(given.first, given.first + given.each):
            test = draw_test(seed, fault)
            found = ask(test)
            right = [f for f in found if f.what == fault]
            want = set(test.truth["where"])
            place = any(not want or set(f.where) & want for f in right)
            extra = {f.what for f in found} - {fault}
            count += [bool(right), place, bool(extra)]
            others.update(extra)
            if given.show and not right:
                about = {k: test.truth[k] for k in ("layout", "noise", "level", "where")}
                print("   missed", fault, seed, about, test.arrays["H"].shape, [f.what for f in found])
        each = 100 * count / max(given.each, 1)
        print(f"{fault:18} {each[0]:5.1f} % {each[1]:5.1f} % {each[2]:5.1f} %  {dict(others)}", flush=True)


if __name__ == "__main__":
    main()
