"""Groups of elements of a structure, and their arrays in files."""

import numpy as np
import pytest

import modalax
from modalax import Structure
from modalax.model.groups import Groups

K = 100.0 * np.array([[1.0, -1.0, 0.0], [-1.0, 3.0, -2.0], [0.0, -2.0, 2.0]])
SHARES = np.zeros((2, 3, 3))
SHARES[0, :2, :2] = [[100.0, -100.0], [-100.0, 100.0]]
SHARES[1] = K - SHARES[0]


@pytest.mark.parametrize("ending", ["npz", "mat"])
def test_a_structure_keeps_its_groups_in_a_file(tmp_path, ending):
    structure = Structure(np.eye(3), 0.1 * np.eye(3), K, list("abc"), groups=Groups(["soft", "stiff"], SHARES))
    path = tmp_path / f"s.{ending}"
    modalax.save(structure, path)
    back = modalax.load(path)
    assert isinstance(back, Structure) and back.groups is not None and back.groups.names == ("soft", "stiff")
    np.testing.assert_array_equal(back.groups.stiffness, SHARES)
    assert not np.asarray(back.groups.mass).any()
    assert back.replace(C=np.zeros((3, 3))).groups is not None and back.replace(K=K).groups is None


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((["a", "a"], SHARES), "'a', 'a'; each needs a name of its own"),
        ((["a", ""], SHARES), "each needs a name of its own"),
        ((["a", "b"],), "stiffness, of mass, or of both; here is neither"),
        ((["a"], SHARES), r"1 groups have stiffness of shape \(2, 3, 3\)"),
        ((["a", "b"], SHARES, SHARES[:, :2, :2]), r"mass of shape \(2, 2, 2\); both need \(2, n, n\)"),
        ((["a", "b"], SHARES[0]), r"both need \(2, n, n\)"),
        ((["a", "b"], SHARES + np.triu(np.ones((3, 3)))), "the stiffness of group a is not symmetric"),
        ((["a", "b"], np.where(np.arange(2)[:, None, None] == 0, SHARES, 0.0)), "group b has neither"),
        ((["a", "b"], SHARES * np.nan), "the groups' stiffness"),
    ],
)
def test_wrong_groups_are_told(arguments, message):
    with pytest.raises(ValueError, match=message):
        Groups(*arguments)


def test_groups_of_other_dofs_are_told():
    with pytest.raises(ValueError, match="the groups are over 3 DoFs, the structure has 2"):
        Structure(np.eye(2), np.eye(2), np.eye(2), groups=Groups(["a", "b"], SHARES))
