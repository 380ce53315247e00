r"""Variable projection of measured FRFs on modes and further terms, on the host with LAPACK.

.. math:: \min \sum_{oif} w_{oif}^2 \Big|H_{oif} - \sum_r (z_{roi} k_r + z_{roi}^* \tilde k_r)
          - \sum_t e_{oit}\, \tau_t(s_f)\Big|^2, \qquad z_{roi} = \psi_{ro} L_{ri}

Shapes :math:`\psi` and the coefficients :math:`e` are linear and eliminated (Golub and Pereyra 1973; Kaufman 1975); the
search runs over :math:`\ln\omega, \ln\zeta` and participation :math:`L`, all real. All channels share one basis
(:mod:`modalax.identify.kernels`), so one orthogonal factorisation leaves few rows instead of all lines: weights that
the outputs share then cost as much as one output, and weights of its own a channel costs a Gram matrix, all from one
matrix product, in coordinates that are orthonormal for the mean weight, so that squaring loses next to nothing.
"""

from collections.abc import Iterator
from copy import copy

import numpy as np
from scipy.linalg.blas import dtrsm

from modalax._numerics.grams import weighted_grams
from modalax.identify.kernels import Modes, coefficient_slopes, coefficients, kernels, pairs, unpack
from modalax.identify.reduced import OwnOutputs, SharedOutputs, Slopes, Sums

INDEPENDENT = 1e-5  # part of a column that those before it leave, from which on a Gram matrix tells it apart
MANY, PLAIN = 2**20, 1e-5  # samples of one input, and the part of their squares outside the basis
CACHED = 2**18  # samples of a block that stays near the processor
BLOCK = 2**25  # numbers that an array of one block of lines or outputs may hold


class Projection:
    r"""FRFs made ready for the elimination of everything linear.

    Parameters
    ----------
    s
        Where the FRFs were measured, :math:`\sigma + j\omega`, shape ``(f,)`` [1/s].
    H
        FRFs, shape ``(f, o, i)``.
    weight
        Weight of real and imaginary part of each sample, :math:`\sqrt2/\sigma`; 0 leaves a sample out. Same shape.
    power
        Number of time derivatives: 0, 1, 2 for receptance, mobility, accelerance.
    terms
        Further columns of every channel with real coefficients, shape ``(f, t)``; a complex coefficient takes two, the
        term and j times it. :func:`modalax.identify.kernels.residual_terms` makes the usual ones, and
        :func:`modalax.identify.kernels.kernels` those of modes whose poles are known.
    real_modes
        Whether residues of the receptance are those of real normal modes.
    """

    def __init__(
        self, s: np.ndarray, H: np.ndarray, weight: np.ndarray, *, power: int = 0, terms: np.ndarray | None = None,
        real_modes: bool = False,
    ):  # fmt: skip
        self.s, self.power, self.real_modes = np.asarray(s, complex), power, real_modes
        self.weight = np.ascontiguousarray(np.moveaxis(np.asarray(weight, float), 0, 2))
        self.y = np.moveaxis(np.asarray(H), 0, 2) * self.weight
        terms = np.zeros((len(self.s), 0), complex) if terms is None else np.asarray(terms, complex)
        Q, self.scale = np.linalg.qr(stacked(terms.T).T)  # else the smallest would be lost beside the largest
        self.terms = Q[: len(self.s)] + 1j * Q[len(self.s) :]
        self.outputs, self.inputs = self.y.shape[:2]
        self.real = [stacked(self.y[:, i]) for i in range(self.inputs)]
        self._known: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}  # bases of the last poles, for all that asks again
        self._weigh()

    def of_input(self, i: int) -> "Projection":
        """The data of one input alone."""
        own = copy(self)
        own.y, own.weight, own.real, own.inputs = self.y[:, [i]], self.weight[:, [i]], [self.real[i]], 1
        if self.shared:
            own.common = self.common[[i]] if len(self.common) > 1 else self.common
        else:
            own._weigh()
        return own

    @property
    def samples(self) -> int:
        """Number of real samples."""
        return 2 * int(np.count_nonzero(self.weight))

    def _weigh(self) -> None:
        """The weights that outputs or inputs have in common: ``common`` rows, and a ``size`` for each line."""
        size = np.sqrt(np.mean(self.weight**2, axis=(1, 2)))
        first = self.weight[int(np.argmax(size))]
        size = size / max(np.max(size), 1e-300)
        self.shared = _equal(self.weight, size[:, None, None] * first)
        self.size = np.where(size > 0, size, 1.0)
        if self.shared:
            self.common = first[:1] if _equal(first, first[:1]) else first
        else:
            power_of = np.maximum(np.mean(self.weight**2, axis=2, keepdims=True), 1e-300)
            self.common = np.sqrt(np.mean(self.weight**2 / power_of, axis=(0, 1)))[None]

    def degrees_of_freedom(self, modes: int) -> int:
        """Samples less unknowns of every kind, with some number of modes; not above zero where there are too few."""
        shapes = modes * (1 if self.real_modes else 2) + self.inputs * self.terms.shape[1]
        return self.samples - self.outputs * shapes - modes * 2 * self.inputs

    def sums(self, theta: np.ndarray, pivot: np.ndarray, held: np.ndarray) -> Sums:
        r"""Cost, gradient and Gauss-Newton matrix.

        Parameters
        ----------
        theta
            :math:`\ln\omega, \ln\zeta` and participation of each mode, as :func:`modalax.identify.kernels.pack` makes
            them, shape ``(n, 2 i)``.
        pivot
            Reference at which each mode's participation is one, shape ``(n,)``.
        held
            1 for modes whose damping keeps its value, shape ``(n,)``.
        """
        parts = [block.sums() for block in self.blocks(theta, pivot, held)]
        return Sums(*(sum(values[1:], values[0]) for values in zip(*parts, strict=True)))

    def blocks(
        self, theta: np.ndarray, pivot: np.ndarray, held: np.ndarray, squares: bool = True
    ) -> Iterator[SharedOutputs | OwnOutputs]:
        """The reduced problem, in blocks of outputs that memory has room for; arguments as for :meth:`sums`.

        Without ``squares`` there are shapes, but no derivatives.
        """
        modes = unpack(theta, pivot, self.real_modes)
        bases, slopes = self._bases(modes.poles, squares), _slopes(modes, pivot, held)
        if self.shared:
            yield self._shared(bases, slopes)
            return
        ((Q, R),) = bases
        k, width = R.shape
        many = max(1, BLOCK // (self.inputs * k * (width + theta.size)))
        for start in range(0, self.outputs, many):
            yield self._own(Q, R, slopes, slice(start, start + many))

    def _bases(self, poles: np.ndarray, squares: bool) -> list[tuple[np.ndarray, np.ndarray]]:
        """Orthonormal basis of terms and kernels and its triangular factor, for each row of common weights."""
        asked = [poles.tobytes() + bytes([squares]) + row.tobytes() for row in self.common]
        if not all(key in self._known for key in asked):
            columns = np.concatenate([self.terms, kernels(self.s, self.power, poles, squares)], axis=1)
            columns = np.concatenate([columns.real, columns.imag])
            self._known.clear()
            self._known.update((key, _basis(columns, row)) for key, row in zip(asked, self.common, strict=True))
        return [self._known[key] for key in asked]

    def _shared(self, bases: list[tuple[np.ndarray, np.ndarray]], slopes: Slopes) -> SharedOutputs:
        t = self.terms.shape[1]
        U, beta, rest = [], [], 0.0
        for i in range(self.inputs):
            Q, R = bases[i if len(bases) > 1 else 0]
            y = self.real[i]
            found = y @ Q
            rest += self._outside(y, Q, found)
            U.append(R[t:, t:])
            beta.append(found[:, t:].T)
        many = np.arange(self.inputs) if len(bases) > 1 else np.zeros(self.inputs, int)

        def lines(_: int) -> np.ndarray:
            return np.array([bases[i][0][:, t:] for i in many])

        return SharedOutputs(np.array(U), np.array(beta), rest, slopes, lines, self.size)

    def _outside(self, y: np.ndarray, Q: np.ndarray, found: np.ndarray) -> float:
        """Squares of data outside the basis; of many samples by their difference where that loses no digit in use."""
        if y.size > MANY:
            whole = float(np.vdot(y, y))
            rest = whole - float(np.vdot(found, found))
            if rest > PLAIN * whole:
                return rest
        left = found @ Q.T
        left -= y
        return float(np.vdot(left, left))

    def _own(self, Q: np.ndarray, R: np.ndarray, slopes: Slopes, part: slice) -> OwnOutputs:
        t = self.terms.shape[1]
        ratio = (self.weight[part] / np.maximum(self.common[0], 1e-300)).reshape(-1, len(self.s))
        y = self.y[part].reshape(ratio.shape)
        L = _roots(Q, ratio)
        beta = np.linalg.solve(L, (stacked(ratio * y) @ Q)[..., None])
        # What is left is taken sample by sample: a difference of squares would lose it beside large FRFs.
        fitted = np.linalg.solve(np.swapaxes(L, 1, 2), beta)[..., 0] @ Q.T
        rest = float(np.sum((stacked(y) - np.tile(ratio, 2) * fitted) ** 2))
        U = (np.swapaxes(L, 1, 2) @ R)[:, t:, t:]
        shape = (-1, self.inputs, U.shape[1])
        columns = np.tile(ratio.reshape(-1, self.inputs, len(self.s)), 2)[..., None]

        def lines(k: int) -> np.ndarray:
            own = L.reshape(-1, self.inputs, *L.shape[1:])[k]
            back = np.linalg.inv(np.swapaxes(own, 1, 2))[..., t:]
            return columns[k] * (Q @ back)

        return OwnOutputs(U.reshape(*shape, U.shape[2]), beta[:, t:, 0].reshape(shape), rest, slopes, lines)

    def remainder(self, x: np.ndarray, modes: Modes) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients of the further terms, and what modes and terms leave of the weighted FRFs.

        Parameters
        ----------
        x
            Unknowns of the shapes, shape ``(o, n c)``.
        modes
            The modes that they belong to.

        Returns
        -------
        tuple
            Coefficients ``(o, i, t)`` and whitened residual ``(o, i, f)``, its real and imaginary part of variance one.
        """
        residue = np.einsum("onc,nic->oin", x.reshape(len(x), *modes.unit.shape), coefficients(modes))
        flat = pairs(residue).reshape(self.outputs, self.inputs, -1)
        columns = kernels(self.s, self.power, modes.poles, squares=False).T
        columns = np.ascontiguousarray(columns.real), np.ascontiguousarray(columns.imag)
        left = np.empty_like(self.y)
        total = np.zeros((self.outputs, self.inputs, self.terms.shape[1]))
        many = max(1, CACHED // (self.inputs * len(self.s)))
        for start in range(0, self.outputs, many):
            part = slice(start, start + many)
            total[part] = self._remainder(flat[part], columns, part, left[part])
        return np.linalg.solve(self.scale, total[..., None])[..., 0], left

    def _remainder(
        self, flat: np.ndarray, columns: tuple[np.ndarray, np.ndarray], part: slice, left: np.ndarray
    ) -> np.ndarray:
        """Coefficients of the orthonormal terms for a few outputs; what is left goes into ``left``."""
        weight, t = self.weight[part], self.terms.shape[1]
        left.real, left.imag = flat @ columns[0], flat @ columns[1]
        left *= -weight
        left += self.y[part]
        total = np.zeros((*left.shape[:2], t))
        if not t:
            return total
        products = (self.terms.conj()[:, :, None] * self.terms[:, None, :]).real
        gram = (weight**2 @ products.reshape(-1, t * t)).reshape(*total.shape, t)
        gram[~np.any(weight, axis=2)] = np.eye(t)
        for _ in range(2):  # the second time takes out what the normal equations lost
            e = np.linalg.solve(gram, ((weight * left) @ self.terms.conj()).real[..., None])[..., 0]
            made = e @ self.terms.T
            made *= weight
            left -= made
            total += e
        return total


def _basis(columns: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal basis of columns under the weights of a row, and its triangular factor."""
    A = columns * np.tile(row, 2)[:, None]
    norm = np.linalg.norm(A, axis=0)
    norm = np.where(norm > 0, norm, 1.0)
    Q, R = orthonormal(A / norm)
    return Q, R * norm


def _equal(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether no weight differs by more than 1e-9 of its size."""
    return bool((np.abs(a - b) <= 1e-9 * b).all())


def _slopes(modes: Modes, pivot: np.ndarray, held: np.ndarray) -> Slopes:
    """Real pairs of columns and derivatives; dampings that are held have none."""
    plain, squared = coefficient_slopes(modes, pivot)
    for part in (plain, squared):
        part[..., 1] *= (1 - held)[:, None, None]
    return Slopes(pairs(coefficients(modes)), pairs(plain), pairs(squared))


def orthonormal(A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """QR of columns of unit norm, by two Cholesky factorisations where these are safe, else by reflections.

    The second one brings orthogonality to rounding unless the first was of next to dependent columns (Yamamoto,
    Nakatsukasa, Yanagisawa and Fukaya 2015).
    """
    whole = np.eye(A.shape[1])
    Q = A
    try:
        for _ in range(2):
            R = np.linalg.cholesky(Q.T @ Q).T
            if np.min(np.diag(R)) < INDEPENDENT:
                return np.linalg.qr(A)
            # Q R = A, as rows: BLAS takes the transpose of what lies row after row as it is.
            Q = dtrsm(1.0, np.asfortranarray(R.T), Q.T, lower=1).T
            whole = R @ whole
    except np.linalg.LinAlgError:
        return np.linalg.qr(A)
    return Q, whole


def stacked(a: np.ndarray) -> np.ndarray:
    """Real parts, then imaginary parts, along the last axis."""
    return np.concatenate([a.real, a.imag], axis=-1)


def _roots(Q: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    """Lower triangular roots of the Gram matrices of a basis under the weights of each channel, ``(c, k, k)``.

    Raises
    ------
    LinAlgError
        Where the columns depend on each other under the weights of a channel: such a trial is no step to take.
    """
    f = len(Q) // 2
    gram = weighted_grams(Q[:f], Q[f:], ratio**2, BLOCK)
    gram[~np.any(ratio, axis=1)] = np.eye(Q.shape[1])
    return np.linalg.cholesky(gram)
