r"""Symmetric changes of matrices by few directions each, :math:`P = \sum_r \pm b_r b_r^T`, and what they do to FRFs.

A spring, a lumped mass or the damping of one mode has one direction, the stiffness of a beam a few: between responses
of some outputs and inputs a change then costs as many products as it has directions, and not those of a whole matrix.
"""

from dataclasses import dataclass

import numpy as np

NOTHING = 1e-11  # part of the largest eigenvalue below which one is rounding


@dataclass(frozen=True)
class Factored:
    """Symmetric changes by their directions.

    Attributes
    ----------
    basis, sign
        Directions of all changes in turn, times the roots of their sizes, shape ``(n, r)``, and their signs ``(r,)``.
    first
        Number of each change's first direction, shape ``(p,)``.
    """

    basis: np.ndarray
    sign: np.ndarray
    first: np.ndarray

    def scaled(self, root: np.ndarray) -> "Factored":
        """The changes with rows and columns times factors, shape ``(n,)``."""
        return Factored(root[:, None] * self.basis, self.sign, self.first)

    def turned(self, T: np.ndarray) -> "Factored":
        """The changes :math:`TPT^T`."""
        return Factored(T @ self.basis, self.sign, self.first)

    def combined(self, sizes: np.ndarray) -> np.ndarray:
        """Sum of the changes, each times its size, shape ``(n, n)``."""
        count = np.diff(np.append(self.first, len(self.sign)))
        return (self.basis * (self.sign * np.repeat(sizes, count))) @ self.basis.T

    def along(self, vectors: np.ndarray) -> np.ndarray:
        """Complex vectors ``(..., n)`` along the directions, shape ``(..., r)``."""
        out = np.empty((*vectors.shape[:-1], len(self.sign)), complex)
        out.real, out.imag = vectors.real @ self.basis, vectors.imag @ self.basis
        return out

    def summed(self, each: np.ndarray) -> np.ndarray:
        """What directions do, shape ``(..., r)``, added up for each change, shape ``(..., p)``."""
        return each if len(self.first) == len(self.sign) else np.add.reduceat(each, self.first, axis=-1)

    def between(self, outer: np.ndarray, inner: np.ndarray) -> np.ndarray:
        """All changes between responses ``(f, n, o)`` and ``(f, n, i)``, shape ``(p, f, o, i)``."""
        left, right = (self._along(responses) for responses in (outer, inner))
        right *= self.sign[:, None, None]
        count = np.diff(np.append(self.first, len(self.sign)))
        if len(count) == len(self.sign):
            return left[..., None] * right[:, :, None]
        out = np.empty((len(count), *left.shape[1:], right.shape[2]), complex)
        for c in np.unique(count):  # a product of matrices each, ten times as fast as sums over directions
            own = np.flatnonzero(count == c)
            some = self.first[own, None] + np.arange(c)
            out[own] = left[some].transpose(0, 2, 3, 1) @ right[some].transpose(0, 2, 1, 3)
        return out

    def _along(self, responses: np.ndarray) -> np.ndarray:
        """Responses along the directions, shape ``(r, f, k)``: two real products cost half of a complex one."""
        f, n, k = responses.shape
        flat = responses.transpose(1, 0, 2).reshape(n, f * k)
        out = np.empty((len(self.sign), f * k), complex)
        out.real, out.imag = self.basis.T @ flat.real, self.basis.T @ flat.imag
        return out.reshape(-1, f, k)


def factored(patterns: np.ndarray) -> Factored:
    """Symmetric changes, shape ``(p, n, n)``, by their eigenvectors."""
    values, vectors = np.linalg.eigh(patterns)
    size = np.abs(values)
    kept = size > NOTHING * size.max(axis=1, keepdims=True)
    kept[~kept.any(axis=1), -1] = True  # of a change that is none, one direction of no size
    basis = (vectors * np.sqrt(size)[:, None]).transpose(0, 2, 1)[kept].T
    count = kept.sum(axis=1)
    return Factored(np.ascontiguousarray(basis), np.sign(values)[kept], np.cumsum(count) - count)
