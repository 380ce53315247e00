"""Two systems of Krack and Gross (Harmonic Balance for Nonlinear Vibration Problems, 2019; examples 2 and 3 of NLvib).

Two masses with cubic springs, whose motion becomes quasi-periodic beside its resonance (a Neimark-Sacker bifurcation),
and two masses with a stop a hundred times as stiff as their springs. Units are the authors': rad/s, without dimension.
"""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from modalax.model import Structure
from modalax.simulate.continuation import follow_branch
from modalax.simulate.joints import CubicSpring, OneSidedGap
from modalax.simulate.stability import floquet_exponents

HZ = 1 / (2 * np.pi)


def one_period(M, C, K, law, slope, force, omega, state):
    """State and monodromy matrix a period later, by the equations of motion and their variation."""
    n, inverse = len(M), np.linalg.inv(M)

    def rate(t, y):
        x, v, phi = y[:n], y[n : 2 * n], y[2 * n :].reshape(2 * n, 2 * n)
        tangent = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ (K + slope(x)), -inverse @ C]])
        a = inverse @ (force * np.cos(omega * t) - C @ v - K @ x - law(x))
        return np.concatenate([v, a, (tangent @ phi).ravel()])

    start = np.concatenate([state, np.eye(2 * n).ravel()])
    period = 2 * np.pi / omega
    end = solve_ivp(rate, (0, period), start, rtol=1e-9, atol=1e-11, max_step=period / 400).y[:, -1]
    return end[: 2 * n], end[2 * n :].reshape(2 * n, 2 * n)


def state_at_start(M, C, K, joints_force, force, omega, harmonics):
    """Displacement and velocity at t = 0 of the motion under the joints' force harmonics, shape (n, h)."""
    X = np.stack(
        [
            np.linalg.solve(K - (k * omega) ** 2 * M + 1j * k * omega * C, (k == 1) * force - joints_force[:, i])
            for i, k in enumerate(harmonics)
        ],
        axis=1,
    )
    return np.concatenate([X.real.sum(1), (1j * omega * np.array(harmonics) * X).real.sum(1)])


def force_harmonics(law, x, harmonics, samples=4096):
    """Fourier coefficients of a force under displacement harmonics ``x``, shape (h,)."""
    k, tau = np.array(harmonics), 2 * np.pi * np.arange(samples) / samples
    f = law((x @ np.exp(1j * np.outer(k, tau))).real)
    return np.where(k == 0, 1, 2) * (np.exp(-1j * np.outer(k, tau)) @ f) / samples


@pytest.mark.slow  # by default the exponents of a branch that turns back, and those of linear modes
def test_two_masses_with_cubic_springs_turn_back_and_become_quasi_periodic():
    M = np.diag([1.0, 0.05])
    K, C = (np.array([[a + b, -b], [-b, b]]) for a, b in ((1.0, 0.0453), (0.002, 0.013)))
    force, k3 = np.array([0.11, 0.0]), (1.0, 0.0042)
    s = Structure(M, C, K, ["1", "2"])
    joints, places = tuple(CubicSpring(k) for k in k3), [["1"], ["1", "2"]]
    branch = follow_branch(
        s, joints, places, (0.8 * HZ, 1.4 * HZ), 0.11, input="1", harmonics=7, samples=64, points=120
    )
    ok = np.asarray(branch.valid)
    omega, q, way = np.asarray(branch.freq)[ok] / HZ, np.asarray(branch.q)[ok], np.asarray(branch.direction)[ok]
    assert omega[-1] > 1.35
    exponents = np.asarray(
        floquet_exponents(s, joints, places, branch.freq[ok], branch.q[ok], branch.harmonics, samples=64)
    )
    leading = exponents[np.arange(len(omega)), exponents.real.argmax(1)]
    unstable = leading.real > 0
    backward = way < 0
    # between the folds one real exponent is positive; before them a complex pair, over a range of frequencies
    assert len(branch.folds()) == 2 and backward.sum() > 3
    assert np.all(unstable[backward]) and np.all(np.abs(leading.imag[backward]) < 1e-9)
    quasi = unstable & ~backward & (np.abs(leading.imag) > 0.05)
    assert 1.10 < omega[quasi].min() < 1.13 and 1.18 < omega[quasi].max() < 1.21

    spring = np.array([[1.0, 0.0], [1.0, -1.0]])

    def law(x):
        return spring.T @ (np.array(k3) * (spring @ x) ** 3)

    def slope(x):
        return spring.T @ np.diag(3 * np.array(k3) * (spring @ x) ** 2) @ spring

    for pick in (quasi, backward, ~unstable):
        i = np.flatnonzero(pick)[pick.sum() // 2]
        each = [force_harmonics(lambda d, k=k: k * d**3, x, branch.harmonics) for k, x in zip(k3, q[i], strict=True)]
        start = state_at_start(M, C, K, spring.T @ np.stack(each), force, omega[i], branch.harmonics)
        end, monodromy = one_period(M, C, K, law, slope, force, omega[i], start)
        assert np.abs(end - start).max() < 1e-6 * np.abs(start).max()  # measured 3e-7
        multiplier = np.abs(np.linalg.eigvals(monodromy)).max()
        assert multiplier == pytest.approx(np.exp(leading[i].real * 2 * np.pi / omega[i]), rel=1e-6)  # measured 2e-7


@pytest.mark.slow  # through its folds by default
def test_a_hard_stop_is_followed_round_the_corner_where_contact_begins():
    M, K = np.eye(2), np.array([[1.0, -1.0], [-1.0, 2.0]])
    C, force = 0.03 * K, np.array([0.0, 0.1])
    s = Structure(M, C, K, ["1", "2"])
    branch = follow_branch(
        s,
        [OneSidedGap(100.0, 1.0)],
        [["1"]],
        (0.5 * HZ, 0.8 * HZ),
        0.1,
        input="2",
        harmonics=21,
        samples=1024,
        points=400,
        downward=True,
    )
    ok = np.asarray(branch.valid)
    omega, q, way = np.asarray(branch.freq)[ok] / HZ, np.asarray(branch.q)[ok, 0], np.asarray(branch.direction)[ok]
    # without contact down to 0.653 rad/s, back up along an unstable part, and down again through the band to its end
    k = np.array(branch.harmonics)
    peak = (q @ np.exp(1j * np.outer(k, 2 * np.pi * np.arange(4096) / 4096))).real.max(1)
    corner = np.flatnonzero(peak > 1)[0]
    linear = np.linalg.solve(K - omega[corner] ** 2 * M + 1j * omega[corner] * C, force)[0]
    assert np.abs(linear) == pytest.approx(1.0, abs=1e-4) and np.all(way[:corner] < 0)
    assert way[corner] > 0 and omega[corner:].max() > 0.75 and omega[-1] < 0.51

    def law(x):
        return np.array([100.0 * max(x[0] - 1.0, 0.0), 0.0])

    def slope(x):
        return np.diag([100.0 * (x[0] > 1.0), 0.0])

    def start_of(i):
        f = force_harmonics(lambda d: 100.0 * np.maximum(d - 1.0, 0.0), q[i], branch.harmonics)
        return state_at_start(M, C, K, np.stack([f, 0 * f]), force, omega[i], branch.harmonics)

    # on the way up the motion closes after a period, and is unstable
    up = np.flatnonzero((omega > 0.70) & (way > 0))[0]
    end, monodromy = one_period(M, C, K, law, slope, force, omega[up], start_of(up))
    assert np.abs(end - start_of(up)).max() < 2e-3 * np.abs(end).max()  # measured 6e-4
    assert np.abs(np.linalg.eigvals(monodromy)).max() > 1.5
    # on the way down it is where marching in time settles
    down = np.flatnonzero((omega > 0.635) & (way < 0) & (np.arange(len(omega)) > corner))[-1]
    period = 2 * np.pi / omega[down]
    times = 40 * period + period * np.arange(2048) / 2048

    def rate(t, y):
        x, v = y[:2], y[2:]
        return np.concatenate([v, force * np.cos(omega[down] * t) - C @ v - K @ x - law(x)])

    x = solve_ivp(rate, (0, 41 * period), start_of(down), t_eval=times, rtol=1e-8, atol=1e-10, max_step=period / 200).y
    settled = 2 * np.mean(x[0] * np.exp(-1j * omega[down] * times))
    assert abs(settled - q[down, 1]) < 2e-3  # measured 1.0e-3 of a motion of 1 that never passes the stop by 3 %


ONE = Structure([[1.0]], [[2.0]], [[1e4]], ["x"])
GIVEN = {"input": "x", "harmonics": 9, "samples": 4096, "points": 150}  # of both, which share a program


def test_enough_samples_take_a_branch_with_a_hard_stop_through_its_folds():
    """One mass, a stop twenty times as stiff; with 512 samples the branch ends beside its upper fold."""
    branch = follow_branch(ONE, [OneSidedGap(2e5, 4e-3)], [["x"]], (10.0, 26.0), 3.0, **GIVEN)
    ok = np.asarray(branch.valid)
    assert np.asarray(branch.freq)[ok][-1] > 25.0 and len(branch.folds()) == 2


def test_a_branch_without_a_start_says_so():
    """A stop far stiffer than the structure, closed at the line where the branch would start, and few harmonics."""
    with pytest.raises(ValueError, match="no motion was found at 16 Hz, where the branch is to start"):
        follow_branch(ONE, [OneSidedGap(5e6, 2e-4)], [["x"]], (16.0, 26.0), 3.0, **GIVEN)
