"""Modes alone against a simulation: causes are named by frequencies and shapes; what a table lacks is not told."""

import json

import numpy as np
import pytest
import scipy.linalg

import modalax
from modalax.cli import main
from modalax.diagnose import catalogue, diagnose
from modalax.diagnose.modal_domain.fitting.inaccuracy import inaccuracy_of
from modalax.diagnose.modal_domain.fitting.state import Setting, state_at
from modalax.diagnose.modal_domain.modes.features import whitener_of
from modalax.diagnose.modal_domain.structure.coordinates import coordinates_of
from modalax.diagnose.modal_domain.table import facts_of, references, unlike
from modalax.files import load_mode_table, save_modes
from modalax.model import ModalModel, Structure
from modalax.model.mode_table import ModeTable

N, SEEN = 10, 6
DOFS = [f"{k + 1}:+Z" for k in range(N)]
STD = (0.001, 0.1, 0.02)


def chain(k=None, m=None) -> Structure:
    """Masses of 1 kg between two walls."""
    k, m = np.full(N + 1, 1e6) if k is None else k, np.ones(N) if m is None else m
    K = np.diag(k[:-1] + k[1:]) - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)
    return Structure(np.diag(m), 2e-5 * K + 0.5 * np.diag(m), K, DOFS)


def measured(case: str, seed: int = 0) -> ModeTable:
    """Six modes of a chain whose every element is off by 1 %, one thing grossly, with errors of a good test."""
    rng = np.random.default_rng(seed)
    k, m = 1e6 * (1 + 0.01 * rng.normal(size=N + 1)), 1 + 0.01 * rng.normal(size=N)
    if case == "mass":
        m[3] += 0.6
    if case == "spring":
        k[6] *= 0.4
    true = chain(k, m).modal()
    shapes = np.asarray(true.shapes).real[:SEEN]
    shapes = shapes / np.abs(shapes).max(axis=1, keepdims=True) + STD[2] * rng.normal(size=shapes.shape)
    if case == "swap":
        shapes[:, [2, 5]] = shapes[:, [5, 2]]
    return ModeTable.of(
        true.frequency_hz[:SEEN] * (1 + STD[0] * rng.normal(size=SEEN)),
        true.damping_ratio[:SEEN] * (1 + STD[1] * rng.normal(size=SEEN)),
        shapes * rng.choice([-3.0, 2.0], size=(SEEN, 1)), DOFS,
    )  # fmt: skip


@pytest.mark.filterwarnings("ignore:invalid value encountered:RuntimeWarning")
@pytest.mark.parametrize(
    ("case", "cause"),
    [("none", None), ("spring", ("joint_stiffness", ["6:+Z", "7:+Z"])),
     pytest.param("mass", ("added_mass", ["4:+Z"]), marks=pytest.mark.slow),
     pytest.param("swap", ("channel_swap", ["3:+Z", "6:+Z"]), marks=pytest.mark.slow)],
)  # fmt: skip
def test_what_a_table_of_modes_shows(case, cause):
    found = diagnose(measured(case), chain(), modal_std=STD)
    answer = found.to_dict()
    assert answer["verdict"] == ("clean" if cause is None else "named")
    assert [(c["name"], c["where"]) for c in answer["causes"]] == ([] if cause is None else [cause])
    if case == "mass":
        mass = answer["causes"][0]["parameters"]["mass"]
        assert mass["value"] == pytest.approx(0.6, abs=4 * mass["std"]) and mass["std"] < 0.1
    assert all(np.isnan(v) for k, v in answer["gain"].items() if k != "held_out")
    assert "0.1 % of frequencies" in answer["notes"][0] and "as told" in answer["notes"][0]
    assert "no gain can be told" in str(found)


def lowest_modes(structure: Structure, count: int = 8, ratio: float = 0.01) -> ModalModel:
    """What a program gives that exports modes and no matrices."""
    values, phi = scipy.linalg.eigh(np.asarray(structure.K), np.asarray(structure.M))
    f = np.sqrt(values[:count]) / 2 / np.pi
    return ModalModel.from_real_modes(f, np.full(count, ratio), phi[:, :count].T, np.ones(count), DOFS)


def test_a_table_is_compared_with_modes_too():
    """The signs refer to a sensor that is exchanged with another, so that all elements seem off; by another all fit."""
    some = [c for c in catalogue() if c.slug == "channel_swap"]
    found = diagnose(measured("swap", 3), lowest_modes(chain()), causes=some)
    (cause,) = found.to_dict()["causes"]
    assert found.verdict == "named" and (cause["name"], set(cause["where"])) == ("channel_swap", {"3:+Z", "6:+Z"})
    assert found.inaccuracy["stiffness"]["value"] < 0.02 and isinstance(found.extended.base, ModalModel)


def test_complex_modes_are_refused():
    modes = lowest_modes(chain())
    turned = modes.replace(shapes=modes.shapes * np.exp(1j * np.linspace(0, 1, N)))
    with pytest.raises(ValueError, match="those of the simulation are complex"):
        diagnose(measured("none"), turned)


@pytest.mark.parametrize("simulation", [Structure(np.eye(N), np.zeros((N, N)), chain().K, DOFS),
                                        lowest_modes(chain(), ratio=0.0)])  # fmt: skip
def test_damping_that_neither_table_nor_simulation_tells_is_not_compared(simulation):
    table = measured("none", 1)
    found = diagnose(ModeTable.of(table.frequency_hz, np.nan, table.shapes, DOFS), simulation)
    assert found.verdict == "clean" and found.inaccuracy["stiffness"]["value"] < 0.02
    assert any("damping is not compared" in reason for reason in found.reasons)


def test_a_cause_that_signs_by_another_sensor_have_no_room_for_has_no_name():
    spring, nothing = (
        diagnose(measured(case), chain(), causes=[c for c in catalogue() if c.slug == "joint_stiffness"])
        for case in ("spring", "none")
    )
    assert spring.verdict == "named" and unlike(spring, [spring]) is spring and unlike(nothing, [spring]) is nothing
    told = unlike(spring, [nothing])
    assert told.verdict == "unknown" and "joint_stiffness" in told.reasons[-1] and "no cause" in told.reasons[-1]


def test_usual_errors_are_said_and_wrong_ones_refused():
    table = measured("none")
    found = diagnose(table, chain())
    assert "usual ones, since none are told" in found.to_dict()["notes"][0]
    with pytest.raises(ValueError, match="three between 0 and 1 are needed"):
        diagnose(table, chain(), modal_std=(0.001, 0.1, -1.0))
    assert diagnose(table, found.extended).verdict == "clean"  # corrected and without causes, it is matrices
    spring = diagnose(measured("spring"), chain(), causes=[c for c in catalogue() if c.slug == "joint_stiffness"])
    with pytest.raises(ValueError, match="compared with matrices or modes, not with an? ExtendedSimulation"):
        diagnose(table, spring.extended)
    other = ModeTable.of(table.frequency_hz, table.damping_ratio, table.shapes, [f"x{k}" for k in range(N)])
    with pytest.raises(ValueError, match="DoFs x0, x1, x2, x3 of the modes are not in the simulation"):
        diagnose(other, chain())


def test_a_mode_that_does_not_move_where_signs_refer_is_left_out_and_said():
    table = measured("none")
    shapes = np.zeros((3, 3))
    shapes[0], shapes[1], shapes[2] = (1, 0.5, 0), (0.5, 1, 0), (0, 0, 1)
    still = ModeTable.of(table.frequency_hz[:3], table.damping_ratio[:3], shapes, DOFS[:3])
    facts, notes = facts_of(still, STD, references(still, STD[2])[0])
    assert len(facts.features.poles) == 2 and facts.inputs[0] in DOFS[:2]
    assert "left out: they hardly move at" in notes[1]


@pytest.mark.filterwarnings("ignore:invalid value encountered:RuntimeWarning")
@pytest.mark.parametrize("ending", ["npz", "csv", "uff"])
def test_the_command_takes_files_of_modes(tmp_path, capsys, ending):
    table, sim = measured("mass"), tmp_path / "sim.npz"
    modalax.save(chain(), sim)
    omega, zeta = 2 * np.pi * table.frequency_hz, table.damping_ratio
    poles = -zeta * omega + 1j * omega * np.sqrt(1 - zeta**2)
    model = ModalModel(poles, table.shapes, table.shapes, outputs=DOFS, inputs=DOFS)
    path, json_ = tmp_path / f"modes.{ending}", tmp_path / "a.json"
    save_modes(model, path)
    loaded = load_mode_table(path)
    np.testing.assert_allclose(loaded.frequency_hz, table.frequency_hz, rtol=1e-4)
    np.testing.assert_allclose(loaded.damping_ratio, table.damping_ratio, rtol=1e-4)
    one, two = (t.shapes / t.shapes[:, :1] for t in (loaded, table))
    np.testing.assert_allclose(one, two, rtol=1e-4)
    assert loaded.dofs == table.dofs
    assert main(["diagnose", str(path), "--simulation", str(sim), "--report", str(tmp_path / "r.html")]) == 2
    assert "holds modes alone" in capsys.readouterr().err
    if ending != "npz":  # what is read is diagnosed alike
        return
    options = ["--simulation", str(sim), "--modal-std", "0.001", "0.1", "0.02", "--json", str(json_)]
    assert main(["diagnose", str(path), *options]) == 0
    answer = json.loads(json_.read_text())
    assert answer["verdict"] == "named" and answer["causes"][0]["where"] == ["4:+Z"]
    assert answer["gain"]["chi2_before"] is None
    assert "no gain can be told" in capsys.readouterr().out.replace("\n", " ")


@pytest.mark.parametrize(
    ("text", "pattern"),
    [
        ("mode,frequency_hz,damping_ratio\n1,5,0.01\n", "has the columns"),
        ("mode,frequency_hz,re 1:+Z\n1,5\n", "line 2 has 2 columns"),
        ("mode,frequency_hz,re 1:+Z\n1,x,1\n", "line 2 holds what is no number"),
        ("mode,frequency_hz,re 1:+Z\n1,-5,1\n", "must be positive"),
        ("mode,frequency_hz,re 1:+Z\n1,5,0\n", "a shape is zero"),
        ("mode,frequency_hz,damping_ratio,re 1:+Z\n1,5,2,1\n", "they lie between 0 and 1"),
        ("mode,frequency_hz,re 1:+Z,re 1:+Z\n1,5,1,1\n", "of different names"),
    ],
)
def test_tables_that_cannot_be(tmp_path, text, pattern):
    path = tmp_path / "x.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=rf"x\.csv: .*{pattern}"):
        load_mode_table(path)
    with pytest.raises(ValueError, match="load_mode_table reads it"):
        modalax.load(path)


def test_a_mode_that_is_damped_away_has_no_partner():
    """Nor is it the spare coordinate, though a mode that the simulation hardly shows need not be seen in it."""
    (facts, _), simulation = facts_of(measured("none"), STD, 0), chain()
    top = 2 * np.pi * float(facts.freq[-1])
    c = coordinates_of(simulation, facts.outputs, facts.inputs, top)
    inaccuracy = inaccuracy_of(simulation, c, top)
    setting = Setting(c, inaccuracy, facts.features, whitener_of(facts.features))
    vars(setting)["linear"] = np.append(np.full(len(facts.features.poles) - 1, np.nan), 1.0)
    sizes = np.zeros(sum(len(p) for p in inaccuracy.patterns))
    state_at(setting, sizes)
    counts = [len(p) for p in inaccuracy.patterns]
    sizes[np.repeat([g == "damping between modes" for g in inaccuracy.groups], counts)] = 1e3
    with pytest.raises(np.linalg.LinAlgError, match="no partner but the spare"):
        state_at(setting, sizes)
