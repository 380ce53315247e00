"""The modes of a measurement in its band, from the FRFs alone: added and dropped until the evidence settles."""

from dataclasses import replace

import numpy as np
import scipy.stats

from modalax.diagnose.modal_domain.modes.free_residues import Channels, Projected, project, refine
from modalax.diagnose.modal_domain.modes.relocation import relocated

CHANCE = 1e-8  # chance of a mode that is only noise
DAMPINGS = (0.002, 0.007, 0.025)  # damping ratios that further modes are looked for at: light to welded structures
HEAVY = 0.2  # damping ratio above which a pole is background and no mode
HEAVIEST = 0.9  # damping ratio above which a pole is no background either, but a residual term
SHARP = 0.03  # least half-bandwidth of a mode, relative to the distance of lines
CANDIDATES = 1500  # frequencies that further modes are looked for at
REACH, FINE = 40.0, 0.25  # half-bandwidths about such a mode that are looked at, and within which lines come together
TOGETHER = 64  # such modes looked at at once
FURTHER = 12  # most modes added in one round
COARSE = 6  # steps of a refinement while modes are still added and dropped
ROUNDS = 16  # most rounds of adding and dropping
AT_ONCE = 0.1  # share of the best candidate's gain from which others are added in the same round
BEYOND, NEARBY = 0.2, 10  # part of the band's ends by which a mode may lie outside, and places there that are tried
MOST = 80  # modes in one band
LINES = 4  # fewest lines per mode


def blind_modes(channels: Channels, start: np.ndarray | None = None, at_most: int = MOST) -> Projected:
    """Modes in the band, by rising frequency.

    Parameters
    ----------
    start
        Poles to begin with, shape ``(n,)`` [rad/s]; none where everything is to be found from the residual.
    at_most
        How many modes there may be.
    """
    found = refine(np.zeros(0, complex) if start is None else start, channels)
    for _ in range(ROUNDS):
        found = _pruned(found, channels)
        most = min(at_most, len(channels.s) // LINES)
        new = further_poles(found, channels)[: max(most - len(found.poles), 0)]
        better = _with(found, new, channels)
        if better is None:
            break
        found = better
    found = settled(refine(found.poles, channels), channels)
    order = np.argsort(np.abs(found.poles))
    return project(found.poles[order], channels)[0]


def _with(found: Projected, new: np.ndarray, channels: Channels) -> Projected | None:
    """Poles with some more, moved to where all of them are needed; None where they are worth nothing."""
    both = np.concatenate([found.poles, new])
    for move in (_relocated, _refined) if len(new) else ():
        trial = _pruned(move(both, channels), channels)
        if trial.chi2 < found.chi2 - cost_of_mode(channels):
            return trial
    return None


def _relocated(poles: np.ndarray, channels: Channels) -> Projected:
    moved = relocated(poles, channels)
    return project(moved[_possible(moved, channels)], channels)[0]


def _refined(poles: np.ndarray, channels: Channels) -> Projected:
    return refine(poles, channels, COARSE)


def _pruned(found: Projected, channels: Channels) -> Projected:
    """Without the poles that are worth nothing, the others as they are."""
    while not (kept := _worth_keeping(found, channels)).all():
        found = project(found.poles[kept], channels)[0]
    return found


def settled(found: Projected, channels: Channels) -> Projected:
    """Poles that are all worth keeping."""
    for _ in range(ROUNDS):
        kept = _worth_keeping(found, channels)
        if kept.all():
            break
        found = refine(found.poles[kept], channels)
    return found


def cost_of_mode(channels: Channels) -> float:
    """Chi-square that a further mode gains under noise alone with a chance of ``CHANCE``."""
    return float(scipy.stats.chi2.isf(CHANCE, 2 + 2 * channels.data.shape[1]))


def misfit(found: Projected, channels: Channels) -> float:
    """Chi-square per sample that the modes leave; at least 1."""
    return max(1.0, left_by(found, channels))


def left_by(found: Projected, channels: Channels) -> float:
    """Chi-square per sample that the modes leave, less than 1 where the noise is overstated."""
    unknowns = found.linear.shape[0] * found.linear.shape[1] + 2 * len(found.poles)
    return found.chi2 / max(channels.samples - unknowns, 1)


def mode_gains(found: Projected) -> np.ndarray:
    """Chi-square that each mode explains with all others kept, shape ``(n,)``."""
    out = np.zeros(len(found.poles))
    for k in range(len(found.poles)):
        block = found.linear[:, 2 * k : 2 * k + 2, 2 * k : 2 * k + 2]
        a = np.stack([found.residues[k].real, found.residues[k].imag], axis=1)
        out[k] = np.einsum("ci,cij,cj->", a, np.linalg.inv(block + 1e-300 * np.eye(2)), a)
    return out


def heavy(poles: np.ndarray) -> np.ndarray:
    """Whether each pole is background: damped so heavily that it is no mode to compare."""
    return -poles.real > HEAVY * np.abs(poles)


def _possible(poles: np.ndarray, channels: Channels) -> np.ndarray:
    """Whether each pole is inside the band, wider than what falls between lines, and oscillates."""
    size, (low, high) = np.abs(poles), np.abs(channels.s[[0, -1]])
    inside = (size > low * (1 - BEYOND)) & (size < high * (1 + BEYOND)) & (-poles.real < HEAVIEST * size)
    return inside & (-poles.real > SHARP * spacing_at(np.abs(channels.s), size))


def spacing_at(lines: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Distance of the lines about each frequency: peaks may have been measured more finely than the rest."""
    apart = np.diff(lines)
    return apart[np.clip(np.searchsorted(lines, w) - 1, 0, len(apart) - 1)]


def _worth_keeping(found: Projected, channels: Channels) -> np.ndarray:
    if not len(found.poles):
        return np.zeros(0, bool)
    inside = _possible(found.poles, channels)
    if not inside.all():
        return inside
    gains = np.minimum(mode_gains(found), beside_one_line(found, channels))
    enough = gains > cost_of_mode(channels) * misfit(found, channels)
    if enough.all():
        return enough
    kept = np.ones(len(found.poles), bool)
    kept[int(np.argmin(gains))] = False
    return kept


def beside_one_line(found: Projected, channels: Channels) -> np.ndarray:
    """Weighted energy that each mode has beside the line at which it has most, shape ``(n,)``.

    What is seen at one line only is noise that all sensors share, or a disturbance, as soon as it is a mode.
    """
    p, q = np.moveaxis(channels.kernels(found.poles).reshape(len(channels.s), -1, 2), 2, 0)
    a, b = found.residues.real.T, found.residues.imag.T  # of |a p + b q|^2, summed over channels
    energy = np.abs(p) ** 2 * (channels.weight @ a**2) + np.abs(q) ** 2 * (channels.weight @ b**2)
    energy += 2 * (p.conj() * q).real * (channels.weight @ (a * b))
    return energy.sum(axis=0) - energy.max(axis=0, initial=0.0)


def further_poles(found: Projected, channels: Channels) -> np.ndarray:
    """Poles that the residual asks for, the likeliest first."""
    rest = channels.weight * (channels.data - found.made(channels))
    grid = _grid(np.abs(channels.s))
    spacing = spacing_at(np.abs(channels.s), grid)
    best, where = np.zeros(len(grid)), np.zeros(len(grid), complex)
    for zeta in DAMPINGS:
        poles = -np.maximum(zeta * grid, 0.5 * spacing) + 1j * grid
        gain = _scanned(poles, rest, channels)
        better = gain > best
        best[better], where[better] = gain[better], poles[better]
    least = cost_of_mode(channels) * misfit(found, channels)
    padded = np.concatenate([[0.0], best, [0.0]])
    peak = (padded[1:-1] >= padded[:-2]) & (padded[1:-1] > padded[2:]) & (best > max(least, AT_ONCE * best.max()))
    chosen: list[complex] = []
    for k in np.argsort(-best):
        apart = all(abs(where[k] - x) > 3 * max(abs(x.real), spacing[k]) for x in chosen)
        if peak[k] and apart:
            chosen.append(complex(where[k]))
    return np.array(chosen[:FURTHER], complex)


def _grid(lines: np.ndarray) -> np.ndarray:
    """Frequencies at which further modes are looked for: lines, and some on either side of the band."""
    beyond = BEYOND * np.linspace(0, 1, NEARBY + 1)[1:]
    low, high = lines[0] * (1 - beyond[::-1]), lines[-1] * (1 + beyond)
    return np.concatenate([low[low > 0], lines[:: max(1, len(lines) // CANDIDATES)], high])


def _scanned(poles: np.ndarray, rest: np.ndarray, channels: Channels) -> np.ndarray:
    """Chi-square that each of some poles of rising frequency gains.

    A pole is looked at within ``REACH`` half-bandwidths about it, on lines brought together to ``FINE`` of one.
    """
    w, half, gain = np.abs(channels.s), -poles.real, np.zeros(len(poles))
    plain = replace(channels, outside=np.zeros(0, complex))
    for part in np.array_split(np.arange(len(poles)), -(-len(poles) // TOGETHER)):
        first = int(np.searchsorted(w, poles[part[0]].imag - REACH * half[part[0]]))
        last = int(np.searchsorted(w, poles[part[-1]].imag + REACH * half[part[-1]], "right"))
        inside = slice(first, last)
        if last - first < LINES:
            continue
        apart = np.diff(w[inside])
        stride = max(1, int(FINE * half[part[0]] / apart.max())) if len(apart) else 1
        edges = np.arange(0, last - first, stride)
        r, weight = (np.add.reduceat(a[inside], edges) for a in (rest, channels.weight))
        s = np.add.reduceat(channels.s[inside], edges) / np.diff(np.append(edges, last - first))
        gain[part] = _gains(replace(plain, s=s).kernels(poles[part]), r, weight)
    return gain


def _gains(columns: np.ndarray, rest: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Chi-square that each pair of columns takes off a weighted residual, shape ``(pair,)``."""
    g = (columns.real.T @ rest.real + columns.imag.T @ rest.imag).reshape(columns.shape[1] // 2, 2, -1)
    own = ((np.abs(columns) ** 2).T @ weight).reshape(g.shape)
    across = (columns[:, ::2].conj() * columns[:, 1::2]).real.T @ weight
    det = np.maximum(own[:, 0] * own[:, 1] - across**2, 1e-3 * own[:, 0] * own[:, 1])
    top = g[:, 0] ** 2 * own[:, 1] - 2 * g[:, 0] * g[:, 1] * across + g[:, 1] ** 2 * own[:, 0]
    return (top / np.maximum(det, 1e-300)).sum(axis=1)
