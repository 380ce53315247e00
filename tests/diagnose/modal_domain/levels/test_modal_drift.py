"""A structure that changes from run to run: by how much its FRFs differ, in the band and beyond it."""

import numpy as np
import pytest
from chains_off import as_measured, chain_off, response, simulation

from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.levels.drift import by_run, drifts
from modalax.diagnose.modal_domain.modes.measured import identify
from modalax.diagnose.modal_domain.structure.coordinates import coordinates_of

LINES = np.linspace(12.0, 62.0, 400)  # below the fourth mode, just beyond the band, and the fifth
SHARES = (0.0, -0.015, -0.03)  # change of stiffness and, half as much, of damping from run to run


def drifting(levels):
    """The chain, 2 % off, as it softens from run to run."""
    M, C, K = chain_off(5, 0.02)
    every = [as_measured(response(M, C * np.sqrt(1 + x), K * (1 + x), LINES), LINES, k) for k, x in enumerate(SHARES)]
    return every[0].replace(
        H=np.concatenate([r.H for r in every]), variance=np.concatenate([r.variance for r in every]),
        level=np.array(levels),
    )  # fmt: skip


def test_a_shift_of_all_modes_moves_those_beyond_the_band_and_what_modes_contribute():
    runs = drifting([np.nan] * len(SHARES))
    c = coordinates_of(simulation(), runs.outputs, runs.inputs, 2 * np.pi * float(LINES[-1]))
    found = identify(runs, c)
    together, _ = drifts(by_run(np.asarray(runs.H), found.noise.sigma), found.modes, found.channels)
    assert together.together
    assert abs(2 * together.frequency - SHARES[-1]) < 4 * 2 * together.std + SHARES[-1] ** 2 / 2
    assert together.chi2 < 1.1 * np.asarray(runs.H).size * 2 * (1 - 1 / len(SHARES))


@pytest.mark.parametrize(
    "levels",
    [[np.nan] * 3, *(pytest.param(some, marks=pytest.mark.slow) for some in ([1.0, 2.0, 4.0], [2.0, 2.0, 2.0]))],
)
def test_what_a_drift_changes_is_predicted_for_each_run(levels):
    """Nothing but noise is left of any run; the drift had been named, and no run but the first was predicted."""
    found = diagnose_modes(drifting(levels), simulation())
    assert [c["name"] for c in found.causes] == ["time_varying"]
    drift = found.causes[0]["parameters"]["relative_stiffness_drift"]
    assert abs(drift["value"] - SHARES[-1]) < 4 * drift["std"]  # of the stiffness, not of its logarithm
    assert found.gain.chi2_before > 100 and found.gain.chi2_after < 1.2
    assert found.gain.held_out.endswith("the drift was fitted to all")
    assert not any(reason.startswith("nothing stands out") for reason in found.reasons)
