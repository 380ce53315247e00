"""A spring that slips with all harmonics of its motion, against cycles that are followed instant by instant."""

import numpy as np
import pytest
import scipy.optimize

from modalax.diagnose.modal_domain.levels.play import ORDERS, slipped

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
    share, _ = slipped(np.array([amplitude]), W, np.full((1, len(ORDERS)), gk, complex))
    assert abs(share[0] - z / x) < 0.03 * abs(z / x)  # higher harmonics are left out


@pytest.mark.parametrize("amplitude", [0.33, 0.6, 2.0])
def test_harmonics_meet_the_structure_where_a_mode_answers_them(amplitude):
    gk = np.array([-3.0 - 8.0j, 1.2 - 0.4j, -0.4 - 0.1j, -0.2 + 0j, -0.1 + 0j, -0.1 + 0j])
    share, X = slipped(np.array([amplitude]), W, gk[None])

    def play(v: np.ndarray) -> np.ndarray:
        high = v[: len(ORDERS)] + 1j * v[len(ORDERS) :]
        return followed((amplitude * np.exp(1j * TIMES) + high @ np.exp(1j * np.outer(ORDERS, TIMES))).real)

    def missing(v: np.ndarray) -> np.ndarray:
        r = v[: len(ORDERS)] + 1j * v[len(ORDERS) :] - gk * [harmonic(play(v), h) for h in ORDERS]
        return np.concatenate([r.real, r.imag])

    found = scipy.optimize.root(missing, np.concatenate([X[0].real, X[0].imag]), method="hybr", tol=1e-10)
    assert np.abs(missing(found.x)).max() < 1e-7 * amplitude
    one = harmonic(followed(amplitude * np.cos(TIMES)), 1) / amplitude
    assert abs(share[0] - harmonic(play(found.x), 1) / amplitude) < 2e-3
    assert abs(share[0] - one) > 0.02  # which the first harmonic alone does not know


def test_it_sticks_below_the_slip_displacement_and_slips_wholly_far_above():
    A = np.array([0.1, 0.299, 300.0])
    share, X = slipped(A, W, np.full((3, len(ORDERS)), 0.2 - 0.1j))
    assert (share[:2] == 0).all() and (X[:2] == 0).all()
    assert share[2] == pytest.approx(1.0, abs=2e-3)
    assert slipped(A[:2], W, np.zeros((2, len(ORDERS)), complex))[1].shape == (2, len(ORDERS))


def test_what_is_known_of_the_harmonics_changes_the_way_but_not_the_answer():
    rng = np.random.default_rng(0)
    A, gk = 10 ** rng.uniform(-0.5, 1, 200), rng.uniform(-1, 0.9, (200, 1)) * np.exp(-0.05j) * np.ones(len(ORDERS))
    share, X = slipped(A, W, gk)
    again, _ = slipped(A, W, gk, X)
    np.testing.assert_allclose(again, share, atol=1e-6)
