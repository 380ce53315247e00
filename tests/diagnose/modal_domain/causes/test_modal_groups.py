"""Parameters of groups of elements as causes: a beam of four parts, every element off, one part's modulus wrong."""

import numpy as np
import pytest
import scipy.linalg
from frames import DAMPING, DOFS, ELEMENTS, FLIP, beam, cantilever, modal_damping, simulation
from kinds import FEW_OR_ALL

from modalax.data import Measurement
from modalax.diagnose import catalogue, diagnose
from modalax.diagnose.causes.local import JointStiffness
from modalax.diagnose.modal_domain.causes.groups import group_factors
from modalax.diagnose.modal_domain.causes.places import candidates_of
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.fitting.inaccuracy import inaccuracy_of
from modalax.diagnose.modal_domain.fitting.state import Setting, matrices_of
from modalax.diagnose.modal_domain.modes.features import Features
from modalax.diagnose.modal_domain.search.screen import _changed
from modalax.diagnose.modal_domain.structure.coordinates import coordinates_of
from modalax.diagnose.routes import check_groups
from modalax.model import Structure
from modalax.model.groups import Groups

PARTS = {"root": (0, 1), "inner": (2, 3), "outer": (4, 5), "tip": (6, 7), "whole": tuple(range(ELEMENTS))}


def shares(names) -> Groups:
    """Stiffness and mass of parts of the beam, put together element by element."""
    K, M = np.zeros((len(names), 18, 18)), np.zeros((len(names), 18, 18))
    k, m = beam()
    for g, name in enumerate(names):
        for e in PARTS[name]:
            at = np.ix_(range(2 * e, 2 * e + 4), range(2 * e, 2 * e + 4))
            K[g][at] += k
            M[g][at] += m
    turned = [FLIP[:, None] * A[:, 2:, 2:] * FLIP for A in (K, M)]
    return Groups(names, *turned)


def built(seed, part="root", stiffness=1.0, mass=1.0, spring=0.0, off=0.01):
    """FRFs of the beam as built: every element off, one part by a factor, a spring that nobody knows."""
    rng = np.random.default_rng(seed)
    k, m = 1 + off * rng.standard_normal(ELEMENTS), 1 + off / 3 * rng.standard_normal(ELEMENTS)
    k[list(PARTS[part])] *= stiffness
    m[list(PARTS[part])] *= mass
    K, M = cantilever(k, m)
    C = modal_damping(M, K, DAMPING * np.exp(0.1 * rng.standard_normal(len(K))))
    K, M, C = (FLIP[:, None] * A * FLIP for A in (K, M, C))
    K[4, 4] += spring
    freq = np.linspace(4.0, 230.0, 140)
    s = 2j * np.pi * freq[:, None, None]
    H = s**2 * np.linalg.inv(K + s * C + s**2 * M)[:, ::2][:, :, [4, 14]]
    sigma = 0.01 * np.sqrt((np.abs(H) ** 2).mean(axis=0)) * np.ones(H.shape)
    noise = rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)
    return Measurement(
        freq, (H + sigma * noise / np.sqrt(2))[None], form="accelerance", outputs=DOFS[::2],
        inputs=(DOFS[4], DOFS[14]), variance=sigma[None] ** 2,
    )  # fmt: skip


def told() -> Structure:
    """The beam as its author has it, with its parts named."""
    return simulation().replace(groups=shares(["root", "inner", "outer", "tip"]))


@pytest.mark.parametrize(("slug", "kind", "which"), [("element_group", "K", 2), ("element_group_mass", "M", 1)])
def test_a_factor_changes_the_share_of_the_group(slug, kind, which):
    S, highest, names = told(), 2 * np.pi * 330.0, ["root", "inner", "outer", "tip"]
    c = coordinates_of(S, DOFS[::2], DOFS[4:5], highest)
    cause = next(x for x in group_factors(S, c) if (x.slug, x.where) == (slug, (names[which],)))
    u = np.array([0.5])
    factor = cause.told(u, np.full((1, 1), 0.04))[f"{'stiffness' if kind == 'K' else 'mass'}_factor"]
    assert factor == {"value": 1 + 0.5 * cause.scale, "std": pytest.approx(0.2 * cause.scale), "unit": "-"}
    by_element = np.where(np.isin(np.arange(ELEMENTS), PARTS[names[which]]), factor["value"], 1.0)
    K, M = cantilever(by_element if kind == "K" else None, by_element if kind == "M" else None)
    none = np.zeros((0, 8, 1))
    empty = Features(np.zeros(0), none, none, none[:, None], np.zeros((0, 5)), np.zeros((0, 0)))
    setting = Setting(c, inaccuracy_of(S, c, highest), empty, np.zeros((0, 0)))
    m, _, k = matrices_of(setting, np.zeros(len(setting.inaccuracy.group_of)), (cause,), u)
    found, expected = (scipy.linalg.eigh(*pair, eigvals_only=True) for pair in ((k, m), (K, M)))
    np.testing.assert_allclose(found[:16], expected, rtol=1e-8)  # the last coordinate is spare
    # and so are the poles by which finite changes are screened
    ((size, poles, _),) = _changed(setting, cause, u)
    assert size == 0.5
    np.testing.assert_allclose(np.abs(poles[:8]), np.sqrt(expected[:8]), rtol=1e-8)


@FEW_OR_ALL
@pytest.mark.parametrize(
    ("seed", "part", "factors", "slug"),
    [
        pytest.param(1, "inner", {"stiffness": 1.15}, "element_group", marks=pytest.mark.slow),
        (3, "outer", {"mass": 0.85}, "element_group_mass"),
    ],
)
def test_a_wrong_parameter_is_named_where_every_element_is_off(seed, part, factors, slug, wanted):
    answer = diagnose_modes(built(seed, part, **factors), told(), wanted=wanted).to_dict()
    ((name, value),) = factors.items()
    (cause,) = answer["causes"]
    assert (answer["verdict"], cause["name"], cause["where"]) == ("named", slug, [part])
    found = cause["parameters"][f"{name}_factor"]
    assert abs(found["value"] - value) < 3 * found["std"] < 0.04
    assert answer["gain"]["chi2_after"] < 1.1 < 100 < answer["gain"]["chi2_before"]


@FEW_OR_ALL
def test_a_parameter_of_the_whole_structure_is_named(wanted):
    simulated = simulation().replace(groups=shares(["whole"]))
    (cause,) = diagnose_modes(built(9, "whole", stiffness=1.1), simulated, wanted=wanted).causes
    assert (cause["name"], cause["where"]) == ("element_group", ["whole"])
    assert abs(cause["parameters"]["stiffness_factor"]["value"] - 1.1) < 0.01


def test_an_element_that_is_a_group_by_itself_is_told_by_its_name():
    """Else either name would be as likely as the other, and neither sure."""
    highest, alone = 2 * np.pi * 330.0, simulation()
    support = np.zeros((1, 16, 16))
    support[0, :2, :2] = np.asarray(alone.K)[:2, :2] - FLIP[:2, None] * np.asarray(beam()[0])[:2, :2] * FLIP[:2]
    S = alone.replace(groups=Groups(["clamp"], support))
    c = coordinates_of(S, DOFS[::2], DOFS[4:5], highest)
    before, after = (candidates_of(x, c, DOFS[::2], DOFS[4:5], None, highest) for x in (alone, S))
    (group,) = [x for x in after if x.slug == "element_group"]
    gone = [x for x in before if x not in after]
    assert len(after) == len(before) and [(x.slug, x.where) for x in gone] == [("joint_stiffness", ("1:+Z",))]
    np.testing.assert_allclose(gone[0].pattern, group.pattern, rtol=1e-6, atol=1e-6 * np.abs(group.pattern).max())
    assert 0 < group.rarity <= 0.2 < 1 == gone[0].rarity


@FEW_OR_ALL
def test_a_spring_that_is_missing_is_no_group(wanted):
    (cause,) = diagnose_modes(built(4, spring=8e3), told(), wanted=wanted).causes
    assert (cause["name"], cause["where"]) == ("joint_stiffness", ["3:+Z"])
    assert abs(cause["parameters"]["stiffness"]["value"] - 8e3) < 400


def test_groups_are_asked_about_in_the_modal_domain_and_the_extended_simulation_has_the_factor():
    asked = [c for c in catalogue() if c.slug == "element_group"]
    data = built(1, "inner", stiffness=1.15, off=0.0)  # a simulation that is exact but for this
    found = diagnose(data, told(), causes=asked)
    assert found.verdict == "named" and found.causes[0]["where"] == ["inner"]
    expected = cantilever(np.where(np.isin(np.arange(ELEMENTS), PARTS["inner"]), 1.15, 1.0))[0]
    got = FLIP[:, None] * np.asarray(found.extended.base.K) * FLIP
    assert np.abs(got - expected).max() < 0.003 * np.abs(expected).max()
    with pytest.raises(ValueError, match="element_group needs a simulation with groups"):
        diagnose(data, simulation(), causes=asked)


def test_the_whole_catalogue_may_be_asked_about_with_a_cause_of_ones_own_where_no_groups_are_named():
    own = type("Own", (JointStiffness,), {"slug": "own"})()
    check_groups(simulation(), [*catalogue(), own])
    with pytest.raises(ValueError, match="element_group needs a simulation with groups"):
        check_groups(simulation(), [c for c in [*catalogue(), own] if c.slug != "gap"])
