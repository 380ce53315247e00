"""Sensors at other points than their names, in a chain or a beam whose every element is off."""

import chains_off
import numpy as np
import pytest
from frames import measured, simulation

from modalax.data import Measurement
from modalax.diagnose.causes.base import RARE
from modalax.diagnose.comparison import as_measurement
from modalax.diagnose.modal_domain import diagnosis
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.odd_channels.misplaced import moved, other_places
from modalax.diagnose.modal_domain.stage import identified, posed
from modalax.model import Structure

EITHER = pytest.mark.parametrize("structure", ["chain", pytest.param("beam", marks=pytest.mark.slow)])
SIMULATIONS = {"beam": simulation(), "chain": chains_off.simulation()}


def labelled(at: dict[str, str], structure: str = "beam", every: int = 1):
    """Outputs of the beam but 6:+Z, or the chain's but 3:+Z, those of ``at`` elsewhere than they are called."""
    if structure == "beam":
        data, unmeasured = measured(31, 0.01)[0], "6:+Z"
    else:
        freq = chains_off.FREQ[::every]
        H = chains_off.response(*chains_off.chain_off(5, 0.02), freq)
        data, unmeasured = chains_off.as_measured(H, freq, 5, (0, 1, 2, 3, 4)), "3:+Z"
    names = [name for name in data.outputs if name != unmeasured]
    rows = [data.outputs.index(at.get(name, name)) for name in names]
    take = lambda a: np.asarray(a)[:, :, rows]
    return data.replace(H=take(data.H), variance=take(data.variance), outputs=tuple(names))


KNOWN = {"sensor_place", "channel_gain", "channel_sign", "channel_swap"}


@pytest.mark.parametrize(("structure", "at", "wanted"), [
    pytest.param("chain", {"2:+Z": "3:+Z"}, KNOWN, marks=pytest.mark.slow),  # three are weighed as one is
    ("chain", {"1:+Z": "2:+Z", "2:+Z": "4:+Z", "4:+Z": "1:+Z"}, KNOWN),
    pytest.param("beam", {"5:+Z": "6:+Z"}, None, marks=pytest.mark.slow),
    pytest.param("beam", {"2:+Z": "3:+Z", "3:+Z": "4:+Z", "4:+Z": "2:+Z"}, None, marks=pytest.mark.slow),
], ids=["one", "three in turn", "one of a beam", "three of a beam"])  # fmt: skip
def test_sensors_at_other_points_are_named_with_these(structure, at, wanted):
    """Among all causes in the slow run."""
    data = labelled(at, structure)
    asked = (lambda slug: True) if wanted is None else wanted.__contains__
    found = diagnose_modes(data, SIMULATIONS[structure], wanted=asked)
    assert found.verdict == "named", found.reasons
    assert [(c["name"], *c["where"]) for c in found.causes] == [("sensor_place", *pair) for pair in at.items()]
    assert all(c["probability"] > 0.99 for c in found.causes)
    assert found.gain.chi2_after < 1.5 < 100 < found.gain.chi2_before
    assert [at.get(name, name) for name in data.outputs] == list(found.extended.outputs)
    assert found.reasons[0].startswith(
        f"{next(iter(at))} measures what the simulation has at {next(iter(at.values()))}"
    )


def test_steep_derivatives_of_what_explains_little_end_no_diagnosis():
    """Factors throughout stand for another place at first; their derivatives hide the prior in rounding."""
    found = diagnose_modes(labelled({"2:+Z": "3:+Z"}, "chain", 2), SIMULATIONS["chain"], wanted=KNOWN.__contains__)
    assert [(c["name"], *c["where"]) for c in found.causes] == [("sensor_place", "2:+Z", "3:+Z")]


EXCHANGED = {"chain": ("1:+Z", "4:+Z"), "beam": ("3:+Z", "7:+Z")}


@EITHER
def test_two_sensors_that_are_exchanged_are_a_swap(structure):
    one, two = EXCHANGED[structure]
    found = diagnose_modes(labelled({one: two, two: one}, structure), SIMULATIONS[structure])
    assert [(c["name"], c["where"]) for c in found.causes] == [("channel_swap", [one, two])]


@EITHER
def test_an_exchange_is_tried_before_other_places_that_hold_one(structure, monkeypatch):
    """A place that moves much as that of one of the two had been taken for it: three sensors elsewhere for a swap."""
    one, two = EXCHANGED[structure]
    monkeypatch.setattr(diagnosis, "other_places", lambda *_: {one: two, two: "2:+Z"})
    found = diagnose_modes(labelled({one: two, two: one}, structure), SIMULATIONS[structure])
    assert [(c["name"], c["where"]) for c in found.causes] == [("channel_swap", [one, two])]


def test_a_wrong_gain_or_sign_or_element_is_no_other_place():
    for change in ({"5:+Z": 0.4}, {"5:+Z": -1.0}, {}):
        data = labelled({})
        factor = np.array([change.get(name, 1.0) for name in data.outputs])[:, None]
        data = as_measurement(data.replace(H=np.asarray(data.H) * factor))
        K = np.asarray(simulation().K).copy()
        if not change:
            K[6:10, 6:10] += np.diag([3e3, 0, 3e3, 0]) - np.diag([3e3, 0], 2) - np.diag([3e3, 0], -2)
        S = simulation().replace(K=K)
        setting = posed(data, S, identified(data, S, lambda _: None)).setting
        assert other_places(setting, S.dofs, data.outputs) == {}


def test_the_probability_of_other_places_knows_how_many_there_are():
    """Each is as rare as what has no name, at any output and DoF."""
    for count in (1, 2):
        there = moved({str(k): str(k + 1) for k in range(count)}, -10.0, -10.0 - 12.0, 200)
        odds = np.exp(12.0) * (RARE / 200) ** count
        assert there.probability == pytest.approx(odds / (1 + odds), rel=1e-9)
        assert [c["where"] for c in there.told()] == [[str(k), str(k + 1)] for k in range(count)]


def test_a_sensor_elsewhere_is_seen_where_each_input_drives_modes_of_its_own():
    """Two chains that nothing joins, one along X and one along Z: half of all residues are noise."""
    rng, one = np.random.default_rng(2), chains_off.matrices(chains_off.MASSES, chains_off.SPRINGS, chains_off.ZETA)
    names = [f"{k}:+{axis}" for axis in "XZ" for k in range(1, 6)]
    both = [np.kron(np.diag([1.0, factor]), A) for A, factor in zip(one, (1.0, 1.2, 1.45), strict=True)]
    H = np.asarray(Structure(*both, names).frf(chains_off.FREQ, form="accelerance", inputs=["3:+X", "2:+Z"]).H)
    labels = [name for name in names if name != "4:+X"]
    H = H[:, [names.index("4:+X" if name == "2:+X" else name) for name in labels]]
    sigma = 0.005 * np.abs(H).max() / 10
    H = H + sigma * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
    data = Measurement(chains_off.FREQ, H[None], form="accelerance", outputs=labels, inputs=["3:+X", "2:+Z"],
                       variance=np.full((1, *H.shape), sigma**2))  # fmt: skip
    nominal = Structure(*both, names)
    setting = posed(data, nominal, identified(data, nominal, lambda _: None)).setting
    assert other_places(setting, nominal.dofs, data.outputs) == {"2:+X": "4:+X"}
