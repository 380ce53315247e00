"""FRFs that are not of the form they are called: what the modes of a fit say of it."""

import numpy as np
import pytest

from modalax.data import FRF
from modalax.identify import residues, wrong_form
from modalax.identify.wrong_form import form_notes, turned_outputs
from modalax.model.modal import ModalModel

FREQ = np.arange(5.0, 125.0, 0.5)
F, ZETA = np.array([18.0, 41.0, 77.0, 103.0]), np.full(4, 0.01)


def measured(form="accelerance"):
    shapes = np.random.default_rng(2).normal(size=(4, 4))
    model = ModalModel.from_real_modes(F, ZETA, shapes, np.ones(4), ["a", "b", "c", "d"])
    return model, model.frf(FREQ, form=form, inputs=["a"])


@pytest.mark.parametrize(("form", "said"), [("accelerance", False), ("mobility", True), ("receptance", False)])
def test_all_frfs_of_another_form(form, said):
    """Two derivatives turn residues by 180 degrees, which a drive point alone tells."""
    model, frf = measured(form)
    frf = FRF(FREQ, frf.H, form="accelerance", outputs=frf.outputs, inputs=frf.inputs)
    notes = form_notes(frf, residues(frf, model.poles), np.ones(4), 0.0)
    assert bool(notes) == said and all("these FRFs are mobility" in note for note in notes)
    assert form_notes(frf, residues(frf, model.poles), np.array([1.0, 1.0, 0.2, 0.0]), 0.0) == []


def test_outputs_of_another_form_are_named():
    model, frf = measured()
    H = np.array(frf.H)
    H[:, 2] = np.asarray(measured("mobility")[1].H)[:, 2]
    mixed = FRF(FREQ, H, form="accelerance", outputs=frf.outputs, inputs=frf.inputs)
    fitted = residues(mixed, model.poles)
    assert turned_outputs(fitted, np.ones(4, bool)).tolist() == [False, False, True, False]
    (note,) = form_notes(mixed, fitted, np.ones(4), 0.0)
    assert "at c are turned" in note and "--without" in note


def test_complex_modes_and_delays_are_no_other_form():
    model, frf = measured()
    late = frf.replace(H=frf.H * np.exp(-2j * np.pi * FREQ * 3e-3)[:, None, None])
    assert not turned_outputs(residues(late, model.poles), np.ones(4, bool)).any()
    shapes = model.shapes + 0.5j * np.random.default_rng(0).normal(size=model.shapes.shape)
    assert not turned_outputs(model.replace(shapes=shapes), np.ones(4, bool)).any()


def test_force_over_motion_is_told(monkeypatch):
    """The poles of the inverse stand for those of its diagram, which would be compiled for this test alone."""
    model, frf = measured()
    monkeypatch.setattr(wrong_form, "diagram", lambda *_: (None, model))
    inverse = FRF(FREQ, 1 / frf.H, form="accelerance", outputs=frf.outputs, inputs=frf.inputs)
    (note,) = form_notes(inverse, residues(inverse, model.poles), np.ones(4), 0.9)
    assert "force over motion" in note
    assert form_notes(frf, residues(frf, model.poles), np.ones(4), 0.9) == []
