"""Sweeps too fast for the resonances, found in a chain whose every element is off."""

import numpy as np
import pytest
import scipy.integrate
from chains_off import as_measured, chain_off, response, simulation, summed

from modalax.data import Measurement
from modalax.diagnose.deadline import Deadline
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.modes.measured import identify
from modalax.diagnose.modal_domain.modes.windows import Sweep
from modalax.diagnose.modal_domain.records.swept import beats, fast_sweep, peaks
from modalax.diagnose.modal_domain.structure.coordinates import coordinates_of

LINES = np.linspace(12.0, 110.0, 300)
FEW = LINES[:196]  # of four modes
END = 10.0  # s, after which every mode has decayed
RATE = 2.0  # Hz/s; the first mode, of a half-bandwidth of 0.23 Hz, takes 0.7 s to decay


@pytest.mark.parametrize("rate", [3.0, -3.0])
def test_a_sweep_is_the_integral_over_all_delays(rate):
    x = 0.7 + 2j
    part = lambda t: np.exp(-x * t + 0.5j * rate * t**2)
    expected = sum(
        unit * scipy.integrate.quad(lambda t, take=take: getattr(part(t), take), 0, 40, limit=4000)[0]
        for unit, take in ((1, "real"), (1j, "imag"))
    )
    value, slope = Sweep(rate).transform(np.array([x]))
    assert value[0] == pytest.approx(expected, rel=1e-7)
    ahead, behind = (Sweep(rate).transform(np.array([x + h]))[0][0] for h in (1e-5, -1e-5))
    assert slope[0] == pytest.approx((ahead - behind) / 2e-5, rel=1e-6)


def swept(seed: int, rate: float = RATE, lines: np.ndarray = LINES) -> Measurement:
    """Accelerances of which each mode is summed over delays, a sweep's phase with them."""
    t = (np.arange(40000) + 0.5) * END / 40000
    H = summed(seed, lines, t, np.exp(1j * np.pi * rate * t**2))
    return as_measured(H, lines, seed, outputs=(0, 3), inputs=(0,))


def found_in(data: Measurement):
    """The sweep in a measurement, by its FRFs alone."""
    c = coordinates_of(simulation(), data.outputs, data.inputs, 2 * np.pi * float(data.freq[-1]))
    return fast_sweep(data, simulation(), identify(data, c), Deadline(), lambda _: None)


@pytest.mark.parametrize("rate", [RATE, pytest.param(-RATE, marks=pytest.mark.slow)])
def test_its_rate_is_told_by_the_frfs_alone(rate):
    found = found_in(swept(5, rate, FEW))
    assert found is not None
    told = found.cause.told(found.u, found.covariance)["sweep_rate"]
    assert told["value"] == pytest.approx(rate, abs=4 * told["std"]) and told["std"] < 0.02 * RATE


def test_sound_frfs_are_of_no_sweep():
    assert found_in(as_measured(response(*chain_off(5, 0.02), FEW), FEW, 5)) is None


def test_poles_as_close_as_they_are_wide_are_in_one_peak():
    poles = np.array([-1 + 100j, -1 + 103j, -1 + 140j])
    assert [g.tolist() for g in peaks(poles)] == [[0, 1], [2]]
    assert beats(poles) and not beats(np.append(poles, -1 + 170j))  # one pair of close modes among others
    assert not beats(np.zeros(0, complex))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [6, 7])
def test_it_is_named_with_its_rate(seed):
    """The dampings of 5, the chain above, happen to be off as with hysteretic damping, which then leads beside it."""
    data = swept(seed)
    found = diagnose_modes(data, simulation())
    answer = found.to_dict()
    assert answer["verdict"] == "named"
    assert [(c["name"], c["where"]) for c in answer["causes"]] == [("fast_sweep", [])]
    assert answer["causes"][0]["parameters"]["sweep_rate"]["value"] == pytest.approx(RATE, rel=0.02)
    again = found.extended.frf(found.freq, form="accelerance", outputs=data.outputs, inputs=data.inputs)
    assert np.abs(again.H - found.predicted_after[0]).max() < 0.05 * np.abs(found.predicted_after).max()
