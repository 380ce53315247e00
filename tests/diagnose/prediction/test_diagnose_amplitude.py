"""The amplitude at which a balance of one harmonic closes, where there are several."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from modalax.diagnose.prediction.amplitude import amplitude

ROOTS = np.log([1.0, 1.02, 1.5])  # a balance that rises, falls and rises through 0


def balance(x):
    """A cubic in the logarithm, and a force."""
    return jnp.prod(jnp.stack([x - r for r in ROOTS]), axis=0) * 1e3, jnp.exp(x) + 0j


@partial(jax.jit, static_argnames="known")  # one program for all tests
def found_near(near, known):
    return amplitude(balance, jnp.zeros(1), near, known)


@pytest.mark.parametrize("root", range(3))
def test_a_motion_that_is_known_stays_at_its_own_root(root):
    near = np.exp(ROOTS[[root]])
    found = found_near(near, known=True)
    assert float(found.at[0]) == pytest.approx(ROOTS[root], abs=1e-9)
    others = np.delete(ROOTS, root)
    assert float(found.slope[0]) == pytest.approx(1e3 * np.prod(ROOTS[root] - others), rel=1e-6)


def test_a_motion_that_was_measured_is_one_at_which_the_balance_rises():
    near = np.exp(ROOTS[[1]]) * 1.1
    found = found_near(near, known=False)
    assert float(found.at[0]) in (pytest.approx(ROOTS[0], abs=1e-4), pytest.approx(ROOTS[2], abs=1e-4))
    assert float(found.slope[0]) > 0


def test_a_known_motion_far_from_any_root_is_searched_for():
    found = found_near(np.array([4.0]), known=True)
    assert float(found.at[0]) == pytest.approx(ROOTS[2], abs=1e-4)
