"""What a diagram hands over to the refinement: modes, and next to no poles that are none."""

import jax.numpy as jnp
import numpy as np
import pytest

from modalax.data import FRF
from modalax.data.datasets import uliege_plane
from modalax.identify import select
from modalax.identify.diagram import diagram, explained, standing
from modalax.identify.tables import PoleTable
from modalax.model import ModalModel

LOWER, UPPER = 50.0, 150.0


def table_of(modes, orders, seed=0):
    """Poles of modes that stay within a hundredth of a half-bandwidth, among others: a comb, anew at each order."""
    rng = np.random.default_rng(seed)
    width = max(orders)
    poles, valid = np.ones((len(orders), width), complex), np.zeros((len(orders), width), bool)
    for row, n in enumerate(orders):
        spread = LOWER + (UPPER - LOWER) * (np.arange(n - len(modes)) + rng.uniform()) / (n - len(modes))
        f = np.concatenate([np.asarray(modes) * (1 + 5e-5 * rng.normal(size=len(modes))), spread])
        poles[row, :n], valid[row, :n] = 2 * np.pi * f * (-0.005 + 1j), True
    return PoleTable(jnp.asarray(poles), jnp.asarray(valid), None, tuple(orders), "lscf")


def test_poles_that_spread_over_the_band_are_no_modes_however_dense_they_are():
    """At high orders one such pole continues another; of what lasts over the orders the modes alone stand still."""
    modes = np.array([61.3, 88.2, 131.9])
    table = table_of(modes, range(2 * len(modes), 161, 2))
    frf = FRF(np.linspace(LOWER, UPPER, 400), np.ones((400, 1, 1), complex))
    lasting = select(table)

    def others(selection):
        f = np.abs(np.asarray(selection.poles)) / (2 * np.pi)
        assert all(np.abs(f - mode).min() < 0.05 for mode in modes)
        return sum(np.abs(modes - one).min() > 0.05 for one in f)

    assert others(lasting) > 40
    assert others(standing(frf, table, lasting)) < 8


@pytest.fixture(scope="module")
def noisy():
    """Three modes at four points, of which 2 % is noise, and the poles."""
    rng = np.random.default_rng(4)
    model = ModalModel.from_real_modes(
        [61.3, 88.2, 131.9], [0.004, 0.006, 0.01], rng.normal(size=(3, 4)), np.ones(3), list("abcd")
    )
    freq = np.linspace(LOWER, UPPER, 401)
    H = np.asarray(model.frf(freq, form="accelerance", inputs=["a"]).H)
    size = 0.02 * np.sqrt(np.mean(np.abs(H) ** 2, axis=0) / 2)
    H = H + size * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape))
    return FRF(freq, H, form="accelerance", outputs=list("abcd"), inputs=["a"]), np.asarray(model.poles)


def test_higher_orders_are_asked_for_only_while_a_mode_is_missing(noisy):
    """Noise of 2 % hides none of them; poles a tenth of a half-bandwidth off do as well as the true ones."""
    frf, poles = noisy
    assert explained(frf, poles)
    assert explained(frf, poles - 0.1j * poles.real)
    assert not any(explained(frf, np.delete(poles, k)) for k in range(3))


def test_noise_that_falls_with_frequency_is_no_missing_mode(noisy):
    """A drift a thousand times the noise at the lowest line; without the second mode the FRFs stay unexplained."""
    frf, poles = noisy
    rng = np.random.default_rng(5)
    drift = 20 * (np.arange(1, 402) ** -1.0)[:, None, None] * rng.normal(size=(2, *frf.shape))
    frf = frf.replace(H=np.asarray(frf.H) + np.std(np.asarray(frf.H)) * (drift[0] + 1j * drift[1]))
    assert explained(frf, poles)
    assert not explained(frf, np.delete(poles, 1))


@pytest.mark.measured
def test_few_poles_of_the_measured_aeroplane_start_the_refinement(measured):
    """A quarter of the hits, 80 to 150 Hz, where ten modes are published: high orders make dozens of its misfit."""
    frf = uliege_plane().frf
    frf = frf.drop([name for k, name in enumerate(frf.inputs) if k % 4]).band(80.0, 150.0)
    _, selection = diagram(frf.transpose(), "plscf", None)
    found = np.abs(np.asarray(selection.poles)) / (2 * np.pi)
    published = np.array([87.852, 89.652, 97.071, 105.200, 118.013, 125.214, 125.584, 129.952, 135.276, 143.372])
    assert sum(np.abs(found / f - 1).min() < 3e-3 for f in published) >= 9
    assert len(found) <= 18
