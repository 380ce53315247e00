r"""Joints fitted over force levels together with the linear modes, first without a law, then by the laws like that.

The joint without a law (:class:`~modalax.diagnose.causes.free_law.FreeLaw`) tells where it sits, how far any joint
there explains the levels, and its stiffness and loss over the amplitude. Every set of laws is compared with those
(:mod:`~modalax.diagnose.jointed.curves`), and the likeliest are fitted to the data. The highest level is predicted.

Real joints follow no law to the noise, so that the size of the error is not known beforehand: each sample is off by a
share of itself that is the same for all, with Jeffreys's prior for it at the fitted levels and at the predicted one,
and samples within the correlation length L of the lines count as one,

.. math:: \ln Z = -\tfrac{n}{2L}\ln\chi^2 - \tfrac{p}{2}\ln\tfrac{n}{L} - \tfrac{n_\mathrm{o}}{2L}\ln\chi^2_\mathrm{o},

n and :math:`n_\mathrm{o}` samples fitted and predicted, p unknowns (Schwarz 1978, Ann. Statist. 6:461; the prediction
as in Dawid 1984, J. R. Stat. Soc. A 147:278).
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from modalax.data import Measurement
from modalax.data.frf import DERIVATIVES
from modalax.diagnose.causes.base import JointCause
from modalax.diagnose.causes.free_law import FreeLaw
from modalax.diagnose.deadline import Deadline
from modalax.diagnose.decision.beliefs import believed
from modalax.diagnose.fitting.hypothesis import to_search
from modalax.diagnose.joint_laws import Explained, compare_laws, joint_task
from modalax.diagnose.jointed.curves import likeliest_sets
from modalax.diagnose.thresholds import THRESHOLDS
from modalax.model import ModalModel

KNOTS = (3, 6)  # values of stiffness and loss of a joint without a law
RELATIVE = 0.02  # share of each sample that is granted beside noise; only its relation to noise matters
FEWEST_LEVELS = 3
MOST_MODES = 3  # in the band
MOST_PLACES = 10  # to the ground at an output, or between two
FITTED = 5  # sets of laws that are fitted to the data


@dataclass(frozen=True)
class Fitted:
    """One joint, or none, with the linear modes, fitted to all levels but the highest.

    Attributes
    ----------
    explained
        The fit; its ``residual`` has the highest level too.
    fitted, held
        Relative error at the fitted levels, and at the highest one: norm of what is missed over that of the FRF.
    evidence
        Logarithm, beside the others.
    probability
        Among sets of laws.
    """

    explained: Explained
    fitted: float
    held: float
    evidence: float = 0.0
    probability: float = 0.0

    @property
    def names(self) -> tuple[tuple[str, tuple[str, ...]], ...]:
        """The laws and their places."""
        e = self.explained.extended
        return tuple(sorted((c.slug, p.where) for c, p in zip(e.causes, e.places, strict=True)))


@dataclass(frozen=True)
class Jointed:
    """What joints explain of the levels.

    Attributes
    ----------
    linear
        The modes alone.
    free
        Joints without a law, the likeliest first.
    laws
        Sets of laws, the likeliest first; none where no joint explains the levels.
    held
        Number of the run at the highest level.
    places
        How many places were compared.
    length
        Correlation length of the errors in lines.
    sigma
        Errors granted to the samples, in the unit of the measurement, shape ``(run, f, o, i)``.
    """

    linear: Fitted
    free: tuple[Fitted, ...]
    laws: tuple[Fitted, ...]
    held: int
    places: int
    length: float
    sigma: np.ndarray

    def explains(self, one: Fitted) -> bool:
        """Whether a joint leaves little of what the modes alone miss, at the fitted levels and beyond."""
        share = 1 - THRESHOLDS.explained_by_joint
        return one.held**2 < share * self.linear.held**2 and one.fitted**2 < share * self.linear.fitted**2


def suited(measurement: Measurement, simulation: ModalModel) -> bool:
    """Whether levels, modes and measured places are such that a joint can be fitted together with the modes."""
    level = np.asarray(measurement.level)
    levels = len(np.unique(level[np.isfinite(level)])) if np.isfinite(level).all() else 0
    count = len(measurement.outputs)
    few = len(np.asarray(simulation.poles)) <= MOST_MODES and count * (count + 1) // 2 <= MOST_PLACES
    driven = len(measurement.inputs) == 1 and measurement.inputs[0] in measurement.outputs
    return levels >= FEWEST_LEVELS and levels == len(level) and few and driven


def fit_joints(
    measurement: Measurement, modes: ModalModel, laws: Sequence[JointCause], late: Deadline,
    tell: Callable[[str], None],
) -> Jointed:  # fmt: skip
    """Fit joints without a law at every measured place, and sets of laws at the place that explains most.

    Parameters
    ----------
    measurement
        Runs at three levels or more, with one input.
    modes
        The modes to start from, those in the band.
    laws
        What to look for.
    late
        When no further fit begins.
    tell
        Called with each step, in words.
    """
    H = np.asarray(measurement.H)
    sigma, held = granted(measurement), highest(measurement)

    def fitted(
        sets: Sequence[Sequence[JointCause]], where: tuple[str, ...], starts: Sequence[np.ndarray] = ()
    ) -> list[Fitted]:
        found = compare_laws(measurement, modes, sets, place=where, sigma=sigma, held_out=[held], starts=starts)
        return [_with_errors(e, sigma, H, held) for e in found]

    names = measurement.outputs
    places = [*((n,) for n in names), *itertools.combinations(names, 2)]
    places = places[:1] if len(np.asarray(modes.poles)) == 1 and len(names) == 1 else places
    tell("fitting a joint without a law together with the modes")
    linear = fitted([[]], places[0])[0]
    rough = sorted(
        (fitted([[FreeLaw(KNOTS[0], reach_of(measurement, where, held))]], where)[0] for where in places),
        key=lambda one: one.explained.chi2,
    )
    where = tuple(rough[0].explained.extended.places[0].where)
    free = [rough[0]]
    for count in KNOTS[1:]:
        if not late():
            free += fitted([[FreeLaw(count, reach_of(measurement, where, held))]], where)
    length = correlation_length(min(free, key=lambda one: one.explained.chi2).explained.residual)
    free = ranked(free, length)
    found = Jointed(linear, tuple(free), (), held, len(places), length, sigma)
    if late() or not found.explains(free[0]):
        return found
    tell("comparing laws with the joint without one")
    task = joint_task(measurement, modes, where, sigma, [held])
    linear_part = free[0].explained.vector[len(free[0].explained.extended.params[0]) :]
    told: list[Fitted] = []
    for one, sizes in likeliest_sets(free[0].explained, task, laws, length)[:FITTED]:
        if not late():
            start = [to_search(law, p) for law, p in zip(one, sizes, strict=True)]
            told += fitted([one], where, [np.concatenate([*start, linear_part])])
    return Jointed(linear, tuple(free), tuple(weighed(ranked(told, length))), held, len(places), length, sigma)


def granted(measurement: Measurement) -> np.ndarray:
    """Error granted to each sample beside noise, in the unit of the measurement, shape ``(run, f, o, i)``."""
    noise = 0.0 if measurement.variance is None else np.asarray(measurement.variance)
    return np.sqrt(noise + (RELATIVE * np.abs(np.asarray(measurement.H))) ** 2)


def highest(measurement: Measurement) -> int:
    """Number of the run at the highest level, which is predicted."""
    return int(np.argmax(np.asarray(measurement.level)))


def reach_of(measurement: Measurement, where: tuple[str, ...], held: int) -> float:
    """Largest amplitude across a place at the fitted levels [m]."""
    H = np.asarray(measurement.H)
    at = [measurement.outputs.index(w) for w in where]
    across = np.abs(H[:, :, at[0], 0] - (H[:, :, at[1], 0] if len(at) > 1 else 0.0))
    level = np.asarray(measurement.level)[:, None] if measurement.force is None else np.asarray(measurement.force)
    omega = 2 * np.pi * np.asarray(measurement.freq)
    return float(np.delete(level * across / omega ** DERIVATIVES[measurement.form], held, axis=0).max())


def _with_errors(e: Explained, sigma: np.ndarray, H: np.ndarray, held: int) -> Fitted:
    left = np.abs(e.residual) * sigma / np.sqrt(2)
    size = lambda a, k: float(np.linalg.norm(np.delete(a, held, 0) if k is None else a[k]))
    each = [np.linalg.norm(left[k]) / np.linalg.norm(H[k]) for k in range(len(H)) if k != held]
    return Fitted(e, float(np.sqrt(np.mean(np.square(each)))), size(left, held) / size(H, held))


def correlation_length(residual: np.ndarray) -> float:
    r""":math:`1 + 2\sum_k\rho_k` lines over the first lags at which neighbours are alike, of complex residuals."""
    r = np.moveaxis(residual, 1, -1).reshape(-1, residual.shape[1])
    power, total = float((np.abs(r) ** 2).sum()), 1.0
    for lag in range(1, r.shape[1] // 2):
        rho = float((r[:, :-lag].conj() * r[:, lag:]).real.sum()) / max(power, 1e-300)
        if rho <= 0:
            break
        total += 2 * rho
    return total


def evidence(one: Fitted, length: float) -> float:
    """Logarithm of the evidence of a fit, with the priors of its laws."""
    e = one.explained
    r = np.abs(e.residual) ** 2
    held = float(r.sum()) - e.chi2
    count, out = e.samples / length, (2 * r.size - e.samples) / length
    prior = sum(math.log(c.prior) + believed(c.slug) for c in e.extended.causes)
    more = THRESHOLDS.several_causes * max(len(e.extended.causes) - 1, 0)
    size = -0.5 * count * math.log(e.chi2) - 0.5 * e.unknowns * math.log(count)
    return size - 0.5 * out * math.log(max(held, 1e-300)) + prior - more


def ranked(fits: Sequence[Fitted], length: float) -> list[Fitted]:
    """Fits by falling evidence."""
    told = [Fitted(f.explained, f.fitted, f.held, evidence(f, length)) for f in fits]
    return sorted(told, key=lambda one: -one.evidence)


def weighed(fits: Sequence[Fitted]) -> list[Fitted]:
    """The best fit of each set of names, with the probability of all its forms together."""
    if not fits:
        return []
    weight = np.exp([one.evidence - fits[0].evidence for one in fits])
    out: dict[object, Fitted] = {}
    for one in fits:
        p = float(sum(w for other, w in zip(fits, weight, strict=True) if other.names == one.names) / weight.sum())
        out.setdefault(one.names, Fitted(one.explained, one.fitted, one.held, one.evidence, p))
    return sorted(out.values(), key=lambda one: -one.probability)
