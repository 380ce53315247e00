"""Expected normal equations of LSCE and FDPI: against their own rows in noise, and against drawn damping."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from modalax.identify import fdpi, lsce
from modalax.identify.expected import expected_fdpi_bias, expected_lsce_bias, lsce_moments

SLOW = pytest.mark.slow


def white(frf, level):
    power = jnp.mean(jnp.abs(frf.H) ** 2, axis=0, keepdims=True)
    return jnp.broadcast_to(2 * level**2 * power, frf.H.shape)


def draws(frf, variance, estimator, count):
    def one(key):
        a, b = jax.random.normal(key, (2, *frf.H.shape))
        table = estimator(eqx.tree_at(lambda f: f.H, frf, frf.H + (a + 1j * b) * jnp.sqrt(variance / 2)))
        return table.poles[0], table.valid[0]

    return map(np.asarray, jax.jit(lambda k: jax.lax.map(one, k))(jax.random.split(jax.random.key(2), count)))


def dampings(poles, valid, near):
    distance = np.where(valid[:, :, None], np.abs(poles[:, :, None] - np.asarray(near)), np.inf)
    found = np.take_along_axis(poles, np.argmin(distance, axis=1), axis=1)
    return -found.real / np.abs(found)


# Method, order, options, level; and what the spread of the normal matrix, left out of the prediction, may add to the
# mean [of the damping].
CASES = {
    "LSCE forward": (lsce, expected_lsce_bias, 16, {}, 0.05, 0.002),
    "LSCE backward": (lsce, expected_lsce_bias, 32, {"constraint": "a0"}, 0.05, 0.003),
    "LSCE weighted": (lsce, expected_lsce_bias, 32, {"constraint": "a0", "weights": "variance"}, 0.05, 0.003),
    "LSCE real": (lsce, expected_lsce_bias, 24, {"real": True}, 0.05, 0.004),
    "FDPI": (fdpi, expected_fdpi_bias, 5, {}, 0.05, 0.006),
    "FDPI with more modes": (fdpi, expected_fdpi_bias, 8, {}, 0.05, 0.006),
    "FDPI without residual": (fdpi, expected_fdpi_bias, 5, {"residual": 0}, 0.05, 0.006),
}
# One of each by default, of FDPI the one whose program another test below has too.
FIRST = ("LSCE backward", "FDPI with more modes")


@pytest.mark.parametrize("case", [c if c in FIRST else pytest.param(c, marks=SLOW) for c in CASES])
def test_predicted_damping_bias_is_the_mean_over_draws(paper, paper_frf, case):
    estimator, predict, order, options, level, second = CASES[case]
    frf = paper_frf.lines(slice(None, None, 2))
    variance = white(frf, level)
    frf = frf.replace(variance=variance)
    bias = predict(frf, paper.poles, order, **options)
    poles, valid = draws(frf, variance, lambda f: estimator(f, order, **options), 100)
    found = dampings(poles, valid, bias.poles)
    predicted, error = 0.02 + np.asarray(bias.damping), found.std(axis=0) / 10
    good = np.asarray(bias.valid) & (np.arange(5) != 2)  # mode 3 is hardly excited and scatters by its own size
    assert good.sum() == 4
    assert np.all(np.abs(found.mean(axis=0) - predicted)[good] < (3.3 * error + second * 0.02)[good])
    # and the bias is more than nothing somewhere: it would not do to predict the truth
    assert np.max(np.abs(found.mean(axis=0) - 0.02)[good] / error[good]) > 4


@pytest.mark.slow
def test_without_noise_only_the_cut_band_is_left(paper, paper_frf):
    frf = paper_frf.lines(slice(None, None, 2))
    tiny = 1e-24 * float(jnp.max(jnp.abs(frf.H)) ** 2)
    table = lsce(frf, 20)
    bias = expected_lsce_bias(frf, paper.poles, 20, variance=tiny)
    near = dampings(np.asarray(table.poles), np.asarray(table.valid), paper.poles)[0]
    assert bool(bias.valid.all())
    # LSCE without noise has the bias of the cut band, and no other: measured 1e-10 apart
    np.testing.assert_allclose(np.asarray(bias.damping), near - 0.02, atol=1e-7)
    exact = expected_fdpi_bias(frf, paper.poles, 5, variance=tiny, residual=0)
    assert np.max(np.abs(exact.relative_damping)) < 1e-4  # FDPI's model is exact here


def test_messages_say_what_is_needed(paper, paper_frf):
    with pytest.raises(ValueError, match="needs a noise variance"):
        expected_lsce_bias(paper_frf, paper.poles, 16)
    with pytest.raises(ValueError, match="order 300 needs 602 lines"):
        expected_lsce_bias(paper_frf, paper.poles, 300, variance=1.0)


@pytest.mark.slow
def test_lsce_moments_are_those_of_the_draws_and_crowded_modes_are_flagged(paper, paper_frf):
    frf = paper_frf.lines(slice(None, None, 2))
    variance = white(frf, 0.05)
    bias = expected_lsce_bias(frf, paper.poles, 32, variance=variance, constraint="a0")
    moments = lsce_moments(frf, bias.poles, 32, variance=variance, constraint="a0")
    found = dampings(*draws(frf, variance, lambda f: lsce(f, 32, constraint="a0"), 100), bias.poles)
    # a standard deviation from 100 draws is known to 7 %
    np.testing.assert_allclose(
        np.asarray(moments.damping_std)[[0, 1, 3, 4]], found.std(axis=0)[[0, 1, 3, 4]], rtol=0.25
    )
    # forward prediction far above the ten poles that there are: stable computational poles between the modes
    crowded = expected_lsce_bias(frf, paper.poles, 32, variance=variance)
    assert bool(crowded.valid[0]) and not bool(crowded.valid[2])
    scatter = lsce_moments(frf, crowded.poles, 32, variance=variance).scatter
    assert float(scatter[2]) > 5 * float(scatter[0])
    with pytest.raises(ValueError, match="one reference"):
        lsce_moments(frf, bias.poles, 32, variance=variance, constraint="norm")


def test_fdpi_with_more_modes_than_there_are_flags_the_one_that_mixes(paper, paper_frf):
    """Eight modes from four principal responses: a computational pole beside the hardly excited mode 3."""
    frf = paper_frf.lines(slice(None, None, 2))
    variance = white(frf, 0.01)
    bias = expected_fdpi_bias(frf, paper.poles, 8, variance=variance)
    assert np.asarray(bias.valid).tolist() == [True, True, False, True, True]
    found = dampings(*draws(frf, variance, lambda f: fdpi(f, 8), 50), bias.poles)
    predicted, error = 0.02 + np.asarray(bias.damping), found.std(axis=0) / 50**0.5
    good = np.asarray(bias.valid)
    assert np.all(np.abs(found.mean(axis=0) - predicted)[good] < 3.3 * error[good] + 0.005 * 0.02)
    assert error[2] > 5 * error[good].max()


@pytest.mark.slow
@pytest.mark.parametrize("predict", [expected_lsce_bias, expected_fdpi_bias])
def test_derivatives_of_the_bias_agree_with_differences(paper, paper_frf, predict):
    """First and second, with respect to the logarithm of the noise variance and the gain of a sample."""
    frf = paper_frf.lines(slice(None, None, 10))
    variance = white(frf, 0.03)

    def bias(at):
        louder = eqx.tree_at(lambda f: f.H, frf, frf.H.at[20, 1, 0].multiply(at[1]))
        return predict(louder, paper.poles, 5, variance=variance * jnp.exp(at[0])).relative_damping[1]

    slope, bend = jax.jit(jax.grad(bias)), jax.jit(jax.hessian(bias))
    at, steps = jnp.array([0.1, 1.05]), 1e-3 * jnp.eye(2)
    first = [(bias(at + h) - bias(at - h)) / 2e-3 for h in steps]
    second = [(slope(at + h) - slope(at - h)) / 2e-3 for h in steps]
    # the truncation of the differences
    np.testing.assert_allclose(slope(at), first, rtol=1e-4)
    np.testing.assert_allclose(bend(at), second, rtol=1e-4)
