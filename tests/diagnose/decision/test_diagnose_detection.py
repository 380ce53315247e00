"""The chance, under noise alone, of what the screening saw."""

import numpy as np

from modalax.diagnose.causes.local import JointStiffness
from modalax.diagnose.causes.missing_modes import MissingMode
from modalax.diagnose.causes.scene import Place
from modalax.diagnose.decision.detection import WHEREABOUTS, _pattern_p, detect
from modalax.diagnose.decision.omnibus import Omnibus
from modalax.diagnose.screening.patterns import low_rank, settled_rank
from modalax.diagnose.screening.screen import Trial
from modalax.diagnose.screening.sensitivities import Residual


def test_effects_that_overflow_are_left_out_of_the_count_of_tests():
    """Wrong units drive the modes of a simulation with claimed errors so far that some effect is infinite there."""
    D = np.random.default_rng(3).normal(size=(3, 40))
    side = Residual(np.zeros((2, 1, 20)), np.zeros((0, 2, 1, 20)), np.zeros((0, 0)))
    quiet = Omnibus(1.0, 0.0, "", (0.0, 0.0))

    def found(directions):
        t = Trial(JointStiffness(), Place(("1",), (0, -1, 0)), 16.0, 4.0, np.ones(1), direction=directions, trials=3)
        return detect([t], {True: side, False: side}, quiet)

    spoilt = np.concatenate([D, np.full((1, 40), np.nan)])
    assert found(spoilt).p_value == found(D).p_value
    assert 0 < found(np.full((1, 40), np.inf)).p_value <= found(D).p_value < 0.01


def test_the_chance_of_a_missing_mode_in_noise_holds_however_unlike_the_channels_noise_is():
    """The bound is that of channels alike; 1500 draws each with up to 12 x 3 channels were 0.8 to 1.6 % below 2 %."""
    rng, below = np.random.default_rng(4), 0
    for _ in range(500):
        gram = np.exp(1.5 * rng.normal(size=(7, 2)))[..., None, None]
        right = (np.sqrt(gram[..., 0, 0]) * rng.normal(size=(7, 2)))[..., None]
        sizes = settled_rank(low_rank(right / gram[..., 0], gram), gram, right)
        gain = 2 * np.sum(sizes * right) - np.sum(sizes**2 * gram[..., 0])
        t = Trial(MissingMode(), Place(()), float(gain), np.nan, np.ones(3), extra=np.moveaxis(sizes, -1, 0))
        below += _pattern_p(t, 1.0, 0.0) < 0.02 * WHEREABOUTS
    assert 2 <= below <= 20
