"""Sensors at other points than their names, in a beam whose every element is off."""

import numpy as np
import pytest
from frames import measured, simulation

from modalax.diagnose.causes.base import RARE
from modalax.diagnose.comparison import as_measurement
from modalax.diagnose.modal_domain import diagnosis
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.misplaced import moved, other_places
from modalax.diagnose.modal_domain.stage import identified, posed


def labelled(at: dict[str, str], seed: int = 31, off: float = 0.01):
    """The beam's outputs but 6:+Z, those of ``at`` measured at other points than they are called."""
    data, _ = measured(seed, off)
    names = [name for name in data.outputs if name != "6:+Z"]
    rows = [data.outputs.index(at.get(name, name)) for name in names]
    take = lambda a: np.asarray(a)[:, :, rows]
    return data.replace(H=take(data.H), variance=take(data.variance), outputs=tuple(names))


@pytest.mark.parametrize("at", [
    {"5:+Z": "6:+Z"}, {"2:+Z": "3:+Z", "3:+Z": "4:+Z", "4:+Z": "2:+Z"},
], ids=["one", "three in turn"])  # fmt: skip
def test_sensors_at_other_points_are_named_with_these(at):
    data = labelled(at)
    found = diagnose_modes(data, simulation())
    assert found.verdict == "named", found.reasons
    assert [(c["name"], *c["where"]) for c in found.causes] == [("sensor_place", *pair) for pair in at.items()]
    assert all(c["probability"] > 0.99 for c in found.causes)
    assert found.gain.chi2_after < 1.5 < 100 < found.gain.chi2_before
    assert [at.get(name, name) for name in data.outputs] == list(found.extended.outputs)
    assert found.reasons[0].startswith(
        f"{next(iter(at))} measures what the simulation has at {next(iter(at.values()))}"
    )


def test_two_sensors_that_are_exchanged_are_a_swap():
    found = diagnose_modes(labelled({"3:+Z": "7:+Z", "7:+Z": "3:+Z"}), simulation())
    assert [(c["name"], c["where"]) for c in found.causes] == [("channel_swap", ["3:+Z", "7:+Z"])]


def test_an_exchange_is_tried_before_other_places_that_hold_one(monkeypatch):
    """A place that moves much as that of one of the two had been taken for it: three sensors elsewhere for a swap."""
    other = {"3:+Z": "7:+Z", "7:+Z": "2:+Z"}
    monkeypatch.setattr(diagnosis, "other_places", lambda *_: other)
    found = diagnose_modes(labelled({"3:+Z": "7:+Z", "7:+Z": "3:+Z"}), simulation())
    assert [(c["name"], c["where"]) for c in found.causes] == [("channel_swap", ["3:+Z", "7:+Z"])]


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
