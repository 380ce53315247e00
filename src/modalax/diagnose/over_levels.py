"""Frequency and damping of each mode at every force level, by local fits that know no law, and what they say."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from modalax._numerics.text import percent
from modalax.diagnose.evidence import Compared, local_pole
from modalax.diagnose.thresholds import THRESHOLDS

SAME = 0.1  # half-bandwidths within which two fits are of one mode
PARTS = 5  # parts of the lines; each left out once tells how well a local fit is determined
MODES, LEVELS = 3, 5  # most modes, and most levels of each, in one sentence


def over_levels(c: Compared) -> dict[str, Any] | None:
    """Modes at every level, and how far the FRFs of each output differ; None without two known levels.

    Standard deviations are those of a jackknife over interleaved parts of the lines (Efron 1982, chapter 3), so that
    what bends a peak is in them as far as lines disagree.
    """
    order = np.argsort(c.level)[: int(np.isfinite(c.level).sum())]
    if not len(order) or c.level[order[0]] == c.level[order[-1]]:
        return None
    modes, every, curves = [], [], {run: c.whitened(c.measured[run]) for run in order}
    for f, zeta in c.modes.T:
        start, rows = complex(2 * np.pi * f * (-zeta + 1j * np.sqrt(max(1 - zeta**2, 0.0)))), []
        for run in order:
            found = _pole(c, curves[run], start)
            if found is None:
                break
            start = found[0]
            rows.append([abs(start) / 2 / np.pi, found[1], -start.real / abs(start), found[2]])
        if len(rows) == len(order) and not any(_same(np.array(rows), np.array(earlier)) for earlier in every):
            every.append(rows)
            names = "frequency_hz", "frequency_std_hz", "damping_ratio", "damping_ratio_std"
            modes.append({name: [float(x) for x in v] for name, v in zip(names, np.transpose(rows), strict=True)})
    low, high = (c.measured[order[k]] for k in (0, -1))
    size = np.maximum(np.linalg.norm(low, axis=(0, 2)), 1e-300)
    change = np.linalg.norm(high - low, axis=(0, 2)) / size
    return {
        "level": [float(v) for v in c.level[order]], "modes": modes,
        "by_output": dict(zip(c.outputs, change.tolist(), strict=True)),
    }  # fmt: skip


def _same(mode: np.ndarray, other: np.ndarray) -> bool:
    """Whether two local fits have ended at one mode, at every level; rows of frequency, deviation and damping ratio."""
    return bool((np.abs(mode[:, 0] - other[:, 0]) < SAME * mode[:, 2] * mode[:, 0]).all())


def _pole(c: Compared, H: np.ndarray, start: complex) -> tuple[complex, float, float] | None:
    """Pole of a local fit, and standard deviations of its frequency [Hz] and damping ratio."""
    pole, parts = local_pole(c, H, start), []
    for k in range(PARTS if pole is not None else 0):
        kept = np.arange(len(c.freq)) % PARTS != k
        assert pole is not None
        part = local_pole(replace(c, freq=c.freq[kept]), H[kept], pole)
        parts += [] if part is None else [(abs(part) / 2 / np.pi, -part.real / abs(part))]
    if pole is None or len(parts) < PARTS:
        return None
    f, zeta = np.sqrt((PARTS - 1) * np.var(parts, axis=0))
    return pole, float(f), float(zeta)


def levels_said(verdict: str, evidence: Mapping[str, Any] | None) -> tuple[str, ...]:
    """Where nothing explains the data and force levels differ: how modes change with the level, and where most."""
    told = None if evidence is None else evidence["over_levels"]
    if verdict != "unknown" or evidence is None or told is None:
        return ()
    test = evidence["tests"]["level_homogeneity"]
    if test is None or test["p_value"] > THRESHOLDS.alarm:
        return ()
    moved = sorted(((_moved(m), k) for k, m in enumerate(told["modes"])), reverse=True)
    some = [told["modes"][k] for sure, k in moved if sure > THRESHOLDS.stands_out][:MODES]
    shown = np.unique(np.linspace(0, len(told["level"]) - 1, LEVELS).round().astype(int)).tolist()
    levels = f"{_row([told['level'][k] for k in shown])} N"
    most = max(told["by_output"], key=told["by_output"].__getitem__)
    where = f", most at {most} (by {percent(told['by_output'][most])})" if len(told["by_output"]) > 1 else ""
    first = f"the FRFs at force levels of {levels} differ by more than noise{where}"
    if not some:
        return (f"{first}, but no mode moves for certain",)
    what = "; ".join(_said(m, shown) for m in some)
    return (f"{first}: each level fitted as if it were linear, {what}",)


def _moved(mode: Mapping[str, list[float]]) -> float:
    """By how many standard deviations a mode differs between any two levels, at most."""
    most = 0.0
    for name, std in (("frequency_hz", "frequency_std_hz"), ("damping_ratio", "damping_ratio_std")):
        x, s = np.array(mode[name]), np.array(mode[std])
        apart = np.abs(x[:, None] - x) / np.maximum(np.hypot(s[:, None], s), 1e-300)
        most = max(most, float(apart.max()))
    return most


def _said(mode: Mapping[str, list[float]], shown: list[int]) -> str:
    f, zeta = (np.array(mode[x])[shown] for x in ("frequency_hz", "damping_ratio"))
    df, dz = (max(mode[x][k] for k in shown) for x in ("frequency_std_hz", "damping_ratio_std"))
    return f"a mode is at {_row(f, 5)} Hz (± {df:.1g}) with damping ratios of {_row(100 * zeta)} % (± {100 * dz:.1g})"


def _row(values: Iterable[float], digits: int = 3) -> str:
    return ", ".join(f"{v:.{digits}g}" for v in values)
