"""What is dropped and what error bars know, on results of a refinement made by hand."""

import jax.numpy as jnp
import numpy as np
import pytest

from modalax.identify import Refined
from modalax.identify.disagreement import Spread
from modalax.identify.flags import stands_for_two
from modalax.identify.one_mode import Rest
from modalax.identify.quality import ModeQuality
from modalax.identify.record_kind import Record
from modalax.identify.settle import at_bound, with_misfit, with_record, with_seconds
from modalax.model import ModalModel

FREQ = np.linspace(10, 60, 101)


def refined(zeta, std):
    n = len(zeta)
    model = ModalModel.from_real_modes(np.linspace(20, 50, n), zeta, np.ones((n, 2)), np.ones(n), ["a", "b"])
    size = jnp.full(n, 1e-3)
    return Refined(
        model=model, frequency_std_hz=size, damping_std=jnp.asarray(std), shape_std=jnp.zeros((n, 2), complex),
        modal_mass_std=None, covariance=jnp.diag(jnp.full(2 * n, 1e-8)), evidence=jnp.full(n, 1e5),
        noise_scale=jnp.array(1.0), chi2=jnp.array(1.0), dof=jnp.array(1.0), whiteness=jnp.array(0.5),
        log_likelihood=jnp.array(0.0), residual=jnp.zeros((101, 2, 1), complex), success=jnp.array(True),
        reason_code=jnp.array(0), steps=jnp.array(1),
    )  # fmt: skip


def spread(error, chance):
    return Spread(np.array([0.1, -0.1]), np.array([0.01, 0.01]), (0.1, 0.1), error, chance)


def quality(chance):
    still = Spread(np.zeros(4), np.ones(4), (0.0, 0.0), (0.0, 0.0), 1.0)
    return ModeQuality(1e4, 50.0, 1.0, 100.0, 2.0, still, spread((0.07, 0.02), chance), None)


def test_modes_without_damping_or_deviation_are_at_a_bound():
    result = refined([1e-7, 0.01, 0.01, 1e-6], [1e-4, 1e-4, np.nan, 1e-4])
    frf = result.model.frf(FREQ, inputs=["a"])
    # Half a bandwidth of the last is 5e-5 Hz where lines are 0.5 Hz apart.
    assert at_bound(frf, result).tolist() == [True, False, True, True]


@pytest.mark.parametrize("chance", [1e-9, 0.3])
def test_error_bars_know_of_inputs_that_disagree(chance):
    result = with_misfit(refined([0.01], [1e-4]), [quality(chance)])
    if chance < 1e-4:
        assert float(result.frequency_std_hz[0]) == pytest.approx(0.07)
        assert float(result.damping_std[0]) == pytest.approx(np.hypot(0.02, 0.01 * 0.07) / 20)
        assert float(result.covariance[0, 0]) == pytest.approx(1e-8 * 70**2)
    else:
        assert float(result.frequency_std_hz[0]) == pytest.approx(1e-3)


@pytest.mark.parametrize(("modes", "told"), [(1, False), (2, True)])
def test_inputs_that_disagree_by_all_modes_together_do_so_for_each(modes, told):
    """A chance of 0.001 is none; twice in one test it is."""
    result = with_misfit(refined([0.01] * modes, [1e-4] * modes), [quality(1e-3)] * modes)
    assert np.asarray(result.frequency_std_hz) == pytest.approx([0.07 if told else 1e-3] * modes)


@pytest.mark.parametrize("probability", [1.0, 0.25])
def test_error_bars_know_what_the_window_of_a_record_adds(probability):
    record = Record("hann", 2.0, np.array([20.0, np.nan]), np.array([0.004, np.nan]), probability)
    result = with_record(refined([0.01, 0.01], [1e-4, 1e-4]), record)
    widened = np.sqrt(1e-8 + probability * 0.006**2)
    assert np.asarray(result.damping_std).tolist() == pytest.approx([widened, 1e-4])


@pytest.mark.parametrize(("chance", "disagree", "told"), [(1e-9, 0.3, True), (1e-9, 1e-9, False), (0.1, 0.3, False)])
def test_error_bars_reach_both_modes_that_one_may_stand_for(chance, disagree, told):
    """Two modes 0.3 Hz from the one found; outputs that disagree on it, or chance, would explain as much."""
    apart = Rest(chance, 0.02, 1.0, complex(-((2 * np.pi * 0.3) ** 2)))
    q = quality(disagree)._replace(rest=apart)
    assert stands_for_two(q, 0.2) is told
    result = with_seconds(refined([0.01], [1e-4]), [q], np.array([stands_for_two(q, 0.2)]))
    widened = np.hypot(1e-3, 0.3) if told else 1e-3
    assert float(result.frequency_std_hz[0]) == pytest.approx(widened)
    assert float(result.damping_std[0]) == pytest.approx(np.hypot(1e-4, 0.3 / 20) if told else 1e-4)
