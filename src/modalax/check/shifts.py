"""Natural frequencies that move between runs, between columns or between sensors."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from modalax.check.basis import Basis
from modalax.check.finding import Finding, Picture, sureness
from modalax.check.modes import Modes, estimate_modes, improve, misfit_of, noise_of, residues_at
from modalax.check.study import Study, line_step

# A shift is told from this share of the frequency on, as one kelvin makes in steel (its modulus falls by 2.5e-4 a
# kelvin), and from this many standard deviations.
SMALLEST, SURE = 1e-4, 6.0
# Sensors of one column are measured at once, so more is asked of them, and a share of the half-power bandwidth.
SENSORS, OF_SENSORS, OF_WIDTH = 3.0, 6e-4, 0.09
# Blocks up to this number are searched for modes of their own where those of the reference do not explain them.
MOST_OWN = 12
STEPS = 6
# Misfit from which on a block is searched for modes of its own.
LEFT = 1.4
# A mode of a block belongs to one of the reference within this many half-power bandwidths, or this share of both.
SAME, NEAR = 2.5, 0.01
# Scatter of a mode's frequency over many blocks that no standard deviation tells.
SCATTER = 4.0
CLEAR = 8.0
# A mode that moves by more than this share of its frequency is another one.
FARTHEST = 0.05
# By how much a sensor may move one, as a share of its frequency and of its half-power bandwidth.
LOADED, LOADED_WIDTH = 0.02, 0.6
# One that overlaps with another is followed over this share of its half-power bandwidth only.
OVERLAPPING = 0.25
# A mode makes at least this share of the response at its frequency in some channel.
LEADS = 0.6


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
        yield Blocks("output", [(0, o, every) for o in range(outs)], study.outputs)


def _between(study: Study, blocks: Blocks) -> tuple[float, Finding] | None:
    """The surest difference between blocks of one kind, as its score and the finding; None if there is none."""
    reference = _reference(study, blocks)
    poles = reference.poles
    if not len(poles):
        return None
    found = [_frequencies(study, poles, block, k < MOST_OWN) for k, block in enumerate(blocks.which)]
    f, s = np.moveaxis(np.array(found), 1, 0)
    f0, width = np.abs(poles) / 2 / np.pi, -poles.real / np.pi
    # A mode narrower than the lines are apart, or cut by the band's end, has no frequency to compare.
    edge = np.minimum(f0 - study.freq[0], study.freq[-1] - f0)
    fit = reference.inside & (width > line_step(study.freq, f0)) & (edge > width)
    s = np.where(fit & (s < 0.1 * width), np.hypot(s, 1e-6 * f0), np.inf)
    if blocks.kind == "output":
        # A sensor's mass moves a mode by little; by more it is another mode.
        s = np.where(np.abs(f - f0) < np.minimum(LOADED * f0, LOADED_WIDTH * width), s, np.inf)
    if blocks.kind == "run" and any(_with_level(study, f[:, m]) for m in np.flatnonzero(np.isfinite(s).all(axis=0))):
        return None
    # Runs whose noise nobody states, as single hits, must stand out of the scatter of the others as sensors do.
    strict = SENSORS if blocks.kind == "output" or (blocks.kind == "run" and study.variance is None) else 1.0
    off, spread = _off(f, s, strict)
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
            best = others[np.argmin(s[others, m])]
            middle = np.median(f[others, m]) if len(others) > 1 else f[best, m]
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


def _block(study: Study, block) -> tuple[np.ndarray, np.ndarray]:
    """FRFs and noise of a block, ``(f, k)``."""
    run, o, i = block
    lines = len(study.freq)
    return tuple(a[run][:, o].reshape(lines, -1) if isinstance(i, slice) else a[run][:, :, i]  # pyright: ignore
                 for a in (study.H, study.sigma))  # fmt: skip


def _reference(study: Study, blocks: Blocks) -> Modes:
    """Modes that blocks are compared with: of all, or of one block where modes of all stand in pairs."""
    if blocks.kind == "output" or all(len(g) == 1 for g in study.groups):
        return study.modes
    own = [estimate_modes(study.freq, *_block(study, block), study.power) for block in blocks.which[:3]]
    return max(own, key=lambda found: np.sum(found.inside & (_clear(found) > CLEAR)))


def _frequencies(study: Study, poles: np.ndarray, block, search: bool) -> np.ndarray:
    """Natural frequencies of one block and their standard deviations [Hz], shape ``(2, n)``; inf where it has none."""
    freq = study.freq[study.telling]
    H, sigma = (a[study.telling] for a in _block(study, block))
    if not np.any(H):
        return np.stack([np.abs(poles) / 2 / np.pi, np.full(len(poles), np.inf)])
    noise = noise_of(H, sigma)
    basis = Basis(2 * np.pi * freq, study.power, noise.weight, study.modes.powers)
    X = noise.weight[:, None] * H / noise.level
    best, left = _converged(basis, poles, X)
    if search and left > LEFT:
        own = estimate_modes(freq, H, sigma, study.power)
        other, less = _converged(basis, _matched(own.poles, poles), X)
        best, left = (other, less) if less < left else (best, left)
    found = residues_at(2 * np.pi * freq, H, noise, best, study.power, study.modes.powers)
    moved = np.abs(best) - np.abs(poles)
    lost = (_clear(found) < CLEAR) | (np.abs(best.real) > 3 * np.abs(poles.real))
    lost |= _leading(found, freq, H, study.power) < LEADS
    # Of modes that overlap, one may take the place of the other, or of one that the reference lacks.
    alone = _alone(poles)
    lost |= np.abs(moved) > np.where(alone, FARTHEST * np.abs(poles), OVERLAPPING * -2 * poles.real)
    lost |= ~alone & (left > LEFT)
    return np.stack([np.abs(best) / 2 / np.pi, np.where(lost, np.inf, found.pole_std / 2 / np.pi)])


def _converged(basis: Basis, poles: np.ndarray, X: np.ndarray) -> tuple[np.ndarray, float]:
    """Poles after a few steps, and the root mean square that they leave over the noise."""
    for _ in range(STEPS):
        moved = improve(basis, poles, X)
        if len(moved) != len(poles):
            break
        still = np.max(np.abs(moved - poles) / -poles.real, initial=0.0) < 1e-4
        poles = moved
        if still:
            break
    return poles, misfit_of(basis, poles, X)


def _clear(found: Modes) -> np.ndarray:
    return np.max(np.abs(found.residues) / np.maximum(found.std, 1e-300), axis=1, initial=0.0)


def _alone(poles: np.ndarray) -> np.ndarray:
    """Whether each mode is further from the next than both are wide."""
    gap = np.abs(poles[:, None].imag - poles[None, :].imag) + poles.real[:, None] + poles.real
    np.fill_diagonal(gap, np.inf)
    return np.min(gap - np.maximum(-poles.real[:, None], -poles.real), axis=1, initial=np.inf) > 0


def _leading(found: Modes, freq: np.ndarray, H: np.ndarray, power: int) -> np.ndarray:
    """Largest share of each mode in what a channel does at its frequency: a mode on the flank of another has little."""
    near = np.abs(freq[:, None] - found.frequency).argmin(axis=0)
    peak = np.abs(found.residues) / -found.poles.real[:, None] * (np.abs(found.poles) ** power)[:, None]
    return np.max(peak / np.maximum(np.abs(H[near]), 1e-300), axis=1, initial=0.0)


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
