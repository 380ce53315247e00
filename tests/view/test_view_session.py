"""Picking modes: steps and their undoing, quick residues, refinement, files, modes beside. Without a browser."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from modalax.files import load, save
from modalax.identify import residues
from modalax.identify.chosen import fit_chosen
from modalax.model.examples import five_dof
from modalax.model.indicators import mac
from modalax.model.modal import ModalModel
from modalax.view.answers import SUM, Answers, drawn
from modalax.view.beside import compare, read_beside
from modalax.view.files import place, read_selection, selection_of
from modalax.view.files import save as save_picks
from modalax.view.quick import Responses
from modalax.view.session import Pick

FREQ = jnp.linspace(20, 70, 401)
TRUTH = five_dof().modal()


def measured(inputs=("1",), noise=0.02):
    return five_dof().frf(FREQ, inputs=list(inputs)).add_noise(jax.random.key(0), noise)


def frequencies(session):
    return [p.frequency_hz for p in session.state.picks]


def test_it_opens_with_the_modes_that_last(session):
    np.testing.assert_allclose(frequencies(session), TRUTH.frequency_hz, rtol=2e-3)
    assert session.past == [] and all(p.order in session.diagram.table.orders for p in session.state.picks)


def test_a_click_picks_and_a_second_click_drops(session):
    session.clear()
    f, order = float(TRUTH.frequency_hz[2]), 12
    session.pick(order, f + 0.05)
    assert frequencies(session) == pytest.approx([f], rel=2e-3) and session.state.picks[0].order == order
    session.pick(order, f + 0.05)
    assert session.state.picks == ()


def test_the_same_mode_at_another_order_moves_the_pick_and_keeps_its_name(session):
    session.name(3, " first   torsion ")
    session.pick(12, frequencies(session)[2])
    assert len(session.state.picks) == 5
    assert session.state.picks[2].order == 12 and session.state.picks[2].name == "first torsion"


def test_close_modes_of_one_order_are_picked_apart(session):
    """Two poles of one order are two modes however close they are."""
    table = session.diagram.table
    row = table.orders.index(12)
    pole = complex(table.poles[row][0])
    near = table.poles.at[row, 0].set(pole).at[row, 1].set(pole * (1 + 1e-5))
    session._diagrams[(*session.state.band, 14)] = type(session.diagram)(
        session.diagram.frf, type(table)(near, table.valid.at[row, :2].set(True), None, table.orders, "lscf"),
        session.diagram.stability, session.diagram.selection, False, (),
    )  # fmt: skip
    try:
        session.clear()
        session.pick(12, abs(pole) / (2 * np.pi))
        session.pick(12, abs(pole) / (2 * np.pi) * (1 + 1e-5))
        assert len(session.state.picks) == 2
    finally:
        session._diagrams.clear()


def test_every_step_is_undone_and_repeated(session):
    start = session.state
    session.drop(2)
    session.name(1, "bending")
    session.clear()
    end = session.state
    for _ in range(3):
        session.undo()
    assert session.state is start
    session.undo()
    assert session.state is start
    for _ in range(4):
        session.redo()
    assert session.state is end
    session.undo()
    session.choose()
    session.redo()  # a new step forgets what was undone
    assert len(session.state.picks) == 5 and session.future == []


@pytest.mark.parametrize("number", [0, 6, -1])
def test_a_number_that_no_mode_has_is_told(session, number):
    with pytest.raises(ValueError, match="there is no mode .*; 5 are picked"):
        session.drop(number)
    assert len(session.state.picks) == 5


def test_a_band_leaves_out_what_lies_beyond_it_and_undo_brings_it_back(session):
    session.look((20.0, 40.0), 8)
    inside = [f for f in np.asarray(TRUTH.frequency_hz) if f <= 40]
    assert len(frequencies(session)) == len(inside) < 5
    assert float(session.diagram.frf.freq[-1]) <= 40 and session.diagram.table.orders[-1] == 8
    session.undo()
    assert len(frequencies(session)) == 5 and session.diagram.table.orders[-1] == 14


@pytest.mark.parametrize(
    ("band", "order", "words"),
    [((50.0, 40.0), None, "second frequency"), ((90.0, 95.0), None, "no line|no frequency"), (None, 999, "999|lines")],
)
def test_a_band_or_order_that_cannot_be_leaves_everything_as_it_was(session, band, order, words):
    before = session.state
    with pytest.raises(ValueError, match=words):
        session.look(band, order)
    assert session.state is before and session.past == []


def test_refinement_gives_standard_deviations_and_comes_nearer(session):
    rough = np.array(frequencies(session))
    session.name(2, "second")
    session.refine()
    fine, std = np.array(frequencies(session)), np.asarray(session.state.refined.frequency_std_hz)
    truth = np.asarray(TRUTH.frequency_hz)
    assert (np.abs(fine - truth) < 5 * std).all() and np.abs(fine - truth).sum() < np.abs(rough - truth).sum()
    assert session.state.picks[1].name == "second" and session.state.picks[1].order is None
    fit = session.fit()
    np.testing.assert_array_equal(fit.model.poles, session.poles)
    assert fit.refined is not None and bool((np.asarray(fit.stability_score) > 0.5).all())
    session.drop(1)
    assert session.state.refined is None


def test_modes_that_change_places_in_the_refinement_take_their_names_along(session, monkeypatch):
    """All of the result goes with the mode: as if it had been refined in the order of the frequencies."""
    from modalax.view import session as module

    straight = fit_chosen(session.diagram.weighted, session.poles, session.tell, True)[1]
    places = np.array([0, 2, 1, 3, 4])
    monkeypatch.setattr(
        module, "fit_chosen", lambda frf, poles, tell, refined: fit_chosen(frf, poles[places], tell, refined)
    )
    session.name(2, "second")
    session.refine()
    assert [p.name for p in session.state.picks] == ["", "", "second", "", ""]
    found = session.state.refined
    assert (np.diff(frequencies(session)) > 0).all()
    np.testing.assert_allclose([p.pole for p in session.state.picks], found.model.poles)
    for name in ("frequency_std_hz", "damping_std", "evidence"):
        np.testing.assert_allclose(getattr(found, name), getattr(straight, name), rtol=1e-4, err_msg=name)
    np.testing.assert_allclose(np.abs(found.shape_std), np.abs(straight.shape_std), rtol=1e-3)
    spread = np.sqrt(np.diag(straight.covariance))
    apart = (np.asarray(found.covariance) - np.asarray(straight.covariance)) / spread / spread[:, None]
    np.testing.assert_allclose(apart, 0, atol=1e-4)


def test_nothing_picked_is_told(session):
    session.clear()
    for step in (session.refine, session.fit, session.model):
        with pytest.raises(ValueError, match="no mode is picked"):
            step()
    told = Answers(session).now()
    assert told["modes"] == [] and told["mac"] == [] and told["shape"] is None and told["unexplained"] > 0.5


def test_quick_residues_are_those_of_unit_weights():
    """The product of one factorisation for all channels, beside the general fit."""
    frf = measured(["1"], 0.1)
    found = Responses(frf).fit(np.asarray(TRUTH.poles))
    model = residues(frf, TRUTH.poles, weights="unit")
    np.testing.assert_allclose(found.residues, model.residues, rtol=1e-6, atol=1e-9 * np.abs(model.residues).max())
    every = np.arange(len(FREQ))
    H = np.asarray(model.frf(FREQ).H)
    np.testing.assert_allclose(found.channel(every[::7], 3, 0), H[::7, 3, 0], rtol=1e-6)
    np.testing.assert_allclose(found.sum(every), np.abs(H).sum(axis=(1, 2)), rtol=1e-6)
    left = np.sum(np.abs(np.asarray(frf.H) - H) ** 2) / np.sum(np.abs(np.asarray(frf.H)) ** 2)
    assert found.unexplained == pytest.approx(left, rel=1e-6)


@pytest.mark.parametrize("turned", [False, True])
def test_shapes_of_several_references_are_the_leading_ones(turned):
    frf = measured(["1", "3"], 0.02)
    found = Responses(frf.transpose() if turned else frf).fit(np.asarray(TRUTH.poles))
    assert float(np.diag(mac(found.shapes, TRUTH.shapes)).min()) > 0.999
    np.testing.assert_allclose(np.abs(found.shapes).max(axis=1), 1, rtol=1e-12)


def test_too_many_modes_for_the_lines_are_told():
    with pytest.raises(ValueError, match="20 modes have 44 unknowns"):
        Responses(measured().lines(slice(0, 20))).fit(np.linspace(1, 2, 20) * 1j - 0.1)


def test_what_the_page_is_told_holds_the_numbers_of_the_session(session):
    session.name(1, "<b>")
    told = Answers(session).now([2, 0], 3)
    assert [m["f"] for m in told["modes"]] == frequencies(session) and told["modes"][0]["name"] == "<b>"
    np.testing.assert_allclose(np.diag(told["mac"]), 1)
    assert told["shape"]["mode"] == 3 and told["undo"] and not told["redo"]
    for channel in ([5, 0], [0, 1], [-1, 0], "all", [0], [True, 0.5]):
        with pytest.raises(ValueError, match="channel"):
            Answers(session).curve(channel)
    assert Answers(session).curve(SUM)["phase"] is None
    json.dumps(Answers(session).opening(), allow_nan=False)
    json.dumps(Answers(session).diagram(), allow_nan=False)


def test_without_places_the_degrees_of_freedom_stand_in_a_row():
    geometry, (which, names) = drawn(None, ["a", "b:+X", "c"])
    assert which == [0, 1, 2] and len(geometry.segments) == 2 and all(n.endswith(":+Z") for n in names)


def test_a_selection_that_was_saved_is_picked_again(session, tmp_path):
    session.name(4, "tail")
    session.drop(1)
    path = tmp_path / "picks.json"
    save_picks(session, "selection", path, False, "data.npz")
    kept = session.state.picks
    session.clear()
    picks, band, order = read_selection(path)
    assert band == session.state.band and order == 14
    session.restore(picks)
    assert session.state.picks == kept


def test_a_result_is_a_selection_too(session, tmp_path):
    session.name(2, "second")
    save_picks(session, "result", tmp_path / "modes.json", False, "data.npz")
    picks, band, order = read_selection(tmp_path / "modes.json")
    np.testing.assert_allclose([p.frequency_hz for p in picks], frequencies(session), rtol=1e-9)
    assert picks[1].name == "second" and order is None and band is not None


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"modes": [{}]}', '{"modes": [{"frequency_hz": 1, "damping_ratio": -1}]}']
)
def test_a_file_that_is_no_selection_is_refused(tmp_path, text):
    (tmp_path / "x.json").write_text(text)
    with pytest.raises(ValueError, match="x.json: holds no selection"):
        read_selection(tmp_path / "x.json")


def test_a_model_that_was_saved_makes_the_same_frfs(session, tmp_path):
    save_picks(session, "model", tmp_path / "modes.npz", False, "data")
    model = load(tmp_path / "modes.npz")
    np.testing.assert_allclose(model.frequency_hz, frequencies(session), rtol=1e-12)
    np.testing.assert_allclose(model.frf(FREQ).H, session.model().frf(FREQ).H, rtol=1e-9)


def test_files_are_neither_replaced_nor_written_elsewhere(session, tmp_path):
    path = tmp_path / "a.json"
    path.write_text("mine")
    for name, words in [("../a.json", "plain"), ("", "plain"), (".hidden", "plain"), ("a.json", "exists already")]:
        with pytest.raises(ValueError, match=words):
            place(tmp_path, name, False)
    with pytest.raises(ValueError, match="read as input"):
        place(tmp_path, "a.json", True, [path])
    with pytest.raises(ValueError, match="exists already"):
        save_picks(session, "selection", path, False, "data")
    assert path.read_text() == "mine"
    with pytest.raises(ValueError, match="is written to .json"):
        save_picks(session, "selection", tmp_path / "a.txt", False, "data")
    with pytest.raises(ValueError, match="cannot be saved"):
        save_picks(session, "all", tmp_path / "b.json", False, "data")
    assert place(tmp_path, "b.json", False) == tmp_path / "b.json"
    assert selection_of(session, "x")["data"] == "x"


def test_modes_beside_are_paired_and_turned_into_phase(session, tmp_path):
    """A sensor that counts the other way, and points that were not measured, do not hinder."""
    truth = TRUTH.normalised("max")
    names = ["4", "1", "2", "9", "5"]  # 3 is missing; 9 was not measured
    shapes = np.asarray(truth.shapes)[:, [3, 0, 1, 2, 4]]
    model = ModalModel(truth.poles, -2j * shapes, truth.participation[:, :1], outputs=names, inputs=["1"])
    save(model, tmp_path / "fe.npz")
    beside = read_beside(tmp_path / "fe.npz")
    picked = session.synthesis.shapes
    found = compare(beside, np.array(frequencies(session)), picked, session.whole.outputs, session.state.band)
    assert found.columns == [0, 1, 3, 4] and list(found.correlation.pairs) == list(range(5))
    assert found.correlation.pair_mac.min() > 0.99
    np.testing.assert_allclose(found.partners, picked[:, found.columns], atol=0.1)
    told = Answers(session, beside).now(SUM, 2)
    assert told["beside"]["common"] == 4 and told["shape"]["other"] is not None


def test_matrices_beside_give_their_undamped_modes(session, tmp_path):
    save(five_dof(), tmp_path / "fe.npz")
    beside = read_beside(tmp_path / "fe.npz")
    np.testing.assert_allclose(beside.table.frequency_hz, TRUTH.frequency_hz, rtol=1e-3)
    told = Answers(session, beside).now()
    assert told["beside"]["pairs"] == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("turned", [False, True])
def test_an_earlier_result_stands_beside(session, turned, tmp_path):
    save_picks(session, "result", tmp_path / "before.json", False, "data.npz")
    if turned:  # as a roving hammer gives it: the shapes are at the inputs
        answer = json.loads((tmp_path / "before.json").read_text())
        answer["inputs"], answer["outputs"] = answer["outputs"], answer["inputs"]
        answer["modes"] = [m | {"shape": m["participation"], "participation": m["shape"]} for m in answer["modes"]]
        (tmp_path / "before.json").write_text(json.dumps(answer))
    told = Answers(session, read_beside(tmp_path / "before.json")).now(SUM, 2)
    assert told["beside"]["pairs"] == [0, 1, 2, 3, 4] and told["shape"]["other"] is not None
    np.testing.assert_allclose(np.diag(told["beside"]["mac"]), 1, atol=1e-2)
    np.testing.assert_allclose(told["beside"]["f"], frequencies(session), rtol=1e-9)


@pytest.mark.parametrize("text", ["", "{}", '{"modes": [], "inputs": [], "outputs": ["1"]}'])
def test_a_file_that_is_no_result_is_refused_beside(text, tmp_path):
    (tmp_path / "x.json").write_text(text)
    with pytest.raises(ValueError, match=r"x.json: holds no result with modes and shapes"):
        read_beside(tmp_path / "x.json")


def test_modes_beside_without_a_common_place_are_told(session, tmp_path):
    model = ModalModel(TRUTH.poles, TRUTH.shapes, TRUTH.participation[:, :1], outputs=list("abcde"), inputs=["a"])
    save(model, tmp_path / "fe.npz")
    told = Answers(session, read_beside(tmp_path / "fe.npz")).now(SUM, 2)
    assert told["beside"]["error"].startswith("fe.npz has none of the measured DoFs 1, 2, 3")
    assert len(told["modes"]) == 5 and told["shape"]["other"] is None


def test_picks_outside_the_band_are_not_restored(session):
    session.restore([Pick(-1 + 2j * np.pi * 300), Pick(complex(TRUTH.poles[0]))])
    assert len(session.state.picks) == 1
