"""What a user may give by mistake is told in words, not by an error from deep inside."""

import jax
import numpy as np
import pytest
import scipy.sparse

import modalax
from modalax import identify, simulate
from modalax.model import ModalModel, Structure, cmif, frac, mac
from modalax.simulate.joints import CubicSpring

F = np.arange(5.0, 15.0, 0.1)
MODEL = ModalModel.from_real_modes([10.0], [0.01], [[1.0]], [1.0], ["a"])
FRF = MODEL.frf(F)
ONE = Structure(np.eye(1), np.eye(1), 1e4 * np.eye(1), ["a"])


def balance(joints):
    return simulate.harmonic_balance(ONE, joints, [["a"]], F, 1.0, inputs=["a"])


WRONG = {
    "fit of an array": (lambda: identify.fit(FRF.H), "fit needs an FRF, not an array"),
    "fit inside jit": (lambda: jax.jit(lambda H: identify.fit(FRF.replace(H=H)).order)(FRF.H), "not known inside jit"),
    "select inside jit": (
        lambda: jax.jit(lambda H: identify.select(identify.lscf(FRF.replace(H=H), 8)).poles)(FRF.H), "select chooses",
    ),
    "levels of an FRF": (lambda: identify.over_amplitude(FRF), "needs a Measurement of several runs, not a FRF"),
    "check of a model": (lambda: modalax.check(MODEL), "check needs an FRF, not a ModalModel"),
    "diagnosis the wrong way round": (lambda: modalax.diagnose(MODEL, FRF), "not a FRF; the measurement comes first"),
    "order that is no integer": (lambda: identify.lscf(FRF, 2.5), "orders is 2.5"),
    "poles in Hz": (lambda: identify.residues(FRF, [10.0]), "poles_from"),
    "residues of a measurement": (
        lambda: identify.residues(modalax.Measurement(F, FRF.H[None]), MODEL.poles), r"\.run\(0\)",
    ),
    "poles of an array": (lambda: identify.plscf(FRF.H, 8), "an estimator of poles needs an FRF, not an array"),
    "poles of several runs": (lambda: identify.lscf(modalax.Measurement(F, FRF.H[None]), 8), r"\.run\(0\)"),
    "refinement of an array": (lambda: identify.refine(FRF.H, MODEL), "refine needs an FRF"),
    "MAC of models": (lambda: mac(MODEL, MODEL), "a is a ModalModel; give its shapes"),
    "CMIF of an array": (lambda: cmif(FRF.H), "CMIF needs an FRF"),
    "FRAC of arrays": (lambda: frac(FRF.H, FRF.H), "needs an FRF, not an array"),
    "sparse matrices": (lambda: Structure(*3 * [scipy.sparse.eye(2)]), "toarray"),
    "a thing that is no number": (lambda: modalax.FRF(F, MODEL), "H is a ModalModel, no numbers"),
    "variance of another shape": (lambda: FRF.replace(variance=np.ones(3)), r"variance has shape \(3,\)"),
    "damping in per cent": (
        lambda: ModalModel.from_real_modes([10.0], [1.0], [[1.0]], [1.0], ["a"]), "0.01 for 1 %",
    ),
    "shapes in columns": (
        lambda: ModalModel.from_real_modes([10.0, 20.0], [0.01, 0.01], np.ones((3, 2)), [1.0, 1.0], ["a", "b", "c"]),
        "a row for each mode",
    ),
    "one frequency": (lambda: MODEL.frf(10.0), r"\[f\] for one"),
    "a joint without a list": (lambda: balance(CubicSpring(1.0)), r"write \[joint\]"),
    "a joint by name": (lambda: balance(["cubic_stiffness"]), "joints holds a str"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_a_mistake_is_told_in_words(case):
    call, words = WRONG[case]
    with pytest.raises(ValueError, match=words):
        call()


def test_a_text_is_one_name():
    model = ModalModel.from_real_modes([10.0], [0.01], [[1.0, 2.0]], [1.0], ["1:+Z", "2:+Z"])
    frf = model.frf(F)
    one = frf.pick(["2:+Z"], ["1:+Z"])
    names = {"outputs": "2:+Z", "inputs": "1:+Z"}
    structure = Structure(np.eye(2), np.eye(2), 1e4 * np.eye(2), ["1:+Z", "2:+Z"])
    for same in (frf.pick(**names), model.frf(F, **names), structure.frf(F, **names)):
        assert (same.outputs, same.inputs) == (one.outputs, one.inputs)
    joint = [CubicSpring(1.0)], [["1:+Z"]]
    assert simulate.harmonic_balance(structure, *joint, F[:3], 1.0, **names).inputs == ("1:+Z",)
    assert simulate.stepped_sine(structure, [], [], F[:3], 1.0, **names).outputs == ("2:+Z",)
    assert simulate.Bench(structure, fs=100.0, **names).inputs == ("1:+Z",)
