"""A chain that is off everywhere and whose modes are all in the band: nothing of it is left for lines to tell."""

from dataclasses import replace

import numpy as np
import pytest
from chains_off import DOFS, FREQ, MASSES, SPRINGS, ZETA, as_measured, chain_off, matrices, response, simulation
from kinds import FEW_OR_ALL, few_or_all

from modalax.diagnose import diagnose
from modalax.diagnose.modal_domain.answer import ModalDiagnosis
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.fitting.fit import fit
from modalax.diagnose.modal_domain.fitting.state import state_at
from modalax.model import Structure


def test_a_column_is_predicted_as_well_as_the_fit_without_it_knows_the_elements():
    found = diagnose(as_measured(response(*chain_off(3, 0.02), FREQ), FREQ, 3), simulation())
    assert isinstance(found, ModalDiagnosis)  # and not line by line, which takes minutes
    assert found.verdict == "clean"
    samples = 2 * 4 * len(FREQ)
    assert found.gain.chi2_unforeseen == pytest.approx(1.0, abs=4 * np.sqrt(2 / samples))
    assert found.gain.chi2_after >= found.gain.chi2_unforeseen


def test_an_oscillator_is_named_where_the_simulation_has_fewer_modes_than_are_measured():
    M, C, K = (np.pad(A, (0, 1)) for A in chain_off(4, 0.02))
    mass, w, v = 0.12, 2 * np.pi * 55.0, np.array([0, 0, 0, 0, 1.0, -1.0])
    M[5, 5] = mass
    C, K = C + 0.04 * w * mass * np.outer(v, v), K + w**2 * mass * np.outer(v, v)
    found = diagnose_modes(as_measured(response(M, C, K, FREQ), FREQ, 4), simulation()).to_dict()
    assert [(c["name"], c["where"]) for c in found["causes"]] == [("tuned_mass", ["5:+Z"])]
    for name, true in (("mass", mass), ("frequency", 55.0), ("damping_ratio", 0.02)):
        told = found["causes"][0]["parameters"][name]
        assert told["value"] == pytest.approx(true, abs=4 * told["std"])
    assert found["inaccuracy"]["damping"]["interval"][1] < 1.0  # the oscillator is none of the simulation's modes


@few_or_all("sensor_filter")
def test_a_delay_is_none_of_the_filters_that_turn_the_phase_as_it_does(wanted):
    H = response(*chain_off(5, 0.02), FREQ)
    H[:, 3] *= np.exp(-2j * np.pi * FREQ * 3e-4)[:, None]
    found = diagnose_modes(as_measured(H, FREQ, 5), simulation(), wanted=wanted)
    assert found.verdict == "named"
    assert [(c["name"], c["where"]) for c in found.causes] == [("time_delay", ["4:+Z"])]
    beside = {c.slug for e in found.stage.explanations for c in e.causes if e.probability > 0.01}
    assert "sensor_filter" in beside  # of a second order, whose phase is the delay's up to a 500th: told by its prior


@few_or_all("sensor_filter")
def test_a_delay_far_beyond_the_usual_needs_no_filter_beside_it(wanted):
    """Twenty times the usual size: two causes that share it would each be more usual."""
    H = response(*chain_off(5, 0.02), FREQ)
    H[:, 3] *= np.exp(-2j * np.pi * FREQ * 3e-3)[:, None]
    found = diagnose_modes(as_measured(H, FREQ, 5), simulation(), wanted=wanted)
    assert [(c["name"], c["where"]) for c in found.causes] == [("time_delay", ["4:+Z"])]
    told = found.causes[0]["parameters"]["delay"]
    assert told["value"] == pytest.approx(3e-3, abs=4 * told["std"])


@FEW_OR_ALL
@pytest.mark.parametrize("stiffness", [60.0, pytest.param(120.0, marks=pytest.mark.slow)])
def test_one_tiny_fault_of_an_exact_simulation_is_named(stiffness, wanted):
    """A spring to ground of a thousandth of those beside it.

    Elements that are all off by a tenth of a per cent explain the modes too, but at the price of an inaccuracy that is
    far smaller than any usual one.
    """
    M, C, K = matrices(MASSES, SPRINGS, ZETA)
    K[2, 2] += stiffness
    found = diagnose_modes(as_measured(response(M, C, K, FREQ), FREQ, 7), simulation(), wanted=wanted)
    assert found.verdict == "named" and [(c["name"], c["where"]) for c in found.causes] == [
        ("joint_stiffness", ["3:+Z"])
    ]
    told = found.causes[0]["parameters"]["stiffness"]
    assert told["value"] == pytest.approx(stiffness, abs=4 * told["std"])
    assert found.to_dict()["inaccuracy"]["stiffness"]["interval"][0] == 0


@pytest.mark.parametrize("off", [0.0, *(pytest.param(x, marks=pytest.mark.slow) for x in (2e-4, 1e-3))])
def test_elements_that_are_all_off_a_little_are_no_fault(off):
    found = diagnose_modes(as_measured(response(*chain_off(3, off), FREQ), FREQ, 3), simulation())
    assert found.verdict == "clean"


def test_the_log_evidence_of_an_exact_simulation_is_that_of_noise_alone():
    """Half of what is likely before the data, where nothing is claimed: beside it an inaccuracy weighs next to nothing.

    Where one is claimed, it is not asked.
    """
    measured = as_measured(response(*matrices(MASSES, SPRINGS, ZETA), FREQ), FREQ, 5)
    told = {}
    for name, given in (("nothing", {}), ("claimed", {"stiffness_std": 0.01})):
        found = diagnose_modes(measured, replace(simulation(), **given))
        setting = found.stage.setting
        f = fit(setting)
        assert f is not None
        nominal = state_at(setting, np.zeros(len(setting.inaccuracy.group_of))).difference
        told[name] = f.log_evidence - (-0.5 * float(nominal @ nominal) - np.log(2))
    assert told["nothing"] == pytest.approx(0, abs=0.7)
    assert told["claimed"] < -2


@FEW_OR_ALL
def test_a_clock_that_is_wrong_is_no_mass_under_all_sensors(wanted):
    """All frequencies are off by one factor, as by a mass under each of five sensors on five alike masses."""
    S, off = Structure(*matrices(np.full(5, 1.2), SPRINGS, ZETA), DOFS), 1 + 6e-4
    H = response(np.asarray(S.M), np.asarray(S.C), np.asarray(S.K), FREQ * off) / off**2
    data = as_measured(H, FREQ, 3, outputs=(0, 1, 2, 3, 4), inputs=(0,))
    found = diagnose_modes(data, S, wanted=wanted)
    assert found.verdict == "ambiguous"
    assert any("cannot be told from one factor" in r for r in found.reasons), found.reasons
