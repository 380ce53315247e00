"""Mains hum: single lines at multiples of 50 or 60 Hz, narrower than any mode."""

from collections.abc import Iterator

import numpy as np

from modalax.check.finding import Finding, Picture, sureness
from modalax.check.modes import Basis, least_squares, lift
from modalax.check.study import Study

MAINS = (50.0, 60.0)
# Mains frequencies wander by this share of themselves; a window spreads a line over so many more.
WANDER, SPREAD = 0.004, 2
# Lines on either side that a hum leaves alone and a mode does not.
TAIL = 12
# Power of a line over that of its surroundings from which on it stands out, and least damping ratio of a real mode.
STANDS_OUT, LEAST_DAMPING = 12.0, 2e-4


def hum(study: Study) -> Iterator[Finding]:
    """Narrow lines at the mains frequency or its multiples."""
    step = np.median(np.diff(study.freq))
    # Where lines are wider apart than the multiples' own width, every line would be near one.
    mains_seen = [m for m in MAINS if step <= m / (6 * SPREAD)]
    if len(study.freq) < 4 * TAIL or not mains_seen:
        return
    power = _left_over(study, float(step))
    best: tuple[float, float, list[float]] | None = None
    for mains in mains_seen:
        multiples = mains * np.arange(1, int(study.freq[-1] / mains) + 1)
        scores = [(f, *_score(study, power, f, float(step))) for f in multiples]
        told = [(f, z) for f, z, alone in scores if z > STANDS_OUT and alone]
        if told and (best is None or sum(z for _, z in told) > best[0]):
            best = (sum(z for _, z in told), mains, [f for f, _ in told])
    if best is None:
        return
    score, mains, lines = best
    share = _share(study, power, lines, float(step))
    shown = ", ".join(f"{f:g}" for f in lines[:6]) + (", ..." if len(lines) > 6 else "")
    yield Finding(
        "hum", (), sure=sureness(score, STANDS_OUT), size=share, unit="of the FRF there",
        evidence=f"single lines stand out at {shown} Hz, multiples of {mains:g} Hz, without the flanks of a resonance",
        advice="look for ground loops, use insulated mounts and shielded cables, average more, or leave the lines out",
        picture=Picture([("left over by the modes, over the noise", study.freq, power)], "Frequency [Hz]", "[-]", True),
    )  # fmt: skip


def _left_over(study: Study, step: float) -> np.ndarray:
    """Mean square of what the modes leave of all FRFs over their noise, with no mode narrower than two lines near a
    multiple of the mains.
    """  # noqa: D205, D400, D415
    poles = study.modes.poles
    f, width = np.abs(poles) / (2 * np.pi), -poles.real / np.pi
    near = np.zeros(len(poles), bool)
    for mains in MAINS:
        near |= np.abs(f - mains * np.maximum(np.round(f / mains), 1)) < SPREAD * step + WANDER * f
    poles = poles[~(near & (width < 2 * step))]
    runs, lines = study.H.shape[:2]
    H = study.H.transpose(1, 0, 2, 3).reshape(lines, -1)
    sigma = study.sigma.transpose(1, 0, 2, 3).reshape(lines, -1)
    basis = Basis(2 * np.pi * study.freq, study.power, np.ones(lines))
    away = np.ones(lines, bool)
    for mains in MAINS:
        multiple = mains * np.maximum(np.round(study.freq / mains), 1)
        away &= np.abs(study.freq - multiple) > (SPREAD + 0.5) * step
    Phi = basis.design(poles)
    both = np.concatenate([away, away])
    coefficients = least_squares(Phi[both], lift(H)[both])[0]
    left = lift(H) - Phi @ coefficients
    power = (left[:lines] ** 2 + left[lines:] ** 2) / np.maximum(sigma**2, (1e-3 * np.abs(H)) ** 2)
    return power.mean(axis=1)


def _score(study: Study, power: np.ndarray, multiple: float, step: float) -> tuple[float, bool]:
    """How far lines at a multiple stand out of their surroundings, and whether they do so without flanks."""
    reach = max(1.0, WANDER * multiple / step)
    near = np.flatnonzero(np.abs(study.freq - multiple) < reach * step)
    if not len(near):
        return 0.0, False
    top = int(near[np.argmax(power[near])])
    lines = np.arange(max(0, top - TAIL), min(len(power), top + TAIL + 1))
    around = lines[np.abs(lines - top) > SPREAD]
    if len(around) < TAIL:
        return 0.0, False
    level = np.median(power[around]) / np.log(2) + 0.3
    height = power[top] / level
    # A mode as narrow as this leaves at m lines off at least (half width / m)^2 of its height.
    narrow = max(0.5 * 2 * LEAST_DAMPING * multiple / step, 0.05)
    flank = np.sum((narrow / np.abs(around - top)) ** 2) * power[top]
    seen = np.sum(power[around] - np.median(power[around]))
    spread = np.sqrt(len(around)) * max(np.std(np.sort(power[around])[:-2]), 1e-12)
    alone = seen < 0.3 * flank or flank < 3 * spread and height > 3 * STANDS_OUT and _again(study, top)
    return float(height), bool(alone)


def _again(study: Study, line: int) -> bool:
    """Whether the line's phase differs from run to run or column to column, as that of no mode does."""
    values = study.H[:, line]
    runs, outs, ins = values.shape
    if runs < 2:
        return False
    unit = values / np.maximum(np.abs(values), np.finfo(float).tiny)
    return bool(np.abs(unit.mean(axis=0)).mean() < 0.8)


def _share(study: Study, power: np.ndarray, lines: list[float], step: float) -> float:
    which = [int(np.argmin(np.abs(study.freq - f))) for f in lines]
    sigma2 = np.mean(study.sigma[:, which] ** 2, axis=(0, 2, 3))
    there = np.mean(np.abs(study.H[:, which]) ** 2, axis=(0, 2, 3))
    return float(np.sqrt(np.max(power[which] * sigma2 / np.maximum(there, 1e-300))))
