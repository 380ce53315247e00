"""Kinds of causes among which one is named by default; among all in the slow run."""

from collections.abc import Collection

import pytest

FEW = frozenset({
    "added_mass", "joint_stiffness", "local_damper", "channel_gain", "channel_sign", "channel_swap", "time_delay",
    "element_group", "element_group_mass",
})  # fmt: skip


def among(some: Collection[str]) -> pytest.MarkDecorator:
    """Ask about some kinds by default, about all in the slow run."""
    few = pytest.param(some.__contains__, id="few")
    return pytest.mark.parametrize("wanted", [few, pytest.param(lambda _: True, id="all", marks=pytest.mark.slow)])


def few_or_all(*more: str) -> pytest.MarkDecorator:
    """Ask about the few and about ``more``, which stand for each other; about all in the slow run."""
    return among(FEW.union(more))


FEW_OR_ALL = few_or_all()
