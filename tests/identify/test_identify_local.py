"""Modes fitted where they dominate, for rows that contradict each other."""

import jax.numpy as jnp
import numpy as np
import pytest

from modalax.data import FRF
from modalax.identify import refine, residues
from modalax.identify.local import fit_where_dominant
from modalax.identify.refine import CONTRADICTION
from modalax.model import ModalModel

FREQ = np.linspace(40, 60, 401)
LOUD = 6  # rows in which the second mode is thirty times what it is in others, and lower by one half-bandwidth
FREQUENCY, DAMPING = np.array([45.0, 50.0, 57.0]), np.array([0.01, 0.002, 0.01])


def rows(shift):
    """Thirty hits on one accelerometer; the relative change of the second frequency in the loud ones is given."""
    rng = np.random.default_rng(5)
    shapes = rng.uniform(0.5, 1.0, (3, 30))
    shapes[1, :LOUD] *= 30.0
    parts = []
    for change in (1 + shift, 1.0):
        model = ModalModel.from_real_modes(
            FREQUENCY * np.array([1.0, change, 1.0]), DAMPING, shapes, np.ones(3), [str(k) for k in range(30)]
        )
        parts.append(model.frf(FREQ, outputs=model.outputs[:1]).H)
    H = jnp.concatenate([parts[0][..., :LOUD], parts[1][..., LOUD:]], axis=2)
    noise = rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)
    size = 1e-3 * jnp.sqrt(jnp.mean(jnp.abs(H) ** 2, axis=0))
    return FRF(FREQ, H + size * noise, outputs=["0"], inputs=[str(k) for k in range(30)]), model


def unexplained(frf, model):
    made = model.frf(frf.freq, form=frf.form, outputs=frf.outputs, inputs=frf.inputs).H
    return float(jnp.sum(jnp.abs(frf.H - made) ** 2) / jnp.sum(jnp.abs(frf.H) ** 2))


pytestmark = pytest.mark.slow  # for what they compile


@pytest.fixture(scope="module")
def contradicting():
    frf, model = rows(-0.002)
    quiet = refine(frf, residues(frf, model.poles), weights=jnp.abs(frf.H))  # every row has as much to say
    return frf, quiet, fit_where_dominant(frf, quiet, residuals="complex", real_modes=False)


def test_loud_rows_are_explained(contradicting):
    frf, quiet, settled = contradicting
    assert unexplained(frf, settled.model) < 0.2 * unexplained(frf, quiet.model)
    assert int(settled.reason_code) == CONTRADICTION
    assert bool(settled.success)


def test_only_modes_that_gain_move(contradicting):
    _, quiet, settled = contradicting
    change = np.abs(np.asarray(settled.model.frequency_hz / quiet.model.frequency_hz) - 1)
    assert change[1] > 2e-4
    assert change[[0, 2]].max() < 1e-12
    loud = 50.0 * 0.998
    assert abs(float(settled.model.frequency_hz[1]) - loud) < 0.2 * abs(50.0 - loud)


def test_deviation_knows_of_the_rows(contradicting):
    """Nearly all that is known of the second mode comes from six rows that agree, the others being 0.1 Hz off."""
    _, quiet, settled = contradicting
    assert float(settled.frequency_std_hz[1]) > 3 * float(quiet.frequency_std_hz[1])
    assert float(settled.frequency_std_hz[1]) < 0.2
    assert float(jnp.sqrt(settled.covariance[2, 2])) == pytest.approx(
        float(settled.frequency_std_hz[1] / settled.model.frequency_hz[1]), rel=1e-9
    )


def test_other_modes_are_not_bent_by_the_loud_one(contradicting):
    """Their shapes at the loud rows; a whole-band fit that leaves much of the loud mode there is off by their size."""
    _, quiet, settled = contradicting
    true = np.asarray(rows(-0.002)[1].residues)[[0, 2], 0, :LOUD]

    def off(model):
        return np.abs(np.asarray(model.residues)[[0, 2], 0, :LOUD] / true - 1).max()

    assert off(quiet.model) > 1.0
    assert off(settled.model) < 0.7


def test_nothing_moves_where_rows_agree():
    frf, model = rows(0.0)
    result = refine(frf, residues(frf, model.poles))
    assert fit_where_dominant(frf, result, residuals="complex", real_modes=False) is result
