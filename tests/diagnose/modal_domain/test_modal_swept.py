"""Sweeps too fast for the resonances, found in a chain whose every element is off."""

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
from chains_off import as_measured, chain_off, response, simulation

from modalax.data import Measurement
from modalax.diagnose.deadline import Deadline
from modalax.diagnose.modal_domain.coordinates import coordinates_of
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.measured import identify
from modalax.diagnose.modal_domain.swept import beats, fast_sweep, peaks
from modalax.diagnose.modal_domain.windows import Sweep

LINES = np.linspace(12.0, 110.0, 400)
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


def swept(seed: int, rate: float = RATE) -> Measurement:
    """Accelerances of which each mode is summed over delays, a sweep's phase with them."""
    M, C, K = chain_off(seed, 0.02)
    w2, P = scipy.linalg.eigh(K, M)
    w = np.sqrt(w2)
    zeta = np.diag(P.T @ C @ P) / 2 / w
    poles = w * (-zeta + 1j * np.sqrt(1 - zeta**2))
    residues = np.einsum("or,ir->roi", P, P) / (2j * poles.imag)[:, None, None] * (poles**2)[:, None, None]
    end, n = 12.0 / (zeta * w).min(), 40000
    t = (np.arange(n) + 0.5) * end / n
    seen = np.exp(-2j * np.pi * LINES[:, None] * t + 1j * np.pi * rate * t**2) * end / n
    direct = 2 * (residues / poles[:, None, None]).sum(axis=0).real
    both = [seen @ np.exp(t[:, None] * p) for p in (poles, poles.conj())]
    H = np.einsum("fr,roi->foi", both[0], residues) + np.einsum("fr,roi->foi", both[1], residues.conj()) + direct
    return as_measured(H, LINES, seed, outputs=(0, 3), inputs=(0,))


def found_in(data: Measurement):
    """The sweep in a measurement, by its FRFs alone."""
    c = coordinates_of(simulation(), data.outputs, data.inputs, 2 * np.pi * float(LINES[-1]))
    return fast_sweep(data, simulation(), identify(data, c), Deadline(), lambda _: None)


@pytest.mark.parametrize("rate", [RATE, pytest.param(-RATE, marks=pytest.mark.slow)])
def test_its_rate_is_told_by_the_frfs_alone(rate):
    found = found_in(swept(5, rate))
    assert found is not None
    told = found.cause.told(found.u, found.covariance)["sweep_rate"]
    assert told["value"] == pytest.approx(rate, abs=4 * told["std"]) and told["std"] < 0.02 * RATE


def test_sound_frfs_are_of_no_sweep():
    assert found_in(as_measured(response(*chain_off(5, 0.02), LINES), LINES, 5)) is None


def test_poles_as_close_as_they_are_wide_are_in_one_peak():
    poles = np.array([-1 + 100j, -1 + 103j, -1 + 140j])
    assert [g.tolist() for g in peaks(poles)] == [[0, 1], [2]]
    assert beats(poles) and not beats(np.append(poles, -1 + 170j))  # one pair of close modes among others
    assert not beats(np.zeros(0, complex))


@pytest.mark.slow
def test_it_is_named_with_its_rate():
    data = swept(5)
    found = diagnose_modes(data, simulation())
    answer = found.to_dict()
    assert answer["verdict"] == "named"
    assert [(c["name"], c["where"]) for c in answer["causes"]] == [("fast_sweep", [])]
    assert answer["causes"][0]["parameters"]["sweep_rate"]["value"] == pytest.approx(RATE, rel=0.02)
    again = found.extended.frf(found.freq, form="accelerance", outputs=data.outputs, inputs=data.inputs)
    assert np.abs(again.H - found.predicted_after[0]).max() < 0.05 * np.abs(found.predicted_after).max()
