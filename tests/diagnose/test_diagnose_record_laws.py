"""Laws of a joint from time records: against records that were marched with known laws."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.io
import scipy.signal

from modalax.diagnose.record_laws import along, fit_laws
from modalax.model import ModalModel
from modalax.model.modal import poles_from
from modalax.simulate.joints import CubicSpring, ElastoSlip, PolynomialStiffness
from modalax.simulate.march import respond

RATE, PERIOD = 400.0, 512


def two_modes(frequency_hz: tuple[float, float] = (20.0, 33.0)) -> ModalModel:
    """A reciprocal structure of two DoFs, driven at the first, the residues of a driving point as squares."""
    psi = np.array([[1.0, 0.6], [0.8, -1.0]]) / np.sqrt(2j * 2 * np.pi * np.array(frequency_hz)[:, None])
    poles = poles_from(jnp.array(frequency_hz), jnp.array([0.02, 0.015]))
    return ModalModel(poles, psi, psi[:, :1], outputs=("a", "b"), inputs=("a",))


def periods(joints: list, places: list, form: str = "receptance") -> tuple[np.ndarray, np.ndarray]:
    """One period of the steady response to a random multisine of 5 to 60 Hz."""
    rng = np.random.default_rng(0)
    lines = np.arange(7, 77)
    spectrum = np.zeros(PERIOD // 2 + 1, complex)
    spectrum[lines] = np.exp(2j * np.pi * rng.uniform(size=len(lines))) * PERIOD / 2 * 5.0
    force = np.fft.irfft(spectrum, PERIOD)
    fine = np.tile(scipy.signal.resample(force, 8 * PERIOD), 5)[:, None]
    record = respond(two_modes(), joints, places, fine, 8 * RATE, inputs=["a"], outputs=["a", "b"], form=form)
    return force[None], np.asarray(record.response)[None, -8 * PERIOD :: 8]


@pytest.mark.parametrize("form", [pytest.param("receptance", marks=pytest.mark.slow), "accelerance"])  # others below
def test_a_cubic_spring_and_the_modes_are_found_together(form):
    true = CubicSpring(1e7)
    force, response = periods([true], [["a", "b"]], form)
    start = two_modes((20.3, 32.7))
    found = fit_laws(force, response, RATE, start, [CubicSpring(2e6)], ["a", "b"], band=(4.0, 70.0), form=form)
    linear = fit_laws(force, response, RATE, start, [], ["a", "b"], band=(4.0, 70.0), form=form)
    assert linear.unexplained > 0.05
    assert found.unexplained < 0.01 * linear.unexplained
    np.testing.assert_allclose(found.joints[0].parameters["k3"], 1e7, rtol=2e-3)
    np.testing.assert_allclose(found.model.frequency_hz, [20.0, 33.0], rtol=2e-4)
    np.testing.assert_allclose(found.model.damping_ratio, [0.02, 0.015], rtol=5e-3)


def test_the_standard_deviation_is_that_of_repeated_noise():
    """Leaving each run out tells what noise does to a parameter, also through the motion that the law sees."""
    force, clean = periods([CubicSpring(1e7)], [["a", "b"]])
    rng, told, values = np.random.default_rng(1), [], []
    for _ in range(6):
        noisy = np.repeat(clean, 4, axis=0)
        noisy = noisy + 0.01 * clean.std() * rng.standard_normal(noisy.shape)
        found = fit_laws(
            np.repeat(force, 4, axis=0), noisy, RATE, two_modes(), [CubicSpring(1e7)], ["a", "b"], band=(4.0, 70.0)
        )
        told.append(float(found.std[0]["k3"]))
        values.append(float(found.joints[0].parameters["k3"]))
    assert 0.4 < np.mean(told) / np.std(values, ddof=1) < 2.5


def test_a_slipping_joint_is_found_and_simulated():
    true = ElastoSlip(2e3, 4.0)
    force, response = periods([true], [["a", "b"]])
    found = fit_laws(force, response, RATE, two_modes(), [ElastoSlip(1.6e3, 3.2)], ["a", "b"], band=(4.0, 70.0))
    assert found.unexplained < 0.01
    np.testing.assert_allclose(found.joints[0].parameters["k"], 2e3, rtol=0.05)
    np.testing.assert_allclose(found.joints[0].parameters["slip_force"], 4.0, rtol=0.05)
    assert float(found.joints[0].parameters["k0"]) == 0.0
    motion = found.simulate(np.tile(force[0], 4), RATE)[-PERIOD:]
    assert np.linalg.norm(motion - response[0]) < 0.03 * np.linalg.norm(response)


def test_coefficients_have_a_factor_each():
    force, response = periods([PolynomialStiffness((3e3, 1e7), (2, 3))], [["b"]])
    start = PolynomialStiffness((1e3, 2e6), (2, 3))
    found = fit_laws(force, response, RATE, two_modes(), [start], ["b"], band=(4.0, 70.0))
    np.testing.assert_allclose(found.joints[0].parameters["coefficients"], [3e3, 1e7], rtol=0.01)
    assert found.std[0]["coefficients"].shape == (2,)


def test_a_law_with_memory_goes_round_its_loop():
    x = 3e-3 * np.sin(2 * np.pi * np.arange(400) / 200)[None]
    f = np.asarray(along(ElastoSlip(1e3, 2.0), jnp.asarray(x), jnp.zeros((1, 400))))[0]
    np.testing.assert_allclose(f[200:], f[:200], atol=1e-9)
    assert f.max() == pytest.approx(2.0) and f.min() == pytest.approx(-2.0)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"force": np.zeros(8)}, r"need \(run, t\)"), ({"place": ["c"]}, "all measured; measured are a, b"),
        ({"response": np.zeros((1, 8, 3))}, "3 responses for 2 outputs"), ({"band": (70.0, 60.0)}, "holds no line"),
    ],
)  # fmt: skip
def test_records_that_do_not_fit_are_refused(change, said):
    given = {"force": np.ones((1, 8)), "response": np.ones((1, 8, 2)), "place": ["a"], "band": (4.0, 170.0)} | change
    with pytest.raises(ValueError, match=said):
        fit_laws(
            given["force"], given["response"], RATE, two_modes(), [], given["place"], band=given["band"]
        )  # fmt: skip


@pytest.mark.slow
@pytest.mark.measured
def test_a_measured_cubic_spring_predicts_what_it_was_not_shown(measured):
    """The Silverbox: two multisines are fitted, a third is predicted from its force alone."""
    found = scipy.io.loadmat(measured / "silverbox" / "SNLS80mV.mat", squeeze_me=True)
    part = slice(40_500, 40_500 + 3 * 8697)
    u, y = (found[name][part] - found[name][part].mean() for name in ("V1", "V2"))
    u, y = u.reshape(3, -1), y.reshape(3, -1)
    fs, psi = 1e7 / 2**14, np.sqrt(np.array([[430 / 2j]]))  # from 68 Hz and unit stiffness
    start = ModalModel(poles_from([68.0], [0.05]), psi, psi, outputs=("1",), inputs=("1",))
    error = {}
    for name, joints in (("linear", []), ("cubic", [CubicSpring(1.0)])):
        fitted = fit_laws(u[:2], y[:2, :, None], fs, start, joints, ["1"], band=(2.0, 200.0))
        error[name] = np.std(fitted.simulate(u[2], fs)[:, 0] - y[2]) / np.std(y[2])
    assert error["linear"] > 0.1
    assert error["cubic"] < 0.02
