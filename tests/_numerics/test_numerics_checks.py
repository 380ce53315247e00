"""What is done to an array of NumPy after an object was made of it does not change the object."""

import jax
import numpy as np
import pytest

from modalax._numerics.checks import own_copy
from modalax.data import FRF, Measurement
from modalax.model import ModalModel, Structure

NAMES = tuple(f"{k}:+Z" for k in range(12))
TRIES = 30  # memory is shared only where an array happens to be aligned


def made(kind: str):
    """An object, and the arrays that it was made of by the names of its fields."""
    A, lines = np.eye(12), np.arange(1.0, 51.0)
    H, channels = np.ones((1, 50, 12, 12), complex), {"outputs": NAMES, "inputs": NAMES}
    if kind == "structure":
        parts = {"M": A.copy(), "C": A.copy(), "K": A.copy(), "D": A.copy()}
        return Structure(*(parts[k] for k in "MCK"), NAMES, D=parts["D"]), parts
    if kind == "measurement":
        parts = {"freq": lines, "H": H, "variance": np.ones(H.shape), "coherence": np.full(H.shape, 0.5)}
        return Measurement(parts["freq"], parts["H"], form="mobility", variance=parts["variance"],
                           coherence=parts["coherence"], **channels), parts  # fmt: skip
    if kind == "frf":
        parts = {"freq": lines, "H": H[0], "variance": np.ones(H[0].shape)}
        return FRF(parts["freq"], parts["H"], form="mobility", variance=parts["variance"], **channels), parts
    parts = {"poles": -1 + 1j * np.arange(1.0, 13.0), "shapes": A + 0j, "participation": A + 0j}
    return ModalModel(**parts, **channels), parts


@pytest.mark.parametrize("kind", ["structure", "measurement", "frf", "modal model"])
def test_an_object_keeps_the_numbers_that_it_was_made_of(kind):
    for _ in range(TRIES):
        whole, parts = made(kind)
        before = {name: np.array(part) for name, part in parts.items()}
        for part in parts.values():
            part += 0.25
        for name, was in before.items():
            np.testing.assert_array_equal(np.asarray(getattr(whole, name)), was, err_msg=name)


def test_a_copy_is_taken_over_without_another_one():
    """Of large data each copy takes as much memory as all that was measured."""
    given = np.arange(300_003.0).reshape(3, -1)[:, 1:]
    copy = own_copy(given, np.dtype(complex))
    np.testing.assert_array_equal(copy, given)
    assert not np.shares_memory(copy, given)
    assert np.shares_memory(np.asarray(jax.device_put(copy)), copy)
    assert own_copy(np.zeros((0, 4)), np.dtype(float)).shape == (0, 4)
    assert own_copy(np.array(2.0), np.dtype(float)) == 2.0
