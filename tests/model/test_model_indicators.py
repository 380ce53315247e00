"""Indicators against closed forms, invariances, scipy, and their gradients against finite differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

from modalax.data import FRF
from modalax.model import Structure, indicators
from modalax.model.examples import five_dof

# Rounding of sums over some ten terms; the largest difference seen was 9e-16, of numbers up to 6.
EXACT = 1e-14
# Central differences with a step of 1e-6; the largest difference seen was 2e-9.
DIFFERENCES = 1e-7

SHAPE_PAIRS = [indicators.mac, indicators.comac, indicators.ecomac, indicators.msf]
SINGLE_SHAPES = [indicators.auto_mac, indicators.mpc, indicators.mean_phase, indicators.mpd]
FRF_PAIRS = [indicators.frac, indicators.fdac]
SINGLE_FRFS = [indicators.sum_frf, indicators.cmif, indicators.mvmif]


def random_shapes(seed, n=4, o=6):
    rng = np.random.default_rng(seed)
    return rng.standard_normal((n, o)) + 1j * rng.standard_normal((n, o))


def random_frf(seed, f=5, o=4, i=2, form="receptance"):
    rng = np.random.default_rng(seed)
    H = rng.standard_normal((f, o, i)) + 1j * rng.standard_normal((f, o, i))
    return FRF(1.0 + np.arange(f), H, form=form)


def factors(seed, n=4):
    return np.random.default_rng(seed).uniform(0.1, 9, (n, 1)) * np.exp(1j * np.arange(1, n + 1))[:, None]


# --- shapes -----------------------------------------------------------------------------------------------------


def test_mac_is_the_squared_cosine_of_two_real_shapes():
    angle = np.linspace(0, np.pi, 7)
    shapes = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    np.testing.assert_allclose(indicators.mac(shapes[:1], shapes)[0], np.cos(angle) ** 2, atol=EXACT)


def test_mac_takes_complex_shapes_by_their_hermitian_product():
    # Two waves that run opposite ways round a ring are orthogonal; their plain transpose product is not 0.
    wave = np.exp(2j * np.pi * np.arange(8) / 8)[None]
    assert float(indicators.mac(wave, wave)[0, 0]) == pytest.approx(1, abs=EXACT)
    assert float(indicators.mac(wave, wave.conj())[0, 0]) < EXACT


def test_mac_and_comac_do_not_see_scale_and_phase():
    a, b = random_shapes(1), random_shapes(2)
    np.testing.assert_allclose(indicators.mac(factors(3) * a, factors(4) * b), indicators.mac(a, b), atol=EXACT)
    for compare in (indicators.comac, indicators.ecomac):
        np.testing.assert_allclose(compare(factors(3) * a, factors(4) * b), compare(a, b), atol=EXACT)


@pytest.mark.parametrize("scale", [1e-200, 1e200])
def test_very_small_and_large_shapes_keep_their_indicators(scale):
    a = random_shapes(1)
    np.testing.assert_allclose(indicators.mac(scale * a, a), indicators.auto_mac(a), atol=EXACT)
    np.testing.assert_allclose(indicators.mpc(scale * a), indicators.mpc(a), atol=EXACT)


def test_auto_mac_of_orthogonal_shapes_is_the_identity():
    q = np.linalg.qr(random_shapes(5, 6, 6))[0]
    np.testing.assert_allclose(indicators.auto_mac(q), np.eye(6), atol=EXACT)


def test_comac_sees_a_gain_of_one_dof_where_shapes_differ_and_ecomac_its_sign():
    a = np.array([[1.0, 1.0, 1.0], [1.0, 1.0, -1.0]])
    swapped = a.copy()
    swapped[:, 1] *= -1
    np.testing.assert_allclose(indicators.comac(a, a), 1, atol=EXACT)
    np.testing.assert_allclose(indicators.comac(a, swapped), 1, atol=EXACT)
    np.testing.assert_allclose(indicators.ecomac(a, a), 0, atol=EXACT)
    np.testing.assert_allclose(indicators.ecomac(a, swapped), [0, 1, 0], atol=EXACT)
    # CoMAC by hand: the products at the last DoF are 1/sqrt(3) * (1/sqrt(3), 0), their squares 2/3 * 1/3.
    b = np.array([[1.0, 1.0, 1.0], [1.0, 1.0, 0.0]])
    ones = np.ones((2, 3))
    np.testing.assert_allclose(indicators.comac(ones, b)[2], (1 / 3) ** 2 / (2 / 3 * 1 / 3), atol=EXACT)


def test_msf_is_the_factor_between_shapes_and_the_least_squares_solution():
    a, b = random_shapes(1), random_shapes(2)
    np.testing.assert_allclose(indicators.msf(factors(3) * b, b), factors(3)[:, 0], rtol=EXACT)
    expected = [np.linalg.lstsq(b[r][:, None], a[r], rcond=None)[0][0] for r in range(4)]
    np.testing.assert_allclose(indicators.msf(a, b), expected, rtol=EXACT)


def test_a_real_shape_turned_in_the_complex_plane_is_collinear():
    real = np.random.default_rng(7).standard_normal((4, 6))
    turned = factors(8) * real
    np.testing.assert_allclose(indicators.mpc(turned), 1, atol=EXACT)
    # arctan of rounding errors; 1e-16 was seen.
    np.testing.assert_allclose(indicators.mpd(turned), 0, atol=EXACT)
    phase = np.asarray(indicators.mean_phase(turned))
    np.testing.assert_allclose(np.exp(2j * phase), np.exp(2j * np.arange(1, 5)), atol=EXACT)


def test_mpc_is_the_usual_expression_in_real_and_imaginary_parts():
    shapes = random_shapes(9)
    x, y = shapes.real, shapes.imag
    sxx, syy, sxy = (x * x).sum(1), (y * y).sum(1), (x * y).sum(1)
    largest = (sxx + syy) / 2 + np.sqrt((sxx - syy) ** 2 / 4 + sxy**2)
    np.testing.assert_allclose(indicators.mpc(shapes), (2 * (largest / (sxx + syy) - 0.5)) ** 2, atol=EXACT)


def test_mean_phase_is_the_principal_axis_and_mpd_the_mean_angle_to_it():
    shapes = random_shapes(9)
    for psi, phase, deviation in zip(shapes, indicators.mean_phase(shapes), indicators.mpd(shapes), strict=True):
        axis = np.linalg.svd(np.stack([psi.real, psi.imag], axis=1))[2][0]
        direction = np.exp(1j * float(phase))
        assert abs(abs(direction.real * axis[0] + direction.imag * axis[1]) - 1) < EXACT
        cosine = np.abs(psi.real * axis[0] + psi.imag * axis[1]) / np.abs(psi)
        expected = np.average(np.arccos(cosine), weights=np.abs(psi))
        # arccos near 1 loses digits that the arctan keeps; 6e-16 was seen.
        assert float(deviation) == pytest.approx(expected, abs=1e-12)


def test_a_rotating_wave_has_no_main_phase():
    wave = np.exp(2j * np.pi * np.arange(400) / 400)[None]
    assert float(indicators.mpc(wave)[0]) < EXACT
    # 400 evenly spread phases: the mean of |angle to a line| is pi/4 up to the squared spacing.
    assert float(indicators.mpd(wave)[0]) == pytest.approx(np.pi / 4, abs=1e-4)


def test_two_equal_parts_at_a_known_angle():
    # Components 1 and e^{ja}: psi^T psi = 1 + e^{2ja}, so MPC = cos^2 a; both lie a/2 from the line between them.
    angle = np.array([0.1, 0.6, 1.2])
    shapes = np.stack([np.ones(3), np.exp(1j * angle)], axis=1)
    np.testing.assert_allclose(indicators.mpc(shapes), np.cos(angle) ** 2, atol=EXACT)
    np.testing.assert_allclose(indicators.mpd(shapes), angle / 2, atol=EXACT)


def test_a_zero_shape_has_the_documented_values():
    a, b = random_shapes(1), random_shapes(2)
    a[1] = 0
    np.testing.assert_array_equal(indicators.mac(a, b)[1], 0)
    np.testing.assert_array_equal(indicators.mac(b, a)[:, 1], 0)
    assert float(indicators.mpc(a)[1]) == 0
    assert float(indicators.mpd(a)[1]) == np.pi / 4
    assert complex(indicators.msf(b, a)[1]) == 0
    still = b.copy()
    still[:, 2] = 0
    assert float(indicators.comac(a, still)[2]) == 0


# --- FRFs -------------------------------------------------------------------------------------------------------


def test_frac_is_one_for_a_gain_and_the_cosine_otherwise():
    a, b = random_frf(1), random_frf(2)
    np.testing.assert_allclose(indicators.frac(a, a.replace(H=(2 - 3j) * a.H)), 1, atol=EXACT)
    x, y = np.asarray(a.H)[:, 3, 1], np.asarray(b.H)[:, 3, 1]
    expected = abs(np.vdot(x, y)) ** 2 / (np.vdot(x, x) * np.vdot(y, y)).real
    assert float(indicators.frac(a, b)[3, 1]) == pytest.approx(expected, abs=EXACT)


def test_fdac_is_the_mac_of_deflections():
    a, b = random_frf(1), random_frf(2).lines(slice(0, 3))
    for i in range(2):
        expected = indicators.mac(a.H[:, :, i], b.H[:, :, i])
        np.testing.assert_allclose(indicators.fdac(a, b)[:, :, i], expected, atol=EXACT)


def test_sum_frf_and_cmif_of_one_channel():
    frf = random_frf(3, o=1, i=1)
    np.testing.assert_allclose(indicators.sum_frf(frf), np.abs(frf.H[:, 0, 0]), rtol=EXACT)
    np.testing.assert_allclose(indicators.cmif(frf)[:, 0], np.abs(frf.H[:, 0, 0]) ** 2, rtol=EXACT)


def test_sum_frf_adds_magnitudes():
    frf = random_frf(3)
    np.testing.assert_allclose(indicators.sum_frf(frf), np.abs(np.asarray(frf.H)).sum((1, 2)), rtol=EXACT)


def test_cmif_is_the_eigenvalues_of_the_normal_matrix():
    frf = random_frf(4)
    H = np.asarray(frf.H)
    expected = np.linalg.eigvalsh(np.swapaxes(H.conj(), 1, 2) @ H)[:, ::-1]
    np.testing.assert_allclose(indicators.cmif(frf), expected, rtol=1e-13)


@pytest.mark.parametrize("form", ["receptance", "mobility", "accelerance"])
def test_mvmif_solves_the_generalised_eigenproblem(form):
    frf = random_frf(5, form=form)
    H = np.asarray(frf.H)
    in_phase, quadrature = (H.imag, H.real) if form == "mobility" else (H.real, H.imag)
    for k, values in enumerate(np.asarray(indicators.mvmif(frf))):
        A, B = in_phase[k].T @ in_phase[k], quadrature[k].T @ quadrature[k]
        np.testing.assert_allclose(values, scipy.linalg.eigh(A, A + B, eigvals_only=True), atol=EXACT)


@pytest.mark.parametrize("form", ["receptance", "mobility", "accelerance"])
def test_minima_of_mvmif_and_peaks_of_cmif_lie_at_the_modes(form):
    # With as many forces as modes and proportional damping, a pattern excites one mode alone and its phase is
    # exactly a quarter turn at the undamped frequency: the minimum is 0 there.
    structure = five_dof()
    true = np.array([26.06, 36.84, 51.47, 56.21, 62.60])
    at_modes = indicators.mvmif(structure.frf(true, form=form))
    # 5e-25 was seen: the square of a rounding error in the FRF.
    assert float(at_modes[:, 0].max()) < 1e-20
    step = 0.01
    freq = np.arange(20, 70, step)
    frf = structure.frf(freq, form=form)
    lowest = np.asarray(indicators.mvmif(frf))[:, 0]
    minima = freq[1:-1][(lowest[1:-1] < lowest[:-2]) & (lowest[1:-1] < lowest[2:]) & (lowest[1:-1] < 0.1)]
    np.testing.assert_allclose(minima, true, atol=step)
    first = np.asarray(indicators.cmif(frf))[:, 0]
    peaks = freq[1:-1][(first[1:-1] > first[:-2]) & (first[1:-1] > first[2:])]
    # Light damping (2 %) moves a peak of the receptance by zeta^2 f, neighbours by some more; 0.03 Hz was seen.
    np.testing.assert_allclose(peaks, true, atol=0.1)


def test_a_repeated_mode_shows_in_the_second_curves():
    shapes = np.linalg.qr(np.random.default_rng(6).standard_normal((4, 4)))[0]
    structure = Structure.from_modes([30.0, 30.0, 45.0, 80.0], np.full(4, 0.01), shapes, np.ones(4), list("abcd"))
    frf = structure.frf(np.arange(25, 50, 0.05), inputs=["a", "b"])
    at = {f: int(np.argmin(np.abs(np.asarray(frf.freq) - f))) for f in (30.0, 45.0, 37.0)}
    second = np.asarray(indicators.mvmif(frf))[:, 1]
    # Both curves dip at the repeated mode, one at the single mode: 5e-4 and 0.9995 were seen.
    assert second[at[30.0]] < 0.02
    assert second[at[45.0]] > 0.5
    sigma = np.asarray(indicators.cmif(frf))
    assert sigma[at[30.0], 1] > 100 * sigma[at[37.0], 1]


def test_mvmif_of_a_dead_line_or_a_dead_force_is_one():
    frf = random_frf(7)
    H = np.asarray(frf.H).copy()
    H[0] = 0
    H[2, :, 1] = 0
    values = np.asarray(indicators.mvmif(frf.replace(H=H)))
    np.testing.assert_allclose(values[0], 1, atol=EXACT)
    assert values[2, 1] == pytest.approx(1, abs=EXACT)
    alone = FRF(frf.freq, H[:, :, :1])
    assert values[2, 0] == pytest.approx(float(indicators.mvmif(alone)[2, 0]), abs=EXACT)


# --- derivatives, transformations, messages ---------------------------------------------------------------------


def scalar(function, *arrays):
    """A weighted sum of what the indicator gives, real."""
    out = function(*arrays)
    weight = jnp.cos(1.0 + jnp.arange(out.size)).reshape(out.shape)
    return jnp.sum(weight * (out.real + 0.3 * out.imag))


def check_gradient(loss, x):
    """One directional derivative by central differences against the gradient."""
    direction = np.random.default_rng(0).standard_normal(x.shape)
    step, loss = 1e-6, jax.jit(loss)
    numeric = (loss(x + step * direction) - loss(x - step * direction)) / (2 * step)
    analytic = np.sum(np.asarray(jax.jit(jax.grad(loss))(x)) * direction)
    assert abs(float(analytic - numeric)) < DIFFERENCES * max(1, abs(float(numeric)))


def join(x):
    return x[0] + 1j * x[1]


@pytest.mark.parametrize("function", SHAPE_PAIRS + SINGLE_SHAPES, ids=lambda f: f.__name__)
def test_gradient_with_respect_to_shapes(function):
    other = (random_shapes(2),) if function in SHAPE_PAIRS else ()
    a = random_shapes(1)
    check_gradient(lambda x: scalar(function, join(x), *other), np.stack([a.real, a.imag]))


@pytest.mark.parametrize("function", FRF_PAIRS + SINGLE_FRFS, ids=lambda f: f.__name__)
def test_gradient_with_respect_to_frfs(function):
    frf = random_frf(1)
    other = (random_frf(2),) if function in FRF_PAIRS else ()
    parts = np.stack([np.real(frf.H), np.imag(frf.H)])
    check_gradient(lambda x: scalar(function, frf.replace(H=join(x)), *other), parts)


@pytest.mark.parametrize("function", SHAPE_PAIRS + SINGLE_SHAPES, ids=lambda f: f.__name__)
def test_gradient_is_finite_where_a_shape_or_component_is_zero(function):
    other = (random_shapes(2),) if function in SHAPE_PAIRS else ()
    a = random_shapes(1)
    a[1], a[:, 2] = 0, 0
    gradient = jax.jit(jax.grad(lambda x: scalar(function, join(x), *other)))(np.stack([a.real, a.imag]))
    assert np.isfinite(np.asarray(gradient)).all()


@pytest.mark.parametrize("function", FRF_PAIRS + SINGLE_FRFS, ids=lambda f: f.__name__)
def test_gradient_is_finite_where_a_line_or_channel_is_zero(function):
    frf = random_frf(1)
    other = (random_frf(2),) if function in FRF_PAIRS else ()
    parts = np.stack([np.real(frf.H), np.imag(frf.H)])
    parts[:, 0], parts[:, :, 1] = 0.0, 0.0
    gradient = jax.jit(jax.grad(lambda x: scalar(function, frf.replace(H=join(x)), *other)))(parts)
    assert np.isfinite(np.asarray(gradient)).all()


@pytest.mark.parametrize("function", SHAPE_PAIRS + SINGLE_SHAPES, ids=lambda f: f.__name__)
def test_shapes_under_jit_and_vmap(function):
    arrays = [np.stack([random_shapes(k), random_shapes(k + 9)]) for k in range(2 if function in SHAPE_PAIRS else 1)]
    together = jax.jit(jax.vmap(function))(*arrays)
    for k in range(2):
        np.testing.assert_allclose(together[k], function(*(a[k] for a in arrays)), atol=1e-13)


@pytest.mark.parametrize("function", FRF_PAIRS + SINGLE_FRFS, ids=lambda f: f.__name__)
def test_frfs_under_jit_and_vmap(function):
    frfs = [random_frf(k) for k in range(2 if function in FRF_PAIRS else 1)]
    gains = jnp.array([1.0, 2.0 - 1.0j])
    together = jax.jit(jax.vmap(lambda g: function(frfs[0].replace(H=g * frfs[0].H), *frfs[1:])))(gains)
    for k in range(2):
        alone = function(frfs[0].replace(H=gains[k] * frfs[0].H), *frfs[1:])
        np.testing.assert_allclose(together[k], alone, atol=1e-12)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: indicators.mac(np.ones((2, 3)), np.ones((2, 4))), "a has 3 DoFs and b has 4"),
        (lambda: indicators.mac(np.ones(3), np.ones((2, 3))), r"a has shape \(3,\)"),
        (lambda: indicators.comac(np.ones((2, 3)), np.ones((3, 3))), "a has 2 modes and b has 3"),
        (lambda: indicators.mpc(np.ones((2, 3), np.float32)), "single precision"),
        (lambda: indicators.mvmif(random_frf(1, o=1, i=2)), "1 outputs and 2 inputs"),
        (lambda: indicators.frac(random_frf(1), random_frf(1, f=4)), "5 and 4 lines"),
        (lambda: indicators.frac(random_frf(1), random_frf(1, form="mobility")), "receptance and mobility"),
        (lambda: indicators.fdac(random_frf(1), random_frf(1, o=3)), "outputs"),
    ],
)
def test_unusable_input_is_said(call, message):
    with pytest.raises(ValueError, match=message):
        call()
