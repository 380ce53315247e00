"""What a diagnosis takes: modal models, missing variances, single levels and references, extended simulations again."""

import os

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import modalax
from modalax import Measurement, ModalModel
from modalax._numerics import programs
from modalax.diagnose import ExtendedSimulation, JointCause, Parameter, diagnose
from modalax.diagnose.causes import catalogue
from modalax.diagnose.causes.channels import ChannelGain
from modalax.diagnose.causes.drift import DriftingSpring
from modalax.diagnose.causes.joints import CubicStiffness, ElastoSlip, GapContact, QuadraticDamping
from modalax.diagnose.causes.local import AddedMass, JointStiffness
from modalax.diagnose.causes.power_laws import MicroSlip
from modalax.diagnose.causes.scene import Place
from modalax.diagnose.comparison import as_measurement, make_comparison
from modalax.diagnose.extend import extend
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.prediction.frf import predict
from modalax.diagnose.screening.score_state import score_state_of
from modalax.diagnose.search.singles import joints_for_drifts
from modalax.model import Structure
from modalax.model.examples import five_dof

FREQ = np.linspace(20.0, 70.0, 128)
FEW = [JointStiffness(), ChannelGain()]


def with_spring(k):
    S = five_dof()
    b = np.eye(5)[2] - np.eye(5)[4]
    return Structure(S.M, S.C, np.asarray(S.K) + k * np.outer(b, b), S.dofs)


def noisy(H, seed, noise=0.02, given=True, **more):
    H = np.asarray(H)
    rng = np.random.default_rng(seed)
    sigma = noise * np.sqrt((np.abs(H) ** 2).mean(axis=1, keepdims=True)) * np.ones(H.shape)
    H = H + sigma * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)) / np.sqrt(2)
    return Measurement(FREQ, H, variance=sigma**2 if given else None, form="mobility", **more)


def linear(structure, seed, inputs=("1", "4"), runs=1, **more):
    H = np.asarray(structure.frf(FREQ, inputs=inputs, form="mobility").H)
    return noisy(np.repeat(H[None], runs, axis=0), seed, outputs=structure.dofs, inputs=inputs, **more)


def named(answer):
    return [(c["name"], sorted(map(str, c["where"]))) for c in answer["causes"]]


@pytest.mark.slow
def test_a_modal_model_is_a_simulation_in_python_and_from_a_file(tmp_path):
    modal = five_dof().modal()
    assert isinstance(modal, ModalModel)
    data = linear(with_spring(2500.0), 1)
    modalax.save(modal, tmp_path / "modes.npz")
    modalax.save(data, tmp_path / "data.npz")
    here = diagnose(data, modal, causes=FEW).to_dict()
    there = diagnose(modalax.load(tmp_path / "data.npz"), modalax.load(tmp_path / "modes.npz"), causes=FEW).to_dict()
    assert here["verdict"] == "named" and here["question"] == "fixed"
    assert named(here) == named(there) == [("joint_stiffness", ["3", "5"])]
    told = here["causes"][0]["parameters"]["stiffness"]
    assert abs(told["value"] - 2500.0) < 4 * told["std"]


def test_missing_variances_are_estimated_from_the_data_and_said_so():
    found = diagnose(linear(with_spring(4000.0), 2, given=False), five_dof(), causes=FEW)
    assert any("no variances given; estimated from the scatter" in note for note in found.notes)
    assert named(found.to_dict()) == [("joint_stiffness", ["3", "5"])]
    several = diagnose(linear(with_spring(4000.0), 2, given=False, runs=3, level=[1.0] * 3), five_dof(), causes=FEW)
    assert any("no variances given; estimated from the repeated runs" in note for note in several.notes)
    assert named(several.to_dict()) == [("joint_stiffness", ["3", "5"])]


@pytest.mark.slow
@pytest.mark.parametrize("inputs", [("1",), ("1", "3", "4")])
def test_one_reference_and_several(inputs):
    found = diagnose(linear(with_spring(4000.0), 3, inputs=inputs), five_dof(), causes=FEW)
    assert ("joint_stiffness", ["3", "5"]) in named(found.to_dict())


@pytest.mark.parametrize("level", [[2.0], [np.nan]])
def test_one_level_and_an_unknown_one(level):
    found = diagnose(linear(with_spring(4000.0), 4, level=level), five_dof(), causes=[JointStiffness(), AddedMass()])
    assert named(found.to_dict()) == [("joint_stiffness", ["3", "5"])]
    assert any("force levels unknown" in note for note in found.notes) == bool(np.isnan(level[0]))


def extended_by(causes, indices, params):
    """An extended simulation put together by hand."""
    S = five_dof()
    comparison = make_comparison(linear(S, 0), S)
    from modalax.diagnose.causes.scene import Place

    places = tuple(Place(tuple(S.dofs[k] for k in i[:2] if k >= 0), i) for i in indices)
    n = comparison.problem.modal_form.stiffness.shape[0]
    h = Hypothesis(causes, places, (None,) * len(causes), tuple(np.asarray(p, float) for p in params), np.zeros((2, n)))
    return extend(comparison, h)


def test_an_extended_simulation_is_saved_loaded_and_refused_where_it_cannot_go(tmp_path):
    extended = extended_by((JointStiffness(), CubicStiffness()), ((2, 4, 0), (1, -1, 0)), ([2500.0], [1e8]))
    modalax.save(extended, tmp_path / "extended.npz")
    back = modalax.load(tmp_path / "extended.npz")
    assert isinstance(back, ExtendedSimulation) and back.slugs == ("joint_stiffness", "cubic_stiffness")
    first, second = (np.asarray(e.predict(3.0, FREQ, form="mobility").H) for e in (extended, back))
    np.testing.assert_array_equal(first, second)
    with pytest.raises(ValueError, match="goes to .npz only"):
        modalax.save(extended, tmp_path / "extended.mat")
    with pytest.raises(ValueError, match="exists already"):
        extended.save(tmp_path / "extended.npz")
    with pytest.raises(ValueError, match="option causes"):
        modalax.save(five_dof(), tmp_path / "plain.npz")
        modalax.load(tmp_path / "plain.npz", causes=[])


class Hardening(JointCause):
    """A law of one's own."""

    slug = "hardening"
    parameters = (Parameter("rate", "N/m^2"),)

    def impedance(self, A, omega, p):
        return p[0] * A + 0j


def test_a_law_of_ones_own_is_loaded_when_told(tmp_path):
    extended = extended_by((Hardening(),), ((2, 4, 0),), ([1e6],))
    modalax.save(extended, tmp_path / "own.npz")
    with pytest.raises(ValueError, match="Hardening"):
        modalax.load(tmp_path / "own.npz")
    back = modalax.load(tmp_path / "own.npz", causes=[Hardening()])
    np.testing.assert_array_equal(np.asarray(back.frf(FREQ).H), np.asarray(extended.frf(FREQ).H))


@pytest.mark.slow
def test_an_extended_simulation_is_diagnosed_again(tmp_path):
    """What it has is not found again, what it lacks is, and the next extension holds both."""
    data = linear(with_spring(2500.0), 5)
    turn = np.ones((1, 1, 5, 1))
    turn[0, 0, 3] = 1.2
    first = diagnose(data, five_dof(), causes=FEW).extended
    assert first is not None
    modalax.save(first, tmp_path / "extended.npz")
    again = modalax.load(tmp_path / "extended.npz")
    assert diagnose(data, again, causes=FEW).verdict == "clean"
    second = diagnose(data.replace(H=np.asarray(data.H) * turn), again, causes=FEW)
    assert named(second.to_dict()) == [("channel_gain", ["4"])]
    assert second.extended is not None and second.extended.slugs == ("joint_stiffness", "channel_gain")
    predicted = second.extended.predict(1.0, FREQ, form="mobility")
    miss = np.asarray(predicted.H) - second.predicted_after[0]
    assert np.abs(miss).max() < 1e-9 * np.abs(second.predicted_after).max()


@pytest.mark.slow
def test_a_joint_that_is_known_is_kept_at_every_level():
    known = extended_by((CubicStiffness(),), ((2, 4, 0),), ([4e9],))
    levels = [1.0, 2.0, 4.0]
    H = np.stack([np.asarray(known.predict(v, FREQ, form="mobility", inputs=("1", "4")).H) for v in levels])
    data = noisy(H, 6, outputs=known.outputs, inputs=("1", "4"), level=levels)
    causes = [CubicStiffness(), QuadraticDamping(), JointStiffness(), ChannelGain()]
    assert diagnose(data, five_dof(), causes=causes).verdict != "clean"
    assert diagnose(data, known, causes=causes).verdict == "clean"
    turn = np.ones((1, 1, 5, 1))
    turn[0, 0, 1] = 0.85
    found = diagnose(data.replace(H=np.asarray(data.H) * turn), known, causes=causes)
    assert named(found.to_dict()) == [("channel_gain", ["2"])]


def test_joints_at_one_place_share_one_motion():
    """A cubic spring in two halves is the same cubic spring."""
    whole = extended_by((CubicStiffness(),), ((2, 4, 0),), ([4e9],))
    halves = extended_by((CubicStiffness(), CubicStiffness()), ((2, 4, 0), (2, 4, 0)), ([1e9], [3e9]))
    a, b, none = (np.asarray(e.predict(3.0, FREQ).H) for e in (whole, halves, five_dof_extended()))
    assert np.abs(a - b).max() < 1e-9 * np.abs(a - none).max()


def five_dof_extended():
    return extended_by((JointStiffness(),), ((2, 4, 0),), ([0.0],))


@pytest.mark.slow
def test_the_force_of_every_line_counts():
    """A line at another force is the same line of a run held at that force."""
    known = extended_by((MicroSlip(),), ((2, 4, 0),), ([200.0, 1.0],))
    force = np.linspace(1.0, 2.0, len(FREQ))
    got = np.asarray(known.predict(force, FREQ).H)
    for k in (0, 40, 127):
        alone = np.asarray(known.predict(force[k], FREQ).H)[k]
        assert np.abs(got[k] - alone).max() < 1e-12 * np.abs(alone).max()
    data = Measurement(FREQ, got[None], force=force[None], outputs=known.outputs, inputs=known.inputs)
    comparison = make_comparison(data, known)
    n = comparison.problem.modal_form.stiffness.shape[0]
    H = predict((), jnp.zeros((0, 3), int), (), (), jnp.zeros((2, n)), comparison.problem)
    assert np.abs(np.asarray(H)[0, :128, :5, :2] - got).max() < 1e-9 * np.abs(got).max()
    plain = eqx.tree_at(lambda p: p.level, comparison.problem, comparison.problem.level * 0 + 1.5)
    assert (
        np.abs(
            np.asarray(predict((), jnp.zeros((0, 3), int), (), (), jnp.zeros((2, n)), plain))[0, :128, :5, :2] - got
        ).max()
        > 1e-4 * np.abs(got).max()
    )


def test_one_run_has_nothing_that_drifts():
    S = five_dof()
    freq = np.linspace(15.0, 75.0, 100)
    H = np.asarray(S.frf(freq, outputs=("1", "2"), inputs=("1",)).H)
    sigma = 0.02 * np.abs(H).max() * np.ones(H.shape)
    rng = np.random.default_rng(1)
    H = H + sigma * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)) / np.sqrt(2)
    one = Measurement(freq, H[None], outputs=("1", "2"), inputs=("1",), variance=sigma[None] ** 2)
    drifting = [c for c in catalogue() if c.slug == "time_varying"]
    assert len(drifting) >= 2
    assert diagnose(one, S, causes=drifting).verdict == "clean"


def test_a_stiff_joint_that_lets_go_is_told_from_one_that_drifts():
    """Stuck at the lowest level, slipping at the highest: far from any small size, but a drifting spring is near."""
    S, k, levels = with_spring(3e5), 3e5, np.array([1.0, 8.0, 64.0])
    place = Place(("3", "5"), (2, 4, 0))
    comparison = make_comparison(Measurement(FREQ, np.zeros((3, 128, 3, 1)), outputs=("1", "3", "5"), inputs=("1",),
                                   level=levels, variance=np.ones((3, 128, 3, 1))), S)  # fmt: skip
    across = float(comparison.scene.amplitudes(place, (1.0,))[0])
    null = Hypothesis(theta=np.zeros((2, comparison.problem.modal_form.stiffness.shape[0])))
    true = null.with_cause(ElastoSlip(True), place, None, np.array([k, 0.2 * across]))
    H = np.broadcast_to(comparison.prediction(true), (3, 128, 3, 1))
    sigma = 0.02 * np.sqrt((np.abs(H) ** 2).mean(axis=1, keepdims=True)) * np.ones(H.shape)
    rng = np.random.default_rng(6)
    noisy = H + sigma * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)) / np.sqrt(2)
    M = Measurement(FREQ, noisy, outputs=("1", "3", "5"), inputs=("1",), level=levels, variance=sigma**2)
    comparison = make_comparison(M, S)
    null = comparison.fit([null], 1)[0]
    drifted = comparison.fit([null.with_cause(DriftingSpring(), Place((), (2, 4, 0)), None, np.array([-0.5 * k]))], 20)
    found = joints_for_drifts(score_state_of(comparison, null), drifted, [ElastoSlip(True), GapContact()])
    best = min(found, key=lambda h: h.chi2)
    assert isinstance(best.causes[0], ElastoSlip) and best.chi2 < drifted[0].chi2 - 50
    assert best.params[0][0] == pytest.approx(k, rel=0.05)
    assert joints_for_drifts(score_state_of(comparison, null), [true], [ElastoSlip(True)]) == []


def test_compiled_programs_go_before_a_process_is_full(tmp_path, monkeypatch):
    """A process that has used up its memory maps ends without an exception, and batches held gigabytes of programs."""
    gone, collected = [], []
    monkeypatch.setattr(jax, "clear_caches", lambda: gone.append(True))
    monkeypatch.setattr(programs.gc, "collect", lambda: collected.append(True))
    monkeypatch.setattr(programs, "_kept", [0])
    monkeypatch.setattr(programs, "GROWN", 0.1)
    given = maps, limit, used = [tmp_path / name for name in ("maps", "limit", "statm")]
    pages, tenth = "9000000 {} 4000 1 0 1 0\n", os.sysconf("SC_PHYS_PAGES") // 10
    limit.write_text("100\n")
    maps.write_text("a map\n" * 59)
    used.write_text(pages.format(1000))
    assert not programs.release_programs(*given) and not gone
    maps.write_text("a map\n" * 61)
    assert programs.release_programs(*given) and len(gone) == 1
    maps.write_text("a map\n")
    used.write_text(pages.format(tenth + 900))
    assert not programs.release_programs(*given)  # it has grown by less than a tenth of the machine's since
    used.write_text(pages.format(tenth + 1100))
    assert programs.release_programs(*given) and len(gone) == 2
    assert not programs.release_programs(*given)
    assert not programs.release_programs(tmp_path / "no such file", limit, used)
    assert len(collected) == len(gone)


def test_the_line_at_0_hz_is_left_out():
    freq, rng = np.linspace(0.0, 70.0, 36), np.random.default_rng(0)
    H = rng.standard_normal((2, 36, 3, 1)) + 1j * rng.standard_normal((2, 36, 3, 1))
    data = Measurement(freq, H, variance=np.abs(H) ** 2, outputs=["1", "2", "3"], inputs=["1"], level=[1.0, 2.0])
    left = as_measurement(data)
    np.testing.assert_array_equal(left.freq, freq[1:])
    np.testing.assert_array_equal(left.H, H[:, 1:])
    np.testing.assert_array_equal(left.variance, np.abs(H[:, 1:]) ** 2)
    assert as_measurement(left) is left
    with pytest.raises(ValueError, match="only the line at 0 Hz"):
        as_measurement(data.replace(freq=freq[:1], H=H[:, :1], variance=None))
