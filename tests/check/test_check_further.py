"""Faults that once were missed or told as others, in virtual tests of the structures that the check is scored on."""

import importlib.util
from pathlib import Path

import pytest

PATH = Path(__file__).parents[2] / "experiments" / "check" / "score.py"
SPEC = importlib.util.spec_from_file_location("check_score", PATH)
assert SPEC and SPEC.loader
score = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(score)


@pytest.mark.parametrize(
    ("fault", "seed"),
    [
        ("drift", 900_002),  # the only output: its steps from line to line look like modes near 0 Hz
        ("force_rolloff", 900_003),  # noise in proportion to the FRF, which falls after a resonance on the way
        ("too_few_lines", 900_007),  # a pole beyond the band has the largest residue
        ("too_few_lines", 900_009),  # lines so wide apart that columns seem to share their noise
        ("frequency_shift", 900_003),  # a run 0.09 % lower, 40 standard deviations but 0.08 of a half-power bandwidth
        ("not_reciprocal", 910_003),  # an exchange would mend a residue, but not the curves
        ("not_reciprocal", 2_000_002),  # a symmetric structure: an exchange with the mirrored place mends the pair
        ("not_reciprocal", 2_000_015),  # here of the two places themselves
        ("swapped", 2_000_023),  # the two places of a single pair, where residues are near zero
        ("reversed", 910_019),
        ("reversed", 2_000_009),  # no mode of the band moves the place: what lies beyond shows the sign
        ("clipped", 2_000_006),  # the largest line is noise near 0 Hz
        ("delay", 950_008),  # two modes in the band, and three drive points
        ("delay", 950_009),  # the last of four peaks is cut by the band's end
    ],
)
def test_a_fault_is_found_at_its_place_and_no_other_is_told(fault, seed):
    arrays, truth = score.draw("frames", seed, fault)
    found = score.ask(arrays)
    assert {f.what for f in found} == {fault}
    assert all(not truth["where"] or set(f.where) & set(truth["where"]) for f in found)
