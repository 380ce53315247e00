"""Natural frequencies that move between runs, between columns or between sensors."""

from collections.abc import Iterator

import numpy as np

from modalax.check.finding import Finding, Picture, sureness
from modalax.check.modes import Basis, Modes, estimate_modes, improve, residues_at
from modalax.check.study import Study

# A shift is told from this share of a half-power bandwidth on, and from this many standard deviations.
SMALLEST_SHIFT, SURE = 0.12, 7.0
STEPS = 3  # Gauss-Newton steps that fit a block
# Blocks up to this number are searched for modes each for itself. A shift must lower the squares around its mode by the
# second.
MOST_OWN, WORTH = 12, 1.6
# A mode of a block belongs to one of the whole within this many half-power bandwidths.
SAME = 2.5


def frequency_shift(study: Study) -> Iterator[Finding]:
    """Frequencies that differ between runs, columns, or rows, beyond their standard deviations."""
    runs, _, outs, ins = study.H.shape
    modes = list(range(len(study.modes.poles)))
    if not modes or not study.explained:
        return
    everywhere = slice(None)
    blocks = []
    if runs > 1:
        blocks.append(
            ("run", [(k, everywhere, everywhere) for k in range(runs)], [f"run {k + 1}" for k in range(runs)])
        )
    if ins > 1:
        blocks.append(("input", [(0, everywhere, i) for i in range(ins)], list(study.inputs)))
    if outs > 1:
        blocks.append(("output", [(0, o, everywhere) for o in range(outs)], list(study.outputs)))
    told = [f for f in (_between(study, modes, *block) for block in blocks) if f is not None]
    # A column that moved also moves the rows that it stands in, less.
    if told:
        yield max(told, key=lambda found: found[0])[1]


def _between(study: Study, modes: list[int], kind: str, blocks: list, names: list[str]):
    """The surest difference between blocks of one kind, as its score and the finding; None if there is none."""
    own = kind != "output" and len(blocks) <= MOST_OWN
    values = [_frequencies(study, study.modes.poles, *block, own=own) for block in blocks]
    best = None
    for m in modes:
        width = study.modes.width[m]
        f, s = np.array([v[:2, m] for v in values]).T
        use = np.flatnonzero(s < 0.1 * width)
        if len(use) < 2 or (kind == "run" and _with_level(study, f)):
            continue
        f, s = f[use], s[use]
        middle = np.median(f) if len(f) > 2 else f[np.argmin(s)]
        off = np.abs(f - middle)
        spread = np.sqrt(s**2 + np.median(s) ** 2)
        # With many blocks their own scatter shows what errors of the model do.
        scatter = 1.5 * np.median(off) if len(f) > 4 and kind == "output" else 0.0
        least = (6 if kind == "output" else 1) * SMALLEST_SHIFT * width
        z = off / np.maximum(np.maximum(SURE * spread, least), SURE * scatter)
        k = int(np.argmax(z))
        if z[k] <= 1 or (best is not None and z[k] <= best[0]):
            continue
        moved = values[use[k]][0, m]
        if _worth(study, blocks[use[k]], m, middle, moved) < WORTH:
            continue
        best = (float(z[k]), m, [names[u] for u, zz in zip(use, z, strict=True) if zz > 1],
                float(f[k] - middle), float(spread[k]), use, f)  # fmt: skip
    if best is None:
        return None
    score, m, which, shift, spread, use, f = best
    width = study.modes.width[m]
    if len(use) == 2:
        which = [names[u] for u in use]
    where = () if kind == "run" else tuple(which)
    f0 = float(np.median(f))
    told = {"run": "run to run", "input": "column to column (input)", "output": "sensor to sensor (output)"}[kind]
    return score, Finding(
        "frequency_shift", where, sure=sureness(score, 1.0), size=shift, unit="Hz",
        interval=(shift - 1.96 * spread, shift + 1.96 * spread),
        evidence=f"the mode at {f0:.5g} Hz moves from {told} by {shift:.3g} Hz ({100 * shift / f0:.3g} %, "
        f"{abs(shift) / width:.2g} of its half-power bandwidth); moved: {', '.join(which)}",
        advice={
            "run": "let the structure settle, watch temperature and supports, and fit the runs one by one",
            "input": "look for a sensor or shaker that was moved between the columns, or supports that changed; fit "
            "the columns one by one",
            "output": "a sensor moved from place to place loads the structure: use lighter ones, or dummy masses",
        }[kind],
        picture=Picture(
            [("frequency", np.arange(1.0, len(use) + 1), f)], f"Number of the {kind}",
            "Natural frequency [Hz]", dots=True,
        ),
    )  # fmt: skip


def _with_level(study: Study, frequency: np.ndarray) -> bool:
    """Whether the frequencies follow the force levels, as those of a non-linear structure do."""
    level = study.level
    if not np.isfinite(level).all() or np.ptp(level) < 0.05 * level.max():
        return False
    steps = np.diff(frequency[np.argsort(level)])
    return bool(np.all(steps <= 0) or np.all(steps >= 0) or len(steps) < 2)


def _block(study: Study, run: int, o, i) -> tuple[np.ndarray, np.ndarray]:
    """FRFs and noise of a block, ``(f, k)``."""
    lines = len(study.freq)
    H, sigma = (a[run][:, o][:, ..., i] if isinstance(o, slice) else a[run][:, o][:, i] for a in (study.H, study.sigma))
    return H.reshape(lines, -1), sigma.reshape(lines, -1)


def _frequencies(study: Study, poles: np.ndarray, run: int, o, i, own: bool) -> np.ndarray:
    """Natural frequencies of one block and their standard deviations [Hz], shape ``(2, n)``; inf where it has none."""
    n, none = len(poles), np.stack([np.abs(poles) / 2 / np.pi, np.full(len(poles), np.inf)])
    H, sigma = _block(study, run, o, i)
    if not np.any(H):
        return none
    if own:
        found = estimate_modes(study.freq, H, sigma, study.power)
        return _matched(found, poles, none)
    omega, weight = 2 * np.pi * study.freq, np.ones(len(study.freq))
    scale = np.sqrt(np.mean(np.abs(H) ** 2, axis=0))
    noise = np.sqrt(np.mean(sigma**2, axis=0)) + 1e-6 * scale + 1e-300
    basis = Basis(omega, study.power, weight)
    moved = poles
    for _ in range(STEPS):
        step = improve(basis, moved, H / noise)
        if len(step) != n:
            return none
        moved = step
    found = residues_at(omega, H, noise, weight, moved, study.power)
    lost = (_clear(found) < 8) | (np.abs(moved - poles) > -3 * poles.real)
    return np.stack([np.abs(moved) / 2 / np.pi, np.where(lost, np.inf, found.pole_std / 2 / np.pi)])


def _clear(found: Modes) -> np.ndarray:
    return np.max(np.abs(found.residues) / np.maximum(found.std, 1e-300), axis=1, initial=0.0)


def _matched(found: Modes, poles: np.ndarray, none: np.ndarray) -> np.ndarray:
    """Modes found in a block beside those of the whole, where exactly one of each is near the other."""
    result = none.copy()
    if not len(found.poles):
        return result
    gap = np.abs(found.poles[:, None] - poles[None, :]) / (2 * -poles.real)
    clear = _clear(found) > 8
    for m in range(len(poles)):
        near = np.flatnonzero((gap[:, m] < SAME) & clear)
        if len(near) == 1 and np.argmin(gap[near[0]]) == m:
            result[:, m] = np.abs(found.poles[near[0]]) / 2 / np.pi, found.pole_std[near[0]] / 2 / np.pi
    return result


def _worth(study: Study, block: tuple, m: int, before: float, after: float) -> float:
    """Sum of squares around a mode with its frequency as elsewhere over that with its own frequency."""
    H, sigma = _block(study, *block)
    poles, left = study.modes.poles, []
    omega, weight = 2 * np.pi * study.freq, np.ones(len(study.freq))
    noise = np.sqrt(np.mean(sigma**2, axis=0)) + 1e-6 * np.sqrt(np.mean(np.abs(H) ** 2, axis=0)) + 1e-300
    near = np.abs(study.freq - after) < np.maximum(3 * study.modes.width[m], 2 * np.median(np.diff(study.freq)))
    for f in (before, after):
        trial = poles.copy()
        trial[m] = poles[m].real + 2j * np.pi * f
        found = residues_at(omega, H, noise, weight, trial, study.power)
        left.append(np.sum((np.abs(H - found.fitted)[near] / noise) ** 2) / (near.sum() * H.shape[1]))
    return float(left[0] / max(left[1], 1.0))
