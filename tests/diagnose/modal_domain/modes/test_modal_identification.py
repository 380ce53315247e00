"""Modes of a measurement: overlapping ones, heavily damped ones, and peaks that are no modes."""

from dataclasses import replace

import numpy as np
import pytest

from modalax.data import Measurement
from modalax.diagnose.modal_domain.modes.bent_peaks import bent, one_each, widened
from modalax.diagnose.modal_domain.modes.beside_band import DAMPING, gains_beside, with_modes_beside
from modalax.diagnose.modal_domain.modes.features import Features, features_of, sure, whitener_of
from modalax.diagnose.modal_domain.modes.free_residues import Channels, project
from modalax.diagnose.modal_domain.modes.measured import alike_runs, identify, settles
from modalax.diagnose.modal_domain.modes.mode_count import blind_modes, heavy, misfit
from modalax.diagnose.modal_domain.modes.relocation import relocated

FREQ = np.linspace(3.0, 60.0, 500)
S = 2j * np.pi * FREQ


def channels_of(H: np.ndarray, rng: np.random.Generator, noise: float = 0.01, s: np.ndarray = S) -> Channels:
    """FRFs ``(f, channel)`` with noise relative to each channel's rms."""
    sigma = noise * np.sqrt((np.abs(H) ** 2).mean(axis=0)) * np.ones(H.shape)
    e = rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)
    return Channels(s, H + sigma * e / np.sqrt(2), 2 / sigma**2, 2, np.zeros(0, complex))


def poles_of(frequency: list[float], zeta: list[float]) -> np.ndarray:
    """Poles [rad/s]."""
    w, z = 2 * np.pi * np.array(frequency), np.array(zeta)
    return -z * w + 1j * w * np.sqrt(1 - z**2)


def frf_of(
    poles: np.ndarray, rng: np.random.Generator, outputs: int = 5, inputs: int = 2, s: np.ndarray = S
) -> np.ndarray:
    """Accelerances ``(f, channel)`` of modes with random real shapes."""
    shapes = rng.standard_normal((len(poles), outputs))
    residues = shapes[:, :, None] * shapes[:, None, :inputs] / (2j * poles.imag)[:, None, None]
    R = residues.reshape(len(poles), -1)
    return (1 / (s[:, None] - poles) @ R + 1 / (s[:, None] - poles.conj()) @ R.conj()) * s[:, None] ** 2


def test_relocation_ends_at_the_poles_from_afar():
    poles = poles_of([8.0, 8.1, 25.0, 44.0], [0.01, 0.012, 0.5, 0.004])
    rng = np.random.default_rng(0)
    start = poles_of([5.0, 17.0, 35.0, 55.0], [0.01] * 4)
    channels = channels_of(frf_of(poles, rng), rng, 1e-6)
    for _ in range(4):
        start = relocated(start, channels)
    np.testing.assert_allclose(np.sort_complex(start), np.sort_complex(poles), rtol=1e-3)


def test_modes_within_a_bandwidth_and_a_heavily_damped_one_are_found_and_no_others():
    poles = poles_of([8.0, 8.1, 25.0, 26.0, 26.1, 44.0], [0.01, 0.012, 0.5, 0.01, 0.007, 0.004])
    rng = np.random.default_rng(1)
    found = blind_modes(channels_of(frf_of(poles, rng), rng))
    assert len(found.poles) == 6 and heavy(found.poles).sum() == 1
    light = np.sort_complex(found.poles[~heavy(found.poles)])
    np.testing.assert_allclose(light, np.sort_complex(np.delete(poles, 2)), rtol=1e-3)


def test_peaks_that_were_measured_more_finely_than_the_rest_are_all_found():
    """Their half-bandwidths are a hundredth of the usual distance of lines, and several of that at the peaks."""
    poles, rng = poles_of([12.0, 27.0, 45.0], [2e-4, 2e-4, 3e-4]), np.random.default_rng(3)
    fine = [np.abs(p) + np.linspace(-8, 8, 41) * -p.real for p in poles]
    s = 1j * np.unique(np.concatenate([2 * np.pi * np.arange(3.0, 60.0, 0.25), *fine]))
    found = blind_modes(channels_of(frf_of(poles, rng, s=s), rng, 1e-3, s))
    np.testing.assert_allclose(np.sort_complex(found.poles), np.sort_complex(poles), rtol=1e-4)


def test_chi_square_is_what_is_left_on_the_lines_however_alike_poles_are():
    """Fifty poles at one peak, whose columns nearly depend on each other: it had come out below zero."""
    rng = np.random.default_rng(5)
    channels = channels_of(frf_of(poles_of([20.0, 45.0], [0.01, 0.01]), rng), rng, 1e-4)
    for count in (2, 12, 50):
        found, _ = project(poles_of(np.linspace(19.0, 21.0, count).tolist(), [0.01] * count), channels)
        left = float((channels.weight * np.abs(channels.data - found.made(channels)) ** 2).sum())
        assert found.chi2 == pytest.approx(left, rel=1e-6)


def test_no_more_modes_are_looked_for_than_there_may_be():
    rng = np.random.default_rng(2)
    channels = channels_of(frf_of(poles_of([10.0, 20.0, 31.0, 38.0, 50.0], [0.01] * 5), rng), rng, 1e-3)
    assert len(blind_modes(channels).poles) == 5 and len(blind_modes(channels, at_most=3).poles) <= 3


def test_levels_that_bend_one_narrow_peak_are_not_averaged():
    """Though the differences drown in the noise of all other lines; hum at one line in one run is no such peak."""
    rng = np.random.default_rng(7)
    poles, moved = poles_of([20.0, 45.0], [0.01, 0.01]), poles_of([20.05, 45.0], [0.01, 0.01])
    H = np.stack([frf_of(p, np.random.default_rng(8)).reshape(len(S), 5, 2) for p in (poles, poles, moved)])
    sigma = 0.5 * np.sqrt((np.abs(H) ** 2).mean(axis=(0, 1))) * np.ones(H.shape)
    noise = sigma * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
    level = np.array([1.0, 2.0, 4.0])
    runs, unlike = alike_runs(H + noise, sigma, level)
    assert list(runs) == [0] and unlike < 1.05
    assert list(alike_runs(H + noise, sigma, level, highest=True)[0]) == [2]
    same = H[[0, 0, 0]] + noise
    same[1, 148] *= 1.3
    assert list(alike_runs(same, sigma, level)[0]) == [0, 1, 2]
    assert list(alike_runs(same, sigma / np.sqrt(1.04), level)[0]) == [0, 1, 2]  # as of variances that are estimated


@pytest.mark.parametrize("bent", [0, 2, None])
def test_of_levels_that_differ_the_one_that_modes_explain_is_identified(bent):
    """The lowest where it is bent no more than the highest: at ``bent`` one side of a peak is larger, else all are."""
    rng, level = np.random.default_rng(7), np.array([1.0, 2.0, 4.0])
    plain = frf_of(poles_of([20.0, 45.0], [0.01, 0.01]), np.random.default_rng(8)).reshape(len(S), 5, 2)
    side = (1 + 0.3 * (S.imag > 2 * np.pi * 20.0) * np.exp(-(((S.imag / 2 / np.pi - 20.0) / 0.3) ** 2)))[:, None, None]
    H = np.stack([plain * (side if bent in (k, None) else 1.0) * (1 + 0.01 * np.sqrt(k)) for k in range(3)])
    sigma = 1e-3 * np.sqrt((np.abs(H) ** 2).mean(axis=(0, 1))) * np.ones(H.shape)
    H = H + sigma * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
    outputs, inputs = [f"{k}:+Z" for k in range(1, 6)], ["1:+Z", "2:+Z"]
    freq = S.imag / 2 / np.pi
    data = Measurement(freq, H, form="accelerance", outputs=outputs, inputs=inputs, level=level, variance=sigma**2)
    assert list(identify(data, None).runs) == [2 if bent == 0 else 0]


def test_friction_settles_with_the_level_and_drag_does_not():
    level, plain = (
        np.array([1.0, 3.0, 9.0]),
        frf_of(poles_of([20.0], [0.01]), np.random.default_rng(8))[None, :, :, None],
    )
    friction, drag = (
        plain * (1 + 0.1 * np.array(a))[:, None, None, None] for a in ([1.0, 0.33, 0.11], [1.0, 3.0, 9.0])
    )
    assert settles(friction, level) and settles(friction[[2, 0, 1]], level[[2, 0, 1]])
    assert not settles(drag, level) and not settles(friction[:2], level[:2]) and not settles(friction, level * np.nan)


def test_a_peak_that_no_poles_make_is_no_mode():
    """Near one peak the response is larger on one side, as of a structure that stiffens with amplitude."""
    rng = np.random.default_rng(2)
    H = frf_of(poles_of([20.0, 45.0], [0.02, 0.01]), rng)
    H = H * (1 + 0.4 * np.tanh((FREQ - 20.2) / 0.05) * np.exp(-(((FREQ - 20.2) / 1.0) ** 2)))[:, None]
    channels = channels_of(H, rng)
    found = blind_modes(channels)
    frequency = np.abs(found.poles) / 2 / np.pi
    assert misfit(found, channels) > 1.2
    assert bent(found, channels)[np.abs(frequency - 20) < 1].all()
    assert not bent(found, channels)[np.abs(frequency - 45) < 0.1].any() and (np.abs(frequency - 45) < 0.1).any()


@pytest.mark.parametrize("correlation", [0.0, 0.9, 1.0])
def test_features_are_whitened_howeveralike_runs_they_are(correlation):
    size = np.array([1e-6, 1.0, 1e3])
    C = (np.full((3, 3), correlation) + (1 - correlation) * np.eye(3)) * size[:, None] * size
    empty = np.zeros((0, 1, 1))
    W = whitener_of(Features(np.zeros(0), empty, empty, empty[:, None], np.zeros((0, 3)), C))
    assert np.isfinite(W).all()
    if correlation < 1:
        np.testing.assert_allclose(W @ C @ W.T, np.eye(3), atol=1e-9)


def test_a_pole_without_information_leaves_the_other_modes_known():
    """As at an end of the band, where a further pole may curve chi-square the wrong way."""
    poles = poles_of([8.0, 25.0, 61.0], [0.01, 0.01, 0.02])
    rng = np.random.default_rng(3)
    found = project(poles, channels_of(frf_of(poles[:2], rng), rng))[0]
    alone = features_of(project(poles[:2], channels_of(frf_of(poles[:2], rng), rng))[0], 5, 2)
    information = found.information.copy()
    information[4:] = information[:, 4:] = 0.0
    information[4, 4], information[5, 5] = -2.0, 0.0
    both = features_of(replace(found, information=information), 5, 2)
    assert np.isfinite(both.covariance).all()
    assert sure(both)[:2].all()
    std = [np.sqrt(np.diag(f.covariance)).reshape(f.values.shape)[:2, :2] for f in (both, alone)]
    np.testing.assert_allclose(std[0], std[1], rtol=0.3)


def test_how_well_a_mode_is_known_needs_one_direction_of_its_residues():
    rng = np.random.default_rng(4)
    poles = poles_of([20.0, 31.0, 33.0], [0.01, 0.02, 0.015])
    found = project(poles, channels_of(frf_of(poles, rng), rng))[0]
    whole, one = features_of(found, 5, 2, 1.3), features_of(found, 5, 2, 1.3, directions=1)
    assert one.width == 4 < whole.width
    errors = [np.diag(f.covariance).reshape(f.values.shape)[:, :4] for f in (whole, one)]
    np.testing.assert_allclose(errors[1], errors[0], rtol=1e-9)
    np.testing.assert_array_equal(sure(one), sure(whole))
    assert whitener_of(whole) is whitener_of(whole)  # which takes seconds where hundreds of sensors were measured


@pytest.mark.parametrize(("force", "part"), [(lambda h: 1.0j * h, 1), (lambda h: 0.8 * h**2, 0)])
def test_a_bent_peak_is_one_mode_as_uncertain_as_the_joint_moved_it(force, part):
    """One mode with drag or a cubic spring, H (delta + i + h(|H|)) = 1 over the detuning, solved at each line."""
    half, freq = 0.3, np.linspace(10.0, 50.0, 401)
    size = np.linspace(1e-3, 1.0, 20000)
    detuning = (30.0 - freq) / half
    peak = np.zeros(len(freq), complex)
    for k, d in enumerate(detuning):
        h = size[np.argmax(size * np.abs(d + 1j + force(size)) >= 1.0)]
        peak[k] = 1 / (d + 1j + force(h))
    shape = np.array([1.0, -0.6, 0.3])
    data = peak[:, None] * shape
    channels = Channels(2j * np.pi * freq, data, np.full(data.shape, 2 / 1e-6), 0, np.zeros(0, complex))
    several = blind_modes(channels)
    modes = one_each(several, channels)
    near = np.abs(np.abs(modes.poles) / 2 / np.pi - 30) < 1
    assert near.sum() == 1 and bent(modes, channels)[near].all()
    f = features_of(modes, 3, 1)
    plain = np.sqrt(np.diag(f.covariance)).reshape(f.values.shape)[near][0]
    wide = np.sqrt(np.diag(widened(f, modes, channels).covariance)).reshape(f.values.shape)[near][0]
    pole = modes.poles[near][0]
    off = [np.log(np.abs(pole) / 2 / np.pi / 30), np.log(-pole.real / 2 / np.pi / half)][part]
    assert abs(off) > 5 * plain[part]
    assert 0.3 * wide[part] < abs(off) < 3 * wide[part]


def test_modes_beside_the_band_are_no_matter_of_residual_terms():
    """The first mode lies a third below the first line, and another above the last one; neither is told."""
    rng = np.random.default_rng(4)
    poles = poles_of([2.1, 8.0, 25.0, 44.0, 75.0], [0.01, 0.012, 0.01, 0.004, 0.01])
    channels = channels_of(frf_of(poles, rng), rng, 2e-3)
    found = blind_modes(channels)
    assert misfit(found, channels) > 1.2
    w = 2 * np.pi * np.array([1.1, 2.1, 2.9, 62.0, 75.0, 150.0])
    left = [project(found.poles, replace(channels, outside=(1j - DAMPING) * w[k : k + 1]))[0].chi2 for k in range(6)]
    np.testing.assert_allclose(gains_beside(found, channels, w), found.chi2 - np.array(left), rtol=1e-6)
    beside = with_modes_beside(found, channels)
    np.testing.assert_allclose(np.sort(np.abs(beside.outside)), np.abs(poles)[[0, -1]], rtol=0.1)
    again = blind_modes(beside, found.poles)
    assert misfit(again, beside) < 1.05
    np.testing.assert_allclose(again.poles, poles[1:4], rtol=1e-3)
    none = channels_of(frf_of(poles[1:4], rng), rng, 2e-3)
    assert with_modes_beside(blind_modes(none), none) is none
