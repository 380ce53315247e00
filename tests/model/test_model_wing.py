"""A measured flying wing matched to its finite-element model, by the script that tells it."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

SCRIPT = Path(__file__).parents[2] / "experiments" / "measured" / "wing.py"


@pytest.mark.measured
def test_sensors_meet_nodes_and_modes_their_partners(measured):
    spec = importlib.util.spec_from_file_location("wing", SCRIPT)
    assert spec is not None and spec.loader is not None
    wing = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(wing)
    folder = measured / "nastran" / "mAEWing2_gvt"
    if not folder.is_dir():
        pytest.skip("the flying wing is not among the measured data")
    _, _, matched, _, _, found = wing.compare(folder)
    # The deck lists its sensors in the order of the test's.
    assert matched.nodes[:12] == tuple(str(7710001 + k) for k in range(12))
    assert np.nanmax(matched.distance) < 0.05
    np.testing.assert_allclose(found.frequency_hz, [5.81, 8.23, 12.46, 15.43, 19.01, 24.32, 26.43, 33.92])
    assert found.pair_mac[0] > 0.95 and found.pair_mac[4] > 0.95 and found.pairs[2] == -1
