"""Joints with all harmonics of their motion, against cycles that are followed instant by instant."""

import numpy as np
import pytest
import scipy.optimize

from modalax.diagnose.modal_domain.levels.balance import ORDERS, balanced
from modalax.diagnose.modal_domain.levels.play import Cube, Drag, Play, Stop

W = 0.3
TIMES = np.pi * np.arange(4096) / 2048


def followed(x: np.ndarray) -> np.ndarray:
    """Play about a motion over its second cycle."""
    z, out = 0.0, []
    for now in np.concatenate([x, x]):
        z = min(max(z, now - W), now + W)
        out.append(z)
    return np.array(out[len(x) :])


def harmonic(x: np.ndarray, order: int) -> complex:
    return complex(2 / len(x) * np.sum(x * np.exp(-1j * order * TIMES)))


@pytest.mark.parametrize(("amplitude", "gk"), [(2.85, 0.86), (0.8, -0.88), (0.36, 0.74)])
def test_behind_one_compliance_it_is_a_stiffer_spring_that_slips(amplitude, gk):
    """Of all that ``x = u + gk z`` may be, ``u`` is a sine then, and ``(1 - gk) z`` the play about it."""

    def both(u: float) -> tuple[complex, complex]:
        z = harmonic(followed(u * np.cos(TIMES)), 1) / (1 - gk)
        return u + gk * z, z

    u = scipy.optimize.brentq(lambda u: abs(both(u)[0]) - amplitude, 1e-3, 10.0)
    x, z = both(u)
    share, _ = balanced(Play(W), np.array([amplitude]), np.full((1, len(ORDERS)), gk, complex))
    assert abs(share[0] - z / x) < 0.03 * abs(z / x)  # higher harmonics are left out


def meets(shape, amplitude, pushed, force):
    """The share of one motion, and what its harmonics by another route give, first with all and then without."""
    share, X = balanced(shape, np.array([amplitude]), pushed[None])
    orders = np.exp(1j * np.outer(ORDERS, TIMES))
    motion = lambda v: v[: len(ORDERS)] + 1j * v[len(ORDERS) :]
    acting = lambda v: force(amplitude * np.exp(1j * TIMES) + motion(v) @ orders, 1j * amplitude * np.exp(1j * TIMES)
                             + 1j * (ORDERS * motion(v)) @ orders)  # fmt: skip

    def missing(v: np.ndarray) -> np.ndarray:
        r = motion(v) - pushed * [harmonic(acting(v), h) for h in ORDERS]
        return np.concatenate([r.real, r.imag])

    found = scipy.optimize.root(missing, np.concatenate([X[0].real, X[0].imag]), method="hybr", tol=1e-10)
    assert np.abs(missing(found.x)).max() < 1e-7 * amplitude
    both = (harmonic(acting(v), 1) / amplitude for v in (found.x, np.zeros(2 * len(ORDERS))))
    return share[0], *both


RESONANT = np.array([-3.0 - 8.0j, 1.2 - 0.4j, -0.4 - 0.1j, -0.2 + 0j, -0.1 + 0j, -0.1 + 0j])


@pytest.mark.parametrize("amplitude", [0.33, 0.6, 2.0])
def test_harmonics_meet_the_structure_where_a_mode_answers_them(amplitude):
    share, exact, one = meets(Play(W), amplitude, RESONANT, lambda x, v: followed(x.real))
    assert abs(share - exact) < 2e-3
    assert abs(share - one) > 0.02  # which the first harmonic alone does not know


@pytest.mark.parametrize(
    ("shape", "force", "close"),
    [
        (Cube(), lambda x, v: x.real**3, 1e-6),
        (Drag(), lambda x, v: v.real * np.abs(v.real), 2e-3),
        (Stop(W), lambda x, v: np.sign(x.real) * np.maximum(np.abs(x.real) - W, 0.0), 2e-3),
    ],
)
@pytest.mark.parametrize("amplitude", [0.5, 1.3])
def test_so_do_those_of_laws_without_a_memory(shape, force, close, amplitude):
    share, exact, one = meets(shape, amplitude, RESONANT, force)
    assert abs(share - exact) < close * abs(exact)
    assert abs(share - one) > 0.02 * abs(exact)


def test_it_sticks_below_the_slip_displacement_and_slips_wholly_far_above():
    A = np.array([0.1, 0.299, 300.0])
    share, X = balanced(Play(W), A, np.full((3, len(ORDERS)), 0.2 - 0.1j))
    assert (share[:2] == 0).all() and (X[:2] == 0).all()
    assert share[2] == pytest.approx(1.0, abs=2e-3)
    assert balanced(Play(W), A[:2], np.zeros((2, len(ORDERS)), complex))[1].shape == (2, len(ORDERS))


def test_what_is_known_of_the_harmonics_changes_the_way_but_not_the_answer():
    rng = np.random.default_rng(0)
    A, gk = 10 ** rng.uniform(-0.5, 1, 200), rng.uniform(-1, 0.9, (200, 1)) * np.exp(-0.05j) * np.ones(len(ORDERS))
    share, X = balanced(Play(W), A, gk)
    again, _ = balanced(Play(W), A, gk, X)
    np.testing.assert_allclose(again, share, atol=1e-6)
