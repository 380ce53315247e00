"""Estimators without the noise bias of LSCF: exact without noise, right on average in it."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from modalax.identify import lscf
from modalax.identify.consistent import compensated, gtls, subspace
from modalax.identify.reweighted import reweighted
from modalax.model.examples import five_dof

STRUCTURE = five_dof()
TRUE = np.asarray(STRUCTURE.modal().poles)
CLEAN = STRUCTURE.frf(np.arange(200, 701, 2) * 0.1, inputs=["1"])
LEVEL = 0.25
# Uniform noise of 25 % on each part: of the definitions tried the one with which LSCF loses 83 % of mode 3's damping.
NOISY = CLEAN.replace(variance=jnp.abs(CLEAN.H) ** 2 * LEVEL**2 / 3)

ESTIMATORS = {
    "compensated": lambda f: compensated(f, 20, weights="variance"),
    "compensated, unit": lambda f: compensated(f, 20),
    "subspace": lambda f: subspace(f, 10, aperture=40, weights="variance"),
    "subspace, unit": lambda f: subspace(f, 10, aperture=40),
    "reweighted": lambda f: reweighted(f, 7),
    "gtls": lambda f: gtls(f, 8, weights="variance"),
}


def damping_error(poles, valid, stable=True):
    """Relative damping error of the pole next to each true one, shape (draw, mode)."""
    good = valid & (poles.real < 0) if stable else valid
    distance = np.where(good[:, :, None], np.abs(poles[:, :, None] - TRUE), np.inf)
    found = np.take_along_axis(poles, np.argmin(distance, axis=1), axis=1)
    assert np.all(np.abs(np.abs(found) / np.abs(TRUE) - 1) < 0.03)
    return -found.real / np.abs(found) / 0.02 - 1


def noisy_errors(estimate, count, stable=True):
    def one(key):
        a, b = jax.random.uniform(key, (2, *CLEAN.H.shape), minval=-1.0, maxval=1.0)
        noise = LEVEL * (CLEAN.H.real * a + 1j * CLEAN.H.imag * b)
        table = estimate(eqx.tree_at(lambda f: f.H, NOISY, CLEAN.H + noise))
        return table.poles[0], table.valid[0]

    poles, valid = jax.jit(lambda k: jax.lax.map(one, k))(jax.random.split(jax.random.key(4), count))
    return damping_error(np.asarray(poles), np.asarray(valid), stable)


def test_lscf_loses_most_of_the_damping_of_the_weak_mode():
    errors = noisy_errors(lambda f: lscf(f, 32), 40, stable=False)
    # The review reports -83 %; measured here -81 %.
    assert -0.90 < errors[:, 2].mean() < -0.70


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow if n.endswith("unit") else ()) for n in ESTIMATORS]
)
def test_the_weak_modes_damping_comes_back(name):
    errors = noisy_errors(ESTIMATORS[name], 40)
    error = errors.std(axis=0) / np.sqrt(len(errors))
    # A tenth of LSCF's bias; measured at most 5.4 % (mode 1); GTLS spreads about twice as much as the others.
    assert abs(errors[:, 2].mean()) < 0.083 + 2 * error[2]
    assert np.all(np.abs(errors.mean(axis=0)) < 0.083 + 2 * error)


EXACT = {
    "compensated": lambda f: compensated(f, 20, variance=1e-14 * jnp.mean(jnp.abs(f.H) ** 2)),
    "subspace": lambda f: subspace(f, 12, aperture=30, arc=0.6),
    "reweighted": lambda f: reweighted(f, 20, weights="unit", arc=0.6, iterations=2),
    "gtls": lambda f: gtls(f, 20, arc=0.6),
}


@pytest.mark.parametrize("name", EXACT)
def test_without_noise_the_modes_are_there(name):
    table = EXACT[name](CLEAN)
    errors = damping_error(np.asarray(table.poles), np.asarray(table.valid))
    # Measured: 2e-6 for compensated, whose variance cannot be zero; 1e-8 for subspace; 6e-14 for the others.
    assert np.abs(errors).max() < 1e-5


def test_table_has_a_row_an_order():
    table = subspace(CLEAN, [6, 10], aperture=24)
    assert table.orders == (6, 10)
    assert np.asarray(table.valid).sum(axis=1).tolist() == [6, 10]
    table = compensated(CLEAN, [8, 12], variance=1e-14)
    assert np.asarray(table.valid).sum(axis=1).tolist() == [8, 12]


def test_bad_input_is_said():
    with pytest.raises(ValueError, match="needs the noise variance"):
        compensated(CLEAN, 10)
    with pytest.raises(ValueError, match="aperture of at least 11"):
        subspace(CLEAN, 10, aperture=8)
