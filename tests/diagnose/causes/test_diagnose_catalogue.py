"""Causes that are asked for by name."""

import json

import numpy as np
import pytest

from modalax.cli import main
from modalax.data import FRF
from modalax.diagnose import diagnose
from modalax.diagnose.causes import as_causes, catalogue
from modalax.diagnose.causes.local import LOCAL
from modalax.files import save
from modalax.model import Structure

CHAIN = Structure(np.eye(3), 2 * np.eye(3), 1e4 * (np.eye(3) * 2 - np.eye(3, k=1) - np.eye(3, k=-1)), ["a", "b", "c"])


def test_a_name_stands_for_all_forms_of_its_cause_and_a_cause_for_itself():
    assert as_causes(None) is None
    assert [type(c).__name__ for c in as_causes("maxwell_joint")] == ["MaxwellJoint", "ZenerJoint"]
    own = LOCAL[0]
    found = as_causes([own, "channel_gain", "added_mass", "channel_gain"])
    order = [c.slug for c in catalogue()]
    assert [c.slug for c in found[:-1]] == sorted(["added_mass", "channel_gain"], key=order.index)
    assert found[-1] is own
    with pytest.raises(ValueError, match="unknown causes: friction, mass; known are added_mass, all"):
        as_causes(["mass", "added_mass", "friction"])


def measured() -> FRF:
    """The chain with a mass at its middle, 1 % noise of known variance."""
    freq, M = np.linspace(5.0, 35.0, 60), np.eye(3) + np.diag([0, 0.3, 0])
    s, rng = 2j * np.pi * freq[:, None, None], np.random.default_rng(2)
    H = np.linalg.inv(np.asarray(CHAIN.K) + s * np.asarray(CHAIN.C) + s**2 * M)
    sigma = 0.01 * np.abs(H).mean()
    noise = sigma * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
    return FRF(freq, H + noise, form="receptance", outputs=CHAIN.dofs, inputs=CHAIN.dofs, variance=sigma**2)


def test_only_what_is_named_is_looked_for(tmp_path, capsys):
    data = measured()
    (cause,) = diagnose(data, CHAIN, causes=["added_mass", "local_damper"]).causes
    assert (cause["name"], cause["where"]) == ("added_mass", ["b"])
    mass = cause["parameters"]["mass"]
    assert abs(mass["value"] - 0.3) < 4 * mass["std"] < 0.03
    with pytest.raises(ValueError, match="unknown causes: mass"):
        diagnose(data, CHAIN, causes=["mass"])
    save(data, tmp_path / "m.npz")
    save(CHAIN, tmp_path / "s.npz")
    command = ["diagnose", str(tmp_path / "m.npz"), "--simulation", str(tmp_path / "s.npz"), "--causes"]
    assert main([*command, "mass,friction"]) == 2
    assert "unknown causes: friction, mass" in capsys.readouterr().err
    assert main([*command, "added_mass,local_damper", "--json", str(tmp_path / "a.json")]) == 0
    assert json.loads((tmp_path / "a.json").read_text())["causes"][0]["name"] == "added_mass"
