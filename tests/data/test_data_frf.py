"""FRF and Measurement: what they accept, how they convert, and that they live under jit, vmap and grad."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from modalax import FRF, Measurement
from modalax.data import looks_conjugated
from modalax.data.causality import phase_fall
from modalax.model.examples import five_dof

FORMS = ("receptance", "mobility", "accelerance")


def frf(lines: int = 21, outputs: int = 3, inputs: int = 2, **changes) -> FRF:
    """Random numbers with a variance and a coherence; nothing physical."""
    rng = np.random.default_rng(0)
    shape = (lines, outputs, inputs)
    given = {
        "variance": rng.uniform(1, 2, shape), "coherence": rng.uniform(0, 1, shape), "level": 2.0, "averages": 4,
    }  # fmt: skip
    return FRF(np.linspace(1, 5, lines), rng.normal(size=shape) + 1j * rng.normal(size=shape), **{**given, **changes})


def test_forms_differ_by_powers_of_j_omega():
    f = frf()
    s = 1j * f.omega[:, None, None]
    mobility, accelerance = f.to_form("mobility"), f.to_form("accelerance")
    np.testing.assert_allclose(mobility.H, f.H * s, rtol=1e-15)
    np.testing.assert_allclose(accelerance.H, f.H * s**2, rtol=1e-15)
    np.testing.assert_allclose(mobility.variance, f.variance * jnp.abs(s) ** 2, rtol=1e-14)
    assert (mobility.form, accelerance.form) == ("mobility", "accelerance")


@pytest.mark.parametrize("form", FORMS)
def test_there_and_back_is_the_same(form):
    f = frf()
    back = f.to_form(form).to_form("receptance")
    np.testing.assert_allclose(back.H, f.H, rtol=1e-14)
    np.testing.assert_allclose(back.variance, f.variance, rtol=1e-14)
    assert f.to_form("receptance") is f


def test_zero_frequency_cannot_be_integrated():
    f = frf(form="accelerance").replace(freq=np.linspace(0, 4, 21))
    with pytest.raises(ValueError, match="accelerance at 0 Hz has no receptance: drop that line first"):
        f.to_form("receptance")
    assert f.lines(slice(1, None)).to_form("receptance").shape == (20, 3, 2)


def test_band_and_pick_cut_everything_alike():
    f = frf()
    part = f.band(2.0, 3.0).pick(["o3", "o1"], ["i2"])
    np.testing.assert_array_equal(part.freq, f.freq[5:11])
    for name in ("H", "variance", "coherence"):
        np.testing.assert_array_equal(getattr(part, name), np.asarray(getattr(f, name))[5:11][:, [2, 0]][:, :, [1]])
    assert (part.outputs, part.inputs, part.averages) == (("o3", "o1"), ("i2",), 4)


def test_band_limits_on_lines_are_inside_despite_rounding():
    f = FRF(np.arange(500) * 0.1, np.ones((500, 1, 1), complex))
    assert f.band(0.3, 0.7).shape[0] == 5


def test_transpose_exchanges_outputs_and_inputs():
    f = frf()
    t = f.transpose()
    np.testing.assert_array_equal(t.H, np.swapaxes(f.H, 1, 2))
    np.testing.assert_array_equal(t.coherence, np.swapaxes(f.coherence, 1, 2))
    assert (t.outputs, t.inputs) == (f.inputs, f.outputs)


@pytest.mark.parametrize(
    ("changes", "pattern"),
    [
        ({"freq": np.linspace(1, 5, 20)}, r"H has shape \(21, 3, 2\) for 20 frequency lines"),
        ({"freq": np.linspace(5, 1, 21)}, "freq must increase: line 1 is 4.8 Hz after 5 Hz"),
        ({"freq": np.linspace(-1, 5, 21)}, "freq starts at -1 Hz"),
        ({"freq": np.linspace(1, 5, 21, dtype=np.float32)}, "freq is in single precision"),
        ({"H": np.ones((21, 3, 2), np.complex64)}, r"H is in single precision \(complex64\).*astype\('complex128'\)"),
        (
            {"H": np.full((21, 3, 2), np.nan + 0j)},
            r"H holds 126 values that are not finite, the first at index \(0, 0, 0\)",
        ),
        ({"variance": -1.0}, "variance holds negative values"),
        ({"form": "inertance"}, "form is 'inertance'"),
        ({"outputs": ["a", "b"]}, "2 names for 3 outputs"),
        ({"inputs": ["a", "a"]}, "inputs names a stand more than once"),
        ({"averages": 0}, "averages is 0"),
    ],
)
def test_unusable_frf(changes, pattern):
    with pytest.raises(ValueError, match=pattern):
        frf().replace(**changes)


@pytest.mark.parametrize(
    ("call", "pattern"),
    [
        (lambda f: f.band(3.0, 2.0), "band 3 to 2 Hz is empty"),
        (lambda f: f.band(6.0, 7.0), "band 6 to 7 Hz holds no line; the data covers 1 to 5 Hz"),
        (lambda f: f.pick(["o9"]), "no output named 'o9'; there are o1, o2, o3"),
        (
            lambda f: f.add_noise(jax.random.key(0), 0.1, "loud"),
            "reference is 'loud'; it must be one of rms, peak, local",
        ),
    ],
)
def test_unusable_choice(call, pattern):
    with pytest.raises(ValueError, match=pattern):
        call(frf())


@pytest.mark.parametrize("reference", ["rms", "peak", "local"])
def test_noise_has_the_variance_that_is_recorded(reference):
    f = frf(lines=4000, outputs=1, inputs=2, variance=None)
    noisy = f.add_noise(jax.random.key(1), 0.1, reference)
    z = (noisy.H - f.H) / jnp.sqrt(noisy.variance)
    # 8000 complex samples: E|z|^2 = 1 to 1.1 % (one standard deviation), E z^2 = 0 for circular noise.
    assert float(jnp.mean(jnp.abs(z) ** 2)) == pytest.approx(1.0, abs=0.045)
    assert abs(complex(jnp.mean(z**2))) < 0.045


def test_frf_under_jit_vmap_and_grad():
    f = frf()
    np.testing.assert_allclose(jax.jit(lambda g: g.to_form("mobility").H)(f), f.to_form("mobility").H, rtol=1e-14)
    stacked = jax.vmap(lambda k: f.add_noise(k, 0.1).H)(jax.random.split(jax.random.key(0), 3))
    assert stacked.shape == (3, *f.shape)
    value, step = 1.7, 1e-6
    power = jax.jit(lambda a: jnp.sum(jnp.abs(f.replace(H=a * f.H).to_form("accelerance").H) ** 2))
    slope = (power(value + step) - power(value - step)) / (2 * step)
    # Central difference of a quadratic: exact but for rounding, 1e-16 of the value over 1e-6.
    np.testing.assert_allclose(jax.grad(power)(value), slope, rtol=1e-8)


def test_measurement_under_jit_vmap_and_grad():
    m = Measurement.from_frfs([frf(level=1.0), frf(level=2.0).replace(H=2 * frf().H)])
    got = jax.jit(lambda m: m.to_form("mobility"))(m)
    np.testing.assert_allclose(got.H, m.to_form("mobility").H, rtol=1e-14)
    assert (got.outputs, got.inputs, got.form, got.averages) == (m.outputs, m.inputs, "mobility", 4)
    np.testing.assert_allclose(got.level, m.level)

    @jax.jit
    def power(gain):
        louder = m.replace(H=m.H * gain[:, None, None, None])
        return sum(jnp.sum(jnp.abs(louder.run(k).to_form("accelerance").H) ** 2) for k in range(m.runs))

    gain, step = jnp.array([1.7, 0.4]), 1e-6
    slope = [(power(gain + step * e) - power(gain - step * e)) / (2 * step) for e in np.eye(2)]
    np.testing.assert_allclose(jax.grad(power)(gain), slope, rtol=1e-8)
    several = jax.vmap(power)(jnp.stack([gain, 2 * gain]))
    np.testing.assert_allclose(several, power(gain) * np.array([1.0, 4.0]), rtol=1e-12)
    for data in (m, frf()):
        with pytest.raises(ValueError, match="cut the band before"):
            jax.jit(lambda x: x.band(2.0, 3.0).H)(data)
    # A run taken under vmap over the runs is that run.
    runs = jax.vmap(lambda H, level: FRF(m.freq, H, form=m.form, level=level).to_form("mobility"))(m.H, m.level)
    np.testing.assert_allclose(runs.H[1], m.run(1).to_form("mobility").H, rtol=1e-14)


def test_measurement_gathers_runs_and_gives_them_back():
    runs = [frf(level=1.0), frf(level=2.0).replace(H=2 * frf().H)]
    m = Measurement.from_frfs(runs)
    assert m.runs == 2 and m.H.shape == (2, 21, 3, 2)
    np.testing.assert_array_equal(m.level, [1.0, 2.0])
    for k, run in enumerate(runs):
        for name in ("H", "variance", "coherence", "level", "freq"):
            np.testing.assert_array_equal(getattr(m.run(k), name), getattr(run, name))
    assert m.band(2.0, 3.0).H.shape == (2, 6, 3, 2)
    np.testing.assert_allclose(m.to_form("mobility").H[1], runs[1].to_form("mobility").H, rtol=1e-15)


def test_runs_that_do_not_fit_together():
    with pytest.raises(ValueError, match="run 1 differs from run 0 in its lines, channels or form"):
        Measurement.from_frfs([frf(), frf(form="mobility")])
    with pytest.raises(ValueError, match="run 1 differs from run 0"):
        Measurement.from_frfs([frf(), frf().replace(freq=np.linspace(1, 6, 21))])
    m = Measurement.from_frfs([frf(), frf()])
    with pytest.raises(ValueError, match="the measurement has 2 runs; pick one"):
        _ = m.frf
    with pytest.raises(ValueError, match="run 2 asked for, but there are 2 runs, counted from 0"):
        m.run(2)
    with pytest.raises(ValueError, match=r"level has shape \(3,\) for 2 runs"):
        m.replace(level=np.ones(3))
    with pytest.raises(ValueError, match=r"it needs \(run, f, o, i\)"):
        m.replace(H=m.H[0])


STRUCTURE = five_dof()
M, C, K = (np.asarray(A) for A in (STRUCTURE.M, STRUCTURE.C, STRUCTURE.K))


def physical(form: str, inputs: list[str], freq: np.ndarray, noise: float, outputs: str = "12345") -> FRF:
    """FRFs of the five-DoF system by NumPy alone, with noise relative to the rms of each channel."""
    w = 2 * np.pi * freq[:, None, None]
    H = np.linalg.inv(K + 1j * w * C - w**2 * M) * (1j * w) ** FORMS.index(form)
    H = H[:, [int(o) - 1 for o in outputs]][:, :, [int(i) - 1 for i in inputs]]
    rng = np.random.default_rng(3)
    sigma = noise * np.sqrt(np.mean(np.abs(H) ** 2, axis=0) / 2)
    noisy = H + sigma * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape))
    return FRF(freq, noisy, form=form, outputs=list(outputs), inputs=inputs)


def conjugated(f: FRF) -> FRF:
    return f.replace(H=np.conj(np.asarray(f.H)))


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("inputs", [["1"], ["2", "4"]])
@pytest.mark.parametrize(("step", "noise"), [(0.02, 0.0), (0.1, 0.25), (1.0, 0.0), (3.0, 0.0)])
def test_conjugation_is_seen_at_any_resolution(form, inputs, step, noise):
    """Half the bandwidth of the modes is 0.5 to 1.3 Hz: from 50 lines in it to none."""
    f = physical(form, inputs, np.arange(20.0, 70.0, step), noise)
    assert not looks_conjugated(f)
    assert looks_conjugated(conjugated(f))


def test_sure_figure_grows_with_the_sum_rule_it_comes_from():
    """On even lines the weighted sum is a moment of the impulse response: the same from the inverse FFT."""
    f = physical("receptance", ["1"], np.arange(20.0, 70.0, 0.1), 0.0)
    H = np.asarray(f.H[:, 0, 0])
    moment = np.sum(np.abs(np.fft.ifft(H)) ** 2 * np.sin(2 * np.pi * np.arange(len(H)) / len(H))) * len(H)
    around = np.append(H, H[0])
    assert moment == pytest.approx(-np.sum(np.imag(around[1:] * around[:-1].conj())), rel=1e-9)
    assert moment > 0
    assert phase_fall(f) == pytest.approx(-phase_fall(conjugated(f)), rel=1e-12)


def test_signs_gains_and_one_integration_too_many_are_not_conjugation():
    f = physical("accelerance", ["1", "3"], np.arange(20.0, 70.0, 0.1), 0.05)
    turned = f.replace(H=f.H * jnp.array([-1.0, 3.0, 1.0, -0.1, 1.0])[:, None])
    assert not looks_conjugated(turned)
    assert not looks_conjugated(f.replace(form="receptance"))
    assert not looks_conjugated(f.replace(H=f.H * 1j * f.omega[:, None, None]))


def test_noise_alone_is_called_conjugated_less_than_once_in_a_thousand():
    rng = np.random.default_rng(0)
    freq = np.linspace(1, 5, 60)
    calls = [
        looks_conjugated(FRF(freq, rng.normal(size=(60, 2, 2)) + 1j * rng.normal(size=(60, 2, 2)))) for _ in range(300)
    ]
    assert not any(calls)


def test_few_lines_of_a_drive_point_are_decided_by_its_energy():
    noisy = physical("receptance", ["1"], np.linspace(25.5, 26.6, 18), 0.25, outputs="1")
    assert abs(phase_fall(noisy)) < 4
    assert not looks_conjugated(noisy)
    assert looks_conjugated(conjugated(noisy))
    assert not looks_conjugated(conjugated(noisy).replace(outputs=["9"])), "without a drive point it is unsure"


def test_one_line_is_undecided():
    assert not looks_conjugated(FRF([5.0], np.full((1, 1, 1), -1j)))


def test_constant_variance_is_checked_under_jit_too():
    freq, H = np.arange(1.0, 5.0), np.ones((4, 1, 1), complex)
    made = jax.jit(lambda H: FRF(freq, H, variance=1e-3).variance)(H)
    np.testing.assert_array_equal(made, np.full(H.shape, 1e-3))
    runs = jax.jit(lambda H: Measurement(freq, H, variance=2e-3).variance)(H[None])
    np.testing.assert_array_equal(runs, np.full((1, *H.shape), 2e-3))
    for make in (FRF, lambda f, H, **k: Measurement(f, H[None], **k)):
        with pytest.raises(ValueError, match="negative values"):
            jax.jit(lambda H, make=make: make(freq, H, variance=-1.0).H)(H)
