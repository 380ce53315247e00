"""Records that ended before the response had decayed, found in a chain whose every element is off."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.integrate
from chains_off import FREQ, as_measured, chain_off, response, simulation, summed

from modalax.data import Measurement
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.modes.free_residues import refine
from modalax.diagnose.modal_domain.modes.measured import prepared
from modalax.diagnose.modal_domain.modes.windows import KINDS, Window
from modalax.diagnose.modal_domain.records import short_records
from modalax.diagnose.modal_domain.records.short_records import end_of_record, record_that_ends, short_record
from modalax.diagnose.modal_domain.structure.coordinates import coordinates_of

LENGTH = 0.9  # s; a sixth to a third of the first mode is left then
LAG = {
    "cut": lambda u: 1.0 + 0 * u,
    "boxcar": lambda u: 1 - u,
    "hann": lambda u: (1 - u) * (2 + np.cos(2 * np.pi * u)) / 3 + np.sin(2 * np.pi * u) / (2 * np.pi),
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_window_is_the_integral_over_its_record(kind):
    x = 0.4 + 3j
    part = lambda t: LAG[kind](t / LENGTH) * np.exp(-x * t)
    expected = sum(
        unit * scipy.integrate.quad(lambda t, take=take: getattr(part(t), take), 0, LENGTH)[0]
        for unit, take in ((1, "real"), (1j, "imag"))
    )
    value, slope = Window(kind, LENGTH).transform(np.array([x]))
    assert value[0] == pytest.approx(expected, rel=1e-9)
    ahead, behind = (Window(kind, LENGTH).transform(np.array([x + h]))[0][0] for h in (1e-5, -1e-5))
    assert slope[0] == pytest.approx((ahead - behind) / 2e-5, rel=1e-6)


def measured(kind: str, freq: np.ndarray, seed: int, length: float = LENGTH) -> Measurement:
    """Accelerances of which each mode is summed over its record, by the integral in closed form of a fine sum."""
    t = (np.arange(4000) + 0.5) * length / 4000
    H = summed(seed, freq, t, LAG[kind](t / length))
    return as_measured(H, freq, seed)


CLOSER = np.arange(60, 550) / LENGTH / 5


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["cut"])
def test_its_window_and_its_length_are_told_by_the_frfs_alone(kind):
    data = measured(kind, CLOSER, 5)
    c = coordinates_of(simulation(), data.outputs, data.inputs, 2 * np.pi * float(CLOSER[-1]))
    found = short_record(data, c, lambda _: None)
    assert found is not None
    assert found.cause.window.kind == kind
    assert found.cause.window.length == pytest.approx(LENGTH, rel=1e-3)


def test_frfs_end_where_the_record_does():
    H = np.asarray(measured("cut", CLOSER, 5).H)[0].reshape(len(CLOSER), -1)
    assert end_of_record(CLOSER, H) == pytest.approx(LENGTH, abs=8 / np.ptp(CLOSER))


def test_sound_frfs_do_not_end():
    H = response(*chain_off(5, 0.02), FREQ)
    assert end_of_record(FREQ, H.reshape(len(FREQ), -1)) is None
    data = as_measured(H, FREQ, 5)
    c = coordinates_of(simulation(), data.outputs, data.inputs, 2 * np.pi * float(FREQ[-1]))
    assert short_record(data, c, lambda _: None) is None


@pytest.mark.slow
def test_it_is_named_with_its_length():
    data = measured("cut", CLOSER, 5)
    found = diagnose_modes(data, simulation())
    answer = found.to_dict()
    assert answer["verdict"] == "named"
    assert [(c["name"], c["where"]) for c in answer["causes"]] == [("leakage", [])]
    assert answer["causes"][0]["parameters"]["record_length"]["value"] == pytest.approx(LENGTH, rel=1e-3)
    again = found.extended.frf(found.freq, form="accelerance", outputs=data.outputs, inputs=data.inputs)
    assert np.abs(again.H - found.predicted_after[0]).max() < 0.05 * np.abs(found.predicted_after).max()


def test_a_fit_through_a_window_that_is_all_rounding_is_no_record_that_ended(monkeypatch):
    """Modes that decay at once hardly differ through a window as short; its chi-square had been -3e10."""
    data = as_measured(response(*chain_off(5, 0.02), CLOSER), CLOSER, 5)
    c = coordinates_of(simulation(), data.outputs, data.inputs, 2 * np.pi * float(CLOSER[-1]))
    channels = prepared(data, c)[0]
    through = replace(channels, window=Window("hann", LENGTH))
    few = refine(np.array([-2 + 100j, -4 + 300j]), through)
    ended = {}
    for chi2 in (channels.data.size, -3e10):
        found = through.window, replace(few, chi2=float(chi2)), through
        monkeypatch.setattr(short_records, "_at", lambda *_, found=found: found)
        ended[chi2] = record_that_ends(channels, LENGTH, data.H.shape[1:]) is not None
    assert ended == {channels.data.size: True, -3e10: False}
