"""Exponential windows that nobody told, from what they make of a mobility or an accelerance."""

import numpy as np
import pytest

from modalax.data import FRF
from modalax.identify import fit, residues
from modalax.identify.neighbourhood import residual_of
from modalax.identify.untold_window import untold_window
from modalax.model.modal import ModalModel, poles_from

DECAY = 3.9  # 2 % are left after 1 s
FREQUENCY, ZETA = [6.9, 43.2, 121.1, 237.3], 0.003


def cantilever(form: str, decay: float) -> FRF:
    """Hits of 1 s on a light structure through an exponential window, its lowest mode weak in accelerance."""
    rng = np.random.default_rng(1)
    shapes = [[2.0, 0.4, 0.9], [2.0, -1.3, -1.1], [2.0, 1.1, -1.2], [2.0, -0.5, 1.3]]
    model = ModalModel.from_real_modes(FREQUENCY, np.full(4, ZETA), shapes, np.ones(4), list("abc"))
    made = model.frf(np.arange(3.0, 301.0), form=form, inputs=["a"], added_decay=decay)
    size = 0.01 * np.sqrt(np.mean(np.abs(made.H) ** 2, axis=0) / 2)
    noise = rng.normal(size=made.H.shape) + 1j * rng.normal(size=made.H.shape)
    return made.replace(H=made.H + size * noise)


@pytest.mark.parametrize("form", ["mobility", "accelerance"])
def test_a_window_is_told_by_what_it_makes_of_accelerance(form):
    told = cantilever(form, DECAY)
    found = fit(told.replace(added_decay=0.0))
    assert any("exponential window that is not told" in note for note in found.notes)
    window = untold_window(found.frf, found.model, residual_of(found.frf, found.model))
    assert window is not None and abs(window.decay - DECAY) < 3 * window.std < DECAY
    model = residues(told, poles_from(FREQUENCY, np.full(4, ZETA)))
    assert untold_window(told, model, residual_of(told, model)) is None


def test_a_receptance_does_not_show_a_window():
    frf = cantilever("receptance", DECAY).replace(added_decay=0.0)
    found = fit(frf, refine=False)
    assert untold_window(frf, found.model, residual_of(frf, found.model)) is None
