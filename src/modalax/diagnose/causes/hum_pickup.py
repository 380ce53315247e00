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

import numpy as np

STRAY = 4e-4  # relative error of the mains frequency
DRAWS = 1000  # draws of noise alone
BESIDE = (-8, -6, -4, 4, 6, 8)  # distances in lines at which hum through a window has ended and a resonance has not
ALSO_WIDE = 0.3  # signal at these lines, relative to that at the tone, from which on it is no tone
LEAST = 8.0  # least gain of chi-square by a tone


@dataclass(frozen=True)
class Pickup:
    """Lines that one source of hum explains.

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
    tones: list[np.ndarray] = []
    for k in range(1, int(freq[-1] * 1.002 // fundamental) + 1):
        at = k * fundamental
        middle = int(np.abs(freq - at).argmin())
        if not live[..., middle].any() or abs(freq[middle] - at) > step[middle] + STRAY * at:
            continue
        offsets = (0.0, STRAY * at, -STRAY * at) if STRAY * at > 0.25 * step[middle] else (0.0,)
        tones.append(np.array([s for off in offsets for s in tone_lines((freq - at - off) / step[middle])]))
    if not tones:
        return Pickup([], [], 1.0)
    lines = np.flatnonzero(np.abs(np.concatenate(tones)).max(axis=0))
    null = _null_of(live[..., lines], [t[:, lines] for t in tones], uneven, known)
    best, found = zip(*(_best(residual, live, t) for t in tones), strict=True)
    here = [
        k for k, (s, value) in enumerate(zip(best, found, strict=True))
        if not _is_wide(residual, live, s, value, float(null.single.mean()))
    ]  # fmt: skip
    unknowns = max(2.0 * (live.any(axis=(0, 2)).sum() + live.any(axis=(1, 2)).sum() - 1), 2.0)
    gains = [_gain(found[k], null.strongest[:, k], unknowns) for k in here]
    sets = [np.flatnonzero(np.abs(best[k]) > 0.05) for k in here]
    alone = [j for j, gain in enumerate(gains) if gain >= LEAST]
    chance = min((tail(found[here[j]], null.strongest.max(axis=1)) for j in alone), default=1.0)
    ways = 1 + (len(tones) > 1)
    if len(here) > 1:  # the channels pick up all harmonics in the same proportion, or nearly so
        value = float(largest(np.concatenate([_summed(residual, live, best[k][None])[0] for k in here])))
        gain = _gain(value, null.together, unknowns + 2.0 * live.any(axis=(1, 2)).sum() * (len(here) - 1))
        # harmonics that were left out as too wide are missed here, and not in the null
        together = tail(value, null.together)
        if together < chance and gain >= LEAST:
            return Pickup(sets, [gain / len(sets)] * len(sets), min(1.0, ways * together))
    return Pickup([sets[j] for j in alone], [gains[j] for j in alone], min(1.0, ways * chance))


@dataclass(frozen=True)
class _Null:
    """The statistic under noise alone, draw by draw.

    Attributes
    ----------
    single
        Of the first form of the first tone, shape ``(draw,)``.
    strongest
        Of the best form of each tone, shape ``(draw, tone)``.
    together
        Of all tones, each in its best form, shape ``(draw,)``.
    """

    single: np.ndarray
    strongest: np.ndarray
    together: np.ndarray


def _null_of(live: np.ndarray, tones: list[np.ndarray], uneven: float, known: float) -> _Null:
    """Draws of noise alone, looked through as the data are."""
    forms = tuple(len(t) for t in tones)
    null = _null(live.tobytes(), live.shape, np.concatenate(tones).tobytes(), forms, known)
    if uneven <= 0:
        return null
    off = np.random.default_rng(1).gamma(1 / uneven, uneven, null.strongest.shape)
    return _Null(null.single * off[:, 0], null.strongest * off, null.together * off[:, 0])


def _best(residual: np.ndarray, live: np.ndarray, tone: np.ndarray) -> tuple[np.ndarray, float]:
    """The form of a tone that explains most, and how much."""
    values = largest(_summed(residual, live, tone))
    return tone[int(np.argmax(values))], float(values.max())


def _summed(residual: np.ndarray, live: np.ndarray, forms: np.ndarray) -> np.ndarray:
    """What each form of a tone has in each channel, of unit variance under noise, shape ``(..., form, column, o)``."""
    at = np.flatnonzero(np.abs(forms).max(axis=0))
    r, used, forms = residual[..., at] * live[..., at], live[..., at].astype(float), forms[:, at]
    return np.moveaxis(r @ forms.T, -1, -3) / np.sqrt(np.maximum(np.moveaxis(used @ forms.T**2, -1, -3), 1e-300))


@lru_cache(maxsize=16)
def _null(used: bytes, shape: tuple[int, ...], flat: bytes, forms: tuple[int, ...], known: float) -> _Null:
    """Draws of noise alone at samples that are used, with variances so well known."""
    live = np.frombuffer(used, bool).reshape(shape)
    tones = np.split(np.frombuffer(flat).reshape(sum(forms), shape[-1]), np.cumsum(forms)[:-1])
    rng, size = np.random.default_rng(0), live.size
    left, parts = max(100, min(DRAWS, int(1e7 / max(size, 1)))), []
    while left > 0:
        count = min(left, max(1, int(1e6 / max(size, 1))))
        left -= count
        y = rng.normal(size=(count, *shape, 2)).view(complex)[..., 0]
        if np.isfinite(known):
            y /= np.sqrt(rng.gamma(known / 2, 2 / known, y.shape))
        sums = [_summed(y, live, t) for t in tones]
        values = [largest(x) for x in sums]  # (draw, form) of each tone
        best = [x[np.arange(count), v.argmax(axis=1)] for x, v in zip(sums, values, strict=True)]
        strongest = np.stack([v.max(axis=1) for v in values], axis=1)
        together = largest(np.concatenate(best, axis=1)) if len(tones) > 1 else strongest[:, 0]
        parts.append((values[0][:, 0], strongest, together))
    single, strongest, together = (np.concatenate(p) for p in zip(*parts, strict=True))
    return _Null(single, strongest, together)


def _gain(value: float, null: np.ndarray, unknowns: float) -> float:
    r"""Chi-square explained less what so many unknowns cost, :math:`x - k\ln(1 + x/k)`, beyond what is usual."""
    value, usual = (x - unknowns * np.log1p(x / unknowns) for x in (value, np.median(null)))
    return float(value - usual)


def _is_wide(residual: np.ndarray, live: np.ndarray, tone: np.ndarray, value: float, noise: float) -> bool:
    """Whether the same lines beside a tone hold nearly as much: of a resonance they do, of hum they do not."""
    at, beside = np.flatnonzero(tone), []
    for shift in BESIDE:
        moved = at + shift
        if moved[0] >= 0 and moved[-1] < len(tone) and live[..., moved].any():
            s = np.zeros(len(tone))
            s[moved] = tone[at]
            beside.append(float(largest(_summed(residual, live, s[None]))[0]))
    return bool(beside) and float(np.mean(beside)) - noise > ALSO_WIDE * (value - noise)
