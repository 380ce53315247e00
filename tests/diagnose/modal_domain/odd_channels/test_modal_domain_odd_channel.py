"""A sensor that is wrong in a way without a name is told as that, and not as an element or a mass at its place."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import chains_off
import numpy as np
import pytest
from frames import DOFS, measured, simulation
from kinds import FEW, among, few_or_all

from modalax.data import Measurement
from modalax.diagnose.decision.beyond import OddChannel
from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.fitting.attempts import attempt
from modalax.diagnose.modal_domain.fitting.explanation import Prior, ranked_by
from modalax.diagnose.modal_domain.judged import judge
from modalax.diagnose.modal_domain.modes.measured import Measured
from modalax.diagnose.modal_domain.odd_channels import askew
from modalax.diagnose.modal_domain.odd_channels.askew import askew_channel
from modalax.diagnose.modal_domain.odd_channels.odd_channel import only_output
from modalax.diagnose.modal_domain.stage import Stage, identified, posed
from modalax.model import Structure

EITHER = pytest.mark.parametrize("structure", ["chain", pytest.param("beam", marks=pytest.mark.slow)])


def stage_of(data: Measurement, simulation: Structure, asked: Callable[[Change, Measured], bool]) -> Stage:
    """The general inaccuracy and the causes that are asked for beside it, one by one and without a search."""
    modes = identified(data, simulation, lambda _: None)
    task = posed(data, simulation, modes)
    found = {}
    attempt(task.setting, found, (), np.zeros(0), None)
    for cause in (c for c in task.candidates if asked(c, modes)):
        attempt(task.setting, found, (cause,), cause.of_size(0.1), None)
    explanations = ranked_by(found, Prior(task.candidates))
    return Stage(data, simulation, task.coordinates, modes, task.setting, task.candidates, explanations, True)


@among({"channel_gain", "channel_sign", "channel_swap", "time_delay", "sensor_filter", "crosstalk"})
@EITHER
def test_a_gain_that_wanders_over_the_lines_gets_no_name_but_its_sensor_is_told(structure, wanted):
    if structure == "beam":
        data, model, name = measured(21, 0.01)[0], simulation(), DOFS[8]
    else:
        freq = chains_off.FREQ[::2]
        H = chains_off.response(*chains_off.chain_off(5, 0.02), freq)
        data, model, name = chains_off.as_measured(H, freq, 5), chains_off.simulation(), chains_off.DOFS[1]
    at, along = data.outputs.index(name), np.linspace(-1.0, 1.0, len(data.freq))
    gain = np.ones(data.H.shape)
    gain[:, :, at] *= (1 + 0.3 * np.sin(4 * along))[:, None]
    data = data.replace(H=data.H * gain, variance=data.variance * gain**2)
    answer = diagnose_modes(data, model, wanted=wanted).to_dict()
    assert answer["verdict"] == "unknown"
    assert any(f"the FRFs at {name} alone differ" in r for r in answer["reasons"])
    assert f"the sensor at {name}" in answer["advice"] and "supports" not in answer["advice"]


@few_or_all("crosstalk", "force_gain")  # as several of which it may seem
@EITHER
@pytest.mark.parametrize("share", [pytest.param(-0.05, marks=pytest.mark.slow), 0.2])
def test_a_force_that_also_acts_elsewhere_is_told_with_its_share_and_has_no_name(structure, share, wanted):
    if structure == "beam":
        data, model, name, along = measured(23, 0.01, stray=(DOFS[10], share))[0], simulation(), DOFS[4], DOFS[10]
    else:
        H = chains_off.response(*chains_off.chain_off(5, 0.02), chains_off.FREQ)
        H[:, :, 0] += share * H[:, :, 2]
        data, model = chains_off.as_measured(H, chains_off.FREQ, 5), chains_off.simulation()
        name, along = chains_off.DOFS[0], chains_off.DOFS[2]
    found = diagnose_modes(data, model, wanted=wanted)
    answer, odd = found.to_dict(), found.stage.odd
    assert answer["verdict"] == "unknown", answer["causes"]
    assert odd is not None and (odd.name, odd.force, odd.along) == (name, True, along)
    assert abs(odd.share / share - 1) < 0.1 and odd.nats > 20.0
    assert any(f"of it also acted at {along}" in r for r in answer["reasons"]), answer["reasons"]
    assert not any("generally off" in r for r in answer["reasons"])  # which stood for the share
    assert f"the force at {name}" in answer["advice"]


def test_a_tilted_sensor_is_likelier_than_the_crosstalk_that_imitates_it():
    data, _ = measured(24, 0.01, tilted=(DOFS[8], DOFS[9], 0.03))
    stage = stage_of(data, simulation(), lambda c, _: (c.slug, c.where) == ("crosstalk", (DOFS[8], DOFS[6])))
    assert [c.slug for c in stage.best.causes] == ["crosstalk"]
    odd = askew_channel(stage.setting, stage.explanations, DOFS, data.outputs, data.inputs)
    assert odd is not None and (odd.name, odd.force, odd.along) == (DOFS[8], False, DOFS[9])
    assert abs(odd.share / 0.03 - 1) < 0.15


@pytest.mark.slow  # without the search by default
def test_a_sensor_that_also_measures_the_rotation_of_its_point_is_told_as_that():
    data, _ = measured(24, 0.01, tilted=(DOFS[8], DOFS[9], 0.03))
    odd = diagnose_modes(data, simulation()).stage.odd
    assert odd is not None and (odd.name, odd.force, odd.along) == (DOFS[8], False, DOFS[9])
    assert abs(odd.share / 0.03 - 1) < 0.15


def with_a_mode_of_its_own() -> Measurement:
    """One sensor with the resonance of a cable or a mount, as large as the channel, and whose foot is 3 % of it."""
    data, _ = measured(21, 0.0)
    at, s = data.outputs.index(DOFS[8]), 2j * np.pi * np.asarray(data.freq)
    own = 2 * np.pi * 1.07 * float(np.median(data.freq))
    gain = np.ones(data.H.shape, complex)
    gain[:, :, at] *= (1 + 0.03 * own**2 / (s**2 + 0.03 * own * s + own**2))[:, None]
    return data.replace(H=data.H * gain)


def test_a_mode_that_one_sensor_alone_shows_is_told_as_its_own():
    data = with_a_mode_of_its_own()
    own = 1.07 * float(np.median(data.freq))

    def asked(cause: Change, modes: Measured) -> bool:
        hz = np.abs(modes.features.poles) / 2 / np.pi
        return cause.slug == "missing_mode" and cause.number == np.argmin(np.abs(hz - own))

    stage = stage_of(data, simulation(), asked)
    explained = [replace(e, misfit=0.0) for e in stage.explanations]  # as if with it the modes were
    judged = judge(replace(stage, explanations=explained))
    assert [c.slug for c in stage.best.causes] == ["missing_mode"] and judged.word == "unknown"
    assert any(f"shows at {DOFS[8]} alone" in r for r in judged.reasons), judged.reasons


@pytest.mark.slow  # without the search by default
def test_a_mode_of_one_sensor_is_no_mode_that_the_simulation_lacks():
    answer = diagnose_modes(with_a_mode_of_its_own(), simulation()).to_dict()
    assert answer["verdict"] == "unknown", answer["causes"]
    assert any(f"shows at {DOFS[8]} alone" in r for r in answer["reasons"]), answer["reasons"]


def test_a_mode_is_of_one_output_only_if_the_others_show_that_they_have_none():
    rng = np.random.default_rng(3)
    noise = (rng.standard_normal((4, 6, 2)) + 1j * rng.standard_normal((4, 6, 2))) / np.sqrt(2)
    f = SimpleNamespace(residues=noise)
    f.residues[0, 2] += 12.0  # clearly at one output
    f.residues[1, 2] += 1.0  # so weak that others may have as much
    f.residues[2] += 12.0 * rng.standard_normal((6, 1))
    f.residues[3, 2:4] += 12.0  # at two
    assert [only_output(f, k) for k in range(4)] == [2, None, None, None]
    assert only_output(SimpleNamespace(residues=f.residues[:, 2:4]), 0) is None  # of two outputs nobody can tell


@pytest.mark.parametrize("share", [0.0, 0.002])
def test_where_nothing_else_stands_out_a_force_askew_is_looked_for_by_its_linear_score(share, monkeypatch):
    """No share that promises nothing is fitted; a small one is found as before."""
    fitted, tried = askew._fitted, []
    monkeypatch.setattr(askew, "_fitted", lambda *a: tried.append(a[1]) or fitted(*a))
    monkeypatch.setattr(askew, "_nearest", lambda *a: pytest.fail("linear scores tell"))
    H = chains_off.response(*chains_off.chain_off(5, 0.002), chains_off.FREQ)
    H[..., 0] = H[..., 0] + share * H[..., 3]
    data, names = chains_off.as_measured(H, chains_off.FREQ, 5), chains_off.DOFS
    stage = stage_of(data, chains_off.simulation(), lambda c, _: False)
    odd = askew_channel(stage.setting, stage.explanations, names, data.outputs, data.inputs)
    assert (share == 0.0) == (odd is None) == (not tried)
    if odd is not None:
        assert (odd.name, odd.force, odd.along) == (names[0], True, names[3])
        assert odd.share == pytest.approx(share, rel=0.3)


def test_a_channel_that_is_hardly_likelier_than_nothing_is_not_told():
    """A clean answer keeps its general inaccuracy and has no advice then."""
    data, _ = measured(22, 0.01)
    found = diagnose_modes(data, simulation(), wanted=FEW.__contains__)
    assert found.verdict == "clean" and found.stage.odd is None and found.advice is None
    for nats, told in ((2.0, False), (4.0, True)):
        odd = OddChannel(DOFS[4], True, nats, DOFS[10], 0.1)
        judged = judge(replace(found.stage, odd=odd))
        assert (judged.odd is odd, judged.word) == (told, "unknown" if told else "clean")
    assert any("generally off" in r for r in found.reasons)


@pytest.mark.slow  # of a smaller mass by default, where a mass stands out beyond the general inaccuracy
def test_a_mass_at_a_sensor_is_no_fault_of_that_sensor():
    data, _ = measured(22, 0.01, mass=(DOFS[8], 0.3))
    found = diagnose_modes(data, simulation())
    assert found.stage.odd is None
    assert [(c["name"], c["where"]) for c in found.to_dict()["causes"]] == [("added_mass", [DOFS[8]])]


PLANE = [f"{k}:+{axis}" for k in range(1, 5) for axis in "XZ"]
AT = np.array([[0.0, 0.0], [1.0, 0.0], [1.1, 0.9], [0.1, 1.0], [-1.0, -0.6], [1.9, -0.8], [0.4, 2.0]])  # last: ground
BARS = [(0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (0, 4), (1, 5), (3, 6), (2, 5), (1, 3)]


def truss(off: np.ndarray) -> Structure:
    """Four masses in a plane that bars hold, each of which is off by a factor."""
    K, M = np.zeros((8, 8)), np.diag(np.repeat([1.0, 1.4, 0.8, 1.1], 2))
    for (a, b), factor in zip(BARS, off, strict=True):
        n = (AT[b] - AT[a]) / np.linalg.norm(AT[b] - AT[a])
        B = np.zeros((8, 1))
        B[2 * a : 2 * a + 2, 0] = n
        if b < 4:
            B[2 * b : 2 * b + 2, 0] = -n
        K += 2e5 * factor * B @ B.T
    return Structure(M, 3e-5 * K, K, PLANE)


@pytest.mark.parametrize("angle", [25.0, 0.0])
def test_a_sensor_turned_towards_another_that_is_measured_is_neither_crosstalk_nor_a_gain(angle):
    """Its sine is the share and its cosine the gain; crosstalk of the same share without the gain stays crosstalk."""
    rng = np.random.default_rng(4)
    true, freq = truss(1 + 0.01 * rng.standard_normal(len(BARS))), np.linspace(30.0, 160.0, 400)
    H = np.asarray(true.frf(freq, form="accelerance", inputs=["2:+X", "3:+Z"]).H)
    sine, cosine = (np.sin(np.radians(angle)), np.cos(np.radians(angle))) if angle else (np.tan(np.radians(25.0)), 1.0)
    H = np.concatenate([cosine * H[:, :1] + sine * H[:, 1:2], H[:, 1:]], axis=1)
    sigma = 0.003 * np.sqrt((np.abs(H) ** 2).mean(axis=0))
    H = H + sigma * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
    data = Measurement(freq, H[None], form="accelerance", outputs=PLANE, inputs=["2:+X", "3:+Z"],
                       variance=np.broadcast_to(sigma**2, H.shape)[None].copy())  # fmt: skip
    both = [("crosstalk", ("1:+X", "1:+Z")), ("channel_gain", ("1:+X",))]
    stage = stage_of(data, truss(np.ones(len(BARS))), lambda c, _: (c.slug, c.where) in both)
    found = {e.causes: e.fit for e in stage.explanations}
    pair = tuple(c for name in both for c in stage.candidates if (c.slug, c.where) == name)
    attempt(stage.setting, found, pair, np.array([1.0, -0.3]), None)
    explanations = ranked_by(found, Prior(stage.candidates))
    odd = askew_channel(stage.setting, explanations, PLANE, data.outputs, data.inputs)
    if not angle:
        assert odd is None and [c.slug for c in explanations[0].causes] == ["crosstalk"]
        return
    assert {c.slug for c in explanations[0].causes} == {"crosstalk", "channel_gain"}
    assert odd is not None and (odd.name, odd.force, odd.along) == ("1:+X", False, "1:+Z") and "25" in odd.said
    assert abs(odd.share / np.tan(np.radians(25.0)) - 1) < 0.03
