"""Causes a hundred times their usual sizes, in structures whose every element is off: a point held, a heavy lump."""

import numpy as np
import pytest
from chains_off import DOFS, FREQ, as_measured, chain_off, response, simulation
from kinds import FEW_OR_ALL

from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.fitting.fit import FARTHEST, _ways, fit
from modalax.diagnose.modal_domain.search.matched import CLOSE, FAR, missed_by_elements
from modalax.diagnose.modal_domain.stage import identified, posed


def held(kind: str, where: tuple[int, ...], size: float, seed: int = 5):
    """FRFs of a chain 1 % off with a spring or a mass more."""
    matrices = dict(zip("MCK", chain_off(seed, 0.01), strict=True))
    v = np.eye(5)[where[0]] - (np.eye(5)[where[1]] if len(where) > 1 else 0.0)
    matrices[kind] = matrices[kind] + size * np.outer(v, v)
    return as_measured(response(*(matrices[name] for name in "MCK"), FREQ), FREQ, seed)


STRONG = [
    pytest.param("K", (2,), 1e7, marks=pytest.mark.slow), ("K", (0, 3), 1e7),
    pytest.param("K", (3,), 1e6, marks=pytest.mark.slow), ("M", (3,), 40.0),
]  # fmt: skip


@FEW_OR_ALL
@pytest.mark.parametrize(("kind", "where", "size"), STRONG)
def test_what_holds_points_or_outweighs_the_structure_is_named_with_its_size(kind, where, size, wanted):
    found = diagnose_modes(held(kind, where, size), simulation(), wanted=wanted)
    assert found.verdict == "named", found.reasons
    slug = {"K": "joint_stiffness", "M": "added_mass"}[kind]
    assert [(c["name"], sorted(c["where"])) for c in found.causes] == [(slug, sorted(DOFS[k] for k in where))]
    (told,) = found.causes[0]["parameters"].values()
    assert abs(told["value"] - size) < 4 * told["std"] < 0.8 * size


@pytest.mark.parametrize("times", [0.1, 1.0, 15.0])
def test_a_fit_of_a_stiff_link_ends_at_its_size_from_far_off(times):
    """From 15 times the size the step of the linear problem leads to a spring of the other sign."""
    data = held("K", (0, 3), 1e7)
    task = posed(data, simulation(), identified(data, simulation(), lambda _: None))
    where = {DOFS[0], DOFS[3]}
    link = next(c for c in task.candidates if c.slug == "joint_stiffness" and set(c.where) == where)
    found = fit(task.setting, (link,), None, np.array([times * 1e7 / link.scale]))
    assert found.chi2 < 2 * task.setting.features.values.size
    assert abs(found.u[0] * link.scale / 1e7 - 1) < 0.2


def test_a_long_step_is_tried_straight_and_by_a_factor():
    old, step = np.array([0.1, 100.0, 0.2]), np.array([0.05, -5000.0, 0.1])
    straight, bent = _ways(old, step, 1)
    np.testing.assert_allclose(straight, [0.15, -4900.0, 0.3])
    assert bent[0] == straight[0]
    assert bent[1] == pytest.approx(100 * np.exp(-FARTHEST), rel=1e-3)
    assert bent[2] == pytest.approx(0.3, rel=0.02)  # small sizes move as they would
    assert len(_ways(old, 0.01 * step, 1)) == 1


def test_misses_of_frequencies_by_a_lump_are_those_of_its_modes():
    data = held("M", (3,), 40.0)
    setting = posed(data, simulation(), identified(data, simulation(), lambda _: None)).setting
    c = setting.coordinates
    lump = Change("added_mass", (DOFS[3],), pattern=np.outer(c.shapes[3], c.shapes[3]), reference=1.0)
    (missed,), (size,) = missed_by_elements(setting.features, setting.coordinates, [lump])
    assert 0.85 * 40.0 < size < 1.15 * 40.0
    S = simulation()
    M = np.array(S.M)
    M[3, 3] += size
    w2 = np.sort(np.linalg.eigvals(np.linalg.solve(M, np.asarray(S.K))).real)
    apart = np.abs(w2 / np.abs(setting.features.poles)[:, None] ** 2 - 1).min(axis=1) / CLOSE
    assert missed == pytest.approx((np.minimum(apart, FAR) ** 2).sum(), rel=1e-6)
