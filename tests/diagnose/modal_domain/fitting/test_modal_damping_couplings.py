"""Damping by modes couples the simulation's modes where the structure's shapes are others, those above the band too."""

import numpy as np
import pytest
import scipy.linalg
from frames import DOFS
from frames import simulation as frame
from kinds import FEW

from modalax.data import Measurement
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.fitting.inaccuracy import NEAR, USUAL, inaccuracy_of
from modalax.diagnose.modal_domain.structure.coordinates import coordinates_of
from modalax.model import Structure


def test_the_highest_mode_of_the_band_is_coupled_with_those_above():
    s, top = frame(), 2 * np.pi * 330
    c = coordinates_of(s, DOFS[::2], (DOFS[6],), top)
    a = inaccuracy_of(s, c, top)
    patterns = a.patterns[a.groups.index("damping between modes")]
    last = int((c.frequencies < top).sum()) - 1
    assert np.flatnonzero(np.abs(patterns[:, last]).sum(axis=0)).max() == min(last + NEAR, c.size - 1)


@pytest.mark.parametrize(("apart", "unlike"), [(0.005, 1.0), (0.02, 1.0), (0.02, 1.6), (0.2, 1.0)])
def test_close_modes_are_coupled_by_damping_as_elements_that_are_off_turn_them(apart, unlike):
    """Two pairs of mass and spring, weakly joined, of modal damping: drawn, and in the simulation's modes."""
    rng, k, joined = np.random.default_rng(0), 1e5, 2e3
    zeta = 0.01 * np.array([1.0, unlike])

    def modes(springs):
        K = np.diag(springs[:2]) + springs[2] * np.array([[1, -1], [-1, 1]])
        w2, P = scipy.linalg.eigh(K)
        return K, np.sqrt(w2), P

    springs = np.array([k, k * (1 + apart), joined])
    K, w, P = modes(springs)
    C = P @ np.diag(2 * zeta * w) @ P.T
    s = Structure(np.eye(2), C, K, ("1:+Z", "2:+Z"))
    c = coordinates_of(s, s.dofs, s.dofs[:1], 3 * w[-1])
    a = inaccuracy_of(s, c, 3 * w[-1])
    own, usual = a.patterns[a.groups.index("damping")], USUAL["damping"]
    told = usual * max((p[0, 1] for p in own), default=0.0)
    drawn = []
    for _ in range(4000):
        _, w_off, P_off = modes(springs * (1 + USUAL["stiffness"] * rng.standard_normal(3)))
        off = P_off @ np.diag(2 * zeta * np.exp(usual * rng.standard_normal(2)) * w_off) @ P_off.T
        drawn.append((P.T @ off @ P)[0, 1])
    found = np.sqrt(np.mean(np.square(drawn)))
    assert told == pytest.approx(found, rel=0.15)


def test_the_tails_of_modes_far_above_the_band_are_off_by_their_damping():
    """Each below noise, together they show in sums over neighbouring lines."""
    n, rng = 12, np.random.default_rng(4)
    B = np.eye(n + 1, n) - np.eye(n + 1, n, -1)
    K, dofs = 1e5 * B.T @ B, tuple(f"{k}:+Z" for k in range(1, n + 1))
    w2, P = scipy.linalg.eigh(K)
    w, zeta = np.sqrt(w2), 0.02
    true = zeta * np.exp(0.4 * rng.standard_normal(n))
    top = 1.04 * w[3]
    freq = np.linspace(0.3 * w[0], top, 400) / 2 / np.pi
    s = 2j * np.pi * freq[:, None]
    modal = s**2 / (s**2 + 2 * true * w * s + w2)
    H = np.einsum("or,fr,ir->foi", P, modal, P[[0, 4]])
    sigma = 0.004 * np.sqrt(np.mean(np.abs(H) ** 2, axis=0))
    H = H + sigma * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
    variance = np.broadcast_to(sigma**2, H.shape)[None].copy()
    data = Measurement(freq, H[None], form="accelerance", outputs=dofs, inputs=(dofs[0], dofs[4]), variance=variance)
    found = diagnose_modes(
        data, Structure(np.eye(n), P @ np.diag(2 * zeta * w) @ P.T, K, dofs), wanted=FEW.__contains__
    )
    assert found.verdict == "clean" and found.after.p_value > 1e-3
