import numpy as np
import pytest

from modalax._numerics.triangles import backward, forward, inverse_of


@pytest.mark.parametrize("shape", [(7,), (7, 1), (7, 3), (7, 2, 3)])
def test_triangular_systems_are_solved_as_general_ones(shape):
    rng = np.random.default_rng(0)
    L, b = np.tril(rng.normal(size=(7, 7)) + 5 * np.eye(7)), rng.normal(size=shape)
    flat = b.reshape(7, -1)
    assert forward(L, b) == pytest.approx(np.linalg.solve(L, flat).reshape(shape), rel=1e-12)
    assert backward(L, b) == pytest.approx(np.linalg.solve(L.T, flat).reshape(shape), rel=1e-12)


def test_a_zero_on_the_diagonal_has_no_solution():
    with pytest.raises(np.linalg.LinAlgError, match="zero on its diagonal"):
        forward(np.diag([1.0, 0.0]), np.ones(2))


def test_a_matrix_without_rows_has_an_inverse_and_nothing_is_printed(capfd):
    rng = np.random.default_rng(0)
    L = np.tril(rng.normal(size=(5, 5)) + 5 * np.eye(5))
    assert inverse_of(L) == pytest.approx(np.linalg.inv(L), rel=1e-12)
    assert inverse_of(np.zeros((0, 0))).shape == (0, 0)
    assert capfd.readouterr() == ("", "")
