"""Strong joints with loss where the simulation has no spring: one cause hides the other until both are there."""

import numpy as np
import pytest
from chains_off import FREQ, MASSES, SPRINGS, ZETA, as_measured, chain_off, matrices, response, simulation
from kinds import few_or_all

from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.fitting.explanation import Explanation
from modalax.diagnose.modal_domain.fitting.fit import fit
from modalax.diagnose.modal_domain.on_lines.polish import without_spare
from modalax.diagnose.modal_domain.search.force_places import losses_at
from modalax.diagnose.modal_domain.stage import identified, posed

STIFF, LOSS, TIME = 9e4, 0.35, 4e-3  # N/m; loss factor; relaxation time [s]
COEFFICIENT, ORDER = 4e3, 0.5


def joined(law, seed):
    """FRFs of a chain 2 % off that a joint holds to the ground at its middle mass."""
    M, C, K = chain_off(seed, 0.02)
    s = 2j * np.pi * FREQ
    Z = np.zeros((len(FREQ), 5, 5), complex)
    Z[:, 2, 2] = {
        "hysteretic_joint": STIFF * (1 + 1j * LOSS) + 0 * s, "maxwell_joint": STIFF * s * TIME / (1 + s * TIME),
        "fractional_joint": COEFFICIENT * s**ORDER,
    }[law]  # fmt: skip
    return as_measured(response(M, C, K, FREQ, Z), FREQ, seed)


@pytest.mark.slow  # by default among hidden effects, as the fractional joint below
def test_a_strong_spring_with_loss_is_named_with_its_loss():
    said = diagnose_modes(joined("hysteretic_joint", 3), simulation()).to_dict()
    assert said["verdict"] == "named" and all(c["where"] == ["3:+Z"] for c in said["causes"])
    found = {c["name"]: next(iter(c["parameters"].values())) for c in said["causes"]}
    assert set(found) == {"joint_stiffness", "hysteretic_joint"}
    for name, true in (("joint_stiffness", STIFF), ("hysteretic_joint", LOSS * STIFF)):
        assert abs(found[name]["value"] - true) < 4 * found[name]["std"] < 0.2 * true


@few_or_all("hysteretic_joint", "maxwell_joint", "fractional_joint")
@pytest.mark.parametrize(
    ("law", "seed", "true", "close"),
    [("maxwell_joint", 4, {"relaxing_stiffness": STIFF, "relaxation_time": TIME}, 0.3),
     pytest.param("fractional_joint", 6, {"coefficient": COEFFICIENT, "order": ORDER}, 0.4, marks=pytest.mark.slow)],
)  # fmt: skip
def test_a_strong_joint_of_one_law_is_named_and_predicts_what_it_was_not_fitted_to(law, seed, true, close, wanted):
    said = diagnose_modes(joined(law, seed), simulation(), wanted=wanted).to_dict()
    (cause,) = said["causes"]
    assert said["verdict"] == "named" and (cause["name"], cause["where"]) == (law, ["3:+Z"])
    for name, value in true.items():
        told = cause["parameters"][name]
        assert abs(told["value"] - value) < 4 * told["std"] < close * value
    assert said["gain"]["chi2_after"] < 1.5


@pytest.mark.parametrize(("coefficient", "order", "top"), [
    pytest.param(40.0, 0.7, 70.0, marks=pytest.mark.slow), (100.0, 0.5, 70.0),
    pytest.param(10.0, 0.7, 200.0, marks=pytest.mark.slow),
])  # fmt: skip
def test_a_weak_joint_between_a_spring_and_a_damper_is_named_as_neither(coefficient, order, top):
    """In an exact chain; a spring or a damper beside dampings that are off in general leaves no more than noise."""
    freq = FREQ[FREQ < top]
    Z = np.zeros((len(freq), 5, 5), complex)
    Z[:, 2, 2] = coefficient * (2j * np.pi * freq) ** order
    H = response(*matrices(MASSES, SPRINGS, ZETA), freq, Z)
    said = diagnose_modes(as_measured(H, freq, 8), simulation()).to_dict()
    (cause,) = said["causes"]
    assert said["verdict"] == "named" and (cause["name"], cause["where"]) == ("fractional_joint", ["3:+Z"])
    told = cause["parameters"]["order"]
    assert abs(told["value"] - order) < 4 * told["std"] < 0.5


def test_losses_are_added_where_none_is_looked_for():
    data = as_measured(response(*chain_off(5, 0.02), FREQ[::3]), FREQ[::3], 5)
    task = posed(data, simulation(), identified(data, simulation(), lambda _: None))
    springs = {c.where: c for c in task.candidates if c.slug == "joint_stiffness" and c.direction is not None}
    found = losses_at(springs["3:+Z",], task.candidates, task.coordinates)
    assert [f.slug for f in found] == ["hysteretic_joint", "maxwell_joint", "fractional_joint"]
    assert all(f.where == ("3:+Z",) and np.array_equal(f.basis[:, 0], springs["3:+Z",].direction) for f in found)
    assert losses_at(springs["3:+Z",], [*task.candidates, *found], task.coordinates) == found
    known = [f for f in task.candidates if f.slug in {f.slug for f in found}]
    assert all(f in known for f in losses_at(springs[known[0].where], task.candidates, task.coordinates))


def test_a_cause_that_may_be_none_on_the_lines_is_left_out_and_one_that_is_needed_stays():
    M, C, K = chain_off(5, 0.02)
    M[2, 2] += 0.2
    data = as_measured(response(M, C, K, FREQ[::3]), FREQ[::3], 5)
    measured = identified(data, simulation(), lambda _: None)
    task = posed(data, simulation(), measured)
    mass = next(c for c in task.candidates if (c.slug, c.where) == ("added_mass", ("3:+Z",)))
    skew = next(c for c in task.candidates if c.slug == "gyroscopic")
    both = Explanation(fit(task.setting, (mass, skew), None, np.array([0.5, 0.0])), 0.0, 1.0)
    kept = without_spare(task.setting, both, [skew], measured)
    assert kept.causes == (mass,) and abs(kept.fit.u[0] * mass.scale / 0.2 - 1) < 0.2
    assert without_spare(task.setting, both, [mass], measured) is both
    assert without_spare(task.setting, both, [], measured) is both
