"""Finite records and windows: which one, and how long, where their effects are alike or ripple over the lines."""

import numpy as np
import pytest
import scipy.linalg

from modalax import Measurement
from modalax.diagnose import diagnose
from modalax.diagnose.causes.damping import ModalDamping
from modalax.diagnose.causes.local import AddedMass, JointStiffness, TunedMass
from modalax.diagnose.causes.records import CUT, ExponentialWindow, Leakage
from modalax.diagnose.causes.scene import Scene
from modalax.model.examples import five_dof

FREQ = np.linspace(20.0, 66.0, 185)  # a quarter of a hertz apart
CAUSES = [Leakage(), ExponentialWindow(), TunedMass(), AddedMass(), ModalDamping(), JointStiffness()]


def measured(kernel, noise, seed=0):
    """Receptances of the five masses where the response of each mode has the transform ``kernel(s - pole)``."""
    structure = five_dof()
    M, C, K = (np.asarray(a) for a in (structure.M, structure.C, structure.K))
    w2, shapes = scipy.linalg.eigh(K, M)
    damping, s = np.diag(shapes.T @ C @ shapes), 2j * np.pi * FREQ
    H = np.zeros((len(FREQ), 5, 2), complex)
    for square, c, shape in zip(w2, damping, shapes.T, strict=True):
        pole = -c / 2 + 1j * np.sqrt(square - c**2 / 4)
        gain = (kernel(s - pole) - kernel(s - pole.conj())) / (2j * pole.imag)
        H += gain[:, None, None] * np.outer(shape, shape[[0, 3]])
    rng = np.random.default_rng(seed)
    sigma = noise * np.sqrt((np.abs(H) ** 2).mean(axis=0)) * np.ones(H.shape)
    H = H + sigma * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)) / np.sqrt(2)
    return Measurement(FREQ, H[None], variance=sigma[None] ** 2, outputs=structure.dofs, inputs=("1", "4"))


def scene_of(freq):
    one = ("1",)
    return Scene(freq, one, one, one, np.array([25.0, 50.0]), np.full(2, 0.01), np.ones(1), None)


@pytest.mark.parametrize("length", [pytest.param(0.613, marks=pytest.mark.slow), 1.213])
def test_a_record_that_ends_in_a_step_is_named_whatever_its_length(length):
    """The step leaves ripples that are much alike only for lengths within a tenth of a decay."""
    data = measured(lambda x: (1 - np.exp(-x * length)) / x, 0.02)
    answer = diagnose(data, five_dof(), causes=CAUSES).to_dict()
    assert answer["verdict"] == "named" and [c["name"] for c in answer["causes"]] == ["leakage"]
    told = answer["causes"][0]["parameters"]["record_length"]
    assert abs(told["value"] - length) < 4 * told["std"] < 0.02 * length


def test_decay_that_no_record_between_such_lines_would_bring_is_an_exponential_window():
    """A boxcar window on random force is the same to first order, but a record that long has lines closer together."""
    decay = 0.02
    answer = diagnose(measured(lambda x: 1 / (x + decay), 0.002), five_dof(), causes=CAUSES).to_dict()
    assert answer["verdict"] == "named" and [c["name"] for c in answer["causes"]] == ["exponential_window"]


def test_lengths_that_the_lines_do_not_show_are_less_likely():
    scene = scene_of(np.arange(20.0, 60.0, 0.25))
    likely = [Leakage().likely(np.array([1 / T]), scene) for T in (1.0, 4.0, 8.0, 40.0)]
    assert likely == pytest.approx([1.0, 1.0, 0.5, 0.1])


def test_a_step_is_looked_for_at_every_stage_of_the_decay():
    scene = scene_of(FREQ)
    place = Leakage().places(scene)[CUT]
    lengths = 1 / np.sort(Leakage().grid(scene, place)[:, 0])
    slow = 2 * np.pi * 25.0 * 0.01
    inside = lengths[(lengths > 1 / slow) & (lengths < 9.0 / slow)]
    assert np.abs(np.diff(inside)).max() <= 0.101 / slow


def test_no_minimum_is_looked_for_beside_a_record_after_whose_decay_nothing_is_cut_off():
    """A fit without leakage ends at a million seconds, and millions of ripples lie before that."""
    scene, slow = scene_of(FREQ), 2 * np.pi * 25.0 * 0.01
    place = Leakage().places(scene)[CUT]
    beside = {length: Leakage().nearby(np.array([1 / length]), place, scene) for length in (9 / slow, 11 / slow, 1e6)}
    assert len(beside[9 / slow]) > 200 and not len(beside[11 / slow]) and not len(beside[1e6])
