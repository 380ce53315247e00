r"""Modes of one frequency, as of a ring, a square plate or a tower of equal sides: what is known of them together.

Of which shapes they are nothing is known, as little as of how far apart they are; any small error turns them. What
moves smoothly with the structure (Kato 1966, chapter II, section 2: the projection on the space of all of them) are the
moments of their residues about a pole :math:`\mu` between them,

.. math:: M_0 = \sum_k A_k, \qquad M_1 = \sum_k (\lambda_k - \mu) A_k,

by which the FRF about them is :math:`M_0/(s-\mu) + M_1/(s-\mu)^2 + \dots` With singular vectors ``U`` of outputs and
``V`` of inputs of the measured :math:`M_0`, of rank ``r``, :math:`U^H M_1 V` and what a matrix of rank ``r`` can move
of :math:`M_0` are as many numbers as ``r`` modes have. The simulation may have more: those that the inputs cannot tell
apart. Where they show as one mode, ``M_0`` is of rank one and the pole is the mean of all,
:math:`\mu + t^H M_1/t^H M_0` along the measured residues ``t``.
"""

from dataclasses import dataclass

import numpy as np

from modalax.diagnose.modal_domain.modes.free_residues import Channels, Projected, project

# Distance over which a pole is taken apart, in half-bandwidths: its square is what two modes so close differ from one.
APART = 1e-3
CLOSE = 1.0  # half-bandwidths within which one measured mode may stand for two of the simulation,
SPLIT = 0.005  # or distance relative to their frequency: errors of elements of a per cent split repeated modes so far
WIDE = 0.02  # relative distance within which errors of elements of some per cent turn modes into each other
TURNS, NOTHING = 10, 1e-12  # fits of shapes and of participations in turn; weight, relative to all, that is rounding
CANCELLED = 0.2  # of residues along the measured ones, that two modes may leave of their sum


@dataclass(frozen=True)
class Group:
    """Two or more measured modes of one frequency.

    Attributes
    ----------
    rows
        Their numbers.
    pole
        Between them [rad/s].
    left, right
        All singular vectors of outputs and inputs of the sum of their residues, shapes ``(o, o)`` and ``(i, i)``.
    sizes
        As many singular values as modes.
    """

    rows: tuple[int, ...]
    pole: complex
    left: np.ndarray
    right: np.ndarray
    sizes: np.ndarray

    def alike(self, residues: np.ndarray) -> np.ndarray:
        """Part of the energy of residues, shape ``(m, o, i)``, that is in the space of these modes, shape ``(m,)``."""
        few = len(self.rows)
        inside = self.left[:, :few].conj().T @ residues @ self.right[:, :few]
        energy = lambda a: (np.abs(a) ** 2).sum(axis=(1, 2))
        return energy(inside) / np.maximum(energy(residues), 1e-300)

    @property
    def shown(self) -> np.ndarray:
        """The sum of the residues as some of rank one, shape ``(r, o, i)``."""
        few = len(self.rows)
        return np.einsum("k,ok,ik->koi", self.sizes, self.left[:, :few], self.right[:, :few].conj())

    def features(self, whole: np.ndarray, first: np.ndarray) -> np.ndarray:
        """Real features of moments ``(..., o, i)``, linear in both, in the order of one mode's, ``(..., r, width)``."""
        few = len(self.rows)
        root = np.sqrt(self.sizes[:, None] * self.sizes)
        turned = self.left.conj().T @ whole @ self.right
        moved = self.left[:, :few].conj().T @ first @ self.right[:, :few] / root
        inner = turned[..., :few, :few] / root
        rows = []
        for j in range(few):
            other = [k for k in range(few) if k != j]
            frequency = (moved[..., j, j] / self.pole).real
            damping = moved[..., j, j].real / self.pole.real - frequency
            others = np.concatenate([
                moved[..., j, other] / self.pole.real, inner[..., j, other],
                turned[..., few:, j] / self.sizes[j], turned[..., j, few:] / self.sizes[j],
            ], axis=-1)  # fmt: skip
            leading = np.stack([frequency, damping, inner[..., j, j].real, inner[..., j, j].imag], axis=-1)
            rows.append(np.concatenate([leading, others.real, others.imag], axis=-1))
        return np.stack(rows, axis=-2)


def group_of(rows: tuple[int, ...], pole: complex, residues: np.ndarray) -> Group:
    """Modes about a pole, with the sum of their residues, shape ``(o, i)``, both at least as many."""
    left, sizes, right = np.linalg.svd(residues)
    return Group(rows, complex(pole), left, right.conj().T, sizes[: len(rows)])


@dataclass(frozen=True)
class Together:
    """Modes in the place of the measured ones.

    Attributes
    ----------
    pairs
        The mode that belongs to each measured one.
    rows, numbers
        Of measured modes, and of further ones that these stand for as well.
    groups
        Measured modes of one frequency.
    """

    pairs: np.ndarray
    rows: np.ndarray
    numbers: np.ndarray
    groups: tuple[Group, ...] = ()

    @property
    def every(self) -> np.ndarray:
        """Numbers of the modes that belong to measured ones, then of the further ones."""
        return np.concatenate([self.pairs, self.numbers])

    @property
    def row(self) -> np.ndarray:
        """The measured mode that each of these is part of; the first of a group."""
        first = np.arange(len(self.pairs))
        for group in self.groups:
            first[list(group.rows)] = group.rows[0]
        return np.concatenate([first, first[self.rows]])

    def seen(self, along: np.ndarray, poles: np.ndarray, residues: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Poles and residues in the place of the measured ones; of a group both moments in its first two places.

        Parameters
        ----------
        along
            What residues are multiplied by and summed over for their part along those of each measured mode, shape
            ``(k, o, i)``.
        poles, residues
            Of all modes.
        """
        mean = poles[self.pairs]
        for k, group, own in self._sums():
            if group is None:
                mean[k] = mean_of(along[k], poles[self.every[own]], residues[self.every[own]])
            else:
                mean[list(group.rows)] = group.pole
        return mean, self.whole(poles, residues)

    def whole(self, poles: np.ndarray, residues: np.ndarray) -> np.ndarray:
        """Residues in the place of the measured ones, at whatever channels."""
        out = residues[self.pairs]
        for k, group, own in self._sums():
            here, A = poles[self.every[own]], residues[self.every[own]]
            out[k] = A.sum(axis=0)
            if group is not None:
                out[group.rows[1]] = ((here - group.pole)[:, None, None] * A).sum(axis=0)
        return out

    def moved(
        self, along: np.ndarray, poles: np.ndarray, residues: np.ndarray, dpoles: np.ndarray, dresidues: np.ndarray,
        turned: dict[int, np.ndarray] | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """Derivatives of what is seen, ``(k, p)`` and ``(k, p, o, i)``.

        Parameters
        ----------
        poles, residues
            Of all modes.
        dpoles, dresidues
            Changes of the modes :attr:`every`, shapes ``(m, p)`` and ``(m, p, o, i)``.
        turned
            By the numbers of measured modes, what modes of one pole move of the first moment by turning into each
            other, shape ``(p, o, i)``.
        """
        count, turned = len(self.pairs), turned or {}
        if not len(self.numbers) and not self.groups:
            return dpoles, dresidues
        mean, whole = dpoles[:count].copy(), dresidues[:count].copy()
        for k, group, own in self._sums():
            here, A, dA = poles[self.every[own]], residues[self.every[own]], dresidues[own]
            whole[k], more = dA.sum(axis=0), turned.get(k)
            if group is not None:
                off = here - group.pole
                first = np.einsum("m,mpoi->poi", off, dA) + np.einsum("mp,moi->poi", dpoles[own], A)
                whole[group.rows[1]] = first if more is None else first + more
                continue
            weight, off = _weights(along[k], A), here - mean_of(along[k], here, A)
            moved = (off[:, None] * np.einsum("oi,mpoi->mp", along[k], dA) + weight[:, None] * dpoles[own]).sum(axis=0)
            moved = moved if more is None else moved + np.einsum("oi,poi->p", along[k], more)
            mean[k] = moved / weight.sum()
        return mean, whole

    def _sums(self) -> list[tuple[int, Group | None, np.ndarray]]:
        """Measured modes that several are part of, the group that they begin, and places of these in :attr:`every`."""
        groups, row = {group.rows[0]: group for group in self.groups}, self.row
        several = sorted({*groups, *row[len(self.pairs) :].tolist()})
        return [(k, groups.get(k), np.flatnonzero(row == k)) for k in several]


@dataclass(frozen=True)
class Origin:
    """What features were made from: poles that were identified, and which of them :func:`twofold` took apart."""

    together: Together
    twice: np.ndarray


def mean_of(along: np.ndarray, poles: np.ndarray, residues: np.ndarray) -> complex:
    """The pole of several modes that show as one, by their parts along its residues."""
    weight = _weights(along, residues)
    return complex((weight * poles).sum() / weight.sum())


def _weights(along: np.ndarray, residues: np.ndarray) -> np.ndarray:
    return np.einsum("oi,moi->m", along, residues)


def reach(poles: np.ndarray) -> np.ndarray:
    """Distance within which another pole is about one frequency with each."""
    return np.maximum(CLOSE * np.abs(poles.real), SPLIT * np.abs(poles))


def close_pairs(poles: np.ndarray) -> list[tuple[int, ...]]:
    """Poles of modes that errors of elements may turn into each other, two by two, the closest first."""
    near, found = np.maximum(reach(poles), WIDE * np.abs(poles)), []
    apart = np.abs(poles[:, None] - poles) / np.minimum(near[:, None], near)
    a, b = np.triu_indices(len(poles), 1)
    for k in np.argsort(apart[a, b]):
        two = int(a[k]), int(b[k])
        if apart[two] < 1 and not any(m in other for other in found for m in two):
            found.append(two)
    return found


def further(
    groups: tuple[Group, ...], along: np.ndarray, poles: np.ndarray, residues: np.ndarray, pairs: np.ndarray
) -> Together:
    """Modes in the place of the measured ones, and further ones so close to these that they stand for both.

    Parameters
    ----------
    groups
        Measured modes of one frequency.
    along
        As for :meth:`Together.seen`.
    poles, residues
        Of all predicted modes, shapes ``(m,)`` and ``(m, o, i)``.
    pairs
        The predicted mode that belongs to each measured one, shape ``(k,)``.
    """
    free = np.ones(len(poles), bool)
    free[pairs] = False
    others, own = np.flatnonzero(free), poles[pairs]
    grouped, rows, numbers = [k for group in groups for k in group.rows], [], []
    apart = np.abs(poles[others, None] - own) - reach(own)
    for j in np.flatnonzero((apart < 0).any(axis=1)):
        k = int(apart[j].argmin())
        weight = _weights(along[k], residues[[pairs[k], others[j]]])
        if k in grouped or abs(weight.sum()) > CANCELLED * np.abs(weight).sum():
            rows.append(k)
            numbers.append(int(others[j]))
    return Together(pairs, np.array(rows, int), np.array(numbers, int), groups)


def of_rank(residues: np.ndarray, variance: np.ndarray, few: int) -> np.ndarray:
    """Sums of so many shapes times participations nearest to residues ``(n, o, i)`` of known variances.

    Shapes and participations are fitted in turn by weighted least squares (Gabriel and Zamir 1979, Technometrics
    21:489), from the singular vectors of the residues, and from those of residues over their deviations, as far as
    these are a product over outputs and inputs.
    """
    there = variance > 0  # none where a channel has no weight
    weight = np.where(there, 1 / np.where(there, variance, 1.0), 0.0)
    level = 0.5 * np.log(np.where(there, variance, variance.max(axis=(1, 2), keepdims=True, initial=1e-300)))
    rows, columns, mean = (level.mean(axis=axis, keepdims=True) for axis in (2, 1, (1, 2)))
    tried = [_in_turn(residues, weight, scale, few) for scale in (np.ones_like(level), np.exp(rows + columns - mean))]
    left = [(weight * np.abs(residues - A) ** 2).sum(axis=(1, 2)) for A in tried]
    return np.where((left[0] < left[1])[:, None, None], *tried)


def _in_turn(residues: np.ndarray, weight: np.ndarray, scale: np.ndarray, few: int) -> np.ndarray:
    """The same from the singular vectors of residues over a scale."""
    participation = np.linalg.svd(residues / scale, full_matrices=False)[2][:, :few] * scale[:, :1]
    turned, heavy = residues.transpose(0, 2, 1), weight.transpose(0, 2, 1)
    for _ in range(TURNS):
        shapes = _given(participation, residues, weight)
        participation = _given(shapes.transpose(0, 2, 1), turned, heavy).transpose(0, 2, 1)
    return _given(participation, residues, weight) @ participation


def _given(rows: np.ndarray, A: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """X nearest to ``A = X rows`` by weights, ``rows`` of shape ``(n, k, i)`` and A ``(n, o, i)``; ``(n, o, k)``."""
    heavy = weight[:, :, None] * rows.conj()[:, None]
    gram = heavy @ rows.transpose(0, 2, 1)[:, None]
    size = np.trace(gram, axis1=2, axis2=3).real[..., None, None]
    gram = gram + NOTHING * np.maximum(size, 1e-300) * np.eye(gram.shape[-1])
    return np.linalg.solve(gram, heavy @ A[..., None])[..., 0]


def twofold(modes: Projected, channels: Channels, which: np.ndarray) -> tuple[Projected, list[tuple[int, ...]]]:
    """Modes with two poles in the place of ``which``, hardly apart, and the numbers of these.

    Their residues tell both moments of what is there, channel by channel, with their covariance.
    """
    if not which.any():
        return modes, []
    poles = np.repeat(modes.poles, 1 + which)
    first = np.flatnonzero(which) + np.arange(np.count_nonzero(which))
    half = APART * modes.poles.real[which]
    poles[first], poles[first + 1] = poles[first] + 1j * half, poles[first] - 1j * half
    return project(poles, channels)[0], [(int(k), int(k) + 1) for k in first]
