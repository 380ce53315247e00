"""Mains hum: single lines at multiples of 50 or 60 Hz, narrower than any mode."""

from collections.abc import Iterator

import numpy as np
from scipy.stats import binom, chi2, gamma

from modalax.check.basis import Basis, least_squares, lift
from modalax.check.finding import Finding, Picture, sureness
from modalax.check.modes import noise_of
from modalax.check.resolution import FEW, lines_a_width
from modalax.check.study import Study

MAINS = (50.0, 60.0)
# Mains frequencies wander by this share of themselves; a window spreads a line over so many more.
WANDER, SPREAD = 0.004, 2
# Lines on either side that a hum leaves alone and a mode does not.
TAIL = 12
# Chance of noise alone, for one line and for all together, below which a hum is told; least share of the FRF there;
# least damping ratio of a real mode; power over the surroundings that needs no flanks to be looked for.
CHANCE, LEAST_SHARE, LEAST_DAMPING, HIGH = 1e-6, 0.05, 2e-4, 36.0
# Multiples of which one must be seen; share of the mains frequency by which a multiple may wander and still be told.
LOWEST, NEAR = 3, 0.25
# Power of what the modes leave, over the noise, from which on they do not explain the lines around.
UNEXPLAINED = 30.0
# Chance of noise alone below which a line stands out; chance that so many of the single lines of all frequencies are
# multiples, from which on they may be no hum.
SEEN, COINCIDENCE = 1e-3, 1e-3
# The same for an output that holds no hum, above which it is free of it.
ABSENT = 1e-2


def hum(study: Study) -> Iterator[Finding]:
    """Narrow lines at the mains frequency or its multiples."""
    step = np.median(np.diff(study.freq))
    # Where lines are wider apart than the multiples' own width, every line would be near one.
    mains_seen = [m for m in MAINS if step <= m / (6 * SPREAD)]
    if len(study.freq) < 4 * TAIL or not mains_seen:
        return
    each = _left_over(study, float(step))
    power = each.mean(axis=(1, 2, 3))
    # Where the lines are wider apart than modes are wide, a mode too is a single line.
    widths = lines_a_width(study)
    unresolved = len(widths) > 0 and float(np.median(widths)) < FEW
    best: tuple[float, float, list[float], list[float]] | None = None
    for mains in mains_seen:
        multiples = mains * np.arange(1, int(min(study.freq[-1] / mains, NEAR / WANDER)) + 1)
        chances = [(f, *_chance(study, power, f, float(step))) for f in multiples]
        told = [(f, chance) for f, chance, alone in chances if chance < 1e-2 and alone]
        # A hum without any of its lower multiples is none, but for one that nothing else can be.
        lowest = multiples[multiples > study.freq[0]][:LOWEST]
        if not any(f in lowest or chance < CHANCE**2 for f, chance in told):
            continue
        # Fisher's sum over all multiples; the others count as chance 1.
        total = -2 * sum(np.log(chance) for _, chance in told)
        together = float(chi2.sf(total, 2 * len(multiples)))
        score = -np.log10(max(min(together, len(multiples) * min(c for _, c in told)), 1e-300)) / -np.log10(CHANCE)
        lines = [f for f, chance in told if chance < SEEN]
        which = _strongest(study, power, lines, float(step))
        if unresolved and not any(_again(study, k) for k in which) and _coincidence(study, power, mains, float(step)):
            continue
        if score > 1 and lines and _share(study, power, which) > LEAST_SHARE and (best is None or score > best[0]):
            best = float(score), mains, lines, [f for f, _ in told]
    if best is None:
        return
    score, mains, lines, seen = best
    which = _strongest(study, power, lines, float(step))
    share = _share(study, power, which)
    shown = ", ".join(f"{f:g}" for f in lines[:6]) + (", ..." if len(lines) > 6 else "")
    yield Finding(
        "hum", _outputs(study, each, which), sure=sureness(score, 1.0), size=share, unit="of the FRF there",
        evidence=f"single lines stand out at {shown} Hz, multiples of {mains:g} Hz, without the flanks of a resonance",
        advice="look for ground loops, use insulated mounts and shielded cables, average more, or leave the lines out",
        picture=Picture([("left over by the modes, over the noise", study.freq, power)], "Frequency [Hz]", "[-]", True),
        bands=tuple((f - reach, f + reach) for f in seen for reach in [SPREAD * float(step) + WANDER * f]),
    )  # fmt: skip


def _left_over(study: Study, step: float) -> np.ndarray:
    """Squares of what the modes leave over the noise, shape ``(f, run, o, i)``.

    No mode near a multiple of the mains is narrower than two lines.
    """
    poles = study.modes.poles
    f, width = np.abs(poles) / (2 * np.pi), -poles.real / np.pi
    near = np.zeros(len(poles), bool)
    for mains in MAINS:
        near |= np.abs(f - mains * np.maximum(np.round(f / mains), 1)) < SPREAD * step + WANDER * f
    poles = poles[~(near & (width < 2 * step))]
    runs, lines = study.H.shape[:2]
    H = study.H.transpose(1, 0, 2, 3).reshape(lines, -1)
    sigma = study.sigma.transpose(1, 0, 2, 3).reshape(lines, -1)
    weight = noise_of(H, sigma).weight
    basis = Basis(2 * np.pi * study.freq, study.power, weight, study.modes.powers)
    away = np.ones(lines, bool)
    for mains in MAINS:
        multiple = mains * np.maximum(np.round(study.freq / mains), 1)
        away &= np.abs(study.freq - multiple) > (SPREAD + 0.5) * step
    Phi = basis.design(poles)
    both = np.concatenate([away, away])
    Y = lift(weight[:, None] * H)
    left = (Y - Phi @ least_squares(Phi[both], Y[both])[0]) / np.concatenate([weight, weight])[:, None]
    power = (left[:lines] ** 2 + left[lines:] ** 2) / _scale(H, sigma)
    return power.reshape(lines, runs, *study.H.shape[2:])


def _scale(H: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Power of the noise of each sample that what is left over is measured by: no model holds to the last digit."""
    return np.maximum(sigma**2, (1e-3 * np.abs(H)) ** 2)


def _chance(study: Study, power: np.ndarray, multiple: float, step: float) -> tuple[float, bool]:
    """Chance that noise makes a line near a multiple stand out so, and whether it does so without flanks."""
    near = _near(study, multiple, step)
    if not len(near):
        return 1.0, False
    top = int(near[np.argmax(power[near])])
    lines = np.arange(max(0, top - TAIL), min(len(power), top + TAIL + 1))
    around = lines[np.abs(lines - top) > SPREAD]
    if len(around) < TAIL:
        return 1.0, False
    # Means of squares of noise follow a gamma distribution; how many independent ones, their own scatter tells.
    level = np.mean(power[around]) + 0.02
    shape = min(level**2 / (np.var(power[around]) + 1e-4), study.H[:, 0].size)
    chance = min(1.0, len(near) * float(gamma.sf(power[top] / level * shape, shape)))
    # A mode as narrow as this leaves at m lines off at least (half width / m)^2 of its height.
    narrow = max(0.5 * 2 * LEAST_DAMPING * multiple / step, 0.05)
    flank = np.sum((narrow / np.abs(around - top)) ** 2) * power[top]
    seen = np.sum(power[around] - np.median(power[around]))
    spread = np.sqrt(len(around)) * max(np.std(np.sort(power[around])[:-2]), 1e-12)
    high = power[top] > HIGH * level and _again(study, top)
    # Too weak for flanks to be seen: no mode was found there either. Where the modes explain little, that says nothing.
    weak = flank < spread and np.median(power[around]) < UNEXPLAINED
    return max(chance, 1e-300), bool(seen < 0.3 * flank or flank < 3 * spread and high or weak)


def _coincidence(study: Study, power: np.ndarray, mains: float, step: float) -> bool:
    """Whether lines that stand out anywhere, as modes narrower than a line do, would fall at multiples by chance."""
    peaks = np.flatnonzero((power > np.roll(power, 1)) & (power > np.roll(power, -1)))
    chances = [(k, *_chance(study, power, float(study.freq[k]), step)) for k in peaks]
    alone = [k for k, chance, told in chances if told and chance < SEEN]
    multiples = mains * np.arange(1, int(study.freq[-1] / mains) + 1)
    at = np.unique(np.concatenate([_near(study, f, step) for f in multiples]))
    return float(binom.sf(np.isin(alone, at).sum() - 1, len(alone), len(at) / len(power))) > COINCIDENCE


def _near(study: Study, multiple: float, step: float) -> np.ndarray:
    """Lines at which a multiple of the mains frequency may stand."""
    return np.flatnonzero(np.abs(study.freq - multiple) < max(1.0, WANDER * multiple / step) * step)


def _strongest(study: Study, power: np.ndarray, multiples: list[float], step: float) -> list[int]:
    """The line near each multiple at which most is left over."""
    return [int(near[np.argmax(power[near])]) for f in multiples for near in [_near(study, f, step)]]


def _again(study: Study, line: int) -> bool:
    """Whether the line's phase differs from run to run or column to column, as that of no mode does."""
    values = study.H[:, line]
    runs, outs, ins = values.shape
    if runs < 2:
        return False
    unit = values / np.maximum(np.abs(values), np.finfo(float).tiny)
    return bool(np.abs(unit.mean(axis=0)).mean() < 0.8)


def _outputs(study: Study, each: np.ndarray, which: list[int]) -> tuple[str, ...]:
    """Outputs that hold the hum at these lines, where they are few and all others clearly do not; else none."""
    others = np.ones(len(each), bool)
    others[[k for line in which for k in range(max(0, line - SPREAD), line + SPREAD + 1) if k < len(each)]] = False
    level = each[others].mean(axis=(0, 1, 3)) + 1e-300
    count = len(which) * each.shape[1] * each.shape[3]  # squares of noise, each exponentially distributed
    chance = gamma.sf(each[which].mean(axis=(0, 1, 3)) / level * count, count)
    has, lacks = chance < CHANCE, chance > ABSENT
    told = has.any() and (has | lacks).all() and 2 * has.sum() <= len(has)
    return tuple(name for name, there in zip(study.outputs, has, strict=True) if there) if told else ()


def _share(study: Study, power: np.ndarray, which: list[int]) -> float:
    """How large the hum is beside the FRFs at the one of its lines where it is largest."""
    H = study.H[:, which]
    sigma2 = np.mean(_scale(H, study.sigma[:, which]), axis=(0, 2, 3))
    there = np.mean(np.abs(H) ** 2, axis=(0, 2, 3))
    return float(np.sqrt(np.max(power[which] * sigma2 / np.maximum(there, 1e-300))))
