"""The whole way from FRFs to modes where nothing but the FRFs is given."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from modalax.data import FRF
from modalax.identify import best_order, fit, lscf, missing_modes, plscf, refine, residues, select
from modalax.identify.host import refine_on_host
from modalax.identify.noise import residual_sigma
from modalax.model import ModalModel
from modalax.model.indicators import mpc

FREQ = np.linspace(20, 110, 601)


def noisy(model, seed, level, kind, form="receptance", inputs=("1",)):
    """FRFs with noise of a size that is not said: even over the lines, or in proportion to the response."""
    rng = np.random.default_rng(seed)
    clean = model.frf(FREQ, inputs=list(inputs), form=form)
    size = np.abs(np.asarray(clean.H))
    sigma = level * (size if kind == "relative" else np.sqrt((size**2).mean(axis=0, keepdims=True)) + 0 * size)
    noise = sigma * (rng.normal(size=size.shape) + 1j * rng.normal(size=size.shape)) / np.sqrt(2)
    return FRF(FREQ, clean.H + noise, form=form, outputs=clean.outputs, inputs=clean.inputs), sigma


def six(frequency, seed):
    rng = np.random.default_rng(seed)
    n = len(frequency)
    return ModalModel.from_real_modes(
        frequency, rng.uniform(0.003, 0.02, n), rng.normal(size=(n, 6)), rng.uniform(0.5, 2, n), list("123456")
    )


@pytest.fixture(scope="module")
def outside():
    """Four modes in the band, one a little below it and one a little above."""
    return six([15.5, 31.0, 52.0, 55.0, 88.0, 117.0], 1)


@pytest.mark.parametrize("kind", ["even", pytest.param("relative", marks=pytest.mark.slow)])
def test_noise_is_read_off_the_residual(kind, outside):
    """Typical deviation within 15 %, and no likelihood lost against the true one (it has more freedom)."""
    frf, sigma = noisy(outside, 0, 0.05, kind)
    refined = refine_on_host(frf, residues(frf, outside.poles))
    found = np.asarray(residual_sigma(frf, refined, "auto", proportional=True))
    assert abs(np.median(found / sigma) - 1) < 0.15
    error = np.abs(np.asarray(frf.H) - np.asarray(outside.frf(FREQ, inputs=["1"]).H)) ** 2

    def likelihood(s):
        return -np.mean(np.log(s**2) + error / s**2)

    assert likelihood(found) > likelihood(sigma) - 0.03


def test_mode_below_the_band_is_looked_for_below_it(outside):
    frf, sigma = noisy(outside, 0, 0.01, "even", form="accelerance")
    model = residues(frf, outside.poles[1:])
    found = np.abs(np.asarray(missing_modes(frf, model, jnp.asarray(sigma)))) / (2 * np.pi)
    assert found.size == 1
    assert 10 < found[0] < 20  # near 15.5 Hz: a slope at the end of the band says no more


@pytest.mark.slow
def test_nothing_is_missing_where_nothing_is(outside):
    frf, sigma = noisy(outside, 1, 0.05, "relative")
    model = refine(frf, residues(frf, outside.poles), weights=jnp.asarray(sigma)).model
    assert missing_modes(frf, model, [jnp.asarray(sigma)]).size == 0


@pytest.mark.slow
def test_robust_errors_grow_where_rows_differ():
    """The frequency of one mode scatters by 0.1 % from row to row: no noise model of independent lines sees that."""
    rng = np.random.default_rng(0)
    freq = np.linspace(45, 55, 201)
    s = 2j * np.pi * freq[:, None]
    omega = 2 * np.pi * 50 * (1 + 1e-3 * rng.normal(size=40))
    poles = omega * (-0.01 + 1j * np.sqrt(1 - 1e-4))
    H = 1 / (s - poles) + 1 / (s - poles.conj()) + 1e-6 * rng.normal(size=(201, 40))
    frf = FRF(freq, H[:, :, None], outputs=[str(k) for k in range(40)], inputs=["0"])
    start = residues(frf, [complex(poles.mean())])
    plain, robust = (refine(frf, start, covariance=kind) for kind in ("gauss-newton", "robust"))
    due = 50e-3 / np.sqrt(40)  # of the mean frequency over the rows
    assert 0.6 < float(robust.frequency_std_hz[0]) / due < 1.6
    assert float(plain.frequency_std_hz[0]) < 0.5 * due


@pytest.mark.slow
def test_long_diagrams_in_parts_are_the_short_ones(forty):
    """From 100 poles on orders are grouped by size; the poles of an order stay the same."""
    # Without noise the unstable computational poles are a matter of rounding.
    frf = forty.frf(np.arange(0, 1000) * 0.1, inputs=["a"]).add_noise(jax.random.key(0), 1e-3)
    long, short = lscf(frf, [30, 50, 100]), lscf(frf, [30, 50], numerator=100)
    for row in (0, 1):
        one, two = (np.asarray(t.poles[row])[np.asarray(t.valid[row])] for t in (long, short))
        assert len(one) == len(two) == (30, 50)[row]
        assert np.all(np.min(np.abs(one[:, None] - two), axis=1) < 1e-6 * np.abs(one))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["even", "relative"])
@pytest.mark.parametrize("level", [0.01, 0.1])
def test_fit_finds_all_modes_and_no_others(kind, level, outside):
    """Noise of unknown size: the right number of modes, and errors that the stated deviations allow."""
    frf, _ = noisy(outside, 3, level, kind, inputs=("1", "4"))
    found = fit(frf)
    inside = np.asarray(found.inside)
    f, zeta = np.asarray(found.model.frequency_hz)[inside], np.asarray(found.model.damping_ratio)[inside]
    assert f.size == 4
    assert found.refined is not None
    true_f, true_zeta = np.asarray(outside.frequency_hz)[1:5], np.asarray(outside.damping_ratio)[1:5]
    z = np.concatenate(
        [
            (f - true_f) / np.asarray(found.refined.frequency_std_hz)[inside],
            (zeta - true_zeta) / np.asarray(found.refined.damping_std)[inside],
        ]
    )
    assert np.max(np.abs(z)) < 4
    assert np.sqrt(np.mean(z**2)) < 2


@pytest.mark.slow
@pytest.mark.parametrize(("estimator", "inputs"), [(lscf, "a"), (plscf, "ac")], ids=["lscf", "plscf, two inputs"])
def test_same_modes_out_of_thirty_random_bands(estimator, inputs, forty, errors, poles_of):
    """Modes inside by three half-bandwidths: 1e-6 in frequency and 1e-4 in damping at the order chosen by itself, and
    1e-5 and 1e-3 at every higher one. Seen: 3e-12 and 7e-11 at most, with the solver that is taken by itself."""
    rng = np.random.default_rng(30)
    whole = forty.frf(np.arange(0, 3500) * 0.05, inputs=list(inputs))
    f, zeta = np.asarray(forty.frequency_hz), np.asarray(forty.damping_ratio)
    for k in range(30):
        width = rng.uniform(25, 110)
        lower = 0.0 if k % 5 == 0 else rng.uniform(0, 150 - width)
        band = (lower, lower + width)
        inside = (f - 3 * zeta * f > band[0]) & (f + 3 * zeta * f < band[1])
        # Every band with as many lines, so that all share one compiled function.
        step = max(1, int(width / 0.05) // 500)
        first = int(round(lower / 0.05))
        frf = whole.lines(slice(first, first + 500 * step, step))
        inside &= f + 3 * zeta * f < float(frf.freq[-1])
        orders = range(20 // len(inputs), 100 // len(inputs) + 1, 4 // len(inputs))
        table = estimator(frf, orders)
        chosen = best_order(table, select(table, band=(float(frf.freq[0]), float(frf.freq[-1])), max_damping=0.1))
        for order in [n for n in orders if n >= chosen]:
            limits = (1e-6, 1e-4) if order == chosen else (1e-5, 1e-3)
            frequency, damping = errors(poles_of(table, order), forty, inside)
            assert frequency < limits[0], (band, order)
            assert damping < limits[1], (band, order)


@pytest.mark.parametrize(("band", "inputs"), [((0.0, 36.0), "a"), ((102.0, 132.0), "ac")], ids=["from 0 Hz", "far"])
def test_fit_gives_the_same_modes_out_of_any_band(band, inputs, forty, errors):
    """Without noise what modes beyond the band make must not bend, drop or turn those inside, which are real.

    Seen: errors of 6e-11 and 4e-9 at most; MPC 0.99999; without the diagram's poles beyond the band it was 0.06.
    """
    frf = forty.frf(np.arange(0, 1750) * 0.1, inputs=list(inputs)).band(*band)
    found = fit(frf)
    assert found.refined is not None and found.refined.success
    assert "of the diagram" in found.refined.reason
    f, zeta = np.asarray(forty.frequency_hz), np.asarray(forty.damping_ratio)
    inside = (f - 3 * zeta * f > band[0]) & (f + 3 * zeta * f < band[1])
    frequency, damping = errors(found.model.poles, forty, inside)
    assert frequency < 1e-6
    assert damping < 1e-4
    own = np.asarray(found.inside)
    assert own.sum() == np.sum((f > band[0]) & (f < band[1]))
    near = np.abs(np.asarray(found.model.frequency_hz)[own, None] - f).argmin(axis=1)
    z = (np.asarray(found.model.frequency_hz)[own] - f[near]) / np.asarray(found.refined.frequency_std_hz)[own]
    assert np.abs(z).max() < 2
    assert np.all(np.asarray(found.refined.frequency_std_hz)[own] < 1e-4 * f[near])
    for modes in (found, fit(frf, refine=False)):
        seen = np.flatnonzero(modes.inside)
        assert np.asarray(mpc(modes.model.shapes))[seen].min() > 0.999
        assert not any("disagree" in word for r in seen for word in modes.flags[r])


def test_score_of_a_mode_is_of_stability_collinearity_and_energy(outside):
    """A fit without refinement; what each mode makes is summed here from its own FRF."""
    frf, _ = noisy(outside, 3, 0.1, "even", inputs=("1", "4"))
    found = fit(frf, refine=False)
    model, total = found.model, float(jnp.sum(jnp.abs(frf.H) ** 2))
    for r in np.flatnonzero(np.asarray(found.inside)):
        own = ModalModel(
            model.poles[r : r + 1], model.shapes[r : r + 1], model.participation[r : r + 1],
            outputs=model.outputs, inputs=model.inputs,
        )  # fmt: skip
        energy = float(jnp.sum(jnp.abs(own.frf(FREQ).H) ** 2)) / total
        assert float(found.energy[r]) == pytest.approx(energy, rel=0.02)  # the lower pole adds a little
        strength = energy / (energy + float(found.unexplained))
        mean = (float(found.stability_score[r]) + float(mpc(own.shapes)[0]) + strength) / 3
        assert float(found.score[r]) == pytest.approx(mean, abs=0.01)
    modes = found.to_dict()["modes"]
    assert [m["score"] for m in modes] == pytest.approx(np.asarray(found.score)[np.asarray(found.inside)])
    # The weakest is known least.
    assert np.argmin([m["energy"] for m in modes]) == np.argmin([m["score"] for m in modes])
    # With a roving hammer the shapes run along the inputs, and so does collinearity.
    roving = fit(frf.transpose(), refine=False)
    assert np.allclose(roving.mpc, found.mpc, atol=1e-9)


def test_what_cannot_be_fitted_is_said():
    shape = (64, 2, 1)
    freq = np.linspace(10.0, 20.0, 64)
    with pytest.raises(ValueError, match="zero throughout the band"):
        fit(FRF(freq, np.zeros(shape, complex)))
    rng = np.random.default_rng(0)
    noise = FRF(freq, rng.normal(size=shape) + 1j * rng.normal(size=shape))
    with pytest.raises(ValueError, match="method is 'era'; it must be one of"):
        fit(noise, method="era")
