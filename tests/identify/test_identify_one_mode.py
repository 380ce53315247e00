"""Whether one mode is enough about a resonance: pairs that look like one peak, and single modes."""

import numpy as np
import pytest

from modalax.data import FRF
from modalax.identify import residues
from modalax.identify.best_poles import best_poles
from modalax.identify.neighbourhood import around, residual_of
from modalax.identify.one_mode import rest_of, second_mode
from modalax.model import ModalModel
from modalax.model.modal import poles_from

FREQ = np.arange(60.0, 141.0, 0.25)
WIDTH = 2.0  # half-power bandwidth of each mode of a pair [Hz]


def pair(apart, outputs, inputs, noise=1e-3, seed=0):
    """Two modes about 100 Hz, ``apart`` half-power bandwidths from each other, between two others."""
    rng = np.random.default_rng(seed)
    f = np.array([75.0, 100.0, 100.0 + apart * WIDTH, 130.0])[[0, 1, 3] if apart == 0 else [0, 1, 2, 3]]
    n = max(outputs, inputs)
    names = [str(k + 1) for k in range(n)]
    model = ModalModel.from_real_modes(f, WIDTH / 2 / f, rng.normal(size=(len(f), n)), np.ones(len(f)), names)
    H = np.array(model.frf(FREQ, outputs=names[:outputs], inputs=names[:inputs]).H)
    size = noise * np.sqrt(np.mean(np.abs(H) ** 2) / 2)
    return FRF(FREQ, H + size * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)), form="receptance")


def one_pole(frf):
    """A model with one mode in the place of the pair, at its best pole."""
    poles = np.array(poles_from([75.0, 100.2, 130.0], [WIDTH / 150, WIDTH / 200, WIDTH / 260]))
    for _ in range(3):
        model = residues(frf, poles)
        hood = around(frf, model, residual_of(frf, model), [1])
        poles[1] = best_poles(hood, hood.poles)[0][0]
    model = residues(frf, poles)
    return model, residual_of(frf, model)


@pytest.mark.parametrize(("outputs", "inputs"), [(5, 1), (4, 2), (2, 3)])
def test_two_modes_within_a_third_of_their_bandwidth_take_the_place_of_one(outputs, inputs):
    frf = pair(0.3, outputs, inputs)
    model, residual = one_pole(frf)
    poles = second_mode(frf, model, residual, 1)
    assert poles is not None
    assert np.sort(np.abs(poles)) / (2 * np.pi) == pytest.approx([100.0, 100.6], abs=0.05)


@pytest.mark.parametrize(("outputs", "inputs"), [(5, 1), (4, 2), (1, 1)])
def test_one_mode_is_enough_for_one(outputs, inputs):
    chances = []
    for seed in range(6):
        frf = pair(0.0, outputs, inputs, seed=seed)
        model, residual = one_pole(frf)
        rest = rest_of(around(frf, model, residual, [1], smooth=True))
        chances.append(rest.chance)
        assert second_mode(frf, model, residual, 1) is None
    assert min(chances) > 1e-4 and max(chances) > 0.2  # of six chances evenly from 0 to 1


def test_the_distance_of_two_is_read_off_one():
    """The mean square of the distances of a pair that is close, weighed by their residues."""
    frf = pair(0.03, 4, 1, noise=1e-8)
    model, residual = one_pole(frf)
    rest = rest_of(around(frf, model, residual, [1], smooth=True))
    true = np.asarray(poles_from([75.0, 100.0, 100.06, 130.0], WIDTH / 2 / np.array([75.0, 100.0, 100.06, 130.0])))
    R = np.asarray(residues(frf, true).residues)[1:3].reshape(2, -1)
    apart, whole = true[1:3] - np.asarray(model.poles)[1], R.sum(axis=0)
    expected = np.sum(apart**2 * (R @ whole.conj())) / np.sum(np.abs(whole) ** 2)
    assert rest.chance == 0 and rest.spread == pytest.approx(expected, rel=0.2)
