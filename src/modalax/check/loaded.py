r"""Natural frequencies of single outputs, where the mass of a sensor moves those of the row that it measured.

A sensor that is moved from place to place, or stands at one of them only, makes each row that of another structure.
Modes common to all rows then stand several to a mode, of one damping and of one shape over the inputs, and parted
among the rows: where one of them responds, the others do not. Modes of a sound structure respond nearly everywhere,
:math:`\sum_o |A_{ao}||A_{bo}|` about :math:`2/\pi` of the most that it can be. A row needs one of each such family.
"""

from itertools import combinations

import numpy as np

from modalax.check.basis import ALL_POWERS, Basis
from modalax.check.block_modes import CLEAR, FARTHEST, LEADS, clear, converged, leading, one_that_moved, weighted
from modalax.check.modes import residues_at, select, worth
from modalax.check.study import Study

# Modes are parted among rows if their sizes over these correlate by less than this; 2/pi is usual.
PARTED = 0.4
# What loads a structure moves more modes than one.
FEWEST = 2
# Rounds in which poles are dropped and the others moved.
ROUNDS = 3


def rows_apart(study: Study, rows: list[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Poles of families of modes, and each row's frequencies of them and their deviations [Hz], ``(row, n)``.

    None unless some modes are parted among the rows and each row is explained by one mode of a family. A deviation is
    inf where a row does not show the mode.
    """
    size = np.linalg.norm(study.residues[:, rows], axis=2)
    pairs = _pairs(study, rows, size)
    # Where each row has a frequency of its own, modes common to all are mixtures: not every two of them are parted.
    for every in (False, True):
        families = _families(len(size), pairs, every)
        if sum(len(family) > 1 for family in families) < FEWEST:
            return None
        found = [_row(study, families, size[:, k], o) for k, o in enumerate(rows)]
        known = [one for one in found if one is not None]
        if len(known) == len(rows):
            f, s = np.moveaxis(np.array(known), 1, 0)
            return study.modes.poles[[family[np.argmax(size[family].max(axis=1))] for family in families]], f, s
    return None


def _pairs(study: Study, rows: list[int], size: np.ndarray) -> list[tuple[int, int]]:
    """Modes that may be one and the same and are parted among the rows, the nearest first."""
    poles = study.modes.poles
    seen = np.max(np.abs(study.residues[:, rows]) / study.residue_std[:, rows], axis=(1, 2)) > CLEAR
    gap = np.abs(poles[:, None] - poles)
    common = size @ size.T / np.maximum(np.linalg.norm(size, axis=1)[:, None] * np.linalg.norm(size, axis=1), 1e-300)
    near = (gap < FARTHEST * np.abs(poles)) & (common < PARTED)
    modes = np.flatnonzero(study.modes.inside & seen).tolist()
    pairs = [(a, b) for a, b in combinations(modes, 2) if near[a, b] and one_that_moved(study, a, b, over=1)]
    return sorted(pairs, key=lambda pair: gap[pair])


def _families(count: int, pairs: list[tuple[int, int]], every: bool) -> list[np.ndarray]:
    """Modes linked by pairs, or such that ``every`` two of them are a pair."""
    family = np.arange(count)
    for a, b in pairs:
        first, second = (np.flatnonzero(family == family[k]) for k in (a, b))
        if not every or all((min(p, q), max(p, q)) in pairs for p in first.tolist() for q in second.tolist()):
            family[second] = family[a]
    return [np.flatnonzero(family == k) for k in np.unique(family)]


def _row(study: Study, families: list[np.ndarray], size: np.ndarray, o: int) -> np.ndarray | None:
    """Frequencies of a row and their deviations [Hz], ``(2, n)``; None if it needs more than one mode of a family."""
    basis, X, H, noise = weighted(study, (0, o, slice(None)))
    start = study.modes.poles[[family[np.argmax(size[family])] for family in families]]
    unknown = np.stack([np.abs(start) / (2 * np.pi), np.full(len(start), np.inf)])
    if not np.any(H):
        return unknown
    _, _, least = _needed(basis, study.modes.poles, X)
    own, which, left = _needed(basis, start, X)
    more = len(study.modes.poles) - len(start)
    if 2 * X.size * (left**2 - least**2) > more * worth(X.shape[1]) * max(least, 1.0) ** 2:
        return None
    found = residues_at(basis.s.imag, H, noise, own, study.power, ALL_POWERS)
    lost = (clear(found) < CLEAR) | (leading(found, basis.s.imag / (2 * np.pi), H, study.power) < LEADS)
    lost |= np.abs(own - start[which]) > FARTHEST * np.abs(start[which])
    unknown[:, which] = np.stack([np.abs(own), np.where(lost, np.inf, found.pole_std)]) / (2 * np.pi)
    return unknown


def _needed(basis: Basis, poles: np.ndarray, X: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Those of the poles that some FRFs need, moved to where they have them; which they are; and what they leave."""
    which, moved, left = np.arange(len(poles)), poles, np.inf
    for _ in range(ROUNDS):
        kept = np.isin(moved, select(basis, moved, X))
        which, start = which[kept], moved[kept]
        moved, left = converged(basis, start, X)
        if len(moved) < len(start):
            return start, which, left
    return moved, which, left
