"""Kinds of causes among which something of the structure is named by default; among all in the slow run."""

import pytest

FEW = frozenset({
    "added_mass", "joint_stiffness", "local_damper", "channel_gain", "channel_sign", "channel_swap", "time_delay",
    "element_group", "element_group_mass",
})  # fmt: skip
FEW_OR_ALL = pytest.mark.parametrize(
    "wanted",
    [pytest.param(FEW.__contains__, id="few"), pytest.param(lambda _: True, id="all", marks=pytest.mark.slow)],
)
