"""Dampers at a place couple modes: they are ranked by the modes that each would give."""

import numpy as np
import pytest
from chains_off import DOFS, FREQ, as_measured, chain_off, response, simulation

from modalax.diagnose.deadline import Deadline
from modalax.diagnose.modal_domain.screen import finite
from modalax.diagnose.modal_domain.stage import run_stage


@pytest.mark.parametrize(("where", "c"), [(0, 300.0), (1, 120.0), (2, 300.0), (4, 120.0)])
def test_a_strong_damper_ranks_first_before_any_fit(where, c):
    """Mode by mode up to eleven of the 15 places had ranked before that of a damper of a fifth of critical."""
    M, C, K = chain_off(3, 0.003)
    C = C + c * np.diag(np.arange(5) == where)
    measurement = as_measured(response(M, C, K, FREQ), FREQ, 3)
    stage = run_stage(measurement, simulation(), Deadline(), lambda slug: slug == "local_damper", lambda text: None)
    dampers = [x for x in stage.candidates if x.slug == "local_damper"]
    assert len(dampers) == 15  # to ground, and between any two
    distance, size = finite(stage.setting, dampers)
    k = int(np.argmin(distance))
    assert dampers[k].where == (DOFS[where],)
    assert 0.5 * c < size[k] * dampers[k].scale < 1.5 * c
