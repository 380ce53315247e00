"""Records of hits that end before the structure has come to rest: poles stay, residues are turned."""

import numpy as np
import pytest

from modalax import FRF, ModalModel, Structure, identify
from modalax.identify.cut_record import cut_notes, is_cut, record_length

LENGTH = 0.5
FREQUENCY, DAMPING = np.array([10.7, 67.1, 151.3]), np.array([0.003, 0.003, 0.004])
SHAPES = np.array([[0.2, 0.6, 1.0], [0.7, 0.9, -1.0], [0.9, -0.5, 1.0]])
NAMES = ("1", "2", "3")


def structure(shapes=SHAPES, mass=0.4):
    return ModalModel.from_real_modes(FREQUENCY, DAMPING, shapes, np.full(3, mass), NAMES)


def cut_off(model):
    """The model with the residues that a record of this length has."""
    return model.replace(
        participation=np.asarray(model.participation) * (1 - np.exp(np.asarray(model.poles) * LENGTH))[:, None]
    )


def hits(seed=0):
    """Transform of the impulse response at 3, cut off, with noise."""
    fs, rng = 1024.0, np.random.default_rng(seed)
    t = np.arange(int(fs * LENGTH)) / fs
    model = structure()
    h = 2 * np.real(
        np.einsum("rt,roi->toi", np.exp(np.outer(np.asarray(model.poles), t)), np.asarray(model.residues)[:, :, 2:])
    )
    H = np.fft.rfft(h, axis=0)[:100] / fs
    sigma = 1e-3 * np.abs(H).mean()
    H = H + sigma / np.sqrt(2) * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape))
    return FRF(np.arange(100) / LENGTH, H, variance=np.full(H.shape, sigma**2), outputs=NAMES, inputs=NAMES[2:])


def test_a_fit_tells_that_its_modal_masses_are_those_of_records_cut_off_and_by_how_much():
    fit = identify.fit(hits(), band=(2.0, 190.0))
    (note,) = [note for note in fit.notes if "end too early" in note]
    assert "records of 0.5 s" in note and "of the slowest mode 90 % is left" in note
    which = np.asarray(fit.inside)
    mass, poles = np.asarray(fit.model.normalised().modal_mass())[which], np.asarray(fit.model.poles)[which]
    assert np.abs(mass[0] - 0.4) > 0.1
    np.testing.assert_allclose((mass * (1 - np.exp(poles * LENGTH)))[0], 0.4, rtol=0.05)


def test_records_that_last_until_rest_are_none_of_these():
    lines = FRF(np.arange(1, 100) / LENGTH, np.ones((99, 3, 3), complex), outputs=NAMES, inputs=NAMES)
    assert cut_notes(lines, structure(), np.ones(3)) == []
    (note,) = cut_notes(lines, cut_off(structure()), np.ones(3))
    assert "exp(pole x length of the record)" in note
    assert cut_notes(lines, cut_off(structure()), np.zeros(3)) == []
    window = lines.replace(added_decay=3.0)
    assert cut_notes(window, cut_off(structure()), np.ones(3)) == []


@pytest.mark.parametrize("seed", range(20))
def test_complex_modes_are_not_taken_for_it(seed):
    rng = np.random.default_rng(seed)
    n = 5
    stiffness, mass = rng.uniform(2e3, 6e3, n), rng.uniform(0.5, 2.0, n)
    chain = np.eye(n) - np.eye(n, k=1)
    dampers = np.where(rng.random(n) < 0.4, rng.uniform(1.0, 6.0, n), 0.02)  # some far stronger than the others
    K, C = (chain @ np.diag(values) @ chain.T for values in (stiffness, dampers))
    model = Structure(np.diag(mass), C, K).modal()
    factor = 1 - np.exp(np.asarray(model.poles) * rng.uniform(0.1, 2.0))
    assert not is_cut(np.asarray(model.residues)[:, :, :1], factor)


def test_lines_of_no_transform_tell_no_length():
    assert record_length(np.arange(20, 60) * 0.25) == pytest.approx(4.0)
    assert record_length(np.arange(20, 60) * 0.25 + 0.1) is None
    assert record_length(np.geomspace(10, 20, 30)) is None
    assert record_length(np.array([1.0, 2.0])) is None
