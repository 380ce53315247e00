"""Lines at which a joint has several steady motions, or none: chosen by what is measured, or set aside."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from modalax.data import Measurement
from modalax.diagnose.causes.joints import CubicStiffness
from modalax.diagnose.causes.scene import Place
from modalax.diagnose.comparison import make_comparison, with_noise_beside
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.prediction.frf import equivalent
from modalax.diagnose.search.measured_force import measured_forces, robust_sizes
from modalax.diagnose.search.rows import fitted_beside_outliers, force_taken, lines_aside
from modalax.model.examples import five_dof
from modalax.simulate import joints
from modalax.simulate.harmonic import simulate

FREQ = np.arange(20.0, 70.0, 1.0)
LEVELS = np.array([1.0, 3.0, 6.0])
PLACE = ("2", "4")
WILD = [(2, 10), (2, 25)]  # run and line


def data(seed: int) -> Measurement:
    """A cubic spring with 1 % noise; at two lines the joint hits now harder, now softer than it should."""
    clean = simulate(five_dof(), [joints.CubicSpring(3e10)], [PLACE], FREQ, LEVELS, inputs=["1"])
    H = np.array(clean.H)
    full = np.asarray(five_dof().frf(FREQ, inputs=PLACE).H)
    across = full[..., 0] - full[..., 1]
    for run, line in WILD:
        H[run, line, :, 0] += 3.0 * across[line]
    rng = np.random.default_rng(seed)
    sigma = 0.01 * np.sqrt(np.mean(np.abs(H) ** 2, axis=(0, 1)))
    noise = rng.standard_normal((2, *H.shape)) * sigma / np.sqrt(2)
    return clean.replace(H=H + noise[0] + 1j * noise[1], variance=sigma**2 + np.zeros(H.shape))


def test_lines_that_no_steady_motion_explains_are_set_aside_and_the_rest_tells_the_law():
    comparison = with_noise_beside(make_comparison(data(0), five_dof(), "fixed"))
    place = Place(PLACE, (*(five_dof().index(n) for n in PLACE), 0))
    force = next(m for m in measured_forces(comparison, comparison.scene.pairs()) if m.place.where == PLACE)
    size = robust_sizes(comparison, CubicStiffness(), place, force)[1]
    assert size[0] == pytest.approx(3e10, rel=0.1)
    theta = np.zeros((2, comparison.problem.modal_form.stiffness.shape[0]))
    start = replace(Hypothesis(theta=theta).with_cause(CubicStiffness(), place, None, size), theta=theta)
    h = fitted_beside_outliers(comparison, start)
    run, line, _ = np.nonzero(force_taken(h))
    assert sorted(zip(run.tolist(), line.tolist(), strict=True)) == WILD
    assert lines_aside(h) == 2
    assert h.freedom == 1 + 2 * 2  # a force of two numbers at each
    assert abs(h.params[0][0] - 3e10) < 4 * np.sqrt(h.covariance[0, 0])
    assert h.chi2 < 1.2 * comparison.problem.samples
    assert comparison.fit([start], 30)[0].chi2 > 2 * h.chi2


def test_of_several_steady_motions_the_measured_one_is_taken():
    """One mass on a hardening spring above its resonance: a small and a large motion are both steady."""
    k3, omega, level = 1e3, np.array([1.5]), np.array([[0.015]])
    drive = 1 / (1 - omega**2 + 0.01j * omega)  # unit mass and spring
    cube = [0.75 * k3, 0.0]
    balance = lambda A: np.abs(A * (1 / complex(drive[0]) + cube[0] * A**2)) - float(level[0, 0])
    grid = np.geomspace(1e-3, 1.0, 4000)
    signs = np.sign(balance(grid))
    roots = np.sqrt(grid[1:] * grid[:-1])[signs[1:] != signs[:-1]]
    assert len(roots) == 3

    balanced = jax.jit(equivalent, static_argnums=0)

    def amplitude(near: float) -> float:
        extra = np.array([1.0, 0.0, 0.0, 0.0, near, 0.0], complex).reshape(6, 1, 1, 1)
        motion = drive[None, :, None]
        Z = balanced(CubicStiffness(), np.array([k3]), omega, drive[None], motion, level, extra)
        return float(np.sqrt(Z.item().real / cube[0]))

    assert amplitude(0.0) == pytest.approx(roots[0], rel=1e-2)
    assert amplitude(0.9 * roots[0]) == pytest.approx(roots[0], rel=1e-2)
    assert amplitude(1.2 * roots[2]) == pytest.approx(roots[2], rel=1e-2)
    # the middle one is of no motion of this law alone; with the harmonics of another it may be the known one
    assert amplitude(1.1 * roots[1]) in (pytest.approx(roots[0], rel=1e-2), pytest.approx(roots[2], rel=1e-2))
    assert amplitude(roots[1]) == pytest.approx(roots[1], rel=1e-2)
