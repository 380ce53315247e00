"""Answers are given again for equal arguments, and for no others."""

from dataclasses import dataclass

import numpy as np
import pytest

from modalax._numerics.remembered import remembered


@dataclass(frozen=True)
class Pair:
    name: str
    values: np.ndarray


def counted(count=2):
    calls = []

    @remembered(count)
    def total(*args, **kwargs):
        calls.append(args)
        return [len(calls)]

    return total, calls


def test_equal_arguments_give_the_same_answer():
    total, calls = counted()
    first = total(Pair("a", np.arange(3.0)), [1, 2.0, None], mass=True)
    assert total(Pair("a", np.arange(3.0)), [1, 2.0, None], mass=True) is first
    assert len(calls) == 1


VALUES = np.arange(3.0)


@pytest.mark.parametrize(
    "other",
    [
        Pair("b", np.arange(3.0)),
        Pair("a", np.arange(3)),
        Pair("a", np.arange(3.0)[:, None]),
        Pair("a", -np.arange(3.0)),
    ],
)
def test_arguments_that_differ_in_anything_give_another(other):
    total, calls = counted()
    assert total(Pair("a", VALUES)) is not total(other)
    assert len(calls) == 2


def test_lists_of_other_shape_are_other_arguments():
    total, calls = counted(9)
    for args in ((["a", "b"],), (["ab"],), (["a"], "b"), ([["a"], "b"],)):
        total(*args)
    assert len(calls) == 4


def test_only_the_last_answers_are_kept():
    total, calls = counted(2)
    for k in (0, 1, 0, 2, 0, 1):
        total(np.array([k]))
    assert len(calls) == 4  # 1 was forgotten for 2, as 0 had been asked for since


def test_other_arguments_are_refused():
    total, _ = counted()
    with pytest.raises(TypeError, match="not remembered by a set"):
        total({1, 2})
