"""Two small things that are wrong of an exact chain, against elements that are all off by a thousandth."""

import numpy as np
import pytest
from chains_off import FREQ, MASSES, SPRINGS, ZETA, as_measured, chain_off, matrices, response, simulation

from modalax.diagnose.deadline import NEVER
from modalax.diagnose.modal_domain.claimed_modes import few_causes_near
from modalax.diagnose.modal_domain.stage import run_stage


@pytest.mark.parametrize("few", [True, False])
def test_a_few_causes_come_near_only_where_all_else_is_exact(few):
    M, C, K = matrices(MASSES, SPRINGS, ZETA) if few else chain_off(101, 0.001)
    if few:
        b = np.eye(5)[1] - np.eye(5)[3]
        M, K = M + 1e-3 * np.outer(np.eye(5)[2], np.eye(5)[2]), K + 60.0 * np.outer(b, b)
    stage = run_stage(
        as_measured(response(M, C, K, FREQ), FREQ, 5), simulation(), NEVER, lambda _: True, lambda _: None
    )
    assert stage is not None and few_causes_near(stage, NEVER) is few
