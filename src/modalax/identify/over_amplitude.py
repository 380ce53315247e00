r"""Modes over the amplitude of the force, without a law: frequency and damping as smooth functions with a band.

Each run is fitted by itself (:func:`modalax.identify.fit`), and its modes are carried from level to level. Every
frequency, damping ratio and residue is then a Gaussian process over :math:`x = F^\beta`,

.. math:: y(x) = a + b x + \tau\,w(x) + e, \qquad
          \mathrm{cov}[w(x), w(x')] = \tfrac{m^3}{3} + \tfrac{m^2}{2}|x - x'|, \quad m = \min(x, x'),

the smoothing spline of Wahba (1978, J. R. Stat. Soc. B 40:364), straight beyond the levels that were measured, with
the variance of the fit in ``e``. The power :math:`\beta` is weighed by its evidence over all modes together, the bend
:math:`\tau` and the scatter beyond stated errors by that of each (Rasmussen and Williams 2006, sections 2.7 and 5.2).
"""

import itertools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import numpy as np
import scipy.optimize
from jaxtyping import Complex, Float

from modalax._numerics.checks import require_double
from modalax.data import FRF, Measurement
from modalax.data.frf import DERIVATIVES
from modalax.identify.fit import fit
from modalax.identify.overview import of_levels
from modalax.identify.residues import residues
from modalax.identify.smooth_series import Smooth, smooth
from modalax.model import ModalModel
from modalax.model.entry import refuse_traced
from modalax.model.modal import poles_from

FARTHEST = 0.08  # change of a frequency between neighbouring levels up to which a mode is the same
UNLIKE = 0.02  # relative change of frequency that counts as much as shapes at right angles
DRAWS = 100  # models drawn for the variance of a predicted FRF
LEAST, MOST = 1e-5, 0.999  # damping ratios that are predicted
ALIKE = (0.02, 0.999)  # range of the correlation of what two levels' fits leave
TINY = 1e-300  # a variance is above 0


class OverAmplitude(eqx.Module):
    """Modes of one structure at several levels of the force, and what they are in between and beyond.

    Attributes
    ----------
    level
        Force amplitude of each run as the measurement states it, rising, shape ``(r,)`` [N].
    frequency_hz, damping_ratio
        Of the modes seen at every level, shape ``(r, k)`` [Hz], [-].
    frequency_std_hz, damping_std
        Standard deviations by each fit alone, same shape.
    models
        Modes and residual terms of each run.
    measured
        The runs as they were fitted.
    seen_once
        Frequencies of modes that some levels show and others do not [Hz]; they are part of the rest.
    """

    level: Float[np.ndarray, " r"]
    frequency_hz: Float[np.ndarray, "r k"]
    damping_ratio: Float[np.ndarray, "r k"]
    frequency_std_hz: Float[np.ndarray, "r k"]
    damping_std: Float[np.ndarray, "r k"]
    models: tuple[ModalModel, ...]
    measured: tuple[FRF, ...]
    seen_once: tuple[float, ...]
    _frequency: Smooth
    _damping: Smooth
    _linear: Smooth

    def __str__(self) -> str:
        """Frequency and damping of each mode at the lowest and the highest level."""
        return of_levels(self)

    def modes(self, level: float) -> ModalModel:
        """The modal model at a level [N], with standard deviations of frequencies and damping ratios."""
        x = self._checked(level)
        (f, df), (z, dz) = self._frequency.at(x), self._damping.at(x)
        return self._model(f, np.clip(z, LEAST, MOST), self._linear.at(x)[0], frequency_std=df / f, damping_std=dz / z)

    def frf(self, level: float, freq: Any = None, *, rest: bool = True) -> FRF:
        """FRF at a level [N], with the variance that the band of the modes gives.

        Parameters
        ----------
        freq
            Lines [Hz]; those measured if None.
        rest
            At the measured lines: add what the modes leave, the modes seen at some levels only and distortion, carried
            over from the levels beside as far as it goes together from level to level (:meth:`rest`). It belongs to the
            signal of the test: leave it out for another one.
        """
        x, own = self._checked(level), self.measured[0]
        lines = np.asarray(own.freq if freq is None else freq, float)
        H = np.asarray(self.modes(level).frf(lines, form=own.form).H)
        rng = np.random.default_rng(0)
        (f, df), (z, dz), (A, dA) = (s.at(x) for s in (self._frequency, self._damping, self._linear))
        of = Response(lines, own.form, (len(f) + 2, len(own.outputs), len(own.inputs)))
        middle = of(f, z, A)
        drawn = (
            of(*(m + s * rng.standard_normal(m.shape) for m, s in ((f, df), (z, dz), (A, dA)))) for _ in range(DRAWS)
        )
        variance = sum(np.abs(H - middle) ** 2 for H in drawn) / DRAWS
        if rest and freq is None:
            left, power = self.rest(x)
            H, variance = H + left, variance + power
        return FRF(
            lines, H, form=own.form, variance=variance, level=level, outputs=own.outputs, inputs=own.inputs
        )  # fmt: skip

    def rest(self, level: float) -> tuple[Complex[np.ndarray, "f o i"], Float[np.ndarray, "f o i"]]:
        r"""What the modes leave of the FRF at a level, and its variance.

        A stationary process over :math:`\ln F` without memory beyond the levels beside (Ornstein and Uhlenbeck), its
        correlation between two levels that of what their fits leave: all of it where these agree, nothing where not.
        """
        left = [
            np.asarray(m.H) - np.asarray(model.frf(m.freq, form=m.form).H)
            for m, model in zip(self.measured, self.models, strict=True)
        ]
        size = [np.linalg.norm(e) for e in left]
        steps, at = np.diff(np.log(self.level)), np.log(level / self.level)
        alike = [np.vdot(a, b).real for a, b in itertools.pairwise(left)] / np.multiply(size[1:], size[:-1])
        rate = -np.log(np.clip(alike, ALIKE[0], ALIKE[1])) / steps  # of forgetting, per step
        before = int(np.searchsorted(self.level, level, side="right")) - 1
        if before < 0 or before == len(left) - 1:
            end = max(before, 0)
            share = np.exp(-rate[max(end - 1, 0)] * abs(at[end]))
            mean, lost = share * left[end], 1 - share**2
            return mean, np.maximum(lost * np.abs(left[end]) ** 2, TINY)
        first, whole = np.exp(-rate[before] * at[before]), np.exp(-rate[before] * steps[before])
        second = whole / first
        a, b = first - second * whole, second - first * whole
        near = np.array([a, b]) / (1 - whole**2)
        lost = 1 - near @ [first, second]
        mean = near[0] * left[before] + near[1] * left[before + 1]
        power = 0.5 * (np.abs(left[before]) ** 2 + np.abs(left[before + 1]) ** 2)
        return mean, np.maximum(lost * power, TINY)

    def band(self, levels: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Frequencies [Hz], their standard deviations, damping ratios and theirs at levels [N], shape ``(l, k)``."""
        every = [(*self._frequency.at(x), *self._damping.at(x)) for x in map(self._checked, np.asarray(levels))]
        f, df, z, dz = (np.array(part) for part in zip(*every, strict=True))
        return f, df, z, dz

    def _checked(self, level: float) -> float:
        if np.ndim(level) or not (np.isfinite(level) and level > 0):
            raise ValueError(f"level is {level}; a force amplitude in N above 0 is needed, one at a time")
        return float(level)

    def _model(self, f: np.ndarray, z: np.ndarray, linear: np.ndarray, **std: Any) -> ModalModel:
        """Modal model of frequencies, damping ratios and the packed residues and residual terms."""
        own, count = self.models[0], len(f)
        if not (f > 0).all():
            raise ValueError(
                f"a frequency falls below 0 at this level, too far from those measured, {self.level[0]:g} to "
                f"{self.level[-1]:g} N"
            )
        shape = (count + 2, len(own.outputs), len(own.inputs))
        A, poles = _unpacked(linear, shape), np.asarray(poles_from(f, np.clip(z, LEAST, MOST)))
        U, S, V = np.linalg.svd(A[:count], full_matrices=False)
        shapes, participation = U[:, :, 0] * S[:, :1], V[:, 0]
        return ModalModel(
            poles, shapes, participation, outputs=own.outputs, inputs=own.inputs, upper=A[count], lower=A[count + 1],
            **std,
        )  # fmt: skip


def over_amplitude(
    measurement: Measurement, *, band: tuple[float, float] | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> OverAmplitude:  # fmt: skip
    """Frequency, damping and shapes of every mode over the level of the force, and the FRF at any level.

    The variance of the measurement is not used: away from linear behaviour the misfit of modes is what counts, and it
    is estimated line by line from what each fit leaves.

    Parameters
    ----------
    measurement
        Runs at two levels or more, each with its ``level`` [N]; of one kind of test, so that a level means the same
        in all of them.
    band
        Frequencies to fit [Hz]; all by default.
    progress
        Called with a word on each step.

    Raises
    ------
    ValueError
        If levels are missing, not positive or alike, or no mode is seen at all of them.
    """
    require_double("over_amplitude")
    refuse_traced(measurement, "over_amplitude")
    if not isinstance(measurement, Measurement):
        raise ValueError(
            f"over_amplitude needs a Measurement of several runs, not a {type(measurement).__name__}; "
            "Measurement.from_frfs makes one of FRFs"
        )
    level = np.asarray(measurement.level, float)
    if not (np.isfinite(level) & (level > 0)).all() or len(np.unique(level)) < max(len(level), 2):
        raise ValueError(
            f"the runs' levels are {level.tolist()}; two runs or more are needed, each at a positive level of its own"
        )
    order = np.argsort(level)
    frfs, found = [], []
    for k in order:
        progress(f"fitting the run at {level[k]:g} N")
        one = fit(measurement.run(int(k)).replace(variance=None, averages=None), band=band)
        frfs.append(one.frf)
        found.append(_Run.of(one))
    chains = carried([run.poles for run in found], [run.shapes for run in found])
    if not len(chains):
        raise ValueError("no mode is seen at every level; look at the fits of the single runs, or choose a band")
    kept = [
        (run.poles[c], run.std[:, c]) for run, c in zip(found, np.array(chains).T, strict=True)
    ]  # fmt: skip
    models = tuple(residues(frf, poles) for frf, (poles, _) in zip(frfs, kept, strict=True))
    poles, std = np.array([p for p, _ in kept]), np.array([s for _, s in kept])
    f, z = np.abs(poles) / (2 * np.pi), -poles.real / np.abs(poles)
    once = [
        float(abs(p)) / (2 * np.pi) for k, run in enumerate(found) for j, p in enumerate(run.poles)
        if all(chain[k] != j for chain in chains)
    ]  # fmt: skip
    linear = np.array([_packed(m) for m in models])
    x = level[order]
    progress("smoothing over the level")
    return OverAmplitude(
        x, f, z, std[:, 0], std[:, 1], models, tuple(frfs), tuple(sorted(once)),
        smooth(x, f, std[:, 0]), smooth(x, z, std[:, 1]), smooth(x, linear, np.zeros_like(linear)),
    )  # fmt: skip


class _Run(eqx.Module):
    """Modes of one run inside the band."""

    poles: Complex[np.ndarray, " k"]
    shapes: Complex[np.ndarray, "k c"]
    std: Float[np.ndarray, "2 k"]

    @classmethod
    def of(cls, found: Any) -> "_Run":
        inside = np.asarray(found.inside)
        m, refined = found.model, found.refined
        both = np.einsum("ko,ki->koi", np.asarray(m.shapes), np.asarray(m.participation)).reshape(len(m.poles), -1)
        std = np.stack([np.asarray(refined.frequency_std_hz), np.asarray(refined.damping_std)])
        return cls(np.asarray(m.poles)[inside], both[inside], np.nan_to_num(std[:, inside]))


def carried(poles: list[np.ndarray], shapes: list[np.ndarray]) -> list[tuple[int, ...]]:
    """Modes seen at every level, each as its number in every run: pairs between neighbours, by frequency and MAC."""
    chains: list[tuple[int, ...]] = [(k,) for k in range(len(poles[0]))]
    for run in range(1, len(poles)):
        a, b = poles[run - 1], poles[run]
        moved = np.abs(np.log(np.abs(b)[None, :] / np.abs(a)[:, None]))
        unit = [s / np.linalg.norm(s, axis=1, keepdims=True) for s in (shapes[run - 1], shapes[run])]
        cost = moved / UNLIKE + 1 - np.abs(unit[0].conj() @ unit[1].T) ** 2
        rows, columns = scipy.optimize.linear_sum_assignment(np.where(moved < FARTHEST, cost, 1e3))
        to = {int(r): int(c) for r, c in zip(rows, columns, strict=True) if moved[r, c] < FARTHEST}
        chains = [(*chain, to[chain[-1]]) for chain in chains if chain[-1] in to]
    return chains


class Response:
    """FRFs of frequencies, damping ratios and packed residues at given lines, in plain NumPy for many draws."""

    def __init__(self, lines: np.ndarray, form: str, shape: tuple[int, ...]):
        self.s, self.shape = 2j * np.pi * lines[:, None], shape
        self.factor = (self.s ** DERIVATIVES[form])[:, :, None]

    def __call__(self, f: np.ndarray, z: np.ndarray, linear: np.ndarray) -> Complex[np.ndarray, "f o i"]:
        """The FRF, residual terms included."""
        A, z = _unpacked(linear, self.shape), np.clip(z, LEAST, MOST)
        poles = 2 * np.pi * f * (-z + 1j * np.sqrt(1 - z**2))
        count = len(f)
        H = np.tensordot(1 / (self.s - poles), A[:count], 1) + np.tensordot(
            1 / (self.s - poles.conj()), A[:count].conj(), 1
        )
        return self.factor * (H + A[count] + A[count + 1] / (self.s**2)[:, :, None])


def _unpacked(linear: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    half = int(np.prod(shape))
    return (linear[:half] + 1j * linear[half:]).reshape(shape)


def _packed(m: ModalModel) -> np.ndarray:
    """Residues, upper and lower residual term as one row of real numbers."""
    A = np.einsum("ko,ki->koi", np.asarray(m.shapes), np.asarray(m.participation))
    every = np.concatenate([A, np.asarray(m.upper)[None], np.asarray(m.lower)[None]]).ravel()
    return np.concatenate([every.real, every.imag])
