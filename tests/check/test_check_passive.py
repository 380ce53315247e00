"""Drive points and other FRFs against what passive structures can show."""

import numpy as np
import pytest
from test_check_words import FREQ, accelerance, chain

from modalax.check.passive import passive_misfit

SIGMA = 1e-3


def misfit(H, power=2, zeta=0.01):
    w = chain()[0]
    poles = w * (-zeta + 1j * np.sqrt(1 - zeta**2))
    return passive_misfit(FREQ, H, np.full(len(FREQ), SIGMA * np.abs(accelerance()).mean()), poles, power)


def test_a_drive_point_is_passive_in_its_form_and_sign_alone():
    own = accelerance()[:, 0, 0]
    assert misfit(own) < 0.05
    assert min(misfit(-own), misfit(own, power=1), misfit(own, power=0)) > 50 * misfit(own)


@pytest.mark.parametrize("o", [1, 3, 4])
def test_a_transfer_function_is_not_passive(o):
    assert misfit(accelerance()[:, o, 0]) > 50 * misfit(accelerance()[:, 0, 0])
