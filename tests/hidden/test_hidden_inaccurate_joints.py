"""Joints at three levels in structures whose every element is off: law and place."""

import numpy as np
import pytest
from inaccurate import draw_case

from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.files import load


@pytest.mark.slow  # by default of a joint that the simulation lacks altogether, which is harder, see below
@pytest.mark.parametrize(("law", "seed"), [("cubic_stiffness", 3), ("elasto_slip", 3)])
def test_a_joint_is_placed_and_its_law_named_where_every_element_is_off(law, seed, tmp_path):
    case = draw_case(
        seed, law, kind="shaft", spread=0.02, claim="none", variance="exact", noise=0.01, lines=2.0, widen=1.0
    )
    case.save(tmp_path, tmp_path / "truth.json")
    hidden = case.truth["causes"][0]
    found = diagnose_modes(load(tmp_path / "measurement.npz"), load(tmp_path / "simulation.npz"))
    answer = found.to_dict()
    assert [(c["name"], sorted(c["where"])) for c in answer["causes"]] == [(law, sorted(hidden["where"]))]
    assert answer["verdict"] in ("named", "ambiguous")
    if law == "cubic_stiffness":
        aim = hidden["parameters"]["cubic_stiffness"]["value"]
        assert answer["causes"][0]["parameters"]["cubic_stiffness"]["value"] == pytest.approx(aim, rel=0.3)
    assert answer["gain"]["chi2_after"] < 0.1 * answer["gain"]["chi2_before"]
    assert np.isfinite(found.residual_after).all()


def test_a_slipping_joint_that_the_simulation_lacks_altogether_is_one_cause(tmp_path):
    case = draw_case(
        3, "elasto_slip", kind="shaft", spread=0.02, claim="none", variance="exact", noise=0.01, lines=1.0, widen=1.0
    )
    hidden = case.truth["causes"][0]
    stiffness, slip = (hidden["parameters"][name]["value"] for name in ("stiffness", "slip_force"))
    names = [str(name) for name in case.simulation["dofs"]]
    b = np.zeros(len(names))
    b[[names.index(name) for name in hidden["where"]]] = (1.0, -1.0)[: len(hidden["where"])]
    case.simulation["K"] = case.simulation["K"] - stiffness * np.outer(b, b)
    case.save(tmp_path, tmp_path / "truth.json")
    found = diagnose_modes(load(tmp_path / "measurement.npz"), load(tmp_path / "simulation.npz"))
    answer = found.to_dict()
    assert [(c["name"], sorted(c["where"])) for c in answer["causes"]] == [("elasto_slip", sorted(hidden["where"]))]
    assert answer["verdict"] in ("named", "ambiguous")
    assert answer["gain"]["chi2_after"] < 0.1 * answer["gain"]["chi2_before"]
    assert np.isfinite(found.residual_after).all()
    told = answer["causes"][0]["parameters"]
    assert abs(told["stiffness"]["value"] - stiffness) < 4 * told["stiffness"]["std"] + 0.02 * stiffness
    assert told["slip_force"]["value"] == pytest.approx(slip, rel=0.2)
    assert any("lacks this joint" in reason for reason in answer["reasons"])
    assert [type(c).__name__ for c in found.extended.causes] == ["ElastoSlip"]
    assert not found.extended.causes[0].replaced
