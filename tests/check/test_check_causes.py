"""What once made sound tests look faulty, and faults once missed, each in a small simulation of its kind."""

from dataclasses import replace

import numpy as np
import pytest
from test_check_words import FREQ, NAMES, Hits, chain

from modalax.check import Records, check
from modalax.check.noise import local_noise
from modalax.data import Measurement


def frfs(freq, times=0, zeta=0.01, beyond=1.0):
    """FRFs of the chain ``(f, o, i)`` between all five places, accelerance times (j w)^times.

    Its first and its last mode are made larger by the factor ``beyond``.
    """
    w, shapes = chain()
    shapes = shapes * np.array([beyond, 1.0, 1.0, 1.0, beyond])[:, None]
    s = 2j * np.pi * freq[:, None]
    return np.einsum("fr,ro,ri->foi", s ** (2 + times) / (s**2 + 2 * zeta * w * s + w**2), shapes, shapes)


def measured(rng, freq, H, sigma, told=True, form="accelerance", outputs=NAMES, inputs=NAMES):
    """Noise on top of ``(f, o, i)``."""
    sigma = sigma * np.ones(H.shape)
    H = H + sigma * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)) / np.sqrt(2)
    extra = {"variance": sigma[None] ** 2} if told else {}
    return Measurement(freq, H[None], form=form, outputs=outputs, inputs=inputs, **extra)


def test_strong_modes_beyond_the_band_shift_no_frequency():
    """A roving hammer, and a band between modes that are three times as large beside it."""
    freq = FREQ[(FREQ > 27) & (FREQ < 62)]
    H = frfs(freq, zeta=0.03, beyond=3.0)[:, [1]]
    m = measured(np.random.default_rng(0), freq, H, 5e-4 * np.sqrt(np.mean(np.abs(H) ** 2)), outputs=NAMES[1:2])
    assert [f.evidence for f in check(m)] == []


@pytest.mark.parametrize("seed", range(2))
def test_noise_that_falls_with_frequency_makes_no_mode_near_0_hz(seed):
    """The even noise of accelerometers in a receptance from 0.1 Hz on, of which nothing is said."""
    rng, freq = np.random.default_rng(seed), np.arange(0.1, 80.0, 0.1)
    H = frfs(freq, times=-2)[:, [0, 2]][:, :, [0, 2]]
    sigma = 0.02 * np.sqrt(np.mean(np.abs(frfs(freq)) ** 2)) / (2 * np.pi * freq[:, None, None]) ** 2
    names = (NAMES[0], NAMES[2])
    m = measured(rng, freq, H, sigma, told=False, form="receptance", outputs=names, inputs=names)
    assert [f.evidence for f in check(m)] == []
    true = np.broadcast_to(sigma[:, 0], (len(freq), 4))
    ratio = local_noise(freq, np.asarray(m.H)[0].reshape(len(freq), 4), 0) / true
    assert 0.6 < ratio[:20].min() and ratio[:20].max() < 1.6


@pytest.mark.parametrize(("late", "where"), [([3], (NAMES[3],)), ([0, 1, 2, 3, 4], ())])
def test_a_delay_is_told_by_two_modes(late, where):
    """Of one channel beside four others; of all together where a driven place is measured."""
    freq = FREQ[FREQ < 48]
    H, tau = frfs(freq)[:, :, [0, 2]], 4e-4
    H[:, late] *= np.exp(-2j * np.pi * freq * tau)[:, None, None]
    sigma = 0.002 * np.sqrt(np.mean(np.abs(H) ** 2))
    (found,) = check(measured(np.random.default_rng(0), freq, H, sigma, inputs=(NAMES[0], NAMES[2])))
    assert (found.what, found.where) == ("delay", where)
    assert found.size == pytest.approx(tau, rel=0.15)


@pytest.mark.parametrize(
    ("turns", "late", "where"),
    [
        # part of a turn and more than one, of one channel and of all by default, as neither asks for the other
        pytest.param(turns, late, where, marks=() if (turns, len(late)) in ((0.4, 5), (1.2, 1)) else pytest.mark.slow)
        for late, where in (([3], (NAMES[3],)), ([0, 1, 2, 3, 4], ()))
        for turns in (0.4, 1.2, -2.2)
    ],
)
def test_a_delay_of_turns_at_the_end_of_the_band_is_told_with_its_size(turns, late, where):
    """As of a laser vibrometer or a radio link: no other form, no turned sign, and no smaller delay of like angles."""
    H, tau = frfs(FREQ)[:, :, [0, 2]], turns / FREQ[-1]
    H[:, late] *= np.exp(-2j * np.pi * FREQ * tau)[:, None, None]
    sigma = 0.002 * np.sqrt(np.mean(np.abs(H) ** 2))
    (found,) = check(measured(np.random.default_rng(0), FREQ, H, sigma, inputs=(NAMES[0], NAMES[2])))
    assert (found.what, found.where) == ("delay", where)
    assert found.size == pytest.approx(tau, rel=0.01)


def test_noise_of_the_force_that_all_sensors_share_shifts_no_frequency():
    hits = Hits(samples=2048, zeta=0.02, count=3).made(0)
    noise = 0.004 * hits.force.max() * np.random.default_rng(0).normal(size=hits.force.shape)
    assert {f.what for f in check(replace(hits, force=hits.force + noise))} == set()


def test_a_channel_of_idle_converter_steps_is_dead_and_not_clipped():
    hits = Hits(samples=2048, zeta=0.02, count=2).made()
    x = hits.response.copy()
    x[:, :, 3] = 1e-4 * np.random.default_rng(0).integers(-1, 2, x.shape[:2])
    found = check(Records(hits.force, x, hits.fs, hits.outputs, input=hits.input))
    assert [(f.what, f.where) for f in found] == [("dead", (NAMES[3],))]
