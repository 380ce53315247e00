r"""Two modes of one frequency, as of a ring, a square plate or a tower of equal sides: what is known of both together.

Of which two shapes they are nothing is known, as little as of how far apart they are; any small error turns them. What
moves smoothly with the structure are the moments of their residues about a pole :math:`\mu` between them,

.. math:: M_0 = A_1 + A_2, \qquad M_1 = (\lambda_1 - \mu) A_1 + (\lambda_2 - \mu) A_2,

by which the FRF about them is :math:`M_0/(s-\mu) + M_1/(s-\mu)^2 + \dots` With singular vectors ``U`` of outputs and
``V`` of inputs of the measured :math:`M_0`, of rank two, :math:`U^H M_1 V` and what a matrix of rank two can move of
:math:`M_0` are as many numbers as two shapes, two participations and two poles have.

Where inputs are such that one measured mode stands for two of the simulation, it is :math:`M_0` of rank one and a pole
that is the mean of both, :math:`\mu + t^H M_1/t^H M_0` along the measured residues ``t``.
"""

from dataclasses import dataclass

import numpy as np

from modalax.diagnose.modal_domain.free_residues import Channels, Projected, project

# Distance over which a pole is taken apart, in half-bandwidths: its square is what two modes so close differ from one.
APART = 1e-3
CLOSE = 1.0  # half-bandwidths within which one measured mode may stand for two of the simulation,
SPLIT = 0.005  # or distance relative to their frequency: errors of elements of a per cent split repeated modes so far
CANCELLED = 0.2  # of residues along the measured ones, that two modes may leave of their sum


@dataclass(frozen=True)
class Pair:
    """Two measured modes of one frequency.

    Attributes
    ----------
    rows
        Their numbers.
    pole
        Between them [rad/s].
    left, right
        All singular vectors of outputs and inputs of the sum of their residues, shapes ``(o, o)`` and ``(i, i)``.
    sizes
        The two singular values.
    """

    rows: tuple[int, int]
    pole: complex
    left: np.ndarray
    right: np.ndarray
    sizes: np.ndarray

    def alike(self, residues: np.ndarray) -> np.ndarray:
        """Part of the energy of residues, shape ``(m, o, i)``, that is in the space of the two, shape ``(m,)``."""
        inside = self.left[:, :2].conj().T @ residues @ self.right[:, :2]
        energy = lambda a: (np.abs(a) ** 2).sum(axis=(1, 2))
        return energy(inside) / np.maximum(energy(residues), 1e-300)

    @property
    def shown(self) -> np.ndarray:
        """The sum of the residues as two of rank one, shape ``(2, o, i)``."""
        return np.einsum("k,ok,ik->koi", self.sizes, self.left[:, :2], self.right[:, :2].conj())

    def values(self, poles: np.ndarray, residues: np.ndarray) -> np.ndarray:
        """Features of modes in their place, shape ``(..., 2, width)``, of ``(..., k)`` and ``(..., k, o, i)``."""
        off = (poles - self.pole)[..., None, None]
        return self._features(residues.sum(axis=-3), (off * residues).sum(axis=-3))

    def slopes(
        self, poles: np.ndarray, residues: np.ndarray, dpoles: np.ndarray, dresidues: np.ndarray,
        turned: np.ndarray | float = 0.0,
    ) -> np.ndarray:  # fmt: skip
        """Derivatives of these, shape ``(2, width, p)``, by changes ``(k, p)`` and ``(k, p, o, i)``.

        ``turned`` is what two modes of one pole move of the first moment by turning into each other, ``(p, o, i)``.
        """
        off = (poles - self.pole)[:, None, None, None]
        first = off * dresidues + dpoles[:, :, None, None] * residues[:, None]
        return np.moveaxis(self._features(dresidues.sum(axis=0), first.sum(axis=0) + turned), 0, -1)

    def _features(self, whole: np.ndarray, first: np.ndarray) -> np.ndarray:
        """Real features, which are linear in both moments, in the order of those of one mode."""
        root = np.sqrt(self.sizes[:, None] * self.sizes)
        turned = self.left.conj().T @ whole @ self.right
        moved = self.left[:, :2].conj().T @ first @ self.right[:, :2] / root
        inner = turned[..., :2, :2] / root
        rows = []
        for j in (0, 1):
            frequency = (moved[..., j, j] / self.pole).real
            damping = moved[..., j, j].real / self.pole.real - frequency
            others = np.concatenate([
                moved[..., j, 1 - j, None] / self.pole.real, inner[..., j, 1 - j, None],
                turned[..., 2:, j] / self.sizes[j], turned[..., j, 2:] / self.sizes[j],
            ], axis=-1)  # fmt: skip
            leading = np.stack([frequency, damping, inner[..., j, j].real, inner[..., j, j].imag], axis=-1)
            rows.append(np.concatenate([leading, others.real, others.imag], axis=-1))
        return np.stack(rows, axis=-2)


def pair_of(rows: tuple[int, int], pole: complex, residues: np.ndarray) -> Pair:
    """Two modes about a pole, with the sum of their residues, shape ``(o, i)``, both at least 2."""
    left, sizes, right = np.linalg.svd(residues)
    return Pair(rows, complex(pole), left, right.conj().T, sizes[:2])


def twofold(modes: Projected, channels: Channels, which: np.ndarray) -> tuple[Projected, tuple[tuple[int, int], ...]]:
    """Modes with two poles in the place of ``which``, hardly apart, and the numbers of these.

    Their residues tell both moments of what is there, channel by channel, with their covariance.
    """
    if not which.any():
        return modes, ()
    poles = np.repeat(modes.poles, 1 + which)
    first = np.flatnonzero(which) + np.arange(np.count_nonzero(which))
    half = APART * modes.poles.real[which]
    poles[first], poles[first + 1] = poles[first] + 1j * half, poles[first] - 1j * half
    return project(poles, channels)[0], tuple((int(k), int(k) + 1) for k in first)


@dataclass(frozen=True)
class Beside:
    """Predicted modes that measured ones stand for as well, one of each further mode.

    Attributes
    ----------
    rows, numbers
        Of the measured modes, and of the predicted ones beside those that belong to them.
    """

    rows: np.ndarray
    numbers: np.ndarray

    def merged(
        self, along: np.ndarray, poles: np.ndarray, residues: np.ndarray, pairs: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Poles and residues in the place of the measured ones; arguments as those of :func:`beside`."""
        if not len(self.rows):
            return poles[pairs], residues[pairs]
        which, mean, whole = np.concatenate([pairs, self.numbers]), poles[pairs], residues[pairs]
        np.add.at(whole, self.rows, residues[self.numbers])
        for k, own in self._together(len(pairs)):
            mean[k] = mean_of(along[k], poles[which[own]], residues[which[own]])
        return mean, whole

    def merged_slopes(
        self, along: np.ndarray, poles: np.ndarray, residues: np.ndarray, dpoles: np.ndarray, dresidues: np.ndarray,
        turned: dict[int, np.ndarray] | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """Derivatives of these ``(k, p)`` and ``(k, p, o, i)``.

        All arguments are of the modes that belong to measured ones, then of those beside them, but ``turned``: by the
        numbers of measured modes, what modes of one pole move of the first moment by turning into each other.
        """
        if not len(self.rows):
            return dpoles, dresidues
        count = len(poles) - len(self.rows)
        mean, whole = dpoles[:count].copy(), dresidues[:count].copy()
        np.add.at(whole, self.rows, dresidues[count:])
        for k, own in self._together(count):
            weight = _weights(along[k], residues[own])
            off = poles[own] - mean_of(along[k], poles[own], residues[own])
            moved = np.einsum("oi,mpoi->mp", along[k], dresidues[own])
            mean[k] = (weight[:, None] * dpoles[own] + off[:, None] * moved).sum(axis=0) / weight.sum()
            if turned and k in turned:
                mean[k] += _weights(along[k], turned[k]) / weight.sum()
        return mean, whole

    def _together(self, count: int) -> list[tuple[int, np.ndarray]]:
        """Each measured mode that stands for several, and the places of these in the list of all."""
        rows = np.concatenate([np.arange(count), self.rows])
        return [(int(k), np.flatnonzero(rows == k)) for k in np.unique(self.rows)]


@dataclass(frozen=True)
class Origin:
    """What features were made from.

    Attributes
    ----------
    first
        Number of the pole of each mode, among those after some were taken apart.
    beside
        Numbers of further poles that are part of a mode.
    twice
        Which of the identified poles were taken apart, as by :func:`twofold`.
    """

    first: np.ndarray
    beside: Beside
    twice: np.ndarray

    def made_of(self, pole: int) -> tuple[int, list[int]]:
        """The mode that a pole is part of, and the numbers of all poles of that."""
        further = np.flatnonzero(self.beside.numbers == pole)
        k = int(self.beside.rows[further[0]]) if len(further) else int(np.flatnonzero(self.first == pole)[0])
        return k, [int(self.first[k]), *(int(m) for m in self.beside.numbers[self.beside.rows == k])]


def mean_of(along: np.ndarray, poles: np.ndarray, residues: np.ndarray) -> complex:
    """The pole of several modes that show as one, by their parts along its residues."""
    weight = _weights(along, residues)
    return complex((weight * poles).sum() / weight.sum())


def _weights(along: np.ndarray, residues: np.ndarray) -> np.ndarray:
    return np.einsum("oi,moi->m", along, residues)


def reach(poles: np.ndarray) -> np.ndarray:
    """Distance within which another pole is about one frequency with each."""
    return np.maximum(CLOSE * np.abs(poles.real), SPLIT * np.abs(poles))


def close_pairs(poles: np.ndarray) -> tuple[tuple[int, int], ...]:
    """Poles about one frequency, two by two, the closest first."""
    near, found = reach(poles), []
    apart = np.abs(poles[:, None] - poles) / np.minimum(near[:, None], near)
    for a, b in zip(*(k[np.argsort(apart[np.triu_indices(len(poles), 1)])] for k in np.triu_indices(len(poles), 1)),
                    strict=True):  # fmt: skip
        if apart[a, b] < 1 and not any(k in two for two in found for k in (a, b)):
            found.append((int(a), int(b)))
    return tuple(found)


def beside(along: np.ndarray, alone: np.ndarray, poles: np.ndarray, residues: np.ndarray, pairs: np.ndarray) -> Beside:
    """Further modes so close to one that belongs to a measured mode that this stands for both.

    Parameters
    ----------
    along
        What residues are multiplied by and summed over for their part along those of each measured mode, shape
        ``(k, o, i)``.
    alone
        Whether each measured mode is one of its frequency.
    poles, residues
        Of all predicted modes, shapes ``(m,)`` and ``(m, o, i)``.
    pairs
        The predicted mode that belongs to each measured one, shape ``(k,)``.
    """
    further = np.delete(np.arange(len(poles)), pairs)
    own = poles[pairs]
    near = np.where(alone, reach(own), -1.0)
    apart = np.abs(poles[further, None] - own) - near
    rows, numbers = [], []
    for j, k in zip(*np.nonzero(apart < 0), strict=True):
        weight = _weights(along[k], residues[[pairs[k], further[j]]])
        if k == apart[j].argmin() and abs(weight.sum()) > CANCELLED * np.abs(weight).sum():
            rows.append(int(k))
            numbers.append(int(further[j]))
    return Beside(np.array(rows, int), np.array(numbers, int))
