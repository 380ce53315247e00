"""Time records to FRFs: exact on noise-free periods, honest about noise against Monte Carlo, scipy as second route."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal

from modalax.data import FRF, average_frfs, frf_from_blocks, frf_from_hits, frf_from_records
from modalax.data.records import pooled_frfs
from modalax.data.spectra import Spectra, estimate, input_noise, multiple_coherence, ordinary_coherence, spectra
from modalax.data.windows import decay_to, effective_averages, exponential_window, force_window, taper
from modalax.model.examples import five_dof

FS = 256.0


def periodic(inputs=("1", "3"), outputs=("1", "2", "5"), blocks=3, samples=256, seed=0, form="receptance"):
    """Noise-free periods: forces, responses and the FRF that made them."""
    frf = five_dof().frf(np.arange(samples // 2 + 1) * FS / samples, form=form, outputs=outputs, inputs=inputs)
    force = np.random.default_rng(seed).standard_normal((blocks, samples, len(inputs)))
    X = np.einsum("foi,mfi->mfo", np.asarray(frf.H), np.fft.rfft(force, axis=1))
    return force, np.fft.irfft(X, samples, axis=1), frf.lines(slice(1, samples // 2))


def complex_noise(rng, *shape):
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)


def spectra_of(F, X):
    """Spectra of blocks ``(m, f, channel)`` that are given in the frequency domain: every line is one draw."""
    m, f = F.shape[:2]
    return Spectra(
        freq=jnp.arange(1.0, f + 1),
        force=jnp.asarray(np.einsum("mfi,mfj->fij", F, F.conj()) / m),
        cross=jnp.asarray(np.einsum("mfo,mfi->foi", X, F.conj()) / m),
        response=jnp.asarray(np.mean(np.abs(X) ** 2, axis=0)),
        averages=float(m),
    )


# --- estimators -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("estimator", ["H1", "H2", "Hv"])
@pytest.mark.parametrize("inputs", [("1",), ("1", "3")])
def test_noise_free_periods_give_the_exact_frf(estimator, inputs):
    force, response, true = periodic(inputs)
    frf = frf_from_blocks(force, response, FS, unit="m", estimator=estimator)
    np.testing.assert_allclose(frf.freq, true.freq, rtol=1e-15)
    scale = float(jnp.abs(true.H).max())
    # 1e-15 of the largest was seen.
    np.testing.assert_allclose(frf.H / scale, true.H / scale, atol=1e-11)
    if len(inputs) == 1:
        np.testing.assert_allclose(frf.coherence, 1, atol=1e-12)
    # Noise comes out at rounding: the variance is a difference of numbers near 1; 1e-15 was seen.
    assert float((frf.variance / jnp.max(jnp.abs(frf.H), axis=0) ** 2).max()) < 1e-12


def test_records_agree_with_scipy():
    rng = np.random.default_rng(1)
    force = rng.standard_normal(5000)
    response = scipy.signal.lfilter([1, 0.5], [1, -0.9, 0.5], force) + 0.2 * rng.standard_normal(5000)
    frf = frf_from_records(force, response, FS, unit="m", block=1.0, overlap=0.5)
    common = dict(fs=FS, window="hann", nperseg=256, noverlap=128, detrend="constant")
    freq, cross = scipy.signal.csd(force, response, **common)
    power = scipy.signal.welch(force, **common)[1]
    coherence = scipy.signal.coherence(force, response, **common)[1]
    np.testing.assert_allclose(frf.freq, freq[1:-1], rtol=1e-15)
    np.testing.assert_allclose(frf.H[:, 0, 0], (cross / power)[1:-1], rtol=1e-11)
    np.testing.assert_allclose(frf.coherence[:, 0, 0], coherence[1:-1], rtol=1e-11)
    blocks = np.stack([force[k : k + 256] for k in range(0, 5000 - 255, 128)])
    s = spectra(*(jnp.asarray(b - b.mean(1, keepdims=True))[..., None] for b in (blocks, blocks)),
                jnp.asarray(taper("hann", 256)), fs=FS, averages=1.0)  # fmt: skip
    np.testing.assert_allclose(s.force[:, 0, 0].real, power[1:-1], rtol=1e-11)


def test_hv_of_one_input_is_the_geometric_mean_of_h1_and_h2():
    force, response, _ = periodic(("1",))
    response = response + 1e-7 * np.random.default_rng(2).standard_normal(response.shape)
    H1, H2, Hv = (frf_from_blocks(force, response, FS, unit="m", estimator=e).H for e in ("H1", "H2", "Hv"))
    np.testing.assert_allclose(jnp.abs(Hv), jnp.sqrt(jnp.abs(H1 * H2)), rtol=1e-12)
    np.testing.assert_allclose(H1 / jnp.abs(H1), Hv / jnp.abs(Hv), atol=1e-12)


def test_total_least_squares_of_two_inputs_solves_the_eigenproblem():
    rng = np.random.default_rng(3)
    F, X = complex_noise(rng, 6, 4, 2), complex_noise(rng, 6, 4, 3)
    s = spectra_of(F, X)
    H = np.asarray(estimate(s, estimator="Hv")[0])
    for f in range(4):
        for o in range(3):
            z = np.concatenate([F[:, f], X[:, f, o : o + 1]], axis=1)
            size = np.sqrt(np.mean(np.abs(z) ** 2, axis=0))
            left = np.linalg.svd(z / size)[2][-1]  # z v^* is smallest: rows of V^H are conjugated.
            row = left / size
            np.testing.assert_allclose(H[f, o], (-row[:2] / row[2]).conj(), rtol=1e-10)


def test_estimators_are_consistent_where_their_noise_is():
    """Each is right with noise where it expects it, and off by the share of noise where it does not."""
    rng = np.random.default_rng(4)
    lines, blocks, H = 100, 4000, np.array([[1.0, 2.0 - 1.0j]])
    F = complex_noise(rng, blocks, lines, 2) @ np.array([[1.0, 0.3], [0.0, 1.0]])
    X = np.einsum("oi,mfi->mfo", H, F)
    share = 0.1
    power_f, power_x = np.mean(np.abs(F) ** 2, axis=(0, 1)), np.mean(np.abs(X) ** 2, axis=(0, 1))
    noisy_F = F + np.sqrt(share * power_f) * complex_noise(rng, *F.shape)
    noisy_X = X + np.sqrt(share * power_x) * complex_noise(rng, *X.shape)
    # Error of the mean over all lines; 3e-3 was seen with noise as expected, 0.1 to 0.26 without.
    bound = 6e-3
    error = lambda F, X, e: np.abs(np.asarray(estimate(spectra_of(F, X), estimator=e)[0]).mean(axis=0) - H).max()
    assert error(F, noisy_X, "H1") < bound
    assert error(noisy_F, X, "H2") < bound
    assert error(noisy_F, noisy_X, "Hv") < bound
    for F_, X_, e in ((noisy_F, X, "H1"), (F, noisy_X, "H2"), (noisy_F, X, "Hv")):
        assert error(F_, X_, e) > 0.04
    found = np.asarray(input_noise(np, spectra_of(noisy_F, noisy_X), "Hv")).mean()
    assert found == pytest.approx(share / (1 + share), rel=0.02)


# --- noise ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("inputs", "blocks"), [(1, 3), (1, 8), (2, 5), (3, 12)])
@pytest.mark.parametrize("same_force", [True, False])
def test_variance_of_h1_is_unbiased_with_its_degrees_of_freedom(inputs, blocks, same_force):
    """Every line is a draw: mean of the stated variance against the scatter, its spread against chi-square."""
    rng = np.random.default_rng(10 * inputs + blocks)
    draws = 40_000
    F = complex_noise(rng, blocks, 1 if same_force else draws, inputs)
    F = np.broadcast_to(F, (blocks, draws, inputs))
    H = complex_noise(rng, 2, inputs)
    noise = np.array([0.3, 2.0])
    X = np.einsum("oi,mfi->mfo", H, F) + noise * complex_noise(rng, blocks, draws, 2)
    estimated, variance = (np.asarray(a) for a in estimate(spectra_of(F, X), estimator="H1"))
    true = np.mean(np.abs(estimated - H) ** 2, axis=0)
    # Scatter of 40,000 draws: 0.5 to 2 % was seen, for a fixed force and where its power varies too.
    np.testing.assert_allclose(variance.mean(axis=0), true, rtol=0.03)
    if same_force:
        exact = noise[:, None] ** 2 * np.diag(np.linalg.inv(F[:, 0].conj().T @ F[:, 0])).real
        np.testing.assert_allclose(variance.mean(axis=0), exact, rtol=0.02)
        # A chi-square of 2(M - i) degrees has relative variance 1/(M - i).
        spread = variance.var(axis=0) / variance.mean(axis=0) ** 2
        np.testing.assert_allclose(spread, 1 / (blocks - inputs), rtol=0.05)


def test_variance_of_one_input_is_the_expression_in_the_coherence():
    rng = np.random.default_rng(5)
    F = complex_noise(rng, 7, 20, 1)
    X = 2 * F + 0.5 * complex_noise(rng, 7, 20, 1)
    s = spectra_of(F, X)
    H, variance = estimate(s, estimator="H1")
    gamma2 = np.asarray(ordinary_coherence(s))
    np.testing.assert_allclose(variance, (1 - gamma2) / gamma2 * np.abs(H) ** 2 / 6, rtol=1e-12)
    np.testing.assert_allclose(multiple_coherence(s), gamma2[..., 0], rtol=1e-12)


@pytest.mark.parametrize("estimator", ["H2", "Hv"])
def test_variance_of_h2_and_hv_holds_to_first_order_in_noise(estimator):
    rng = np.random.default_rng(6)
    draws, blocks, share = 20_000, 20, 0.02
    F = complex_noise(rng, blocks, draws, 1)
    noise_f = np.sqrt(share) * complex_noise(rng, *F.shape)
    noise_x = 3 * np.sqrt(share) * complex_noise(rng, *F.shape) * (estimator == "Hv")
    H, variance = (np.asarray(a) for a in estimate(spectra_of(F + noise_f, 3 * F + noise_x), estimator=estimator))
    # 1 % was seen for H2, 3 % for Hv; the second order is about the share of noise.
    assert variance.mean() == pytest.approx(np.mean(np.abs(H - 3) ** 2), rel=0.05)


def test_multiple_coherence_is_the_share_of_power_explained():
    rng = np.random.default_rng(7)
    F = complex_noise(rng, 5000, 3, 2)
    X = F @ np.array([[1.0], [2.0]]) + 0.5 * complex_noise(rng, 5000, 3, 1)
    s = spectra_of(F, X)
    # Powers 1 + 4 against 0.25 of noise; the scatter of 5,000 blocks is 1e-3.
    np.testing.assert_allclose(multiple_coherence(s), 5 / 5.25, atol=5e-3)
    np.testing.assert_allclose(ordinary_coherence(s)[:, 0], np.full((3, 2), [1 / 5.25, 4 / 5.25]), atol=0.05)


def test_frfs_of_several_forces_carry_the_multiple_coherence():
    rng = np.random.default_rng(8)
    force = rng.normal(size=(40, 64, 2))
    response = force @ rng.normal(size=(2, 3)) + 0.1 * rng.normal(size=(40, 64, 3))
    frf = frf_from_blocks(force, response, 64.0, unit="m", outputs=["a", "b", "c"])
    s = spectra(force, response, np.ones(64), fs=64.0, averages=40.0)
    np.testing.assert_allclose(frf.multiple_coherence, multiple_coherence(s), rtol=1e-12)
    part = frf.lines(slice(3, 9)).pick(["c", "a"])
    np.testing.assert_array_equal(part.multiple_coherence, np.asarray(frf.multiple_coherence)[3:9, [2, 0]])
    np.testing.assert_array_equal(pooled_frfs([frf, frf]).multiple_coherence, frf.multiple_coherence)
    assert frf.transpose().multiple_coherence is None and frf.without_statistics().multiple_coherence is None
    assert frf_from_blocks(force[..., :1], response, 64.0, unit="m").multiple_coherence is None


@pytest.mark.parametrize(("window", "overlap"), [
    pytest.param("hann", 0.0, marks=pytest.mark.slow), pytest.param("hann", 0.5, marks=pytest.mark.slow),
    ("hann", 0.75), ("boxcar", 0.5),
])  # fmt: skip
def test_overlapping_blocks_count_for_what_they_are_worth(window, overlap):
    """Stated variance of a Welch FRF against its scatter over 250 records of white noise, pooled over lines."""
    rng = np.random.default_rng(8)
    samples, step = 64, round(64 * (1 - overlap))
    blocks = 20
    length = samples + (blocks - 1) * step
    H, variances = [], []
    for _ in range(250):
        force = rng.standard_normal(length)
        frf = frf_from_records(
            force, 2 * force + rng.standard_normal(length), FS, unit="m", block=samples / FS, overlap=overlap,
            window=window,
        )  # fmt: skip
        H.append(np.asarray(frf.H)[2:-2])
        variances.append(np.asarray(frf.variance)[2:-2])
    scatter = np.mean(np.abs(np.array(H) - 2) ** 2)
    assert frf.averages == int(effective_averages(taper(window, samples), step, blocks) + 1e-9)
    # 250 records of 27 lines, correlated by the window: 4 % was seen.
    assert np.mean(variances) == pytest.approx(scatter, rel=0.1)


def test_effective_averages_of_known_cases():
    assert effective_averages(taper("hann", 512), 512, 10) == 10
    # Hann at half overlap: rho_1 = (1/6)^2, the sum over w(t) w(t + n/2) divided by that over w^2.
    assert effective_averages(taper("hann", 512), 256, 10) == pytest.approx(10 / (1 + 2 * 0.9 / 36), rel=1e-12)
    assert effective_averages(np.ones(512), 256, 10) == pytest.approx(10 / (1 + 2 * 0.9 / 4), rel=1e-12)


def test_average_of_repeats_is_their_mean_with_its_variance():
    rng = np.random.default_rng(9)
    H = complex_noise(rng, 6, 4, 2, 1)
    mean = average_frfs([FRF(np.arange(1.0, 5), h) for h in H])
    np.testing.assert_allclose(mean.H, H.mean(axis=0), rtol=1e-14)
    np.testing.assert_allclose(mean.variance, H.var(axis=0, ddof=1) / 6, rtol=1e-13)
    assert mean.averages == 6


# --- windows and hits -------------------------------------------------------------------------------------------


def digital(poles, fs):
    """Two-pole digital filter of a continuous pole pair: exact in discrete time, so that nothing aliases."""
    z = np.exp(np.asarray(poles) / fs)
    return [0.0, 1.0], [1.0, -2 * z.real, abs(z) ** 2]


def hammer(rng, hits, block, fs, pole, double=(), noise=0.0, gap=0):
    """A record of half-sine hits on one vibrating mode; ``double`` names the hits with a second contact."""
    n = round(block * fs)
    force = np.zeros(hits * (n + gap))
    pulse = np.sin(np.pi * np.arange(1, 6) / 6)
    for k in range(hits):
        at = k * (n + gap) + 20
        force[at : at + 5] += 50 * rng.uniform(0.8, 1.2) * pulse
        if k in double:
            force[at + 40 : at + 45] += 20 * pulse
    response = scipy.signal.lfilter(*digital(pole, fs), force)
    return force, response + noise * rng.standard_normal(len(force))


def test_the_exponential_window_moves_every_pole_exactly():
    """Also for hits that come late or twice, because force and response carry the same window."""
    fs, n, pole, decay = 500.0, 2000, -1.0 + 200.0j, 6.0
    force = np.zeros(n)
    force[[3, 4, 90]] = 1.0, 2.0, 0.7
    response = scipy.signal.lfilter(*digital(pole, fs), force)
    frf = frf_from_blocks(force[None, :, None], response[None, :, None], fs, unit="m", decay=decay)
    z = np.exp((2j * np.pi * np.asarray(frf.freq) + decay) / fs)
    # What is left at the end of the block is e^{-(1 + 6) 4} = 7e-13 of the response.
    b, a = digital(pole, fs)
    expected = (b[1] / z) / (a[0] + a[1] / z + a[2] / z**2)
    np.testing.assert_allclose(frf.H[:, 0, 0], expected, atol=1e-10 * np.abs(expected).max())
    assert float(frf.added_decay) == decay
    assert frf.variance is None and frf.coherence is None and frf.averages is None


def test_changing_the_form_of_a_windowed_frf_keeps_to_its_path():
    """The window evaluates H at s = jw + decay, so that is what integrates an accelerance."""
    decay, freq = 5.0, np.arange(1.0, 40.0)
    s = 2j * np.pi * freq + decay
    receptance = 1 / (s**2 + 2 * s + 2e4)
    frf = FRF(freq, (s**2 * receptance)[:, None, None], form="accelerance", added_decay=decay)
    np.testing.assert_allclose(frf.to_form("receptance").H[:, 0, 0], receptance, rtol=1e-13)


def test_windows_are_what_they_say():
    force = np.asarray(force_window(100, 100.0, stop=0.3, start=0.1, ramp=0.1))
    np.testing.assert_array_equal(force[10:31], 1)
    assert force[35] == pytest.approx(0.5) and force[5] == pytest.approx(0.5)
    np.testing.assert_allclose(force[40:], 0, atol=1e-15)
    np.testing.assert_array_equal(np.asarray(force_window(10, 10.0, stop=0.45)), [1] * 5 + [0] * 5)
    decay = decay_to(0.01, 2.0)
    assert float(exponential_window(201, 100.0, decay)[-1]) == pytest.approx(0.01, rel=1e-12)
    np.testing.assert_allclose(taper("hann", 8), 0.5 - 0.5 * np.cos(np.pi * np.arange(8) / 4), atol=1e-15)


def test_hits_are_found_cut_and_averaged():
    # Damped so that nothing is left at the end of the block, e^{-(20 + 2) 0.95} = 8e-10.
    fs, pole = 1000.0, -20.0 + 400.0j
    rng = np.random.default_rng(11)
    force, response = hammer(rng, 6, 1.0, fs, pole, noise=1e-3)
    frf = frf_from_hits(force, response, fs, unit="m", block=0.95, pretrigger=0.005, contact=0.02, decay=2.0)
    assert frf.averages == 6
    b, a = digital(pole, fs)
    z = np.exp((2j * np.pi * np.asarray(frf.freq) + 2.0) / fs)
    true = (b[1] / z) / (a[0] + a[1] / z + a[2] / z**2)
    inside = np.asarray(frf.freq) < 100
    whitened = np.abs(np.asarray(frf.H)[:, 0, 0] - true)[inside] / np.sqrt(np.asarray(frf.variance)[:, 0, 0])[inside]
    # |error|^2 over its estimate from 6 hits follows F(2, 10): 1.25 +- 0.17 over 94 lines.
    assert np.mean(whitened**2) == pytest.approx(1.25, rel=0.5)
    # The pole shows where it belongs once the window's decay is taken back: the peak of |H| is at 400 rad/s.
    peak = 2 * np.pi * float(frf.freq[jnp.argmax(jnp.abs(frf.H[:, 0, 0]))])
    assert abs(peak - 400) < 2 * np.pi / 0.95


def test_double_hits_and_overloads_are_left_out_with_a_warning():
    fs, rng = 1000.0, np.random.default_rng(12)
    force, response = hammer(rng, 5, 1.0, fs, -8.0 + 400.0j, double=(1,))
    clipped = np.clip(response, -np.inf, 0.97 * response.max())
    settings = dict(unit="m", block=0.95, pretrigger=0.005)
    with pytest.warns(UserWarning) as record:
        frf = frf_from_hits(force, clipped, fs, **settings, full_scale=[1e9, clipped.max()])
    messages = [str(w.message) for w in record]
    assert "hits 2 of 5 left out: double hits" in messages
    assert any(m.endswith("left out: overloaded") for m in messages)
    assert frf.averages == 5 - 1 - sum(clipped[k * 1000 : (k + 1) * 1000].max() == clipped.max() for k in (0, 2, 3, 4))
    assert frf_from_hits(force, response, fs, **settings, keep_all=True).averages == 5


def test_a_clipped_peak_is_seen_without_knowing_the_full_scale():
    fs, rng = 1000.0, np.random.default_rng(13)
    force, response = hammer(rng, 3, 1.0, fs, -8.0 + 400.0j)
    force[1020:1025] = force.max() * 1.2
    with pytest.warns(UserWarning, match="hits 2 of 3 left out: overloaded"):
        frf = frf_from_hits(force, response, fs, unit="m", block=0.95, pretrigger=0.005)
    assert frf.averages == 2


def test_a_hit_without_its_whole_block_is_left_out_with_a_warning():
    fs, rng = 1000.0, np.random.default_rng(14)
    force, response = hammer(rng, 3, 1.0, fs, -8.0 + 400.0j)
    with pytest.warns(UserWarning, match="1 hits left out: the record of 2.5 s"):
        frf = frf_from_hits(force[:2500], response[:2500], fs, unit="m", block=0.9)
    assert frf.averages == 2


# --- units, transformations, messages ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("unit", "form", "factor"),
    [("m", "receptance", 1), ("m/s", "mobility", 1), ("m/s^2", "accelerance", 1), ("g", "accelerance", 9.80665)],
)
def test_the_unit_of_the_response_decides_the_form(unit, form, factor):
    force, response, _ = periodic(("1",))
    noise = response + 1e-6 * np.random.default_rng(0).standard_normal(response.shape)
    frf, plain = (frf_from_blocks(force, noise, FS, unit=u) for u in (unit, "m"))
    assert frf.form == form
    np.testing.assert_allclose(frf.H, factor * plain.H, rtol=1e-14)
    np.testing.assert_allclose(frf.variance, factor**2 * plain.variance, rtol=1e-14)


def test_band_names_and_level_are_kept():
    force, response, true = periodic()
    frf = frf_from_blocks(
        force, response, FS, unit="m", band=(20.0, 70.0), outputs=["1", "2", "5"], inputs=["1", "3"], level=6.0
    )
    np.testing.assert_allclose(frf.freq, true.band(20.0, 70.0).freq)
    assert (frf.outputs, frf.inputs, float(frf.level)) == (("1", "2", "5"), ("1", "3"), 6.0)


@pytest.mark.parametrize("estimator", ["H1", "Hv"])
def test_derivatives_with_respect_to_samples(estimator):
    force, response, _ = periodic(blocks=4, samples=32)
    rng = np.random.default_rng(15)
    response = response / np.abs(response).max() + 0.1 * rng.standard_normal(response.shape)

    @jax.jit
    def loss(x):
        frf = frf_from_blocks(force, x, FS, unit="m", estimator=estimator)
        assert frf.variance is not None
        return jnp.sum(jnp.abs(frf.H) ** 2) + jnp.sum(frf.variance)

    direction, step = rng.standard_normal(response.shape), 1e-6
    numeric = (loss(response + step * direction) - loss(response - step * direction)) / (2 * step)
    # 7e-9 was seen.
    assert float(jnp.sum(jax.grad(loss)(response) * direction)) == pytest.approx(float(numeric), rel=1e-6)


def test_many_noise_draws_at_once():
    force, response, _ = periodic(blocks=4, samples=32)
    noise = 1e-6 * np.random.default_rng(16).standard_normal((2, *response.shape))
    one = lambda x: frf_from_blocks(force, x, FS, unit="m", estimator="Hv")
    together = jax.jit(jax.vmap(one))(response + noise)
    for k in range(2):
        alone = one(response + noise[k])
        np.testing.assert_allclose(together.H[k], alone.H, rtol=1e-8)
        np.testing.assert_allclose(together.variance[k], alone.variance, rtol=1e-6)


def test_continuous_records_under_jit():
    rng = np.random.default_rng(17)
    force, response = rng.standard_normal((2, 600))
    one = lambda x: frf_from_records(force, x, FS, unit="m", block=0.5)
    np.testing.assert_allclose(jax.jit(one)(response).H, one(response).H, rtol=1e-10)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda f, x: frf_from_blocks(f, x, FS, unit="mm"), "unit is 'mm'; a response can be in m, m/s"),
        (lambda f, x: frf_from_blocks(f, x, FS, unit="m", estimator="H3"), "estimator is 'H3'"),
        (lambda f, x: frf_from_blocks(f[0], x, FS, unit="m"), r"they need \(m, t, i\)"),
        (lambda f, x: frf_from_blocks(f[:1], x[:1], FS, unit="m"), "1 independent blocks for 2 forces; at least 2"),
        (lambda f, x: frf_from_blocks(0 * f, x, FS, unit="m"), "force 1 is zero at 254 lines, the first at 1 Hz"),
        (lambda f, x: frf_from_blocks(f[..., [0, 0]], x, FS, unit="m"), "the 2 forces are one at"),
        (lambda f, x: frf_from_blocks(f, x, FS, unit="m", band=(200.0, 300.0)), "the band 200 to 300 Hz holds no line"),
        (lambda f, x: frf_from_blocks(f.astype("float32"), x, FS, unit="m"), "force is in single precision"),
        (lambda f, x: frf_from_records(f[0], x[0][:-1], FS, unit="m", block=0.2), "256 samples and response 255"),
        (lambda f, x: frf_from_records(f[0], x[0], FS, unit="m", block=2.0), r"blocks of 2 s .512 samples."),
        (lambda f, x: frf_from_records(f[0] * np.nan, x[0], FS, unit="m", block=0.2), "force holds 512 values"),
        (lambda f, x: frf_from_records(f[0], x[0], FS, unit="m", block=0.2, window="hat"), "no window named 'hat'"),
        (lambda f, x: frf_from_hits(f[0], x[0], FS, unit="m", block=0.2), "force has 2 channels; a record of hits"),
        (lambda f, x: frf_from_hits(0 * f[0, :, 0], x[0], FS, unit="m", block=0.2), "no whole hit in 1 s"),
        (lambda f, x: average_frfs([FRF([1.0], [[[1.0]]])]), "1 FRFs; at least 2"),
        (lambda f, x: force_window(10, 10.0, stop=0.1, start=0.2), "keeps 0.2 to 0.1 s"),
        (lambda f, x: decay_to(0.0, 1.0), "remainder 0 after 1 s"),
    ],
)
def test_unusable_input_is_said(call, message):
    force, response, _ = periodic()
    with pytest.raises(ValueError, match=message):
        call(force, response)


# --- measured ---------------------------------------------------------------------------------------------------


@pytest.mark.measured
def test_measured_hammer_hits_give_clean_frfs(measured):
    files = [measured / "hammer_hits" / f"measurements_{k}.npy" for k in range(1, 6)]
    records = np.concatenate([np.load(f) for f in files], axis=1)
    fs = 25_600.0
    # The record's units are unknown; the form does not matter for peaks and coherence.
    frf = frf_from_hits(records[1], records[2], fs, unit="m/s^2", block=0.99, pretrigger=10 / fs)
    assert frf.averages == 5
    freq, size = np.asarray(frf.freq), np.abs(np.asarray(frf.H)[:, 0, 0])
    for expected in (810, 851, 900, 2640):
        near = np.abs(freq - expected) < 15
        assert abs(freq[near][size[near].argmax()] - expected) < 2
        # A peak, not a slope: lower on both sides of the neighbourhood by a factor; 3.9 was the smallest seen.
        assert size[near].max() > 2 * max(size[near][0], size[near][-1])
    band = (freq > 700) & (freq < 1000)
    coherence = np.asarray(frf.coherence)[:, 0, 0]
    assert np.median(coherence[band]) > 0.999
    # The FRF's own standard deviation there: 0.5 % was seen.
    relative = np.sqrt(np.asarray(frf.variance)[:, 0, 0]) / size
    assert np.median(relative[band]) < 0.01
