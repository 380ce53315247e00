"""Laws of a joint fitted together with the mode, on an oscillator whose answer is known in closed form."""

import jax.numpy as jnp
import numpy as np
import pytest

from modalax import Measurement, ModalModel
from modalax.diagnose.causes.channels import ChannelGain
from modalax.diagnose.causes.joints import CubicStiffness, GapContact, QuadraticDamping
from modalax.diagnose.causes.power_laws import MicroSlip
from modalax.diagnose.joint_laws import compare_laws, modes_at

MASS, HERTZ, ZETA, CUBIC = 2.0, 40.0, 0.004, 6e10
FREQ = np.linspace(39.0, 41.5, 60)
LEVELS = (0.3, 1.0, 3.0)
NOISE = 0.01


def oscillator(change=0.0):
    return ModalModel.from_real_modes([HERTZ * (1 + change)], [ZETA * (1 + 20 * change)], [[1.0]], [MASS], ["1"])


def hardening(force, freq, cubic=CUBIC):
    """Receptance of a Duffing oscillator by one harmonic: a cubic equation in the squared amplitude, its least root."""
    w = 2 * np.pi * freq
    D = MASS * ((2 * np.pi * HERTZ) ** 2 - w**2 + 2j * ZETA * 2 * np.pi * HERTZ * w)
    H = np.empty(len(freq), complex)
    for k, d in enumerate(D):
        c = 0.75 * cubic
        roots = np.roots([c**2, 2 * c * d.real, abs(d) ** 2, -(force[k] ** 2)])
        A2 = min(r.real for r in roots if abs(r.imag) < 1e-9 * abs(r) and r.real > 0)
        H[k] = 1 / (d + c * A2)
    return H


def measured(seed=0):
    force = np.array(LEVELS)[:, None] * (1 + 0.2 * np.sin(np.linspace(0, 5, len(FREQ))))
    H = np.stack([hardening(f, FREQ) for f in force])
    rng = np.random.default_rng(seed)
    sigma = NOISE * np.abs(H)
    e = sigma * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)) / np.sqrt(2)
    return Measurement(FREQ, (H + e)[:, :, None, None], force=force, outputs=("1",), inputs=("1",)), sigma


@pytest.mark.slow
def test_the_law_is_found_though_the_mode_is_wrong_and_the_force_varies():
    """The starting mode is 0.2 % off in frequency, half of the resonance's width."""
    data, sigma = measured()
    ranked = compare_laws(
        data,
        oscillator(0.002),
        [[], [QuadraticDamping()], [CubicStiffness()]],
        place="1",
        sigma=sigma[:, :, None, None],
    )
    best = ranked[0]
    assert best.slugs == ("cubic_stiffness",) and best.probability > 0.99
    assert 0.7 < best.chi2 / best.samples < 1.1
    k3, std = float(best.extended.params[0][0]), float(best.extended.spread[0][0])
    assert abs(k3 - CUBIC) < 4 * std < 0.1 * CUBIC
    held = hardening(np.full(len(FREQ), 6.0), FREQ)  # twice the highest force that was fitted
    predicted = np.asarray(best.extended.predict(6.0, FREQ).H)[:, 0, 0]
    assert np.linalg.norm(predicted - held) < 0.1 * np.linalg.norm(held)  # measured 0.01 to 0.03
    A = np.array([1e-5, 5e-5, 1e-4])
    value, error = modes_at(best, A)
    exact = np.sqrt((2 * np.pi * HERTZ) ** 2 + 0.75 * CUBIC * A**2 / MASS) / (2 * np.pi)
    assert (np.abs(value[0, 0] - exact) < 4 * error[0, 0] + 1e-6).all()
    assert (error[0, 0] < 2e-3 * HERTZ).all() and (error[1, 0] < 0.2 * value[1, 0]).all()


def test_microslip_is_the_fundamental_of_masings_loop():
    """First loading -x |x|^n, unloading by twice that at half size: integrated over one loop."""
    A, n = 3e-4, 0.7
    t = (np.arange(20000) + 0.5) / 20000 * np.pi
    x = A * np.cos(t)
    first = lambda y: -y * np.abs(y / 1e-4) ** n
    force = first(A) - 2 * first((A - x) / 2)  # on the way down; the way up is its mirror image
    fundamental = 2 / np.pi * np.mean(force * np.exp(1j * -t)) * np.pi / A
    got = complex(MicroSlip().impedance(jnp.array(A), jnp.array(1.0), jnp.array([1.0, n])))
    assert abs(got - fundamental) < 1e-6 * abs(fundamental)
    assert got.real < 0 < got.imag


def test_what_cannot_be_asked_is_refused():
    data, sigma = measured()
    sigma = sigma[:, :, None, None]
    with pytest.raises(ValueError, match="channel_gain is no law of a joint"):
        compare_laws(data, oscillator(), [[ChannelGain()]], place="1", sigma=sigma)
    with pytest.raises(ValueError, match="'2' was not measured"):
        compare_laws(data, oscillator(), [[]], place="2", sigma=sigma)
    blind = ModalModel([1j * 250 - 1], [[1.0]], [[1e-3]], outputs=["1"], inputs=["2"])
    with pytest.raises(ValueError, match="no scale"):
        compare_laws(data.replace(inputs=("2",)), blind, [[]], place="1", sigma=sigma)


@pytest.mark.slow
@pytest.mark.measured
def test_a_bolted_beam_is_predicted_beyond_the_fitted_levels(measured):
    """Three levels fitted, the highest predicted five times better than by the mode of the lowest (measured 7.6)."""
    from modalax.data.datasets import brake_reuss_beam
    from modalax.identify import refine, residues
    from modalax.model.modal import poles_from

    beam = brake_reuss_beam(drive_point=True)
    low, H = beam.run(0), np.asarray(beam.H)
    lower = beam.replace(H=beam.H[:3], level=beam.level[:3], force=beam.force[:3])
    mode = refine(low, residues(low, poles_from([80.25], [0.002]), residuals="none"), residuals="none").model
    (found,) = compare_laws(
        lower, mode, [[MicroSlip(), GapContact()]], place="beam", sigma=0.025 * np.abs(np.asarray(lower.H))
    )
    before = np.linalg.norm(np.asarray(mode.frf(beam.freq, form="accelerance").H) - H[3])
    after = np.linalg.norm(np.asarray(found.extended.predict(beam.force[3], beam.freq, form="accelerance").H) - H[3])
    assert after < before / 5
    value, std = modes_at(found, np.array([3e-5, 1.4e-4, 2.2e-4]))
    low_, turn, high = value[0, 0]
    assert turn < low_ - 0.2 and high > turn + 0.08  # falls by 0.33 Hz and rises by 0.16 Hz
    assert value[1, 0, 2] > 2.5 * value[1, 0, 0]
    assert np.isfinite(std).all() and (std > 0).all() and std[0].max() < 0.05
