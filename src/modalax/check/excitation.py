r"""Faults of the force seen in the noise of the FRFs, because :math:`\mathrm{var}\,H \propto 1/|F|^2`.

A hammer that touches twice, :math:`F = F_0(1 + a e^{-j\omega\tau})`, leaves ripples of period :math:`1/\tau` in the
noise of all FRFs of its column; a force spectrum that ends inside the band leaves noise that grows to its end.
"""

from collections.abc import Callable, Iterator

import numpy as np

from modalax.check.finding import Finding, Picture, sureness
from modalax.check.study import Study, running_mean

# A ripple is reported if one period holds this many times the median power of all others, its amplitude in the
# logarithm of the noise is at least this, and the band holds at least this many of them.
RIPPLE, SMALLEST_RIPPLE, FEWEST = 60.0, 0.4, 4
# Shares of the lines at whose FRF the law of noise over FRF may bend, parts of the band that must ripple alike, and
# how much.
KNOTS, THIRDS, ALIKE = (0.1, 0.3, 0.5, 0.7, 0.85, 0.95), 3, 0.4
# Growth of the noise within the upper part of the band [dB], noise over FRF at its end, and by how much it may fall on
# the way [dB].
GROWTH, LOST, FALL = 20.0, 0.15, 1.5
# Lines on either side, at least, that the noise of a line is averaged with.
LEAST_HALF = 4


def excitation(study: Study) -> Iterator[Finding]:
    """Find double hits and forces whose spectrum ends inside the band, for each input."""
    if len(study.freq) < 100:
        return
    for i, name in enumerate(study.inputs):
        noise = _noise(study, i)
        if noise is None:
            continue
        found = _end_of_force(study, i, name) or _ripple(study, noise, name)
        if found is not None:
            yield found


def _noise(study: Study, i: int) -> np.ndarray | None:
    """Logarithm of the noise power of a column, without the part in proportion to the FRFs, ``(f,)``."""
    H = study.H[..., i].transpose(1, 0, 2).reshape(len(study.freq), -1)
    if study.variance is not None:
        power = study.variance[..., i].transpose(1, 0, 2).reshape(H.shape)
    else:
        if np.median(study.modes.misfit) > 2:
            return None  # The residual of the modes is more than noise.
        left = (study.H[0] - study.modes.fitted.reshape(study.H[0].shape))[..., i]
        H, power = study.H[0, ..., i], np.abs(left) ** 2
    good = (power > 0).all(axis=0) & (np.abs(H) > 0).all(axis=0)
    if not good.any():
        return None
    span = np.log(study.freq[-1] / study.freq[0])
    log, size = np.log(power[:, good]), np.log(np.abs(H[:, good]) ** 2)
    # Noise of the responses does not follow the FRF, noise of the force does, and there is everything between.
    left = np.empty_like(log)
    # Noise of an accelerometer is even; in receptances and mobilities it falls with frequency.
    course = np.polynomial.legendre.legvander(2 * np.log(study.freq / study.freq[0]) / span - 1, 3)[:, 1:]
    for k in range(log.shape[1]):
        known = np.concatenate([_bends(size[:, k]), course], axis=1)
        left[:, k] = log[:, k] - known @ np.linalg.lstsq(known, log[:, k], rcond=None)[0] + log[:, k].mean()
    return left.mean(axis=1)


def _bends(size: np.ndarray) -> np.ndarray:
    """A straight line in parts over the size of the FRF."""
    knots = np.quantile(size, KNOTS)
    return np.stack([np.ones_like(size), size, *(np.maximum(size - knot, 0.0) for knot in knots)], axis=1)


def _ripple(study: Study, noise: np.ndarray, name: str) -> Finding | None:
    """A double hit, seen as a ripple of one period in the noise."""
    lines, step = len(noise), float(np.median(np.diff(study.freq)))
    if np.ptp(np.diff(study.freq)) > 0.01 * step:
        return None
    smooth = running_mean(noise[:, None], max(5, lines // 8))[:, 0]
    rest = (noise - smooth) * np.hanning(lines)
    power = np.abs(np.fft.rfft(rest, 4 * lines)) ** 2
    # Bins are 1/(4 lines step) of quefrency apart; slower ripples than FEWEST in the band belong to the smooth part.
    # Where the noise grows strongly, the curvature of its growth remains, at few ripples.
    first = 4 * (2 * FEWEST if np.ptp(smooth) > 3 else FEWEST)
    k = first + int(np.argmax(power[first:]))
    # An exact variance does not scatter; an amplitude of 0.01 in its logarithm is no ripple either.
    floor = np.median(power[first:]) / np.log(2) + 1e-4 * lines
    score = power[k] / floor
    amplitude = 2 * np.sqrt(power[k]) / np.sum(np.hanning(lines))
    harmonic = power[2 * k - 4 : 2 * k + 5].max() if 2 * k + 5 < len(power) else 0.0
    # The logarithm of |1 + a exp(-j w tau)| has harmonics that fall off; a ripple of resonances has others.
    others = np.delete(power, np.r_[:first, max(0, k - 8) : min(len(power), k + 9)])
    if (
        score < RIPPLE
        or amplitude < SMALLEST_RIPPLE
        or np.sort(others)[-min(12, len(others))] > 0.35 * power[k]
        or harmonic > power[k]
        or not _throughout(rest, k / (4 * lines))
    ):
        return None
    tau = k / (4 * lines * step)
    size = float(np.clip(amplitude / 2, 0, 1))
    return Finding(
        "double_hit", (name,), sure=sureness(score, RIPPLE), size=float(tau), unit="s",
        interval=(float(tau - 0.5 / (lines * step)), float(tau + 0.5 / (lines * step))),
        evidence=f"the noise of all FRFs of this column rises and falls every {1 / tau:.4g} Hz: the hammer touched "
        f"again {tau:.4g} s after the hit, with about {100 * size:.2g} % of it",
        advice="repeat the hits that were double; a lighter hammer or a stiffer grip rebounds less",
        picture=Picture([("noise power", study.freq, noise - noise.mean())], "Frequency [Hz]", "Log of noise [-]"),
    )  # fmt: skip


def _throughout(rest: np.ndarray, per_line: float) -> bool:
    """Whether a ripple goes on through the band with one phase; those of resonances come and go."""
    turn = rest * np.exp(-2j * np.pi * per_line * np.arange(len(rest)))
    window = np.hanning(len(rest))
    edges = np.linspace(0.08, 0.92, THIRDS + 1) * len(rest)
    parts = [slice(int(a), int(b)) for a, b in zip(edges[:-1], edges[1:], strict=True)]
    values = np.array([turn[p].sum() / window[p].sum() for p in parts])
    mean = values.mean()
    return bool(np.all(np.real(values * np.conj(mean)) > ALIKE * np.abs(mean) ** 2))


def _end_of_force(study: Study, i: int, name: str) -> Finding | None:
    """A force spectrum that ends inside the band: the noise grows to the end and hides the FRFs there."""
    lines = len(study.freq)
    H, sigma = np.abs(study.H[..., i]), study.sigma[..., i]
    share = np.sqrt(np.median(sigma**2, axis=(0, 2)) / np.maximum(np.median(H**2, axis=(0, 2)), 1e-300))
    level = 10 / np.log(10) * np.log(np.median(sigma[:, :, :] ** 2, axis=(0, 2)))
    # Receptances and mobilities are brought to accelerances, where the noise of accelerometers is even.
    even = level + 20 * (2 - study.power) * np.log10(study.freq / study.freq[-1])
    edges = np.linspace(0, lines, 11).round().astype(int)
    in_parts = lambda y: np.array([np.median(y[a:b]) for a, b in zip(edges[:-1], edges[1:], strict=True)])
    parts = min(in_parts(level), in_parts(even), key=lambda p: float(p[-1] - np.median(p[:6])))
    growth = float(parts[-1] - np.median(parts[:6]))
    end = float(np.median(share[edges[-2] :]))
    # Noise in proportion to the FRF falls after a resonance; over the FRF it does not.
    falls = min(float(-np.diff(p[5:]).min()) for p in (parts, in_parts(20 * np.log10(share + 1e-300))))
    if growth < GROWTH or end < LOST or falls > FALL:
        return None
    limit = float(study.freq[_end(min(level, even, key=lambda y: float(np.ptp(in_parts(y)[:6]))), in_parts)])
    return Finding(
        "force_rolloff", (name,), sure=sureness(growth / GROWTH, 1.0), size=limit, unit="Hz",
        evidence=f"the noise grows by {growth:.3g} dB towards the end of the band, to {end:.2g} of the FRFs there: the "
        f"force has little energy above {limit:.4g} Hz",
        advice="use a harder tip or a lighter hammer, or keep to the band below",
        picture=Picture([("noise power", study.freq, level)], "Frequency [Hz]", "Noise power [dB]"),
    )  # fmt: skip


def _end(level: np.ndarray, in_parts: Callable[[np.ndarray], np.ndarray]) -> int:
    """Line from which on noise [dB] stays above its middling level: resonances raise it too, and let it fall again."""
    smooth = running_mean(level[:, None], max(LEAST_HALF, len(level) // 100))[:, 0]
    below = np.flatnonzero(smooth <= np.median(in_parts(level)[:6]) + GROWTH / 2)
    return min(int(below.max(initial=-1)) + 1, len(level) - 1)
