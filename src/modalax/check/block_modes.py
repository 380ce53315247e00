"""Modes of a part of a measurement: a run, a column or a row."""

import numpy as np

from modalax.check.basis import ALL_POWERS, Basis
from modalax.check.modes import Modes, Noise, improve, misfit_of, noise_of
from modalax.check.study import Study

STEPS = 6
# A mode is seen in a part if a residue exceeds its standard deviation by this factor.
CLEAR = 8.0
# Two modes may be one that moved if their half-power bandwidths differ by less than this factor and the modal assurance
# criterion of their shapes exceeds this.
ONE_WIDTH, ONE_SHAPE = 1.5, 0.9
# A mode that moves by more than this share of its frequency is another one.
FARTHEST = 0.05
# A mode makes at least this share of the response at its frequency in some channel.
LEADS = 0.6


def _block(study: Study, block) -> tuple[np.ndarray, np.ndarray]:
    """FRFs and noise of a block, ``(f, k)``."""
    run, o, i = block
    lines = len(study.freq)
    return tuple(a[run][:, o].reshape(lines, -1) if isinstance(i, slice) else a[run][:, :, i]
                 for a in (study.H, study.sigma))  # fmt: skip


def weighted(study: Study, block) -> tuple[Basis, np.ndarray, np.ndarray, Noise]:
    """The basis of a block at the lines that tell poles, its FRFs over their noise, the FRFs, and the noise."""
    H, sigma = (a[study.telling] for a in _block(study, block))
    noise = noise_of(H, sigma)
    basis = Basis(2 * np.pi * study.freq[study.telling], study.power, noise.weight, ALL_POWERS)
    return basis, noise.weight[:, None] * H / noise.level, H, noise


def converged(basis: Basis, poles: np.ndarray, X: np.ndarray) -> tuple[np.ndarray, float]:
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


def clear(found: Modes) -> np.ndarray:
    """Largest residue of each mode in its standard deviations."""
    return np.max(np.abs(found.residues) / np.maximum(found.std, 1e-300), axis=1, initial=0.0)


def leading(found: Modes, freq: np.ndarray, H: np.ndarray, power: int) -> np.ndarray:
    """Largest share of each mode in what a channel does at its frequency: a mode on the flank of another has little."""
    near = np.abs(freq[:, None] - found.frequency).argmin(axis=0)
    peak = np.abs(found.residues) / -found.poles.real[:, None] * (np.abs(found.poles) ** power)[:, None]
    return np.max(peak / np.maximum(np.abs(H[near]), 1e-300), axis=1, initial=0.0)


def one_that_moved(study: Study, a: int, b: int, over: int = 0) -> bool:
    """Whether two close modes may be one at different frequencies: of one damping, and of one shape.

    The shape is that over the outputs (``over`` 0) or the inputs (1), where the modes are strongest.
    """
    wide = study.modes.width[[a, b]]
    residues = study.residues if over == 0 else study.residues.transpose(0, 2, 1)
    shapes = [residues[r][:, np.argmax(np.linalg.norm(residues[r], axis=0))] for r in (a, b)]
    alike = (
        np.abs(np.vdot(*shapes)) ** 2
        / np.maximum(np.vdot(shapes[0], shapes[0]) * np.vdot(shapes[1], shapes[1]), 1e-300).real
    )
    return bool(wide.max() < ONE_WIDTH * wide.min() and alike > ONE_SHAPE)
