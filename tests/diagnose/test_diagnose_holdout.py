"""Which block of the data is held out, and how far its prediction may miss it."""

import numpy as np
import pytest
import scipy.linalg

from modalax import Measurement, Structure
from modalax.diagnose.causes.channels import ChannelGain
from modalax.diagnose.comparison import empty, make_comparison
from modalax.diagnose.holdout import held_out_block, measure
from modalax.diagnose.search.look import look
from modalax.diagnose.search.singles import fit_single

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


CLAIMED = 3e-3  # relative deviation of every modal frequency


def told(off, gains, seed):
    """Gain on the column of the first of three masses beside that of the middle one, which rests in the second mode.

    Frequencies are off by ``off`` claimed deviations; ``gains`` are those of the third output, by column.
    """
    w2, V = scipy.linalg.eigh(1e4 * (2 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1)))
    names, freq = ("1", "2", "3"), np.linspace(8.0, 34.0, 300)

    def with_modes(w, **claims):
        return Structure(np.eye(3), (V * (0.02 * w)) @ V.T, (V * w**2) @ V.T, names, **claims)

    true, simulation = (
        with_modes(np.sqrt(w2) * np.exp(CLAIMED * np.asarray(off))), with_modes(np.sqrt(w2), frequency_std=CLAIMED)
    )  # fmt: skip
    H = np.array(true.frf(freq, inputs=("2", "1")).H)[None]
    H[:, :, 2] *= np.array(gains)
    sigma = 0.01 * np.sqrt((np.abs(H) ** 2).mean()) * np.ones(H.shape)
    rng = np.random.default_rng(seed)
    H = H + sigma * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)) / np.sqrt(2)
    data = Measurement(freq, H, variance=sigma**2, outputs=names, inputs=("2", "1"))
    comparison = make_comparison(data, simulation, "fixed")
    seen = look(comparison, [ChannelGain()])
    found = fit_single(seen.state, seen.screening.trials)[0]
    assert found.names == {("channel_gain", ("3",))}
    gain = measure((comparison, comparison), comparison.fit([empty(comparison)], 14)[0], found)
    assert gain.held_out == "the column of input 1"
    return gain


def test_a_mode_that_the_block_alone_shows_may_be_off_as_its_author_claims():
    """Its errors are far larger than noise; how far the block is missed is that of a normal variable all the same."""
    rng = np.random.default_rng(7)
    gains = [told(rng.normal(size=3), (1.1, 1.1), seed) for seed in range(24)]
    missed = np.array([g.missed for g in gains])
    assert sum(g.chi2_after > 10 for g in gains) > 12
    assert missed.max() < 4 and (missed > 2).sum() <= 3
    assert (missed > 0).sum() > 3  # so that the above says something


def test_a_gain_that_differs_from_column_to_column_misses_the_block():
    assert told((0, 1, 0), (1.1, 1.3), 0).missed > 4
