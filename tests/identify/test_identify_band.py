"""Which lines a fit uses: offsets at 0 Hz, drift below the first resonance."""

import numpy as np
import pytest

from modalax.data import FRF
from modalax.data.frf import DERIVATIVES
from modalax.identify.band import drift_ends, usable_lines
from modalax.model import ModalModel

FREQ = np.linspace(0, 100, 801)


@pytest.fixture(scope="module")
def structure():
    return ModalModel.from_real_modes(
        [12.0, 35.0, 70.0], [0.01, 0.02, 0.01], np.random.default_rng(0).normal(size=(3, 4)), np.ones(3), list("abcd")
    )


def drifting(model, form="accelerance", share=0.94, free=False):
    """FRFs of which drift, falling with the square of the frequency, holds a share of the sum of squares."""
    rng = np.random.default_rng(1)
    model = model.replace(lower=np.full((4, 4), 0.3)) if free else model
    H = np.array(model.frf(FREQ[1:], form=form, inputs=["a", "b"]).H)
    fall = (FREQ[1:] ** -2.0 * (2j * np.pi * FREQ[1:]) ** (DERIVATIVES[form] - 2))[:, None, None]
    drift = fall * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape))
    drift *= np.sqrt(share / (1 - share) * np.sum(np.abs(H) ** 2) / np.sum(np.abs(drift) ** 2))
    return FRF(FREQ, np.concatenate([np.full((1, 4, 2), 1e3), H + drift]), form=form)


@pytest.mark.parametrize(("form", "free"), [("accelerance", False), ("accelerance", True), ("mobility", False)])
def test_drift_is_left_out_up_to_where_it_ends(structure, form, free):
    frf = drifting(structure, form, free=free)
    kept, told = usable_lines(frf, choose=True)
    assert 0.5 < float(kept.freq[0]) < 9.0  # well above where it dominates, and below the first resonance
    assert np.sum(np.abs(np.asarray(frf.H)[1:]) ** 2) > 10 * np.sum(np.abs(np.asarray(kept.H)) ** 2)
    assert "0 Hz" in told[0] and "drift" in told[1] and "94 %" in told[1]


def test_a_band_given_by_hand_is_kept_and_another_one_suggested(structure):
    kept, told = usable_lines(drifting(structure), choose=False)
    assert len(kept.freq) == 800
    assert "a band from" in told[-1]


@pytest.mark.parametrize("form", list(DERIVATIVES))
def test_sound_measurements_keep_all_lines(structure, form):
    """Supported, free, with noise, or from the flank of a resonance on: only the line at 0 Hz goes."""
    rng = np.random.default_rng(2)
    for lower in (0.0, 0.5):
        H = np.array(structure.replace(lower=np.full((4, 4), lower)).frf(FREQ, form=form).H)
        H += 0.02 * np.abs(H).mean() * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape))
        frf = FRF(FREQ, H, form=form)
        assert drift_ends(frf.lines(slice(1, None)))[0] == 0
        kept, told = usable_lines(frf, choose=True)
        assert len(kept.freq) == 800 and len(told) == 1
        flank = frf.band(12.5, 90.0)
        assert len(usable_lines(flank, choose=True)[0].freq) == len(flank.freq)


def test_noise_of_accelerometers_that_was_integrated_is_left_out(structure):
    rng = np.random.default_rng(3)
    a = np.array(structure.frf(FREQ[1:], form="accelerance").H)
    a += 0.01 * np.abs(a).mean() * (rng.normal(size=a.shape) + 1j * rng.normal(size=a.shape))
    frf = FRF(FREQ[1:], a / (2j * np.pi * FREQ[1:, None, None]) ** 2, form="receptance")
    kept, told = usable_lines(frf, choose=True)
    assert 0.5 < float(kept.freq[0]) < 9.0
    assert np.sum(np.abs(np.asarray(frf.H)) ** 2) > 10 * np.sum(np.abs(np.asarray(kept.H)) ** 2)
    assert "integrated noise" in told[0]


def test_low_suspension_modes_are_no_drift(structure):
    """A suspension at 0.3 Hz, lines 0.125 Hz apart."""
    soft = ModalModel.from_real_modes([0.3, 35.0], [0.05, 0.01], np.ones((2, 1)), [1.0, 1.0], ["a"])
    frf = soft.frf(FREQ[1:], form="accelerance")
    assert drift_ends(frf)[0] == 0


@pytest.mark.parametrize("form", ["receptance", "mobility"])
def test_the_lower_residual_term_is_left_out_at_0_hz(form):
    """It is infinite there; its value at one radian a second has no meaning."""
    model = ModalModel.from_real_modes([20.0], [0.01], [[1.0]], [1.0], ["a"]).replace(lower=np.array([[1e6]]))
    bare = model.replace(lower=None)
    freq = np.array([0.0, 5.0])
    with_term, without = (np.asarray(m.frf(freq, form=form).H)[:, 0, 0] for m in (model, bare))
    assert with_term[0] == without[0]
    assert with_term[1] != without[1]
    assert np.asarray(model.frf(freq, form="accelerance").H)[0, 0, 0] == pytest.approx(1e6)


def test_one_line_at_0_hz_is_refused():
    with pytest.raises(ValueError, match="one line, at 0 Hz"):
        usable_lines(FRF([0.0], np.ones((1, 1, 1), complex)), choose=True)


def test_a_first_resonance_with_closer_lines_is_no_drift():
    """A stepped sine that starts on its upper flank, with lines 0.01 Hz apart there and 3 Hz elsewhere."""
    shapes = np.random.default_rng(1).normal(size=(3, 4))
    model = ModalModel.from_real_modes([12.0, 35.0, 70.0], [0.01, 0.02, 0.01], shapes, np.ones(3), list("abcd"))
    freq = np.concatenate([12.0 + 0.01 * np.arange(24), np.arange(15.0, 260, 3)])
    assert drift_ends(model.frf(freq, form="accelerance", inputs=["a"])) == (0, 0.0)
