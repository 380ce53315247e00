r"""Products of receptances with residual, weights and nuisances, from which elements at all places are scored."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array

from modalax._numerics.checks import as_array
from modalax.diagnose.causes.scene import Place
from modalax.diagnose.causes.signals import ModalTerms
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.fitting.residual import complex_of
from modalax.diagnose.prediction.frf import gains_of
from modalax.diagnose.screening.in_place import InPlace, in_place
from modalax.diagnose.screening.sensitivities import BATCH, Residual
from modalax.diagnose.setup.modal_form import ModalForm
from modalax.diagnose.setup.problem import Problem

ROUNDING = 1e-9  # imaginary part of shapes, relative to the largest component, that is rounding of the eigensolver
WIDTHS = (40, 64, 100, 160)  # ranks tried for the gains of many modes


@dataclass(frozen=True)
class Reduced:
    """Products of the receptances with residual, weights and nuisances, in the coordinates of the modes.

    Attributes
    ----------
    gains
        Of the modes and of their conjugates, shape ``(f, m)``.
    shapes, participation
        At every DoF of the simulation, shape ``(m, dof)``.
    upper, lower
        Residual terms between DoFs, shape ``(dof, dof)``; None where there are none.
    outputs, inputs
        DoFs of the channels.
    S, T
        Products with the residual ``(run, f, dof, i)`` and with the nuisances ``(dof, k, run, f, i)``.
    weight2
        Squared weights, shape ``(run, f, o, i)``.
    inner
        Inverse information of the nuisances, shape ``(k, k)``.
    factors
        Two matrices whose product the gains are, where that is much shorter (modes beyond the band are alike in it).
    there
        Linear elements that are in place; None where there are none.
    """

    gains: np.ndarray
    shapes: np.ndarray
    participation: np.ndarray
    upper: np.ndarray | None
    lower: np.ndarray | None
    outputs: np.ndarray
    inputs: np.ndarray
    S: np.ndarray
    T: np.ndarray
    weight2: np.ndarray
    inner: np.ndarray
    omega: np.ndarray
    level: np.ndarray
    factors: tuple[np.ndarray, np.ndarray] | None = None
    there: InPlace | None = None
    cache: dict[tuple[int, int], np.ndarray] = field(default_factory=dict)

    def motion(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Receptance from the inputs to places, shape ``(place, f, i)``; ``b`` below 0 is the ground."""
        left, right = _along(self.shapes, a, b), self.participation[:, self.inputs]
        H = np.stack([self.gains @ (left * right[:, i, None]) for i in range(right.shape[1])], axis=-1)
        H = H + self._far(lambda R: _along(R[:, self.inputs].T, a, b).T[None])
        if self.there is not None:
            H = H - _along(self.there.left, a, b) @ self.there.right[:, :, self.inputs]
        return H.transpose(1, 0, 2)

    def column(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Receptance from places to the outputs, shape ``(f, place, o)``."""
        lines, gains = (None, self.gains) if self.factors is None else self.factors
        modes = gains.shape[1] // 2
        right = _along(self.participation, a, b).T[:, :modes]
        own, conjugate = gains[:, None, :modes] * right, gains[:, None, modes:] * right.conj()
        # shapes and their conjugates, so that products with real matrices do; of real modes half of them
        shape = self.shapes[:modes, self.outputs]
        H = _times_real(own + conjugate, shape.real)
        if np.abs(shape.imag).max(initial=0.0) > ROUNDING * np.abs(shape).max(initial=0.0):
            H = H + 1j * _times_real(own - conjugate, shape.imag)
        H = H.reshape(len(gains), -1) if lines is None else lines @ H.reshape(len(gains), -1)
        H = H.reshape(len(self.gains), len(a), -1) + self._far(lambda R: _along(R[self.outputs], a, b).T[None])
        if self.there is None:
            return H
        return H - np.swapaxes(self.there.left[:, self.outputs] @ _along(self.there.right, a, b, 2), 1, 2)

    def summed(self, line: int, sums: np.ndarray) -> np.ndarray:
        """Receptance from every DoF to sums ``(q, o)`` of the outputs at one line, shape ``(q, dof)``."""
        modes = self.gains.shape[1] // 2
        u, v = self.gains[line, :modes, None], self.gains[line, modes:, None]
        shape, right = self.shapes[:modes, self.outputs], self.participation[:modes]
        H = _times_real((u * right + v * right.conj()).T, shape.real @ sums.T)
        if np.abs(shape.imag).max(initial=0.0) > ROUNDING * np.abs(shape).max(initial=0.0):
            H = H + 1j * _times_real((u * right - v * right.conj()).T, shape.imag @ sums.T)
        if self.upper is not None and self.lower is not None:
            far = self.upper[self.outputs] - self.lower[self.outputs] / self.omega[line] ** 2
            H = H + (sums @ far).T
        if self.there is not None:
            H = H - ((sums @ self.there.left[line, self.outputs]) @ self.there.right[line]).T
        return H.T

    def column_at(self, place: Place) -> np.ndarray:
        """The column of one place, kept for the next cause, shape ``(f, o)``."""
        key = place.index[:2]
        if key not in self.cache:
            self.cache[key] = self.column(*ends([place]))[:, 0]
        return self.cache[key]

    def drive(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Receptance across places, shape ``(place, f)``."""
        H = self.gains @ (_along(self.shapes, a, b) * _along(self.participation, a, b))
        both = lambda R: np.einsum("kk->k", _along(_along(R, a, b).T, a, b))
        H = H + self._far(lambda R: both(R)[None])
        if self.there is not None:
            left, right = _along(self.there.left, a, b), _along(self.there.right, a, b, 2)
            H = H - np.einsum("fpq,fqp->fp", left, right)
        return H.T

    def nuisances(self, a: Any, b: Any) -> np.ndarray:
        """Products with the nuisances at one place, shape ``(k, run, f, i)``; ``b`` below 0 is the ground."""
        return self.T[a] if b < 0 else self.T[a] - self.T[b]

    def _far(self, at: Callable[[np.ndarray], np.ndarray]) -> Any:
        """Contribution of the residual terms, over the lines."""
        if self.upper is None or self.lower is None:
            return 0.0
        upper, lower = at(self.upper), at(self.lower)
        return upper - lower / self.omega.reshape(-1, *[1] * (lower.ndim - 1)) ** 2


def factors_of(gains: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Factors of the gains by random combinations (Halko, Martinsson and Tropp 2011, SIAM Rev. 53:217)."""
    rng = np.random.default_rng(0)
    for width in WIDTHS:
        if 3 * width > min(gains.shape):
            return None
        Q = np.linalg.qr(gains @ rng.normal(size=(gains.shape[1], width)))[0]
        B = Q.conj().T @ gains
        if np.abs(gains - Q @ B).max() < 1e-13 * np.abs(gains).max():
            return Q, B
    return None


def _times_real(z: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Complex arrays times a real matrix along the last axis, shape ``(rows, columns of x)``."""
    z, out = z.reshape(-1, len(x)), np.empty((z.size // len(x), x.shape[1]), complex)
    out.real, out.imag = z.real @ x, z.imag @ x
    return out


def _along(x: np.ndarray, a: np.ndarray, b: np.ndarray, axis: int = 1) -> np.ndarray:
    """Entries of the first DoFs less those of the second, where there is one, along an axis."""
    second = (b >= 0).astype(float).reshape([-1 if k == axis else 1 for k in range(x.ndim)])
    return np.take(x, a, axis) - second * np.take(x, np.maximum(b, 0), axis)


@eqx.filter_jit
def gains_and_ends(modal_form: ModalForm, omega: Array, theta: Array) -> tuple[Array, Array, Array]:
    """Gains of the modes, shape ``(f, m)``, their shapes and participation."""
    k, c, shapes, participation = modal_form.adapted(theta)
    still = ModalTerms(k[None], c[None], modal_form.hysteresis[None])
    gains = gains_of(1j * omega, still, modal_form.poles, [], modal_form.mixing is not None)
    return gains[0], shapes, participation


def reduce(problem: Problem, theta: np.ndarray, state: Residual, beside: Hypothesis | None = None) -> Reduced:
    """Make the products for one residual.

    Parameters
    ----------
    theta
        Logarithmic changes of the modal frequencies and damping ratios, shape ``(2, n)``.
    state
        The residual.
    beside
        The hypothesis that leaves it, whose linear elements are in place; none if None.
    """
    modal_form = problem.modal_form
    gains, *ends_of = gains_and_ends(modal_form, problem.omega, as_array(theta))
    gains = np.asarray(gains)
    psi, part = (np.concatenate([a, a.conj()]) for a in map(np.asarray, ends_of))
    there = np.abs(psi).max(axis=1) > 0  # the others only fill up
    gains, psi, part = np.ascontiguousarray(gains[:, there]), psi[there], part[there]
    o, i = np.asarray(problem.outputs), np.asarray(problem.inputs)
    upper, lower = np.asarray(modal_form.upper), np.asarray(modal_form.lower)
    far = bool(np.abs(upper).max(initial=0.0) + np.abs(lower).max(initial=0.0) > 0)
    weight = np.asarray(problem.weight)
    runs = weight.shape[0]
    omega = np.asarray(problem.omega)
    away = (upper[o] - lower[o] / omega[:, None, None] ** 2).conj() if far else None
    there = None if beside is None else in_place(beside, gains, psi, part, (upper, lower) if far else None, omega)

    def back(x: np.ndarray) -> np.ndarray:
        """From the outputs to every DoF, through the conjugate receptances."""
        modal = np.einsum("mo,rfoi->rfmi", psi[:, o].conj(), x, optimize=True) * gains.conj()[..., None]
        out = np.einsum("md,rfmi->rfdi", part.conj(), modal, optimize=True)
        out = out if away is None else out + np.einsum("fod,rfoi->rfdi", away, x, optimize=True)
        if there is None:
            return out
        return out - np.einsum("fqd,foq,rfoi->rfdi", there.right.conj(), there.left[:, o].conj(), x, optimize=True)

    S = back(weight * complex_of(state.value, runs))
    G = complex_of(state.nuisance, runs) if len(state.nuisance) else np.zeros((0, *weight.shape), complex)
    T = np.zeros((S.shape[2], len(G), *S.shape[:2], S.shape[3]), complex)
    for k, g in enumerate(G):
        if g.any():  # the others only fill up
            T[:, k] = np.moveaxis(back(weight * g), 2, 0)
    return Reduced(
        gains, psi, part, upper if far else None, lower if far else None, o, i, S, T, weight**2, state.inner,
        omega, np.asarray(problem.level), factors_of(gains), there,
    )  # fmt: skip


def as_one(apart: Reduced, pooled: Problem) -> Reduced:
    """The products with all runs as one: pooled residuals times their weight are the sums of those of the runs."""
    weight2, level = np.asarray(pooled.weight) ** 2, np.asarray(pooled.level)
    S, T = apart.S.sum(axis=0, keepdims=True), apart.T.sum(axis=2, keepdims=True)
    return replace(apart, S=S, T=T, weight2=weight2, level=level)


@dataclass(frozen=True)
class At:
    """Products at some places, stacked along the first axis, and both DoFs of each place.

    Those with the nuisances are made where they are needed (:meth:`Reduced.nuisances`): all of them at once would take
    places times nuisances times samples.
    """

    motion: np.ndarray
    drive: np.ndarray
    S: np.ndarray
    N: np.ndarray
    a: np.ndarray
    b: np.ndarray

    def of(self, order: np.ndarray) -> "At":
        """The products at some of the places."""
        return At(*(x[order] for x in (self.motion, self.drive, self.S, self.N, self.a, self.b)))


def at_places(reduced: Reduced, places: Sequence[Place], targets: bool = True, apart: At | None = None) -> At:
    """Products at directions over the DoFs.

    Parameters
    ----------
    targets
        Whether ``N`` is wanted as well as what the changes need.
    apart
        The same with the runs apart, if ``reduced`` has them pooled and it is there already.
    """
    a, b = ends(places)

    def pair(x: np.ndarray, axis: int) -> np.ndarray:
        """Along ``axis``, first DoF less second; places first."""
        x = np.moveaxis(x, axis, 0)
        second = np.where(b >= 0, 1.0, 0.0).reshape(-1, *[1] * (x.ndim - 1))
        return x[a] - second * x[np.maximum(b, 0)]

    S = pair(reduced.S, 2)
    if apart is not None:
        return At(apart.motion, apart.drive, S, apart.N.sum(axis=1, keepdims=True), a, b)
    motion, drive = reduced.motion(a, b), reduced.drive(a, b)
    if not targets:
        return At(motion, drive, S, S[:0], a, b)
    N, (runs, lines, outputs, inputs) = [], reduced.weight2.shape
    weight2 = np.ascontiguousarray(reduced.weight2.transpose(1, 2, 0, 3)).reshape(lines, outputs, -1)
    for k in range(0, len(a), BATCH):
        column = reduced.column(a[k : k + BATCH], b[k : k + BATCH])
        square = (column.real**2 + column.imag**2) @ weight2
        N.append(square.reshape(lines, -1, runs, inputs).transpose(1, 2, 0, 3))
    return At(motion, drive, S, np.concatenate(N), a, b)


def ends(places: Sequence[Place]) -> tuple[np.ndarray, np.ndarray]:
    """Both DoFs of each place; the second is -1 at the ground."""
    index = np.array([p.index[:2] for p in places]).reshape(-1, 2)
    return index[:, 0], index[:, 1]
