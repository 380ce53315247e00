r"""The lines around some modes with everything else taken out, for questions that only they answer.

There, channel by channel, :math:`D_c = \sum_r R_{rc} K(s, \lambda_r) + B b_c + e_c`: the modes asked about with a
kernel :math:`K`, neighbours of fixed poles and a straight line in :math:`B`, and noise of unit variance. Few lines and
few unknowns, so this is done with NumPy on the host.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from modalax.data.frf import DERIVATIVES, FRF
from modalax.identify.maximum import response
from modalax.identify.plain import modal_of, samples_of
from modalax.identify.shared_noise import shared_noise
from modalax.model.modal import ModalModel

WIDTH, LINES = 8.0, 12  # reach of the lines on either side, in half-bandwidths and at least in lines
MOST = 400  # lines; of more every second, third, ... is taken
HALF, LEAST = 3, 0.1  # lines on either side over which noise is averaged, and its least part of the typical one
LEADING = 12  # principal columns of the channels that a search for poles looks at
PLAIN = 1e-5  # part of the data's sum of squares from which on a difference of sums tells what is left
TWIN = 0.1  # distance of modes, in sums of half-bandwidths, below which residues tell them apart rather than poles
INDEPENDENT = 1e-6  # part of residues from which on they are none of a neighbour's, rounding aside
ROUNDING = 1e-12  # least noise, relative to the largest FRF around

Kernel = Callable[[np.ndarray, complex], np.ndarray]


class Neighbourhood(NamedTuple):
    """Whitened lines around some modes.

    Attributes
    ----------
    s
        Where the lines were evaluated, shape ``(m,)`` [1/s].
    data
        FRFs less all other modes, over their noise, shape ``(m, c)`` with channel ``o * inputs + i`` in place ``c``.
    weight
        What every kernel is multiplied with line by line, shape ``(m,)``.
    fixed
        Columns of neighbours and of a straight line, shape ``(m, k)``.
    residues
        Residues of the modes over the channels' noise, shape ``(n, c)``.
    poles
        Their poles, shape ``(n,)`` [rad/s].
    power
        Number of time derivatives of the form.
    near, near_residues
        Poles of neighbours in ``fixed`` [rad/s], and their residues over the channels' noise, shape ``(k, c)``.
    noise
        Standard deviation of each channel's noise, shape ``(c,)``, in the unit of the FRFs.
    inputs
        Number of inputs.
    kernel
        The kernel through which resonances are seen; that of a steady state if None.
    """

    s: Complex[np.ndarray, " m"]
    data: Complex[np.ndarray, "m c"]
    weight: Float[np.ndarray, " m"]
    fixed: Complex[np.ndarray, "m k"]
    residues: Complex[np.ndarray, "n c"]
    poles: Complex[np.ndarray, " n"]
    power: int
    near: Complex[np.ndarray, " k"]
    near_residues: Complex[np.ndarray, "k c"]
    noise: Float[np.ndarray, " c"]
    inputs: int
    kernel: Kernel | None = None

    def pole_kernel(self, s: np.ndarray, pole: complex) -> np.ndarray:
        """The kernel of a steady state, in the form of the FRF."""
        return s**self.power / (s - pole)

    def seen(self, poles: Sequence[complex] | np.ndarray) -> Complex[np.ndarray, "m n"]:
        """Kernels of some poles as they are seen here, times the weight."""
        kernel = self.pole_kernel if self.kernel is None else self.kernel
        each = np.array([kernel(self.s, complex(p)) for p in poles], complex)
        return each.reshape(-1, len(self.s)).T * self.weight[:, None]

    def columns(self, poles: Sequence[complex] | np.ndarray) -> Complex[np.ndarray, "m columns"]:
        """Kernels of some poles with the fixed columns, each of unit norm."""
        A = np.concatenate([self.seen(poles), self.fixed], axis=1)
        return A / np.maximum(np.linalg.norm(A, axis=0), 1e-300)

    def left(self, poles: Sequence[complex] | np.ndarray) -> Complex[np.ndarray, "m c"]:
        """What the best residues leave of the data."""
        Q = np.linalg.qr(self.columns(poles))[0]
        return self.data - Q @ (Q.conj().T @ self.data)

    def squares_left(self, poles: Sequence[complex] | np.ndarray) -> float:
        """Sum of squares of what the best residues leave, as a difference where that loses no digit in use."""
        Q = np.linalg.qr(self.columns(poles))[0]
        seen = Q.conj().T @ self.data
        whole = float(np.vdot(self.data, self.data).real)
        rest = whole - float(np.vdot(seen, seen).real)
        if rest > PLAIN * whole:
            return rest
        left = self.data - Q @ seen
        return float(np.vdot(left, left).real)

    def least_of_one(self) -> float:
        """Sum of squares that one mode leaves at the very least, whatever its pole and its kernel.

        One mode is of rank one, and no matrix of rank one explains more than the largest singular value (Eckart and
        Young 1936), found here from the residues by one step of subspace iteration. Zero where it is too small a
        difference to tell.
        """
        Q = np.linalg.qr(self.columns(()))[0]
        seen, mix = Q.conj().T @ self.data, self.residues.conj().T
        basis = np.linalg.qr(self.data @ mix - Q @ (seen @ mix))[0]
        found = basis.conj().T @ self.data
        whole = float(np.vdot(self.data, self.data).real)
        rest = whole - float(np.vdot(seen, seen).real) - float(np.linalg.norm(found, 2)) ** 2
        return rest if rest > PLAIN * whole else 0.0

    def leading(self) -> Complex[np.ndarray, "m k"]:
        """What the channels have in common without the fixed columns: their ``LEADING`` largest principal columns.

        Found in the range of a few random combinations (Halko, Martinsson and Tropp 2011, algorithm 4.4).
        """
        Q = np.linalg.qr(self.columns(()))[0]
        data, count = self.data - Q @ (Q.conj().T @ self.data), self.data.shape[1]
        if count <= LEADING:
            return data
        mix = np.random.default_rng(0).normal(size=(count, 2 * LEADING))
        seen = np.linalg.qr(data @ (data.conj().T @ (data @ mix)))[0]
        vectors, sizes, _ = np.linalg.svd(seen.conj().T @ data, full_matrices=False)
        return seen @ (vectors * sizes)[:, :LEADING]

    def beside_twins(self) -> "Neighbourhood | None":
        r"""The lines of one mode in the one combination of channels in which neighbours of the same pole hold nothing.

        However the shape :math:`\psi` and participation :math:`L` of a neighbour change, its residues change by
        :math:`a L^T + \psi b^T` alone. What of the mode's own residues is orthogonal to this is no neighbour's: two
        inputs tell two modes of one frequency. None without such neighbours (:data:`TWIN`), or where nothing is left
        beside them, as with one input.
        """
        which = np.abs(self.near - self.poles[0]) < TWIN * -(self.near.real + self.poles[0].real)
        if not which.any():
            return None
        held = (self.near_residues[which] * self.noise).reshape(int(which.sum()), -1, self.inputs)
        columns = []
        for residue in held:
            left, _, right = np.linalg.svd(residue, full_matrices=False)
            columns += [np.kron(row, right[0]) for row in np.eye(residue.shape[0])]
            columns += [np.kron(left[:, 0], row) for row in np.eye(self.inputs)]
        basis, sizes, _ = np.linalg.svd((np.array(columns) / self.noise).T, full_matrices=False)
        basis = basis[:, sizes > INDEPENDENT * sizes[0]]
        own = self.residues[0] - basis @ (basis.conj().T @ self.residues[0])
        size = float(np.linalg.norm(own))
        if size < INDEPENDENT * float(np.linalg.norm(self.residues[0])):
            return None
        mix, keep = own.conj()[:, None] / size, ~which
        fixed = np.concatenate([self.fixed[:, : -len(which)], self.fixed[:, -len(which) :][:, keep]], axis=1)
        return self._replace(
            data=self.data @ mix, residues=self.residues @ mix, fixed=fixed, near=self.near[keep],
            near_residues=self.near_residues[keep] @ mix, noise=np.ones(1), inputs=1,
        )  # fmt: skip

    def channels(self, which: np.ndarray) -> "Neighbourhood":
        """The same lines of some channels."""
        return self._replace(
            data=self.data[:, which], residues=self.residues[:, which], noise=self.noise[which],
            near_residues=self.near_residues[:, which],
        )  # fmt: skip


def around(
    frf: FRF,
    model: ModalModel,
    residual: Complex[np.ndarray, "f o i"],
    which: Sequence[int],
    smooth: bool = False,
    scatter: Float[np.ndarray, "f c"] | None = None,
) -> Neighbourhood:
    """The lines around some modes of a model, with its other modes and residual terms taken out.

    Residues of neighbours are free, so that a part of one that they hold does not count for the modes asked about. Of a
    neighbour closer to one of these than they are to each other they stay: free in every channel, it would stand for
    that mode however plainly the two differ in shape.

    Parameters
    ----------
    frf, model
        The FRF and a modal model of it.
    residual
        The FRF less what the model makes, as :func:`residual_of` gives it.
    which
        Indices of the modes.
    smooth
        Whether noise that is not known may change over the lines, so that no part of them is taken for quieter than it
        is; sharp misfit then counts as noise where it is.
    scatter
        :func:`scatter_of` the residual, for questions about many modes.
    """
    freq, poles = np.asarray(frf.freq), np.asarray(model.poles)
    own = poles[list(which)]
    width, centre = -own.real / (2 * np.pi), own.imag / (2 * np.pi)
    step = float(np.median(np.diff(freq)))
    reach = max(WIDTH * float(width.max()), LINES * step)
    first, last = np.searchsorted(freq, [centre.min() - reach, centre.max() + reach])
    first, last = max(0, min(first, len(freq) - 2 * LINES)), min(len(freq), max(last, 2 * LINES))
    lines = slice(first, last, max(1, (last - first) // MOST))
    s = np.asarray(frf.added_decay) + 2j * np.pi * freq
    rest = residual[first:last].reshape(last - first, -1)
    noise, course = channel_noise(frf, residual, slice(first, last), smooth, scatter)
    power = DERIVATIVES[frf.form]
    weight = 1 / course[:: lines.step]
    apart = np.ptp(own.imag)
    beside = (np.abs(poles[:, None] - own) < apart).any(axis=1) | ~_within(poles, s[lines])
    others = [k for k in np.flatnonzero(~beside).tolist() if k not in which]
    shapes, part = (np.asarray(a)[[*which, *others]] for a in (model.shapes, model.participation))
    residues = (shapes[:, :, None] * part[:, None, :]).reshape(len(shapes), -1) / noise
    residues, near_residues = residues[: len(own)], residues[len(own) :]
    straight = np.stack([np.ones(len(s[lines])), np.linspace(-1, 1, len(s[lines]))])
    near = [s[lines] ** power / (s[lines] - poles[k]) for k in others]
    fixed = (np.array([*straight, *near]) * weight).T.astype(complex)
    whitened = rest[:: lines.step] * (1 / noise)
    whitened += (s[lines, None] ** power / (s[lines, None] - own)) @ residues
    whitened *= weight[:, None]
    return Neighbourhood(
        s[lines], whitened, weight, fixed, residues, own, power, poles[others], near_residues, noise, frf.shape[2]
    )


def _within(poles: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Which poles act on the lines other than as a straight line."""
    margin = -2 * poles.real
    return (s[0].imag - margin < poles.imag) & (poles.imag < s[-1].imag + margin)


def residual_of(frf: FRF, model: ModalModel) -> Complex[np.ndarray, "f o i"]:
    """The FRF less what the model makes."""
    if (model.outputs, model.inputs) == (frf.outputs, frf.inputs) and frf.ends[0] > 0:
        return np.asarray(frf.H) - response(modal_of(model), samples_of(frf))
    made = model.frf(frf.freq, form=frf.form, outputs=frf.outputs, inputs=frf.inputs, added_decay=frf.added_decay)
    return np.asarray(frf.H - made.H)


def channel_noise(
    frf: FRF,
    residual: Complex[np.ndarray, "f o i"],
    lines: slice,
    smooth: bool = False,
    scatter: Float[np.ndarray, "f c"] | None = None,
) -> tuple[Float[np.ndarray, " c"], Float[np.ndarray, " m"]]:
    """Standard deviation of each channel's noise in some lines, and its course over them (mean square 1).

    From the variance where it is known; else from the scatter of the residual between neighbouring lines.
    """
    count = residual[lines].shape[0]
    parts = np.asarray(frf.H)[lines].view(float)  # the larger of both parts is near enough to the magnitude
    floor = ROUNDING * max(float(parts.max()), -float(parts.min())) + 1e-300
    if frf.variance is not None:
        variance = np.asarray(frf.variance)[lines].reshape(count, -1) + floor**2
        size = np.sqrt(variance.mean(axis=0))
        course = np.sqrt(np.mean(variance / size**2, axis=1))
        return size, course / np.sqrt(np.mean(course**2))
    power = line_noise(residual[lines].reshape(count, -1)) if scatter is None else scatter[lines]
    size = np.sqrt(power.mean(axis=0) + floor**2)
    if not smooth:
        return size, np.ones(count)
    mean = (power @ size**-2 + floor**2 * np.sum(size**-2)) / len(size)
    course = np.convolve(np.pad(mean, HALF, "edge"), np.ones(2 * HALF + 1), "valid")
    course = np.sqrt(np.maximum(course, LEAST * np.median(course)))
    return size, course / np.sqrt(np.mean(course**2))


class Left(NamedTuple):
    """What a model leaves of an FRF ``(f, o, i)``, and its :func:`scatter_of`, for questions about many modes."""

    residual: np.ndarray
    scatter: np.ndarray | None


def left_of(frf: FRF, model: ModalModel) -> Left:
    """What a model leaves of an FRF; noise that outputs share has the scatter by which it counts."""
    residual = residual_of(frf, model)
    scatter = scatter_of(frf, residual)
    return Left(residual, None if scatter is None else scatter * shared_of(frf, residual))


def shared_of(frf: FRF, residual: Complex[np.ndarray, "f o i"]) -> float:
    """By how much noise that the outputs share counts more, of :func:`modalax.identify.shared_noise.shared_noise`."""
    sigma = 1.0
    if frf.variance is not None:
        variance = np.asarray(frf.variance)
        sigma = np.sqrt(np.where(variance > 0, variance, np.inf))
    return shared_noise((np.asarray(frf.H) - residual) / sigma, residual / sigma)


def judged(frf: FRF, residual: Complex[np.ndarray, "f o i"]) -> FRF:
    """The FRF by which modes are judged: with a variance by which noise counts that the outputs share."""
    shared = 1.0 if frf.variance is None else shared_of(frf, residual)
    return frf if shared == 1.0 else frf.replace(variance=shared * np.asarray(frf.variance))


def scatter_of(frf: FRF, residual: Complex[np.ndarray, "f o i"]) -> Float[np.ndarray, "f c"] | None:
    """Power of what changes from line to line in every channel; None where the variance is known."""
    return None if frf.variance is not None else line_noise(residual.reshape(len(residual), -1))


def line_noise(residual: Complex[np.ndarray, "m c"]) -> Float[np.ndarray, "m c"]:
    r"""Power of what changes from line to line, :math:`|r_{k-1}-2r_k+r_{k+1}|^2/6`; that of the ends repeats.

    Independent noise has this expectation; model error that is smooth over three lines adds nothing.
    """
    if len(residual) < 3:
        return squares(residual)
    change = residual[:-2] + residual[2:]
    for _ in range(2):
        change -= residual[1:-1]
    power = np.empty(residual.shape)
    np.square(change.real, out=power[1:-1])
    power[1:-1] += change.imag**2
    power[1:-1] /= 6
    power[0], power[-1] = power[1], power[-2]
    return power


def squares(z: Complex[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Squared magnitudes, without the roots that ``np.abs`` takes."""
    power = z.real**2
    power += z.imag**2
    return power
