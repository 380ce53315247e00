r"""Interference from one source: each sensor picks it up in a fixed proportion, so over the channels it has rank one.

Where hum reaches, the residual is :math:`r_{coq} = a_c\,g_o\,s_q` and noise, with an unknown amplitude and phase
:math:`a_c` in each run and input, an unknown gain :math:`g_o` of each output, and the lines :math:`s_q` of a tone
through a window. The largest singular value of what is summed over the lines with :math:`s_q` finds it where the sum of
squares over all channels does not yet: of n outputs in m columns noise makes about
:math:`2(\sqrt n + \sqrt m)^2` of it, of the sum of squares :math:`2nm`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

STRAY = 4e-4  # of the mains frequency, by which it may be off
DRAWS = 1000  # of noise alone
BESIDE = (-8, -6, -4, 4, 6, 8)  # lines away, where hum through a window has ended and a resonance has not
ALSO_WIDE = 0.3  # of what is more than noise at the tone, beyond which the same beside it makes it no tone
LEAST = 8.0  # gain below which a tone is left alone


@dataclass(frozen=True)
class Pickup:
    """What one source explains.

    Attributes
    ----------
    sets
        Lines of each tone that is taken for hum.
    gains
        Chi-square that each explains, less what its unknowns would explain of noise.
    p_value
        Chance of the strongest under noise alone.
    """

    sets: list[np.ndarray]
    gains: list[float]
    p_value: float


def tone_lines(u: np.ndarray) -> list[np.ndarray]:
    r"""Lines of a tone at distances ``u`` [line spacings]: the nearest alone, and a Hann window's.

    The transform of a Hann window is :math:`\mathrm{sinc}(u)/(1-u^2)`, its sign alternating from line to line or not
    with the origin of time.
    """
    nearest = (np.arange(len(u)) == np.abs(u).argmin()).astype(float)
    near = np.where(np.abs(np.abs(u) - 1) < 1e-6, u + 1e-5, u)
    hann = np.where(np.abs(u) < 2, np.sinc(near) / (1 - near**2), 0.0)
    return [nearest, hann, hann * (-1.0) ** np.arange(len(u))]


def largest(y: np.ndarray) -> np.ndarray:
    """Square of the largest singular value, over the leading axes."""
    if y.shape[-2] > y.shape[-1]:
        y = np.swapaxes(y, -1, -2)
    return np.linalg.eigvalsh(y @ np.conj(np.swapaxes(y, -1, -2)))[..., -1]


def pickup(
    freq: np.ndarray,
    fundamental: float,
    residual: np.ndarray,
    live: np.ndarray,
    uneven: float,
    known: float,
    tail: Callable[[float, np.ndarray], float],
) -> Pickup:
    """Look for one source at the multiples of a mains frequency.

    Parameters
    ----------
    residual
        Whitened, complex, shape ``(column, o, f)``, a column an input of a run; both parts have unit variance.
    live
        Which samples count, same shape.
    uneven
        Variance of the factor by which the noise of a line may be off.
    known
        Degrees of freedom to which the variance of each channel is known.
    tail
        Chance that draws of the null, its second argument, exceed the first.
    """
    step = np.gradient(freq) if len(freq) > 1 else np.ones(1)
    used = live.any(axis=2)
    null = _Null(used, uneven, known)
    tones, values, harmonics = [], [], []
    for k in range(1, int(freq[-1] * 1.002 // fundamental) + 1):
        at = k * fundamental
        middle = int(np.abs(freq - at).argmin())
        if not live[..., middle].any() or abs(freq[middle] - at) > step[middle] + STRAY * at:
            continue
        offsets = (0.0, STRAY * at, -STRAY * at) if STRAY * at > 0.25 * step[middle] else (0.0,)
        mine = [s for off in offsets for s in tone_lines((freq - at - off) / step[middle])]
        found = [float(largest(_summed(residual, live, s))) for s in mine]
        best = int(np.argmax(found))
        tones += mine
        if not _is_wide(residual, live, mine[best], found[best], float(null.draws.mean())):
            values.append(found[best])
            harmonics.append(mine[best])
    gains = [null.gain(v) for v in values]
    sets = [np.flatnonzero(np.abs(s) > 0.05) for s in harmonics]
    single = [k for k, gain in enumerate(gains) if gain >= LEAST]
    chance = min((tail(values[k], null.draws) for k in single), default=1.0)
    if len(harmonics) > 1:  # the channels pick up all harmonics in the same proportion, or nearly so
        every = _Null(np.tile(used, (len(harmonics), 1)), uneven, known)
        value = float(largest(np.concatenate([_summed(residual, live, s) for s in harmonics])))
        together = tail(value, every.draws)
        if together < chance and every.gain(value) >= LEAST:
            return Pickup(sets, [every.gain(value) / len(sets)] * len(sets), min(1.0, (len(tones) + 1) * together))
    return Pickup([sets[k] for k in single], [gains[k] for k in single], min(1.0, (len(tones) + 1) * chance))


class _Null:
    """Noise alone: draws of :func:`largest`, and what a value explains beyond what it would explain of noise."""

    def __init__(self, used: np.ndarray, uneven: float, known: float):
        self.draws = _null(used.tobytes(), used.shape, known)
        if uneven > 0:
            self.draws = self.draws * np.random.default_rng(1).gamma(1 / uneven, uneven, len(self.draws))
        self.unknowns = max(2.0 * (used.any(axis=0).sum() + used.any(axis=1).sum() - 1), 2.0)
        self.usual = float(np.median(_explained(self.draws, self.unknowns)))

    def gain(self, value: float) -> float:
        """Chi-square explained, less what the unknowns cost and what is usual."""
        return float(_explained(value, self.unknowns)) - self.usual


def _summed(residual: np.ndarray, live: np.ndarray, s: np.ndarray) -> np.ndarray:
    """What a tone of these lines has in each channel, of unit variance in each part under noise alone."""
    lines = np.flatnonzero(s)
    r, used, s = residual[..., lines], live[..., lines], s[lines]
    return (r * used) @ s / np.sqrt(np.maximum(used @ s**2, 1e-300))


@lru_cache(maxsize=16)
def _null(used: bytes, shape: tuple[int, int], known: float) -> np.ndarray:
    """Draws of :func:`largest` under noise alone: of channels that are used, with variances so well known."""
    live = np.frombuffer(used, bool).reshape(shape)
    rng = np.random.default_rng(0)
    count = max(100, min(DRAWS, int(4e6 / max(live.size, 1))))
    y = (rng.normal(size=(count, *shape)) + 1j * rng.normal(size=(count, *shape))) * live
    return largest(y / np.sqrt(rng.gamma(known / 2, 2 / known, y.shape)) if np.isfinite(known) else y)


def _explained(value: Any, unknowns: float) -> Any:
    r"""Chi-square less what so many unknowns of that size cost, :math:`x - k\ln(1 + x/k)`."""
    return value - unknowns * np.log1p(value / unknowns)


def _is_wide(residual: np.ndarray, live: np.ndarray, tone: np.ndarray, value: float, noise: float) -> bool:
    """Whether the same lines beside a tone hold nearly as much: of a resonance they do, of hum they do not."""
    at, beside = np.flatnonzero(tone), []
    for shift in BESIDE:
        moved = at + shift
        if moved[0] >= 0 and moved[-1] < len(tone) and live[..., moved].any():
            s = np.zeros(len(tone))
            s[moved] = tone[at]
            beside.append(float(largest(_summed(residual, live, s))))
    return bool(beside) and float(np.mean(beside)) - noise > ALSO_WIDE * (value - noise)
