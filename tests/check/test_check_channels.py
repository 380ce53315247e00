"""Channels, and whole measurements, without data of their own."""

import re

import numpy as np
import pytest
from test_check_words import FREQ, NAMES, NOISE, Bench, accelerance

from modalax.check import check
from modalax.data import Measurement


def told(H):
    """Findings, with no word of the noise."""
    return check(Measurement(FREQ, H[None], form="accelerance", outputs=NAMES, inputs=(NAMES[0], NAMES[2])))


def noise(shape, seed=0):
    rng = np.random.default_rng(seed)
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


@pytest.mark.parametrize("size", [0.0, 1.0])
def test_where_no_channel_holds_data_all_are_dead(size):
    (found,) = told(size * noise((len(FREQ), 5, 2)))
    assert (found.what, found.where) == ("dead", NAMES)
    assert ("noise" if size else "zero") in found.evidence


@pytest.mark.parametrize("scatter", [0.0, 1e-3, 1.0])
def test_a_small_constant_channel_is_dead_with_noise_or_without(scatter):
    H = accelerance()
    H = H + NOISE * np.sqrt(np.mean(np.abs(H) ** 2)) * noise(H.shape)
    H[:, 3] = 1e-4 * np.abs(H).mean() * (1 + scatter * noise(H[:, 3].shape))
    (found,) = told(H)
    assert (found.what, found.where) == ("dead", (NAMES[3],)) and "constant" in found.evidence


def test_a_quiet_channel_and_a_rigid_mass_are_sound():
    H = accelerance()
    H[:, 3] *= 1e-3
    assert list(told(H + 1e-5 * noise(H.shape))) == []
    assert "dead" not in {f.what for f in told(1 + 0.01 * noise(H.shape))}


def test_no_mode_is_told_from_ten_lines():
    few = Bench(accelerance(FREQ[:10]), freq=FREQ[:10]).measured()
    assert [(f.what, f.size, f.unit) for f in few] == [("too_few_lines", 10, "lines")]


def test_a_copied_channel_is_told_with_its_factor():
    """The second output repeats the first, noise included, at twice the gain."""
    H = accelerance()
    H = H + 0.01 * np.abs(H).mean() * noise(H.shape)
    H[:, 1] = 2 * H[:, 0]
    (found,) = [f for f in told(H) if f.what == "duplicated"]
    assert "the first is 0.5 times the second, noise included" in found.evidence


def test_a_channel_that_a_file_holds_no_number_of_is_dead(tmp_path):
    H = noise((1, len(FREQ), 5, 1)) * 1e-3 + accelerance()[None, :, :, :1]
    H[:, :, 3] = np.nan
    np.savez(tmp_path / "a.npz", freq=FREQ, H=H, form="accelerance", outputs=NAMES, inputs=NAMES[:1])
    with pytest.warns(UserWarning, match=re.escape(f"a.npz: no finite number at output {NAMES[3]}; left out")):
        found = check(tmp_path / "a.npz")
    (dead,) = [f for f in found if f.what == "dead"]
    assert dead.where == (NAMES[3],) and "no finite number" in dead.evidence
