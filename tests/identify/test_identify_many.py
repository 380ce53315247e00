"""Diagrams of many noisy copies at once are those of each alone."""

import jax
import numpy as np
import pytest

from modalax.identify import lscf
from modalax.identify.many import companion_roots, many_poles
from modalax.model.examples import five_dof

ORDER = 12


def copies(count: int, noise: float) -> tuple[list, np.ndarray]:
    clean = five_dof().frf(np.arange(20.0, 70.0, 0.5), inputs=["1"])
    frfs = [clean.add_noise(jax.random.key(k), noise) if noise else clean for k in range(count)]
    H = np.stack([np.asarray(frf.H)[:, :, 0].T for frf in frfs])
    return frfs, np.stack([H.real, H.imag], axis=1)


@pytest.mark.parametrize("noise", [0.002, 0.3])
def test_poles_are_those_of_each_alone(noise):
    frfs, H = copies(4, noise)
    poles, valid = many_poles(np.asarray(frfs[0].omega), H, ORDER)
    assert valid.sum() == sum(range(2, ORDER + 1))
    for frf, found in zip(frfs, np.asarray(poles), strict=True):
        alone = lscf(frf, range(2, ORDER + 1))
        assert (np.asarray(alone.valid).sum(axis=1) == valid.sum(axis=1)).all()
        for n in range(2, ORDER + 1):
            rows = np.asarray(alone.poles)[n - 2, :n], found[n - 2, :n]
            apart = np.abs(rows[0][:, None] - rows[1]) / np.abs(rows[0][:, None])
            # By orthogonal factors and eigenvalues there, by moments and simultaneous iteration here.
            assert max(apart.min(axis=0).max(), apart.min(axis=1).max()) < 1e-6


def test_roots_that_do_not_settle_are_eigenvalues(monkeypatch):
    from modalax.identify import many

    frfs, H = copies(3, 0.05)
    omega = np.asarray(frfs[0].omega)
    poles = np.asarray(many_poles(omega, H, 5)[0])
    moving = lambda A, start, used: (np.zeros((*start.shape, 3), complex), np.array([np.nan, 1.0, np.inf]))
    monkeypatch.setattr(many, "_aberth", moving)
    other = np.asarray(many_poles(omega, H, 5)[0])
    assert np.allclose(np.sort_complex(other), np.sort_complex(poles), rtol=1e-9)
    a = np.array([[-6.0, 11.0, -6.0]])  # (u - 1)(u - 2)(u - 3)
    assert np.allclose(np.sort_complex(companion_roots(a)), [1, 2, 3])


def test_a_step_is_computed_once():
    from modalax.identify import many

    lowered = many._aberth.lower(np.ones((6, 1, 8), complex), np.ones((5, 1), complex), np.ones((5, 1)))
    asked, done = lowered.cost_analysis(), lowered.compile().cost_analysis()
    # A program for each of two parts of the result would compute all that they have in common twice, for 1.7 times.
    assert done["flops"] < 1.2 * asked["flops"]


def test_too_few_lines_are_told():
    _, H = copies(1, 0.01)
    with pytest.raises(ValueError, match="order 60 needs 122 lines"):
        many_poles(np.arange(100.0), H, 60)
