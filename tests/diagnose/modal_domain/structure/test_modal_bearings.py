"""Elements that end at a bearing, a roller or a clamp are read off stiffness and mass as those between free nodes."""

import numpy as np
import pytest
import scipy.linalg

from modalax.data import Measurement
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.structure.nodes import nodes_of
from modalax.diagnose.modal_domain.structure.parts import parts_of
from modalax.model import Structure

AXES = "X", "Z", "RY"


def element(length, stiffness, turned):
    """Stiffness and consistent mass of a plane beam over X, Z, RY of its two ends; RY turns Z towards X."""
    L, EI = length, stiffness
    bend = [[12, 6 * L, -12, 6 * L], [6 * L, 4 * L * L, -6 * L, 2 * L * L], [-12, -6 * L, 12, -6 * L],
            [6 * L, 2 * L * L, -6 * L, 4 * L * L]]  # fmt: skip
    heavy = [[156, 22 * L, 54, -13 * L], [22 * L, 4 * L * L, 13 * L, -3 * L * L], [54, 13 * L, 156, -22 * L],
             [-13 * L, -3 * L * L, -22 * L, 4 * L * L]]  # fmt: skip
    K, M, across, along = np.zeros((6, 6)), np.zeros((6, 6)), [1, 2, 4, 5], [0, 3]
    K[np.ix_(across, across)] = EI / L**3 * np.array(bend)
    M[np.ix_(across, across)] = L / 420 * np.array(heavy)
    K[np.ix_(along, along)] = 1e6 / L * np.array([[1, -1], [-1, 1]])
    M[np.ix_(along, along)] = L / 6 * np.array([[2, 1], [1, 2]])
    c, s = np.cos(turned), np.sin(turned)
    T = np.kron(np.eye(2), [[c, s, 0], [-s, c, 0], [0, 0, -1]])
    return T.T @ K @ T, T.T @ M @ T


def beams(count, held, axes=AXES, turn=0.0, factors=None):
    """Stiffness and mass of each of a row of unequal beams over the DoFs that are not held, and their names."""
    names = [f"{k}:+{axis}" for k in range(count + 1) for axis in AXES]
    keep = [k for k, name in enumerate(names) if name not in held and name.split("+")[1] in axes]
    each = []
    for e in range(count):
        own = element(0.3 * (1 + 0.1 * e), 20 * (1 + 0.2 * e) * (1 if factors is None else factors[e]), turn * e)
        full = np.zeros((2, len(names), len(names)))
        full[:, 3 * e : 3 * e + 6, 3 * e : 3 * e + 6] = own
        each.append(full[:, keep][:, :, keep])
    return np.array(each), tuple(names[k] for k in keep)


CASES = {
    "cantilever": (6, ("0:+X", "0:+Z", "0:+RY"), AXES, 0.0),
    "bearing and roller": (6, ("0:+X", "0:+Z", "6:+Z"), AXES, 0.0),
    "two bearings": (6, ("0:+X", "0:+Z", "6:+X", "6:+Z"), AXES, 0.0),
    "bending alone": (6, ("0:+Z", "6:+Z"), ("Z", "RY"), 0.0),
    "clamp and bearing": (6, ("0:+X", "0:+Z", "0:+RY", "6:+Z"), AXES, 0.0),
    "arch on two bearings": (6, ("0:+X", "0:+Z", "6:+X", "6:+Z"), AXES, 0.3),
    "arch on a roller": (6, ("0:+X", "0:+Z", "6:+Z"), AXES, 0.3),
    "two clamps": (6, ("0:+Z", "0:+RY", "6:+Z", "6:+RY"), ("Z", "RY"), 0.0),
}


@pytest.mark.parametrize("which", CASES)
@pytest.mark.parametrize("matrix", [0, 1], ids=["stiffness", "mass"])
def test_every_element_is_read(which, matrix):
    each, names = beams(*CASES[which])
    A = each[:, matrix].sum(axis=0)
    found = [p.full(len(A)) for p in parts_of(A, nodes_of(names), mass=bool(matrix))]
    assert len(found) == 6
    np.testing.assert_allclose(sum(found), A, atol=1e-12 * A.max())
    for own in each[:, matrix]:
        assert min(np.abs(some - own).max() for some in found) < 1e-7 * np.abs(own).max()


def test_a_beam_over_three_bearings_and_one_on_springs():
    each, names = beams(8, ("0:+Z", "4:+Z", "8:+Z"), ("Z", "RY"))
    K = each[:, 0].sum(axis=0)
    found = [p.full(len(K)) for p in parts_of(K, nodes_of(names))]
    assert max(min(np.abs(some - own).max() for some in found) for own in each[:, 0]) < 1e-7 * K.max()
    each, names = beams(6, ("0:+Z", "6:+Z"), ("Z", "RY"))
    K = each[:, 0].sum(axis=0)
    for spring, parts in (("3:+Z", 7), ("6:+RY", 7), ("5:+Z", 6)):  # next to a bearing it counts as the last beam's
        held = K.copy()
        held[names.index(spring), names.index(spring)] += 300.0
        found = [p.full(len(K)) for p in parts_of(held, nodes_of(names))]
        assert len(found) == parts
        np.testing.assert_allclose(sum(found), held, atol=1e-12 * K.max())
        read = [min(np.abs(some - own).max() for some in found) < 1e-7 * K.max() for own in each[:, 0]]
        assert sum(read) == parts - 1


def test_two_beams_between_bearings_still_sum_to_the_whole():
    """Which of the two has how much of the stiffness in the middle the matrix does not tell."""
    each, names = beams(2, ("0:+Z", "2:+Z"), ("Z", "RY"))
    for matrix in (0, 1):
        A = each[:, matrix].sum(axis=0)
        found = [p.full(len(A)) for p in parts_of(A, nodes_of(names), mass=bool(matrix))]
        np.testing.assert_allclose(sum(found), A, atol=1e-12 * A.max())


def test_beams_that_are_off_between_bearings_are_no_cause():
    rng = np.random.default_rng(5)
    held, axes = ("0:+Z", "6:+Z"), ("Z", "RY")
    each, names = beams(6, held, axes)
    plain = each.sum(axis=0)
    off, _ = beams(6, held, axes, factors=1 + 0.03 * rng.standard_normal(6))
    K, M = off.sum(axis=0)

    def damped(K, M):
        w2, P = scipy.linalg.eigh(K, M)
        return M @ P @ np.diag(2 * 0.01 * np.sqrt(w2)) @ P.T @ M

    low = np.sqrt(scipy.linalg.eigh(K, M, eigvals_only=True)[[0, 4]]) / 2 / np.pi
    freq = np.linspace(0.7 * low[0], 1.2 * low[1], 700)
    s = 2j * np.pi * freq[:, None, None]
    outputs = [k for k, name in enumerate(names) if name.endswith("Z")]
    H = s**2 * np.linalg.inv(K + s * damped(K, M) + s**2 * M)[:, outputs][:, :, outputs[:2]]
    sigma = 0.005 * np.sqrt((np.abs(H) ** 2).mean(axis=0)) * np.ones(H.shape)
    noise = (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
    channels = tuple(names[k] for k in outputs)
    data = Measurement(
        freq, (H + sigma * noise)[None], form="accelerance", outputs=channels, inputs=channels[:2],
        variance=sigma[None] ** 2,
    )  # fmt: skip
    said = diagnose_modes(data, Structure(plain[1], damped(*plain), plain[0], names)).to_dict()
    assert said["verdict"] == "clean" and not said["causes"]
    assert said["gain"]["chi2_after"] < 1.1
