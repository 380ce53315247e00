"""The noise bias of LSCF and pLSCF: predicted without drawing noise, and found again by drawing it."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from modalax.data.frf import FRF
from modalax.identify import lscf, plscf
from modalax.identify.bias import expected_poles, one_pole_shift, pole_paths, predicted_damping_bias
from modalax.model.examples import five_dof

FREQ = np.arange(200, 701) * 0.1
STRUCTURE = five_dof()
TRUE = STRUCTURE.modal().poles


def review_frf(form="receptance", inputs=("1",), step=1):
    return STRUCTURE.frf(FREQ[::step], inputs=list(inputs), form=form)


def white(frf, level):
    """Variance of noise of ``level`` times each channel's rms on the real and on the imaginary part."""
    rms = jnp.sqrt(jnp.mean(jnp.abs(frf.H) ** 2, axis=0, keepdims=True))
    return jnp.broadcast_to(2 * (level * rms) ** 2, frf.H.shape)


def draws(frf, variance, estimate, count):
    """Poles of ``count`` noisy copies, unstable ones left in: they belong to the mean."""

    def one(key):
        real, imag = jax.random.normal(key, (2, *frf.H.shape))
        noisy = eqx.tree_at(lambda f: f.H, frf, frf.H + (real + 1j * imag) * jnp.sqrt(variance / 2))
        table = estimate(noisy)
        return table.poles[0], table.valid[0]

    poles, valid = jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(7), count))
    return np.where(valid, poles, np.inf)


def nearest_damping(poles, targets):
    """Damping ratios of the poles next to each target, shape (draw, mode)."""
    near = np.argmin(np.abs(poles[:, :, None] - np.asarray(targets)), axis=1)
    found = np.take_along_axis(poles, near, axis=1)
    return -found.real / np.abs(found)


CASES = {
    "complex, arc 0.6": dict(method="lscf", order=20, options={}),
    "complex, whole circle": dict(method="lscf", order=16, options=dict(arc=1.0)),
    "real": dict(method="lscf", order=24, options=dict(real=True)),
    "accelerance": dict(method="lscf", order=20, options={}, form="accelerance"),
    "variance weights": dict(method="lscf", order=16, options=dict(weights="variance"), sloped=True),
    "larger numerator": dict(method="lscf", order=14, options=dict(numerator=20)),
    "two references": dict(method="plscf", order=8, options={}, inputs=("1", "4")),
    "two references, real": dict(method="plscf", order=12, options=dict(real=True), inputs=("1", "4")),
}


# The other options change one factor each of what these two go through.
QUICK = ("real", "variance weights")


@pytest.mark.parametrize("case", [c if c in QUICK else pytest.param(c, marks=pytest.mark.slow) for c in CASES])
def test_predicted_damping_bias_is_the_mean_over_draws(case):
    spec = CASES[case]
    frf = review_frf(spec.get("form", "receptance"), spec.get("inputs", ("1",)), step=4)
    variance = white(frf, 0.04)
    if spec.get("sloped"):
        variance = variance * jnp.linspace(0.3, 3.0, frf.H.shape[0])[:, None, None]
    frf = frf.replace(variance=variance)
    estimator = {"lscf": lscf, "plscf": plscf}[spec["method"]]
    bias = predicted_damping_bias(frf, TRUE, spec["order"], method=spec["method"], **spec["options"])
    found = nearest_damping(
        draws(frf, variance, lambda f: estimator(f, spec["order"], **spec["options"]), 100), bias.poles
    )
    mean, error = found.mean(axis=0), found.std(axis=0) / np.sqrt(len(found))
    good = np.asarray(bias.valid)
    assert good[[0, 1, 3, 4]].all()
    predicted = 0.02 + np.asarray(bias.damping)
    gap = np.abs(mean - predicted)[good]
    # 3 % of the bias, or 3.3 standard errors, which one of thirty comparisons exceeds with 3 % chance. The mean matrix
    # leaves its spread out, which was measured as 0.2 % of the damping with real coefficients.
    second = 0.003 * 0.02 if spec["options"].get("real") else 0.0
    assert np.all(gap < np.maximum(0.03 * np.abs(predicted - 0.02), 3.3 * error + second)[good])


def test_frequency_stays_where_damping_falls():
    frf = review_frf()
    bias = predicted_damping_bias(frf, TRUE, 20, variance=white(frf, 0.15), arc=1.0)
    assert not bias.valid[2]  # mode 3 is hardly excited: lost in the noise, and said
    good = np.asarray(bias.valid)
    assert np.all(np.asarray(bias.relative_damping)[good] < -0.03)
    assert np.all(np.abs(np.asarray(bias.relative_frequency)[good]) < 0.004)


def test_one_pole_shift_is_real_and_in_closed_form():
    # One pole on the whole circle, periodic lines: M11 and C are then the energies of the rows.
    n = 64
    freq = 10 + np.arange(n) * 0.1
    span = 2 * np.pi * (freq[-1] - freq[0])
    arc = (n - 1) / n
    step = 2 * np.pi * arc / span
    centre = np.pi * (freq[0] + freq[-1])
    u = np.exp(-1j * (2 * np.pi * freq - centre) * step)
    pole = -0.8 + 2j * np.pi * 13.0
    root = np.exp(-(pole - 1j * centre) * step)
    H = 1 / (1 - u / root)  # one pole, constant numerator
    sigma2 = 0.05
    frf = FRF(freq, H[:, None, None], variance=sigma2 * np.ones((n, 1, 1)))
    table = expected_poles(frf, 1, arc=arc, numerator=0, ridge=0.0)
    # The constant numerator takes the mean: what is left of H has this energy, what is left of the noise n - 1.
    energy = np.sum(np.abs(H - H.mean()) ** 2)
    shift = one_pole_shift(sigma2 * (n - 1), energy, step)
    # Measured: 5e-17.
    np.testing.assert_allclose(table.poles[0, 0], pole + shift, rtol=1e-12)
    assert shift > 0


def pole_of(frf, variance, scale, ridge, which, real):
    table = expected_poles(frf, 12, variance=variance, scale=scale, ridge=ridge, arc=0.95, real=real)
    good = jnp.where(table.valid[0], jnp.abs(table.poles[0] - TRUE[which]), jnp.inf)
    return table.poles[0, jnp.argmin(jax.lax.stop_gradient(good))]


@pytest.mark.slow
@pytest.mark.parametrize("real", [False, True])
def test_jacobians_of_a_pole_agree_with_differences(real):
    frf = review_frf(step=5)
    variance = white(frf, 0.05)

    def zeta(log_scale, log_ridge, gain):
        louder = eqx.tree_at(lambda f: f.H, frf, frf.H.at[40, 2, 0].multiply(gain))
        pole = pole_of(louder, variance, jnp.exp(log_scale), jnp.exp(log_ridge), 3, real)
        return -pole.real / jnp.abs(pole)

    at = (jnp.asarray(0.1), jnp.log(1e-3), jnp.asarray(1.05))
    slope = jax.jit(jax.grad(zeta, argnums=(0, 1, 2)))
    first, second = slope(*at), jax.jit(jax.hessian(zeta, argnums=(0, 1, 2)))(*at)
    h = 1e-4
    for k in range(3):
        up = [a + h * (j == k) for j, a in enumerate(at)]
        down = [a - h * (j == k) for j, a in enumerate(at)]
        difference = (zeta(*up) - zeta(*down)) / (2 * h)
        # The truncation of the difference.
        np.testing.assert_allclose(first[k], difference, rtol=1e-6, atol=1e-12)
        gradients = [slope(*p) for p in (up, down)]
        for j in range(3):
            difference = (gradients[0][j] - gradients[1][j]) / (2 * h)
            np.testing.assert_allclose(second[k][j], difference, rtol=1e-5, atol=1e-10)


def test_slope_with_noise_agrees_with_a_difference():
    frf = review_frf(step=10)
    variance = white(frf, 0.05)

    def pole(scale):
        table = expected_poles(frf, 8, variance=variance, scale=scale, arc=0.95)
        return table.poles[0, jnp.argmin(jnp.abs(jax.lax.stop_gradient(table.poles[0]) - TRUE[1]))]

    both = jax.jit(lambda scale: jax.jvp(pole, (scale,), (1.0,)))  # value and slope by one program
    slope = both(1.0)[1]
    difference = (both(1.0 + 1e-4)[0] - both(1.0 - 1e-4)[0]) / 2e-4
    np.testing.assert_allclose(slope, difference, rtol=1e-6)  # measured 5e-9


def test_paths_start_at_the_modes_and_end_at_the_prediction():
    frf = review_frf(step=2)
    options = dict(variance=white(frf, 0.1), arc=1.0)
    paths, certain = pole_paths(frf, TRUE, 16, jnp.geomspace(1e-6, 1.0, 40), **options)
    bias = predicted_damping_bias(frf, TRUE, 16, **options)
    np.testing.assert_allclose(paths[0], TRUE, rtol=1e-4)  # measured 2e-5
    good = np.asarray(bias.valid)
    np.testing.assert_allclose(np.asarray(paths[-1])[good], np.asarray(bias.poles)[good], rtol=1e-12)
    assert np.asarray(certain)[-1][good].all()


def test_a_diagrams_bias_is_that_of_each_of_its_orders():
    frf = review_frf(step=10)
    variance = white(frf, 0.05)
    all_orders = predicted_damping_bias(frf, TRUE, [8, 12], variance=variance)
    assert all_orders.damping.shape == (2, 5)
    one = predicted_damping_bias(frf, TRUE, 8, variance=variance, numerator=12)
    np.testing.assert_allclose(all_orders.damping[0], one.damping, rtol=1e-8)
    assert np.array_equal(all_orders.valid[0], one.valid)


def test_prediction_needs_a_variance_and_a_known_method():
    with pytest.raises(ValueError, match="needs a noise variance"):
        predicted_damping_bias(review_frf(step=5), TRUE, 8)
    with pytest.raises(ValueError, match="lscf, plscf"):
        predicted_damping_bias(review_frf(step=5), TRUE, 8, variance=1e-12, method="lsce")
