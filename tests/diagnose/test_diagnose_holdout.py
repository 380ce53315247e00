"""Which block of the data is held out."""

import numpy as np
import pytest

from modalax.diagnose.holdout import held_out_block

NAN = float("nan")


@pytest.mark.parametrize(
    ("level", "inputs", "options", "words", "runs", "columns"),
    [
        ([1, 2, 9], ("a", "b"), {}, "run 3 at 9 N, the highest level", [2], [0, 1]),
        ([9, 1, 9, 2], ("a",), {}, "runs 1, 3 at 9 N, the highest level", [0, 2], [0]),
        ([4, 4], ("a", "b"), {}, "run 2, the last repeat", [1], [0, 1]),
        ([NAN, NAN], ("a",), {}, "run 2, the last repeat", [1], [0]),
        ([NAN], ("a", "b"), {}, "the column of input b", [0], [1]),
        ([1, 2, 9], ("a", "b"), {"alike": False}, "the column of input b; no run, as each has", [0, 1, 2], [1]),
        ([1, 2, 9], ("a", "b"), {"foretold": False}, "run 3 at 9 N, the highest level", [2], [0, 1]),
    ],
)
def test_the_highest_level_a_repeat_or_a_column(level, inputs, options, words, runs, columns):
    said, mask = held_out_block(np.array(level, float), inputs, (len(level), 5, 2, len(inputs)), 5, **options)
    assert said.startswith(words)
    expected = np.zeros(mask.shape, bool)
    expected[np.ix_(runs, range(5), range(2), columns)] = True
    np.testing.assert_array_equal(mask, expected)


@pytest.mark.parametrize(("level", "options", "why"), [
    ([NAN], {"foretold": False}, ""), ([1, 2], {"alike": False, "foretold": False}, "no run"),
])  # fmt: skip
def test_stretches_of_lines_where_no_column_foretells_another(level, options, why):
    said, mask = held_out_block(np.array(level, float), ("a", "b"), (len(level), 64, 2, 2), 64, **options)
    assert said.startswith("every fourth of 16 blocks") and why in said
    assert mask[0, :, 0, 0].sum() == 16 and (mask == mask[:1, :, :1, :1]).all()
