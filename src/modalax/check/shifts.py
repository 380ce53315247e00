"""Natural frequencies that move between runs, between columns or between sensors."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from modalax.check.basis import ALL_POWERS
from modalax.check.block_modes import CLEAR, FARTHEST, LEADS, clear, converged, leading, one_that_moved, weighted
from modalax.check.finding import Finding, Picture, sureness
from modalax.check.loaded import rows_apart
from modalax.check.modes import Modes, estimate_modes, misfit_of, residues_at, select
from modalax.check.study import Study, line_step
from modalax.data.dofs import parse_dof

# A shift is told from this share of the frequency on, as one kelvin makes in steel (its modulus falls by 2.5e-4 a
# kelvin), and from this many standard deviations.
SMALLEST, SURE = 1e-4, 6.0
# Sensors of one column are measured at once, so more is asked of them, and a share of the half-power bandwidth.
SENSORS, OF_SENSORS, OF_WIDTH = 3.0, 6e-4, 0.09
# Blocks up to this number are searched for modes of their own where those of the reference do not explain them.
MOST_OWN = 12
# Error of the phase of a column that no standard deviation knows [rad]; channels are matched to some 0.05 degrees.
PHASE = 1e-3
# Misfit from which on a block is searched for modes of its own.
LEFT = 1.4
# A mode of a block belongs to one of the reference within this many half-power bandwidths, or this share of both.
SAME, NEAR = 2.5, 0.01
# Scatter of a mode's frequency over many blocks that no standard deviation tells.
SCATTER = 4.0
# By how much a sensor may move one, as a share of its frequency and of its half-power bandwidth.
LOADED, LOADED_WIDTH = 0.02, 0.6
# One that overlaps with another is followed over this share of its half-power bandwidth only.
OVERLAPPING = 0.25


@dataclass(frozen=True)
class Blocks:
    """Parts of a measurement that ought to have the same frequencies: runs, columns or rows."""

    kind: str
    which: Sequence[tuple[int, object, object]]
    names: Sequence[str]


def frequency_shift(study: Study) -> Iterator[Finding]:
    """Frequencies that differ between runs, columns, or rows, beyond their standard deviations."""
    if not len(study.modes.poles) or not study.explained:
        return
    told = [found for blocks in _blocks(study) if (found := _between(study, blocks)) is not None]
    # A column that moved also moves the rows that it stands in, less.
    if told:
        yield max(told, key=lambda found: found[0])[1]


def _blocks(study: Study) -> Iterator[Blocks]:
    runs, _, outs, ins = study.H.shape
    every = slice(None)
    if runs > 1:
        yield Blocks("run", [(k, every, every) for k in range(runs)], [f"run {k + 1}" for k in range(runs)])
    if ins > 1:
        yield Blocks("input", [(0, every, i) for i in range(ins)], study.inputs)
    if outs > 1:
        # Structures may move in one direction without another, each with frequencies of its own.
        for direction in dict.fromkeys(along := [parse_dof(name).direction for name in study.outputs]):
            rows = [o for o in range(outs) if along[o] == direction]
            if len(rows) > 1:
                yield Blocks("output", [(0, o, every) for o in rows], [study.outputs[o] for o in rows])


def _between(study: Study, blocks: Blocks) -> tuple[float, Finding] | None:
    """The surest difference between blocks of one kind, as its score and the finding; None if there is none."""
    apart = rows_apart(study, [o for _, o, _ in blocks.which]) if blocks.kind == "output" else None
    poles, f, s = apart or _compared(study, blocks)
    if not len(poles):
        return None
    f0, width = np.abs(poles) / 2 / np.pi, -poles.real / np.pi
    # A mode narrower than the lines are apart, or cut by the band's end, has no frequency to compare.
    edge = np.minimum(f0 - study.freq[0], study.freq[-1] - f0)
    fit = (width > line_step(study.freq, f0)) & (edge > width)
    # A phase that is off at resonance moves the frequency by as large a share of half of the bandwidth.
    s = np.where(fit & (s < 0.1 * width), np.hypot(s, 0.5 * PHASE * width), np.inf)
    if blocks.kind == "output" and apart is None:
        # A sensor's mass moves a mode by little; by more it is another mode, unless rows are known to have one each.
        s = np.where(np.abs(f - f0) < np.minimum(LOADED * f0, LOADED_WIDTH * width), s, np.inf)
    if blocks.kind == "run" and any(_with_level(study, f[:, m]) for m in np.flatnonzero(np.isfinite(s).all(axis=0))):
        return None
    off, spread = _off(f, s, 0.0 if apart else _strict(study, blocks.kind))
    least = np.maximum(OF_SENSORS * f0, OF_WIDTH * width) if blocks.kind == "output" else SMALLEST * f0
    with np.errstate(invalid="ignore"):
        z = np.where(np.isfinite(spread), np.abs(off) / np.maximum(SURE * spread, least), 0.0)
    # All modes of a block together: the whole structure that became softer or heavier.
    mean, mean_std = _mean_of(off / f0, spread / f0)
    mean_z = np.abs(mean) / np.maximum(SURE * mean_std, np.median(least / f0))
    score = np.maximum(z.max(axis=1, initial=0.0), np.where(np.isfinite(mean_z), mean_z, 0.0))
    if blocks.kind == "output":
        # What loads a structure moves more modes than one; a single one may be two that a sensor sees in another mix.
        score = np.sort(z, axis=1)[:, -2] if z.shape[1] > 1 else np.zeros(len(z))
    if score.max(initial=0.0) <= 1:
        return None
    k = int(np.argmax(score))
    m = int(np.argmax(np.where(np.isfinite(spread[k]), np.abs(off[k]) / spread[k], 0.0)))
    return float(score[k]), _finding(blocks, k, m, f, off[:, m], spread[:, m], f0, width, score)


def _strict(study: Study, kind: str) -> float:
    """How far blocks must stand out of the scatter of the others: sensors, and runs whose noise nobody states, more."""
    return SENSORS if kind == "output" or (kind == "run" and study.variance is None) else 1.0


def _compared(study: Study, blocks: Blocks) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Poles that blocks are compared with, and each block's frequencies of them and deviations, ``(block, n)``."""
    poles = _reference(study, blocks).poles
    found = [_frequencies(study, poles, block, k < MOST_OWN) for k, block in enumerate(blocks.which)]
    f, s = np.moveaxis(np.array(found), 1, 0)
    return poles, f, s


def _off(f: np.ndarray, s: np.ndarray, strict: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies of each block off those of the others, and the standard deviations of that, ``(block, mode)``."""
    blocks, modes = f.shape
    off, spread = np.zeros(f.shape), np.full(f.shape, np.inf)
    for m in range(modes):
        use = np.flatnonzero(np.isfinite(s[:, m]))
        for k in use:
            others = use[use != k]
            if not len(others):
                continue
            ordered = np.sort(f[others, m])
            # Of two in the middle the nearer one: of three blocks the one that moved is off both others, they are not.
            pair = ordered[[(len(ordered) - 1) // 2, len(ordered) // 2]]
            middle = pair[np.argmin(np.abs(pair - f[k, m]))]
            scatter = SCATTER / 6 * np.median(np.abs(f[others, m] - middle)) if len(others) > 3 else 0.0
            off[k, m] = f[k, m] - middle
            typical = 1.2533 * np.median(s[others, m]) / np.sqrt(len(others))
            spread[k, m] = np.sqrt(s[k, m] ** 2 + typical**2 + (strict * scatter) ** 2)
    return off, spread


def _mean_of(relative: np.ndarray, spread: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weighted mean over modes of relative shifts, and its standard deviation from noise and from their scatter."""
    weight = 1 / spread**2
    total = np.maximum(weight.sum(axis=1), 1e-300)
    mean = (weight * relative).sum(axis=1) / total
    count = np.maximum(np.isfinite(spread).sum(axis=1), 1)
    chi2 = (weight * (relative - mean[:, None]) ** 2).sum(axis=1) / np.maximum(count - 1, 1)
    return mean, np.sqrt(np.maximum(chi2, 1.0) / total)


def _finding(blocks: Blocks, k: int, m: int, f, off, spread, f0, width, score) -> Finding:
    moved = [name for name, z in zip(blocks.names, score, strict=True) if z > 1]
    if len(blocks.which) == 2 or len(moved) > len(blocks.which) / 2:
        moved = list(blocks.names)
    shift, std = 100 * off[k] / f0[m], 100 * spread[k] / f0[m]
    told = {"run": "run to run", "input": "column to column (input)", "output": "sensor to sensor (output)"}
    listed = ", ".join(moved[:6]) + (", ..." if len(moved) > 6 else "")
    return Finding(
        "frequency_shift", () if blocks.kind == "run" else tuple(moved), sure=sureness(float(score[k]), 1.0),
        size=float(shift), unit="%", interval=(float(shift - 1.96 * std), float(shift + 1.96 * std)),
        evidence=f"the mode at {f0[m]:.5g} Hz moves from {told[blocks.kind]} by {off[k]:.3g} Hz ({shift:.3g} %, "
        f"{abs(off[k]) / width[m]:.2g} of its half-power bandwidth) at {blocks.names[k]}; not the same: {listed}",
        advice={
            "run": "let the structure settle, watch temperature and supports, and fit the runs one by one",
            "input": "look for a sensor or shaker that was moved between the columns, or supports that changed; fit "
            "the columns one by one",
            "output": "a sensor moved from place to place loads the structure: use lighter ones, or dummy masses",
        }[blocks.kind],
        picture=Picture(
            [("frequency", np.arange(1.0, len(f) + 1)[use], f[use, m])
             for use in [np.isfinite(spread)]], f"Number of the {blocks.kind}", "Natural frequency [Hz]", dots=True,
        ),
    )  # fmt: skip


def _with_level(study: Study, frequency: np.ndarray) -> bool:
    """Whether the frequencies follow the force levels, as those of a non-linear structure do."""
    level = study.level
    if not np.isfinite(level).all() or np.ptp(level) < 0.05 * level.max():
        return False
    steps = np.diff(frequency[np.argsort(level)])
    return bool(np.all(steps <= 0) or np.all(steps >= 0) or len(steps) < 2)


def _reference(study: Study, blocks: Blocks) -> Modes:
    """Modes that blocks are compared with.

    Those of all columns together stand in pairs where the columns differ; each column then needs one of a pair only.
    """
    if blocks.kind != "input" or not any(
        one_that_moved(study, a, b) for g in study.groups for a, b in combinations(g, 2)
    ):
        return study.modes
    own = [_of_block(study, study.modes.poles, block)[0] for block in blocks.which[:3]]
    return max(own, key=lambda found: np.sum(found.inside & (clear(found) > CLEAR)))


def _of_block(study: Study, poles: np.ndarray, block) -> tuple[Modes, float]:
    """Those of the poles that a block needs, moved to where it has them, and the misfit that is left."""
    basis, X, H, noise = weighted(study, block)
    poles, left = converged(basis, select(basis, poles, X), X)
    return residues_at(basis.s.imag, H, noise, poles, study.power, ALL_POWERS), left


def _frequencies(study: Study, poles: np.ndarray, block, search: bool) -> np.ndarray:
    """Natural frequencies of one block and their standard deviations [Hz], shape ``(2, n)``; inf where it has none."""
    basis, X, H, noise = weighted(study, block)
    if not np.any(H):
        return np.stack([np.abs(poles) / 2 / np.pi, np.full(len(poles), np.inf)])
    best, left = converged(basis, poles, X)
    if search and left > LEFT:
        own = estimate_modes(basis.s.imag / 2 / np.pi, H, noise.sigma, study.power)
        other, less = converged(basis, _matched(own.poles, poles), X)
        best, left = (other, less) if less < left else (best, left)
    found = residues_at(basis.s.imag, H, noise, best, study.power, ALL_POWERS)
    moved = np.abs(best) - np.abs(poles)
    lost = (clear(found) < CLEAR) | (np.abs(best.real) > 3 * np.abs(poles.real))
    lost |= leading(found, basis.s.imag / 2 / np.pi, H, study.power) < LEADS
    # Of modes that overlap, one may take the place of the other, or of one that the reference lacks.
    alone = _alone(poles)
    lost |= np.abs(moved) > np.where(alone, FARTHEST * np.abs(poles), OVERLAPPING * -2 * poles.real)
    lost |= ~alone & (left > LEFT)
    # No shift is surer than what it explains: its deviations squared are at most what chi-square falls by.
    gain = 2 * X.size * (misfit_of(basis, poles, X) ** 2 - left**2) / max(left, 1.0) ** 2
    std = np.maximum(found.pole_std, np.abs(moved) / np.sqrt(max(gain, 1.0)))
    return np.stack([np.abs(best), np.where(lost, np.inf, std)]) / (2 * np.pi)


def _alone(poles: np.ndarray) -> np.ndarray:
    """Whether each mode is further from the next than both are wide."""
    gap = np.abs(poles[:, None].imag - poles[None, :].imag) + poles.real[:, None] + poles.real
    np.fill_diagonal(gap, np.inf)
    return np.min(gap - np.maximum(-poles.real[:, None], -poles.real), axis=1, initial=np.inf) > 0


def _matched(own: np.ndarray, poles: np.ndarray) -> np.ndarray:
    """The reference's poles, each replaced by the one of a block that is nearest both ways."""
    result = poles.copy()
    if not len(own):
        return result
    gap = np.abs(own[:, None] - poles[None, :]) / np.maximum(2 * SAME * -poles.real, NEAR * np.abs(poles))
    for m in range(len(poles)):
        k = int(np.argmin(gap[:, m]))
        if gap[k, m] < 1 and np.argmin(gap[k]) == m:
            result[m] = own[k]
    return result
