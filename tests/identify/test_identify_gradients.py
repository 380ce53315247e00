"""Derivatives of modal parameters with respect to every FRF sample, estimator by estimator, against differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from modalax.identify import (
    compensated,
    fdpi,
    fdpi_normal_modes,
    gtls,
    lsce,
    lscf,
    plscf,
    refine,
    residues,
    reweighted,
    subspace,
)
from modalax.model import ModalModel

MODEL = ModalModel.from_real_modes(
    [30.0, 37.0], [0.02, 0.015], [[1.0, 0.6, -0.4], [0.5, -1.0, 0.7]], [1.0, 2.0], list("abc")
)


@pytest.fixture(scope="module")
def noisy():
    """Without noise the poles hang on few directions of the data; with it on all."""
    return MODEL.frf(np.linspace(24, 44, 81), inputs=["a", "b"]).add_noise(jax.random.key(0), 0.02)


def of_table(table):
    """Logarithm of the frequency, and damping ratio, of the pole nearest the first mode."""
    away = jnp.where(table.valid[0], jnp.abs(table.poles[0] - MODEL.poles[0]), jnp.inf)
    pole = table.poles[0, jnp.argmin(away)]
    return jnp.stack([jnp.log(jnp.abs(pole)), -pole.real / jnp.abs(pole)])


def of_normal_modes(modes):
    return jnp.concatenate([jnp.log(modes.frequency_hz), modes.shapes.ravel()])


def of_model(model):
    shapes = model.shapes.ravel()
    return jnp.concatenate([jnp.log(model.frequency_hz), model.damping_ratio, shapes.real, shapes.imag])


ESTIMATES = {
    "lscf": lambda frf: of_table(lscf(frf, 6)),
    "lscf, aN": lambda frf: of_table(lscf(frf, 6, constraint="aN")),
    "lscf, norm": lambda frf: of_table(lscf(frf, 6, constraint="norm")),
    "lscf, moments": lambda frf: of_table(lscf(frf, 6, solver="moments")),
    "plscf": lambda frf: of_table(plscf(frf, 3)),
    "lsce": lambda frf: of_table(lsce(frf, 8)),
    "fdpi, as many as outputs": lambda frf: of_table(fdpi(frf, 3)),
    "fdpi, fewer": lambda frf: of_table(fdpi(frf, 2)),
    "fdpi, more": lambda frf: of_table(fdpi(frf, 4)),
    "fdpi_normal_modes": lambda frf: of_normal_modes(fdpi_normal_modes(frf, 2)),
    "compensated": lambda frf: of_table(compensated(frf, 8)),
    "subspace": lambda frf: of_table(subspace(frf, 6, aperture=12)),
    "gtls": lambda frf: of_table(gtls(frf, 4)),
    "reweighted": lambda frf: of_table(reweighted(frf, 4, iterations=3)),
    "residues": lambda frf: of_model(residues(frf, MODEL.poles))[4:],
    "refine": lambda frf: of_model(refine(frf, MODEL).model),
}


SLOW = {
    "refine",
    "lscf, aN",
    "lscf, norm",
    "lscf, moments",
    "fdpi, fewer",
    "fdpi, more",
    "reweighted",
    "residues",
}  # to compile


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow if n in SLOW else ()) for n in ESTIMATES])
def test_derivative_with_respect_to_the_frf(name, noisy):
    """Forward and reverse mode against central differences, along one direction over all samples.

    In reverse one sum of all values, weighted at random, shows an error of any of them.
    """
    rng = np.random.default_rng(1)
    direction = jnp.abs(noisy.H).mean() * (rng.normal(size=noisy.H.shape) + 1j * rng.normal(size=noisy.H.shape))

    def estimate(H):
        return ESTIMATES[name](noisy.replace(H=H))

    @jax.jit
    def along(step):
        H = noisy.H + step * direction
        value, push = jax.linearize(estimate, H)  # traced once for both modes
        weights = np.random.default_rng(2).uniform(0.5, 1.5, len(value))
        (gradient,) = jax.linear_transpose(push, H)(jnp.asarray(weights))
        return value, push(direction), jnp.sum((gradient * direction).real), weights

    step = 1e-4 if name == "refine" else 1e-5  # a search ends within 1e-10 of the maximum, not at rounding
    _, forward, reverse, weights = along(0.0)
    numeric = (along(step)[0] - along(-step)[0]) / (2 * step)
    # Measured: 6e-6 for the smallest singular vector, 1e-6 and less for the others.
    np.testing.assert_allclose(forward, numeric, rtol=2e-5, atol=1e-8)
    np.testing.assert_allclose(reverse, weights @ forward, rtol=1e-7, atol=1e-11)
    assert np.abs(np.asarray(forward)).max() > 1e-4
