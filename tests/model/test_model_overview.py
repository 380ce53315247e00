import jax
import numpy as np
import pytest

from modalax.model import Mass, ModalModel, Spring, Structure, change
from modalax.model.correlation import correlate
from modalax.model.matching import match
from modalax.model.mode_table import ModeTable
from modalax.model.overview import ROWS


def test_a_modal_model_prints_its_table_of_modes():
    model = ModalModel.from_real_modes([10.0, 20.0], [0.01, 0.0], np.eye(2), [3.0, 4.0], ["a", "b"])
    text = str(model.replace(upper=1e-6, damping_std=0.1)).splitlines()
    assert text[:5] == [
        "Modal model of 2 modes",
        "  2 outputs: a, b",
        "  2 inputs: a, b",
        "  residual terms of modes above the band",
        "  claimed inaccuracy (standard deviation): damping ratio 10 %",
    ]
    assert text[5].split("  ")[-1] == "Modal mass [kg]"
    assert [row.split() for row in text[7:]] == [["1", "10", "1", "3"], ["2", "20", "0", "-"]]


def test_a_long_table_is_cut_and_says_so():
    n = ROWS + 2
    model = ModalModel.from_real_modes(np.arange(1.0, n + 1), np.full(n, 0.01), np.ones((n, 1)), np.ones(n), ["a"])
    assert str(model).splitlines()[-1] == "... and 2 more modes"


def test_a_modal_model_without_a_drive_point_has_no_modal_mass():
    model = ModalModel([-1 + 60j], [[1.0]], [[1.0]], outputs=["a"], inputs=["b"])
    assert "kg" not in str(model) and str(model).splitlines()[0] == "Modal model of 1 mode"


def test_a_structure_prints_damping_and_claims():
    K = np.array([[2.0, -1.0], [-1.0, 1.0]])
    plain = Structure(np.eye(2), np.zeros((2, 2)), K, ["a", "b"])
    assert str(plain).splitlines() == ["Structure of 2 degrees of freedom: a, b", "  no damping"]
    claimed = Structure(np.eye(2), 0.1 * K, K, D=0.01 * K, stiffness_std=0.03, mass_std=0.01, pairs=[("1", "2")])
    assert str(claimed).splitlines()[1:] == [
        "  viscous and hysteretic damping",
        "  claimed inaccuracy (standard deviation): stiffness 3 %, mass 1 %",
        "  1 pair named between which springs and joints may sit",
    ]


@pytest.mark.parametrize("what", [ModalModel([-1 + 60j], [[1]], [[1]], outputs=["a"], inputs=["a"]), None])
def test_inside_a_compiled_function_the_plain_text_is_shown(what):
    seen = []
    what = Structure(np.eye(1), np.eye(1), np.eye(1)) if what is None else what
    jax.jit(lambda x: (seen.append(str(x)), 0.0)[1])(what)
    assert seen[0].startswith(type(what).__name__ + "(")


def test_a_modified_structure_prints_what_was_put_where():
    plain = Structure(np.eye(2), np.zeros((2, 2)), np.eye(2), ["a", "b"])
    assert str(change(change(plain, ["a"], Mass(0.5)), ["b", "a"], Spring(1e5))).splitlines()[2:] == [
        "  with Mass(m = 0.5) at a",
        "  with Spring(k = 100000) at b - a",
    ]


def test_a_match_prints_a_line_a_dof():
    assert str(match(["1:+Z"], ["1:+Z", "2:+Z"])).splitlines() == [
        "1 measured DoF matched to nodes of the model",
        "  1:+Z -> 1 by name, 0 mm away",
    ]


def test_a_correlation_prints_its_pairs():
    none = np.full(2, np.nan)
    table = ModeTable(np.array([10.0, 20.0]), none, np.eye(3)[:2] + 0j, ("1:+Z", "2:+Z", "3:+Z"), none, none)
    text = str(correlate(table, [10.5, 30.0], np.eye(3)[[0, 2]])).splitlines()
    assert text[0] == "1 pair of 2 measured modes and 2 of the model"
    assert [row.split() for row in text[3:]] == [["10", "1", "10.5", "+5.00", "1.000"], ["20", "-", "-", "-", "-"]]
