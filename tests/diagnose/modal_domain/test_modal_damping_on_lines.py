"""Hysteretic damping whose rates of decay are those of an impact window: lines tell them apart, modes do not."""

import chains_off
import numpy as np
import pytest

from modalax.diagnose.modal_domain.diagnosis import diagnose_modes

DECAY = 5.0  # 1/s


@pytest.mark.parametrize("hysteretic", [True, False])
def test_hysteretic_damping_that_decays_as_a_window_does_is_told_from_one(hysteretic):
    """All modes of a simulation that is hardly damped decay alike, by a complex stiffness or by a window."""
    M, C, K = chains_off.chain_off(5, 0.02)
    model = chains_off.simulation()
    freq = chains_off.FREQ
    s = 2j * np.pi * freq[:, None, None]
    if hysteretic:
        w, P = np.linalg.eigh(np.linalg.solve(np.diag(np.sqrt(np.diag(M))), K) / np.sqrt(np.diag(M)))
        shapes = P / np.sqrt(np.diag(M))[:, None]
        loss = M @ shapes @ np.diag(2j * DECAY * np.sqrt(w)) @ shapes.T @ M
        H = s**2 * np.linalg.inv(s**2 * M + K + loss)
    else:
        s = s + DECAY
        H = s**2 * np.linalg.inv(s**2 * M + 0.1 * s * C + K)
    data = chains_off.as_measured(H, freq, 5)
    answer = diagnose_modes(data, model.replace(C=0.1 * np.asarray(model.C))).to_dict()
    name = "structural_damping" if hysteretic else "exponential_window"
    assert (answer["verdict"], [c["name"] for c in answer["causes"]]) == ("named", [name])
