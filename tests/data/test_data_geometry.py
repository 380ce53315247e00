"""Names of DoFs and the geometry they sit on."""

import numpy as np
import pytest

from modalax.data import Dof, Geometry, parse_dof
from modalax.data.dofs import direction_vectors, same_place


@pytest.mark.parametrize(
    ("text", "dof", "name"),
    [
        ("12:-Z", Dof("12", "Z", -1), "12:-Z"),
        ("12:+X", Dof("12", "X", 1), "12:+X"),
        ("12:y", Dof("12", "Y", 1), "12:+Y"),
        ("wing:12:-RZ", Dof("wing:12", "RZ", -1), "wing:12:-RZ"),
        (" 5 ", Dof("5", None, 1), "5"),
        ("left tip", Dof("left tip", None, 1), "left tip"),
        ("a:b", Dof("a:b", None, 1), "a:b"),
        ("7:+Q", Dof("7:+Q", None, 1), "7:+Q"),
    ],
)
def test_names_are_read(text, dof, name):
    assert parse_dof(text) == dof
    assert parse_dof(text).name == name
    assert parse_dof(parse_dof(text).name) == dof


def test_empty_name_is_refused():
    with pytest.raises(ValueError, match="a DoF name is empty"):
        parse_dof("  ")


@pytest.mark.parametrize(
    ("a", "b", "sign"),
    [
        ("1:+Z", "1:Z", 1),
        ("1:+Z", "1:-Z", -1),
        ("1:-Z", "1:-Z", 1),
        ("1:+Z", "1:+RZ", 0),
        ("1:+Z", "2:+Z", 0),
        ("5", "5", 1),
    ],
)
def test_same_place(a, b, sign):
    assert same_place(a, b) == sign == same_place(b, a)


def test_direction_vectors():
    expected = [[1, 0, 0], [0, -1, 0], [0, 0, -1], [0, 0, 0]]
    np.testing.assert_array_equal(direction_vectors(["1:X", "1:-Y", "2:-RZ", "3"]), expected)


def square() -> Geometry:
    xyz = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    return Geometry(["a", "b", "c", "d"], np.array(xyz, float), [("a", "b", "c", "d", "a"), ("a", "c")])


def test_lines_become_segments():
    np.testing.assert_array_equal(square().segments, [[0, 1], [1, 2], [2, 3], [3, 0], [0, 2]])
    assert Geometry(["a"], np.zeros((1, 3))).segments.shape == (0, 2)


def test_places_of_dofs():
    np.testing.assert_array_equal(square().places(["c:+Z", "b:-X", "b"]), [[1, 1, 0], [1, 0, 0], [1, 0, 0]])
    assert square().places([]).shape == (0, 3)


def test_displacements_gather_signs_directions_and_repeats():
    vectors, known = square().displacements(
        ["a:-Z", "a:+X", "b:+Y", "b:-Y", "c:+RZ", "d"], np.array([2, 3j, 1, -2, 9, 9])
    )
    expected = np.zeros((4, 3), complex)
    expected[0] = [3j, 0, -2]
    expected[1] = [0, 1.5, 0]
    np.testing.assert_array_equal(vectors, expected)
    np.testing.assert_array_equal(known.sum(axis=1), [2, 1, 0, 0])
    real, _ = square().displacements(["a:-Z"], np.array([2]))
    assert real.dtype == float and real[0, 2] == -2


@pytest.mark.parametrize(
    ("arguments", "pattern"),
    [
        ((["a", "b"], np.zeros((2, 2))), r"xyz has shape \(2, 2\); it needs \(node, 3\)"),
        ((["a", "a"], np.zeros((2, 3))), "nodes names a stand more than once"),
        ((["a"], np.zeros((2, 3))), "1 names for 2 nodes"),
        ((["a", "b"], np.zeros((2, 3)), [("a", "z")]), "lines go to nodes z, which have no position"),
        ((["a"], np.full((1, 3), np.nan)), "xyz holds 3 values that are not finite"),
        ((["a"], np.zeros((1, 3), np.float32)), "xyz is in single precision"),
    ],
)
def test_unusable_geometry(arguments, pattern):
    with pytest.raises(ValueError, match=pattern):
        Geometry(*arguments)


def test_dof_without_place_and_wrong_number_of_values():
    with pytest.raises(ValueError, match="DoF 'z:.X': node 'z' has no position; there are a, b, c, d"):
        square().places(["z:+X"])
    with pytest.raises(ValueError, match=r"values has shape \(3,\) for 2 DoFs"):
        square().displacements(["a:X", "b:X"], np.zeros(3))
