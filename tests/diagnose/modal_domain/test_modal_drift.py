"""A structure that changes from run to run: by how much its FRFs differ, in the band and beyond it."""

import numpy as np
from chains_off import as_measured, chain_off, response, simulation

from modalax.diagnose.modal_domain.coordinates import coordinates_of
from modalax.diagnose.modal_domain.levels.drift import by_run, drifts
from modalax.diagnose.modal_domain.measured import identify

LINES = np.linspace(12.0, 62.0, 400)  # below the fourth mode, just beyond the band, and the fifth
SHARES = (0.0, -0.015, -0.03)  # change of stiffness and, half as much, of damping from run to run


def test_a_shift_of_all_modes_moves_those_beyond_the_band_and_what_modes_contribute():
    M, C, K = chain_off(5, 0.02)
    every = [as_measured(response(M, C * np.sqrt(1 + x), K * (1 + x), LINES), LINES, k) for k, x in enumerate(SHARES)]
    runs = every[0].replace(
        H=np.concatenate([r.H for r in every]), variance=np.concatenate([r.variance for r in every]),
        level=np.full(len(every), np.nan),
    )  # fmt: skip
    c = coordinates_of(simulation(), runs.outputs, runs.inputs, 2 * np.pi * float(LINES[-1]))
    found = identify(runs, c)
    together, _ = drifts(by_run(np.asarray(runs.H), found.noise.sigma), found.modes, found.channels)
    assert together.together
    assert abs(2 * together.frequency - SHARES[-1]) < 4 * 2 * together.std + SHARES[-1] ** 2 / 2
    assert together.chi2 < 1.1 * np.asarray(runs.H).size * 2 * (1 - 1 / len(every))
