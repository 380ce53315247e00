"""Modes of a structure with a skew coupling, a joint that loses energy or one that relaxes, and what they tell."""

import numpy as np
import pytest
from chains_off import DOFS, FREQ, as_measured, chain_off, response, simulation

from modalax.diagnose.deadline import Deadline
from modalax.diagnose.modal_domain.causes.line_forces import LineForce
from modalax.diagnose.modal_domain.fitting.state import matrices_of, screening_slopes, slopes_at, state_at
from modalax.diagnose.modal_domain.search.force_places import KINDS
from modalax.diagnose.modal_domain.search.oscillators import oscillators
from modalax.diagnose.modal_domain.stage import run_stage

SLUGS = "gyroscopic", "hysteretic_joint", "maxwell_joint", "fractional_joint"
STEP, CLOSE = 1e-6, 1e-5  # of differences; of derivatives, relative to the largest
EXACT = {"fractional_joint": 2e-5}  # of residues, relative; a power is made of joints that relax


@pytest.fixture(scope="module")
def stage():
    data = as_measured(response(*chain_off(7, 0.02), FREQ[::3]), FREQ[::3], 7)
    return run_stage(data, simulation(), Deadline(), lambda _: False, lambda _: None)


def force(stage, slug: str) -> tuple[LineForce, np.ndarray]:
    pair = stage.coordinates.shapes[[1, 2]].T
    basis = pair if slug == "gyroscopic" else pair[:, :1] - pair[:, 1:]
    f = KINDS[slug](slug, DOFS[1:3], 40.0 if slug == "gyroscopic" else 3e4, basis=basis, middle=250.0)
    return f, np.array([0.7, 0.2])[: f.count]


def off(stage) -> np.ndarray:
    return 0.01 * np.random.default_rng(0).standard_normal(len(stage.setting.inaccuracy.group_of))


@pytest.mark.parametrize("slug", SLUGS)
def test_residues_are_those_of_the_whole_dynamic_stiffness(stage, slug):
    f, u = force(stage, slug)
    state = state_at(stage.setting, off(stage), (f,), u)
    M, C, K = matrices_of(stage.setting, off(stage), (f,), u)
    c, turn = stage.coordinates, np.exp(2j * np.pi * np.arange(64) / 64)
    for pole, residue in zip(state.modes.poles[:5], state.plain, strict=False):
        around = 0.02 * abs(pole) * turn
        s = pole + around
        T = K + s[:, None, None] * C + s[:, None, None] ** 2 * M + f.basis @ f.stiffness(u, s) @ f.basis.T
        H = c.outputs @ np.linalg.inv(T) @ c.inputs.T
        integral = (H * around[:, None, None]).mean(axis=0)
        assert np.abs(integral - residue).max() < EXACT.get(slug, 1e-10) * np.abs(integral).max()


@pytest.mark.parametrize("slug", SLUGS)
def test_slopes_are_those_of_finite_differences(stage, slug):
    f, u = force(stage, slug)
    x, n = np.concatenate([off(stage), u]), len(off(stage))
    state = state_at(stage.setting, x[:n], (f,), x[n:])
    at = lambda x: state_at(stage.setting, x[:n], (f,), x[n:]).difference
    J = slopes_at(stage.setting, state, (f,), u)
    for k in (0, 8, n // 2, *range(n, len(x))):
        step = STEP * np.eye(len(x))[k]
        change = (at(x - step) - at(x + step)) / (2 * STEP)
        assert np.abs(change - J[:, k]).max() < CLOSE * np.abs(J).max()
    none = state_at(stage.setting, x[:n])
    small = np.array([1e-7, 0.0])[: f.count]
    beside = slopes_at(stage.setting, state_at(stage.setting, x[:n], (f,), small), (f,), small)[:, n]
    screened = screening_slopes(stage.setting, none, [f])[:, 0]
    assert np.abs(screened - beside).max() < CLOSE * np.abs(beside).max()


def test_a_light_oscillator_is_sought_with_the_mass_that_its_own_mode_asks_for():
    M, C, K = (np.pad(A, (0, 1)) for A in chain_off(4, 0.02))
    mass, w, v = 0.002, 2 * np.pi * 40.0, np.array([0, 0, 0, 0, 1.0, -1.0])
    M[5, 5] = mass
    C, K = C + 0.06 * w * mass * np.outer(v, v), K + w**2 * mass * np.outer(v, v)
    data = as_measured(response(M, C, K, FREQ), FREQ, 4, noise=0.003)
    asked = "missing_mode", "tuned_mass"
    stage = run_stage(data, simulation(), Deadline(), lambda slug: slug in asked, lambda _: None)
    extra = min((c for c in stage.candidates if c.freed is not None), key=lambda c: abs(abs(c.pole) - w))
    cause, u = oscillators(stage.setting, stage.candidates, extra)[0]
    assert cause.where == ("5:+Z",)
    assert cause.size(u) == pytest.approx(mass, rel=0.2)
    assert [c.where for c in stage.explanations[0].causes] == [("5:+Z",)]


@pytest.mark.parametrize("order", [0.12, 0.45, 0.85])
def test_a_power_of_frequency_is_a_sum_of_joints_that_relax(order):
    f = KINDS["fractional_joint"]("fractional_joint", ("1",), 3e4, basis=np.ones((1, 1)), middle=250.0)
    u = np.array([0.7, np.log(order / (1 - order))])
    s = 2j * np.pi * np.geomspace(8.0, 200.0, 9) * np.exp(0.1j)  # a fortieth of the way about, as poles of 10 % damping
    Z, slope, _ = f.load(u).expanded(s)
    power = 0.7 * 3e4 * (s / 250.0) ** order
    np.testing.assert_allclose(Z[:, 0, 0], power, rtol=1e-4)  # the slower, the better
    np.testing.assert_allclose(slope[:, 0, 0], order * power / s, rtol=3e-4)
    np.testing.assert_allclose(f.stiffness(u, s)[:, 0, 0], power, rtol=1e-12)
    (c, a), errors, _ = f.as_catalogue(u, np.diag([0.01, 0.04]))
    assert a == pytest.approx(order) and c * 250.0**order == pytest.approx(0.7 * 3e4)
    draws = u + np.random.default_rng(0).standard_normal((10_000, 2)) * 0.01 * np.sqrt([0.01, 0.04])
    told = np.array([f.as_catalogue(one, np.eye(2))[0] for one in draws])
    np.testing.assert_allclose(told.std(axis=0) / 0.01, errors, rtol=0.03)
