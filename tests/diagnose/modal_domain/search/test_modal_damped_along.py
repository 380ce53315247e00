"""Damping that changes with stiffness or mass, as an element's own does: no cause by itself, whatever it follows."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg
from chains_off import DOFS, FREQ, MASSES, SPRINGS, as_measured, response
from kinds import few_or_all

from modalax.data import Measurement
from modalax.diagnose import pipeline
from modalax.diagnose.causes import catalogue
from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.fitting.attempts import attempt
from modalax.diagnose.modal_domain.fitting.inaccuracy import inaccuracy_of
from modalax.diagnose.modal_domain.fitting.state import Setting, changes_of
from modalax.diagnose.modal_domain.modes.features import Features
from modalax.diagnose.modal_domain.search.damped_along import with_loss
from modalax.diagnose.modal_domain.search.steps import Search, other_forms
from modalax.diagnose.modal_domain.stage import identified, posed
from modalax.diagnose.modal_domain.structure.coordinates import coordinates_of
from modalax.diagnose.pipeline import diagnose
from modalax.diagnose.routes import may_tell_joints
from modalax.diagnose.search import law_force
from modalax.diagnose.search.measured_force import differs_by_run
from modalax.model import Structure

RATIO = 0.012
NO_FEATURES = Features(
    np.zeros(0), *[np.zeros((0, 5, 1))] * 2, np.zeros((0, 1, 5, 1)), np.zeros((0, 5)), np.zeros((0, 0))
)


def matrices(masses: np.ndarray, springs: np.ndarray, kind: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mass, damping that follows stiffness, mass or the modes, and stiffness."""
    B = np.eye(6, 5) - np.eye(6, 5, -1)
    M, K = np.diag(masses), B.T @ np.diag(springs) @ B
    w2, P = scipy.linalg.eigh(K, M)
    C = {
        "ratios": M @ P @ np.diag(2 * RATIO * np.sqrt(w2)) @ P.T @ M,
        "stiffness": 6e-5 * K,
        "both": 1.5 * M + 4e-5 * K,
    }[kind]
    return M, C, K


def off(size: float, seed: int = 5) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return MASSES * (1 + size / 3 * rng.standard_normal(5)), SPRINGS * (1 + size * rng.standard_normal(6))


@few_or_all("hysteretic_joint")
@pytest.mark.parametrize(
    ("cause", "kind", "size"),
    [
        # each cause, each kind of damping and each size by default, as none asks for the others
        pytest.param(cause, kind, size, marks=() if (k, i) == (j % 2, min(j, 1)) else pytest.mark.slow)
        for k, cause in enumerate(("joint_stiffness", "added_mass"))
        for j, kind in enumerate(("ratios", "stiffness", "both"))
        for i, size in enumerate((0.0, 0.01))
    ],
)
def test_what_is_wrong_of_stiffness_or_mass_is_one_cause_whatever_its_damping_does(cause, kind, size, wanted):
    """With damping held, a damper or a lossy joint had been named beside it, of a size that its damping has."""
    masses, springs = off(size)
    if cause == "added_mass":
        masses[2] += 0.2
        where, parameter, truth, scale = [DOFS[2]], "mass", 0.2, MASSES[2]
    else:
        springs[3] *= 0.7
        where, parameter, truth, scale = [DOFS[2], DOFS[3]], "stiffness", -0.3 * SPRINGS[3], SPRINGS[3]
    H = response(*matrices(masses, springs, kind), FREQ)
    author = Structure(*matrices(MASSES, SPRINGS, kind), DOFS)
    found = diagnose_modes(as_measured(H, FREQ, 5), author, wanted=wanted)
    assert found is not None and found.verdict == "named", found.reasons
    assert [(c["name"], c["where"]) for c in found.causes] == [(cause, where)]
    told = found.causes[0]["parameters"][parameter]
    assert abs(told["value"] - truth) < 4 * told["std"] + 3 * size * scale
    if size == 0:  # all DoFs but the middle one are measured, and the extension damps as the structure does
        true, nominal = (matrices(*x, kind)[1] for x in ((masses, springs), (MASSES, SPRINGS)))
        missed = np.asarray(found.extended.base.C) - true
        assert np.linalg.norm(missed) < 0.2 * np.linalg.norm(true - nominal) + 1e-3 * np.linalg.norm(nominal)


def test_a_softer_joint_of_a_simulation_that_is_exact_else_is_named_by_all_of_diagnose():
    """By lines its damping is something more; that search took a minute, and ended without a sure name."""
    springs = np.where(np.arange(6) == 3, 0.7, 1.0) * SPRINGS
    H = response(*matrices(MASSES, springs, "ratios"), FREQ)
    found = diagnose(as_measured(H, FREQ, 5), Structure(*matrices(MASSES, SPRINGS, "ratios"), DOFS))
    assert found.verdict == "named" and [c["name"] for c in found.causes] == ["joint_stiffness"], found.reasons
    assert any("damping changes with it" in reason for reason in found.reasons)


def test_force_levels_that_agree_tell_of_no_joint(monkeypatch):
    """A spring whose sides differ had been told of three levels, after two minutes; slip is not asked about at all."""
    laws, asked = {"joint_stiffness", "local_damper", "added_mass", "bilinear_stiffness", "elasto_slip"}, []
    monkeypatch.setattr(pipeline, "catalogue", lambda *a: [c for c in catalogue(*a) if c.slug in laws])
    monkeypatch.setattr(pipeline, "imitators", list)
    follow = pipeline.explain_force
    monkeypatch.setattr(pipeline, "explain_force", lambda s, c: asked.append({k.slug for k in c}) or follow(s, c))
    balance, unlike = law_force.balanced, []
    monkeypatch.setattr(law_force, "balanced", lambda law, p, *a: unlike.append(p[1]) or balance(law, p, *a))
    springs, freq = np.where(np.arange(6) == 3, 0.7, 1.0) * SPRINGS, FREQ[::8]
    H = response(*matrices(MASSES, springs, "ratios"), freq)
    runs = [as_measured(H, freq, seed) for seed in (6, 7, 8)]
    levels = Measurement(
        freq, np.concatenate([m.H for m in runs]), form="accelerance", outputs=runs[0].outputs, inputs=runs[0].inputs,
        variance=np.concatenate([m.variance for m in runs]), level=[1.0, 3.0, 9.0],
    )  # fmt: skip
    assert not may_tell_joints(levels)
    assert may_tell_joints(levels.replace(H=levels.H * np.array([1.0, 1.0, 1.1])[:, None, None, None]))
    found = diagnose(levels, Structure(*matrices(MASSES, SPRINGS, "ratios"), DOFS))
    assert found.verdict == "named" and [c["name"] for c in found.causes] == ["joint_stiffness"], found.reasons
    assert asked == [laws - {"bilinear_stiffness", "elasto_slip"}, laws - {"elasto_slip"}]
    assert 0 in unlike and max(unlike) <= 1  # sides alike tell nothing of how unlike they are: no leap to the bound


@pytest.mark.parametrize("size", [-0.6, 1e-3, 3.0, 100.0])
@pytest.mark.parametrize("unlike", [np.ones(5), np.array([1.0, 2.5, 0.4, 1.7, 0.8])], ids=["one ratio", "five"])
@pytest.mark.parametrize("kind", ["K", "M"])
def test_damping_that_keeps_the_ratios_is_that_of_the_changed_structure(kind, size, unlike):
    """Against the damping matrix of the changed structure, whose modes keep their ratios, and its differences."""
    ratios = RATIO * unlike
    M, _, K = matrices(MASSES, SPRINGS, "ratios")
    w2, P = scipy.linalg.eigh(K, M)
    C = M @ P @ np.diag(2 * ratios * np.sqrt(w2)) @ P.T @ M
    c = coordinates_of(Structure(M, C, K, DOFS), DOFS, DOFS[:1], 2 * np.pi * FREQ[-1])
    b = np.eye(5)[2] - (np.eye(5)[3] if kind == "K" else 0.0)
    slug, where = ("joint_stiffness", (DOFS[2], DOFS[3])) if kind == "K" else ("added_mass", (DOFS[2],))
    scale = SPRINGS[3] if kind == "K" else MASSES[2]
    along = with_loss(Change(slug, where, scale, c.shapes.T @ b), c, np.arange(5))[1]

    def changed(x: float) -> np.ndarray:
        both = {"K": K, "M": M, kind: (K if kind == "K" else M) + x * scale * np.outer(b, b)}
        w2, P = scipy.linalg.eigh(both["K"], both["M"])
        return c.shapes.T @ (both["M"] @ P @ np.diag(2 * ratios * np.sqrt(w2)) @ P.T @ both["M"]) @ c.shapes

    true = changed(size) - changed(0.0)
    told = along.changes(np.array([size, 1.0]))["C"]
    np.testing.assert_allclose(told, true, atol=1e-9 * np.abs(changed(0.0)).max(), rtol=1e-6)
    step = 1e-6 * max(1.0, abs(size))
    slope = (changed(size + step) - changed(size - step)) / (2 * step)
    found = along.slopes(np.array([size, 0.7]))
    np.testing.assert_allclose(found[0]["C"], 0.7 * slope, atol=1e-5 * np.abs(slope).max(), rtol=1e-4)
    np.testing.assert_allclose(found[1]["C"], told)


@pytest.mark.parametrize("kind", ["K", "M"])
def test_beside_it_dampings_are_off_mode_by_mode_of_the_changed_structure(kind):
    """Of modes that a strong change has mixed; each keeps its ratio, by the order of frequencies."""
    M, C, K = matrices(MASSES, SPRINGS, "ratios")
    simulation = Structure(M, C, K, DOFS)
    highest = 2 * np.pi * 1.2 * FREQ[-1]
    c = coordinates_of(simulation, DOFS, DOFS[:1], highest)
    setting = Setting(c, inaccuracy_of(simulation, c, highest), NO_FEATURES, np.zeros((0, 0)))
    b, size = np.eye(5)[1], 8.0 * (SPRINGS[1] if kind == "K" else MASSES[1])
    slug = "joint_stiffness" if kind == "K" else "added_mass"
    along = with_loss(Change(slug, (DOFS[1],), size, c.shapes.T @ b), c, np.arange(5))[1]
    z = np.array([0.3, -0.2, 0.1, 0.25, -0.4])
    own = np.flatnonzero(setting.inaccuracy.group_of == setting.inaccuracy.groups.index("damping"))[:5]
    sizes = np.zeros(len(setting.inaccuracy.group_of))
    sizes[own] = z
    u = np.ones(2)
    told = c.damping + changes_of(setting, sizes, (along,), u)["dC"]
    both = {"K": K, "M": M, kind: (K if kind == "K" else M) + size * np.outer(b, b)}
    w2, P = scipy.linalg.eigh(both["K"], both["M"])
    true = both["M"] @ P @ np.diag(2 * RATIO * np.exp(z) * np.sqrt(w2)) @ P.T @ both["M"]
    np.testing.assert_allclose(told[:5, :5], (c.shapes.T @ true @ c.shapes)[:5, :5], atol=1e-9 * np.abs(true).max())


@pytest.mark.parametrize(("share", "expected"), [(0.0, False), (0.05, True)])
def test_a_force_at_a_place_tells_levels_apart_that_noise_hides(share, expected):
    """Of 200 lines each by itself differs by a part of its noise."""
    rng = np.random.default_rng(1)
    force = np.ones((3, 200, 1)) * (1 + share * np.arange(3))[:, None, None]
    noise = (rng.standard_normal(force.shape) + 1j * rng.standard_normal(force.shape)) * 0.05
    measured = SimpleNamespace(unit=force + noise, information=np.full(force.shape, 1 / 0.05**2))
    assert differs_by_run(measured) is expected


def test_a_spring_is_fitted_with_damping_along_where_a_joint_that_relaxes_leads():
    """The joint stood for what the damping of a spring does, and was likelier than the spring with none by 32 nats."""
    M, C, K = matrices(*off(0.01), "ratios")
    K = K + 0.6 * SPRINGS[3] * np.diag(np.eye(5)[0])
    w2, P = scipy.linalg.eigh(K, M)
    H = response(M, M @ P @ np.diag(2 * RATIO * np.sqrt(w2)) @ P.T @ M, K, FREQ)
    data, simulation = as_measured(H, FREQ, 5), Structure(*matrices(MASSES, SPRINGS, "ratios"), DOFS)
    task = posed(data, simulation, identified(data, simulation, lambda _: None))
    joint, spring = (
        next(c for c in task.candidates if (c.slug, c.where) == (slug, (DOFS[0],)))
        for slug in ("maxwell_joint", "joint_stiffness")
    )
    found = {}
    attempt(task.setting, found, (joint,), np.array([0.6 * SPRINGS[3] / joint.scale, 3.0]), None)
    other_forms(Search(task.setting, found, task.setting, task.candidates))
    best = max((f for f in found.values()), key=lambda f: f.log_evidence)
    assert (joint,) in found and (spring,) in found
    assert best.causes[0].slug == "joint_stiffness" and best.causes[0].along == "at equal damping ratios"
    assert best.log_evidence > found[(spring,)].log_evidence + 5
