"""The refinement and the scan on the host beside those in JAX, and what a search relies on."""

from importlib import import_module

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from threadpoolctl import threadpool_info

from modalax.data import FRF
from modalax.data.windows import exponential_window
from modalax.identify import ascent, fit, mode_scores, refine, residues
from modalax.identify import mode_search as module
from modalax.identify.ascent import climb
from modalax.identify.fdpi import line_weight
from modalax.identify.host import refine_on_host
from modalax.identify.information import inverse_information
from modalax.identify.kernels import pack, turned_to_largest, unpack
from modalax.identify.maximum import response
from modalax.identify.plain import modal_of, samples_of
from modalax.identify.scan import Grid, _Scan
from modalax.model import ModalModel
from modalax.model.modal import poles_from

FREQ = np.linspace(24, 44, 81)
MODEL = ModalModel.from_real_modes(
    [30.0, 37.0], [0.02, 0.015], [[1.0, 0.6, -0.4], [0.5, -1.0, 0.7]], [1.0, 2.0], list("abc")
)
FRF_ = MODEL.frf(FREQ, inputs=["a", "b"], form="accelerance").add_noise(jax.random.key(0), 0.02)
KINDS = {
    "known": (FRF_, "auto", "gauss-newton"),
    "turned": (FRF_.transpose(), "auto", "robust"),
    "unknown": (FRF_.replace(variance=None), "auto", "sandwich"),
    "own weights": (FRF_.replace(variance=None), "noisy", "robust"),
}


@pytest.mark.parametrize("real_modes", [False, True])
@pytest.mark.parametrize(
    "name",
    [pytest.param(k, marks=() if k == "known" else pytest.mark.slow) for k in ("known", "own weights", "turned")],
)
def test_residues_of_both(name, real_modes):
    frf, weights, _ = KINDS[name]
    weights = jnp.abs(frf.H) if weights == "noisy" else weights
    one = eqx.filter_jit(residues)(frf, MODEL.poles, weights=weights, real_modes=real_modes)
    two = residues(frf, MODEL.poles, weights=weights, real_modes=real_modes)
    for part in ("shapes", "participation", "upper", "lower"):
        a, b = getattr(one, part), getattr(two, part)
        np.testing.assert_allclose(b, a, rtol=1e-8, atol=1e-9 * float(jnp.abs(a).max()))


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_refinement_of_both(name):
    """Poles to 1e-9, deviations of everything, evidence, whiteness and noise."""
    frf, weights, kind = KINDS[name]
    weights = jnp.abs(frf.H) if weights == "noisy" else weights
    start = residues(frf, MODEL.poles * (1 + 0.003j))
    one, two = (call(frf, start, weights=weights, covariance=kind) for call in (refine, refine_on_host))
    assert bool(one.success) and bool(two.success)
    np.testing.assert_allclose(two.model.poles, one.model.poles, rtol=1e-9)
    np.testing.assert_allclose(two.model.shapes, one.model.shapes, rtol=1e-6, atol=1e-8)
    for part in (
        "frequency_std_hz", "damping_std", "modal_mass_std", "covariance", "evidence", "noise_scale", "chi2", "dof",
        "whiteness", "log_likelihood",
    ):  # fmt: skip
        a, b = np.asarray(getattr(one, part)), np.asarray(getattr(two, part))
        np.testing.assert_allclose(b, a, rtol=2e-5, atol=1e-5 * np.abs(a).max(), err_msg=part)
    np.testing.assert_allclose(two.shape_std, one.shape_std, rtol=2e-5, atol=1e-9)
    np.testing.assert_allclose(two.residual, one.residual, atol=1e-5 * float(jnp.abs(one.residual).max()))


def test_intervals_hold_the_truth_as_often_as_they_say():
    """80 refinements at 10 % noise: standardised errors of mean 0 and spread 1, 95 % intervals that hold the truth."""
    clean = MODEL.frf(FREQ, inputs=["a", "b"], form="accelerance")
    start = residues(clean, MODEL.poles * (1 + 0.003j))
    true, z = np.concatenate([MODEL.frequency_hz, MODEL.damping_ratio]), []
    rng, noisy = np.random.default_rng(0), clean.add_noise(jax.random.key(0), 0.1)
    sigma, shape = np.sqrt(np.asarray(noisy.variance) / 2), (80, *clean.shape)
    for noise in sigma * (rng.normal(size=shape) + 1j * rng.normal(size=shape)):
        found = refine_on_host(noisy.replace(H=np.asarray(clean.H) + noise), start)
        assert bool(found.success), found.reason
        got = np.concatenate([found.model.frequency_hz, found.model.damping_ratio])
        z.append((got - true) / np.concatenate([found.frequency_std_hz, found.damping_std]))
    z = np.array(z)
    assert np.all(abs(z.mean(axis=0)) < 4 / np.sqrt(80)) and np.all(abs(z.std(axis=0) - 1) < 4 / np.sqrt(160))
    assert 0.92 < np.mean(abs(z) < 1.96) < 0.98  # 320 values: 0.95 +- 0.012


def test_two_modes_at_one_place_have_no_deviation():
    """The third mode has that of a fit without the second: within 20 %."""
    first, third = np.asarray(MODEL.poles)
    found = refine_on_host(FRF_, residues(FRF_, np.array([first, first, third])), max_steps=0)
    alone = refine_on_host(FRF_, residues(FRF_, MODEL.poles))
    assert np.isnan(found.frequency_std_hz).tolist() == np.isnan(found.damping_std).tolist() == [True, True, False]
    assert float(found.damping_std[2]) == pytest.approx(float(alone.damping_std[1]), rel=0.2)


def test_unknowns_that_a_singular_matrix_does_not_tell_do_not_hide_the_others():
    matrix = np.array([[4.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 25.0]])
    np.testing.assert_allclose(inverse_information(matrix), np.diag([0, 0, 0.04]), atol=1e-15)
    sound = matrix + np.diag([1.0, 0.0, 0.0])
    np.testing.assert_allclose(inverse_information(sound), np.linalg.inv(sound), rtol=1e-12)


def test_a_mode_that_comes_into_the_band_has_its_damping_fitted():
    """A start 0.03 Hz below the band, its damping ratio of 0.05 % held there; the mode is 0.05 Hz inside."""
    model = ModalModel.from_real_modes([24.05], [0.002], [[1.0, 0.6, -0.4]], [1.0], list("abc"))
    frf = model.frf(np.linspace(24, 34, 101), inputs=["a", "b"], form="accelerance").add_noise(jax.random.key(0), 0.002)
    found = refine_on_host(frf, residues(frf, poles_from([23.97], [0.0005])))
    assert abs(float(found.model.damping_ratio[0]) - 0.002) < 4 * float(found.damping_std[0]) < 1e-5


def test_the_same_modes_from_another_pivot():
    """Participations beside a pivot that is next to nothing, and beside the largest: one model, unknowns up to 1."""
    theta, pivot = np.array([[5.0, -4.0, 3e9, 0.5, -2e9, 1.0]]), np.array([1])
    turned, largest = turned_to_largest(theta, pivot)
    one, two = (unpack(t, p, False) for t, p in ((theta, pivot), (turned, largest)))
    assert largest.tolist() == [0] and np.abs(turned[:, 2:]).max() <= 1
    np.testing.assert_allclose(two.participation, one.participation / one.participation[:, :1], rtol=1e-14)
    np.testing.assert_array_equal(two.poles, one.poles)


def test_response_of_plain_arrays():
    model = MODEL.replace(upper=jnp.ones((3, 3)) * 1e-5, lower=1j * jnp.ones((3, 3)))
    for form in ("receptance", "accelerance"):
        frf = model.frf(FREQ, form=form, added_decay=2.0)
        found = response(modal_of(model), samples_of(frf))
        np.testing.assert_allclose(found, frf.H, rtol=1e-12)


def test_scan_of_both():
    """Scores of the host, in single precision, beside those in JAX; inside the band and beyond it."""
    rng = np.random.default_rng(0)
    shape = FRF_.H.shape
    residual, sigma = rng.normal(size=shape) + 1j * rng.normal(size=shape), rng.uniform(0.5, 2.0, shape)
    s = 2j * np.pi * FREQ
    grid = Grid(s, 2, (20.0, 50.0))
    some = np.arange(0, len(grid.poles), 7)
    known = np.asarray(MODEL.poles)
    found = _Scan(grid, sigma.reshape(len(s), -1), known).scores(residual.reshape(len(s), -1), some)
    expected = mode_scores(FRF_, residual, sigma, jnp.asarray(grid.poles[some]), jnp.asarray(known))
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-2)
    assert 0 < grid.inside[some].sum() < len(some)


def test_lines_far_from_a_narrow_mode_hardly_count(monkeypatch):
    """Of large sets only lines near a pole are compared: a clear mode scores the same within 3 %, at its own pole."""
    freq, known = np.linspace(20.0, 60.0, 1601), np.array([-2.0 + 2j * np.pi * 50])
    model = ModalModel.from_real_modes([33.0], [0.001], [[1.0, 0.6]], [1.0], list("ab"))
    clean = np.asarray(model.frf(freq, inputs=["a"], form="accelerance").H).reshape(len(freq), 2)
    rng, sigma = np.random.default_rng(0), np.full(clean.shape, 0.02 * np.abs(clean).max())
    residual = clean / sigma + (rng.normal(size=clean.shape) + 1j * rng.normal(size=clean.shape)) / np.sqrt(2)
    grid = Grid(2j * np.pi * freq, 2, (20.0, 60.0))
    scan, some = _Scan(grid, sigma, known), np.flatnonzero(np.abs(grid.freq - 33.0) < 1)
    whole = scan.scores(residual, some)
    monkeypatch.setattr(import_module("modalax.identify.scan"), "MANY", 0)
    near = scan._near(grid.poles[some[:3]], residual.size)
    assert 20 < near.stop - near.start < 400
    part, best = scan.scores(residual, some), np.argmax(whole)
    assert np.argmax(part) == best and whole[best] > 1e4
    assert part[best] == pytest.approx(whole[best], rel=0.03)


def test_a_large_set_ends_where_any_set_does(monkeypatch):
    """Searches with modes that may not stay end early there; what is told does not depend on it."""
    usual = fit(FRF_)
    real, ends = module.maximise, []
    monkeypatch.setattr(module, "several", lambda *_: True)
    monkeypatch.setattr(module, "maximise", lambda *a, **k: ends.append(k.get("tol")) or real(*a, **k))
    large = fit(FRF_)
    assert 5.0 in ends and ends[-1] == module.FINE  # three outputs and two inputs
    assert usual.refined is not None and large.refined is not None
    std = np.asarray(usual.refined.frequency_std_hz)
    assert (np.abs(np.asarray(large.model.frequency_hz - usual.model.frequency_hz)) < 0.01 * std).all()
    np.testing.assert_allclose(large.refined.frequency_std_hz, std, rtol=1e-3)


def test_a_mode_that_runs_away_is_dropped(monkeypatch):
    """Of three starts for two modes the one that is out of range for some steps, from wherever it then is."""
    monkeypatch.setattr(ascent, "PATIENCE", 3)
    samples = samples_of(FRF_)
    projection = samples.projection(np.sqrt(np.asarray(FRF_.variance)))
    poles, part = np.append(np.asarray(MODEL.poles), [-5.0 + 170j]), np.ones((3, 2), complex)
    theta = pack(poles, part, np.zeros(3, int))
    at = climb(projection, theta, np.zeros(3, int), np.zeros(3), runaway=lambda t: t[:, 0] < np.log(185.0))
    assert at.finished
    assert at.kept.tolist() == [0, 1]


def test_fit_compiles_no_refinement_and_leaves_the_threads_alone(monkeypatch):
    """The search is done on the host: nothing of it may call the refinement in JAX."""
    monkeypatch.setattr(import_module("modalax.identify.refine"), "_refine", None)
    monkeypatch.setattr(import_module("modalax.identify.residues"), "_fit", None)
    before = [pool["num_threads"] for pool in threadpool_info()]
    seen = []
    real = module.maximise
    monkeypatch.setattr(
        module, "maximise", lambda *a, **k: seen.append([p["num_threads"] for p in threadpool_info()]) or real(*a, **k)
    )
    frf = FRF(FREQ, FRF_.H, form="accelerance", outputs=FRF_.outputs, inputs=FRF_.inputs)
    found = fit(frf)
    assert np.allclose(found.model.frequency_hz, [30.0, 37.0], rtol=1e-2)
    assert max(n for row in seen for n in row) == 1  # a library that has not begun says 0
    assert [pool["num_threads"] for pool in threadpool_info()] == before


def test_known_weights_windows_and_a_single_inputs_participation_need_no_program(monkeypatch, caplog):
    """They are of few numbers, and JAX would compile a program for every new shape of a measurement."""
    lines = 83
    freq = np.linspace(24, 44, lines)
    frf = FRF(freq, np.asarray(MODEL.frf(freq, inputs=["a"]).H), outputs=MODEL.outputs, inputs=["a"])
    with jax.log_compiles(), caplog.at_level("WARNING"):
        window, weight = exponential_window(1237, 100.0, 0.5), line_weight(frf, "unit")
    assert "Compiling" not in caplog.text
    assert np.array_equal(window, np.exp(-0.5 * np.arange(1237) / 100.0)) and np.array_equal(
        weight, np.ones((lines, 1))
    )
    monkeypatch.setattr(import_module("modalax.identify.residues"), "_fit", None)
    assert np.allclose(residues(frf, MODEL.poles).modal_mass("a"), MODEL.modal_mass("a"), rtol=1e-9)
