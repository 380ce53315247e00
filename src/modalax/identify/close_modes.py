"""Test whether two close modes are two, or one that a short record or unequal hits make look like two."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.special
from jaxtyping import Complex, Float

from modalax.data.frf import FRF
from modalax.identify.neighbourhood import Kernel, Neighbourhood, around, best_poles
from modalax.identify.record_window import RECORDS, record_kernel
from modalax.model.indicators import mac
from modalax.model.modal import ModalModel

CHANCE = 1e-6  # chance at which a second mode is found that is not there
NEAR = 1.5  # distance of modes, in lines or in sums of their half-bandwidths, below which they are asked about
ALIKE, FEW = 0.9, 4  # MAC from which on shapes are alike, and DoFs below which all are
UNLIKE = 0.5  # MAC of shapes of many DoFs below which they are those of two modes
MISFIT = 4.0  # power of what two modes leave, over the noise's, above which no evidence for the second is taken
MOSTLY = 0.7  # part of what a second mode explains from which on a record that is cut short takes its place
MANY = 16  # DoFs from which on shapes tell modes apart, and groups of channels that get a step, not a search, each
SURELY = 2.0  # times the evidence needed at which two modes are two without a search for the best one
STRONG = 8  # modes that are asked about the record
CONTRARY = 2.0  # fall of the same, over all modes but the one most for a record, from which on they are against it
PLAIN = 60.0  # rise of twice the log-likelihood, over those modes, from which on a record is named


class Trial(NamedTuple):
    """One way to explain the lines around some modes: twice the negative log-likelihood, unknowns, and poles."""

    chi2: float
    unknowns: int
    poles: Complex[np.ndarray, " n"]


def duration(frf: FRF) -> float | None:
    """Length of a record whose lines these are, the inverse of their distance [s]; None where they are uneven."""
    steps = np.diff(np.asarray(frf.freq))
    if len(steps) < 2 or np.ptp(steps) > 1e-3 * np.median(steps):
        return None
    return float(1 / np.median(steps))


def kernel_of(frf: FRF, record: str, T: float) -> Kernel:
    """The kernel of a record, scaled as that of the steady state in the form of the FRF is at its peak."""
    return lambda s, pole: record_kernel(s, pole, T, record)


def two_modes(
    frf: FRF,
    model: ModalModel,
    residual: Complex[np.ndarray, "f o i"],
    pair: tuple[int, int],
    cut: bool = False,
    scatter: Float[np.ndarray, "f c"] | None = None,
) -> bool:
    r"""Whether the lines around two modes hold more than one mode can make in any usual record.

    Compared with two poles are one pole in each kind of record (:data:`RECORDS`), and one pole that differs from input
    to input or from output to output. Two modes stay two if they are likelier than each of these by a likelihood
    ratio test at ``CHANCE``, its noise that of the lines or, where larger and correlated, what the best one leaves.
    Where two poles leave far more than the noise and look alike, the second is a sign of misfit and not of a mode.

    Where the records are known to be ``cut``, leakage adds noise that follows the response: there one mode in a record
    also stands for two if it explains ``MOSTLY`` of what the second one does. All of this must hold for noise that is
    even over the lines and for noise that follows their scatter.
    """
    likeness = _likeness(model, pair)
    # Where the variance is known, it tells the course over the lines.
    courses = (False, True) if frf.variance is None else (False,)
    hoods = (around(frf, model, residual, pair, smooth, scatter) for smooth in courses)
    return all(told_apart(frf, hood, likeness, cut) for hood in hoods)


def told_apart(frf: FRF, hood: Neighbourhood, likeness: float | None = None, cut: bool = False) -> bool:
    """Whether the lines around two modes hold both of them; see :func:`two_modes`.

    Parameters
    ----------
    frf
        The FRF.
    hood
        The lines around the two, with their poles and residues.
    likeness
        MAC of their shapes; None where they have too few DoFs to be compared.
    cut
        Whether the records are known to end before the modes have died out.
    """
    mean = np.average(hood.poles, weights=np.sum(np.abs(hood.residues / hood.poles.real[:, None]) ** 2, axis=1))
    broad = complex(mean.real - np.ptp(hood.poles.imag) / 2, mean.imag)
    if likeness is not None and likeness < UNLIKE and max(frf.shape[1:]) >= MANY:
        # one mode has one shape in any record and at any hit, so only plain evidence is asked for
        two = _at(hood, hood.poles)
        level = _level(frf, two.chi2 / max(2 * hood.data.size - two.unknowns, 1))
        need = level * scipy.special.chdtri(two.unknowns // 2, CHANCE)
        if 2 * hood.least_of_one() - two.chi2 > SURELY * need:
            return True
        return bool(_best(hood, [mean], None, hood.leading()).chi2 - two.chi2 > need)
    leading = hood.leading()
    two = _trial(hood, hood.poles, leading=leading)
    starts = [*hood.poles, mean, broad]
    others = [_best(hood, starts, None, leading)]
    T = duration(frf)
    if T is not None:
        others += [_best(hood, starts, kernel_of(frf, r, T), leading) for r in RECORDS if r != "steady"]
    least = min(other.chi2 for other in others)
    if cut and others[0].chi2 - least > MOSTLY * (others[0].chi2 - two.chi2):
        return False
    one = others[0].poles
    _, n_out, n_in = frf.shape
    places = np.divmod(np.arange(n_out * n_in), n_in)
    others += [_apart(hood, one, place) for place in places if place.max() > 0]
    left = two.chi2 / max(2 * hood.data.size - two.unknowns, 1)
    scale = _level(frf, left) * _correlation(hood.left(two.poles), left)
    for other in others:
        need = scipy.special.chdtri(max(two.unknowns - other.unknowns, 1), CHANCE)
        if (other.chi2 - two.chi2) / scale < need:
            return False
    return bool(left < MISFIT) or (likeness is not None and likeness <= ALIKE)


def _likeness(model: ModalModel, pair: tuple[int, int]) -> float | None:
    """MAC of the shapes of two modes; None where they have so few DoFs that all shapes are alike."""
    longer = model.shapes if model.shapes.shape[1] >= model.participation.shape[1] else model.participation
    if longer.shape[1] < FEW:
        return None
    return float(mac(longer[pair[0]][None], longer[pair[1]][None])[0, 0])


def _level(frf: FRF, left: float) -> float:
    """Power of the noise in units of what whitened the data: what the best trial leaves, unless less than is known."""
    return max(1.0, left) if frf.variance is not None else max(left, 1e-12)


def _at(hood: Neighbourhood, poles: np.ndarray) -> Trial:
    """The poles as they are."""
    return Trial(2 * hood.squares_left(poles), 2 * len(poles) * (1 + hood.data.shape[1]), poles)


def _trial(
    hood: Neighbourhood, start: Sequence[complex] | np.ndarray, kernel: Kernel | None = None,
    leading: np.ndarray | None = None,
) -> Trial:  # fmt: skip
    poles, chi2 = best_poles(hood, start, kernel, leading)
    return Trial(2 * chi2, 2 * len(poles) * (1 + hood.data.shape[1]), poles)


def _best(hood: Neighbourhood, starts: Sequence[complex], kernel: Kernel | None, leading: np.ndarray) -> Trial:
    return min((_trial(hood, [s], kernel, leading) for s in starts), key=lambda t: t.chi2)


def _apart(hood: Neighbourhood, start: Sequence[complex] | np.ndarray, place: np.ndarray) -> Trial:
    """One pole for each group of channels; of ``MANY`` groups or more, one step from the pole of all."""
    count = int(place.max()) + 1
    if count < MANY:
        trials = [_trial(hood.channels(place == k), start) for k in range(count)]
        return Trial(sum(t.chi2 for t in trials), sum(t.unknowns for t in trials), np.asarray(start))
    pole = complex(start[0])
    Q = np.linalg.qr(hood.columns([pole]))[0]
    left = hood.data - Q @ (Q.conj().T @ hood.data)
    change = hood.weight * hood.s**hood.power / (hood.s - pole) ** 2
    change = change - Q @ (Q.conj().T @ change)
    own = hood.weight * hood.s**hood.power / (hood.s - pole)
    R = (np.linalg.pinv(hood.columns([pole])) @ hood.data)[0] / np.linalg.norm(own)
    size = np.bincount(place, np.abs(R) ** 2, count) * np.sum(np.abs(change) ** 2)
    asked = R.conj() * (change.conj() @ left)
    asked = np.bincount(place, asked.real, count) + 1j * np.bincount(place, asked.imag, count)
    gained = float(np.sum(np.abs(asked) ** 2 / np.maximum(size, 1e-300)))
    return Trial(2 * (float(np.sum(np.abs(left) ** 2)) - gained), 2 * (count + hood.data.shape[1]), np.asarray(start))


def _correlation(left: Complex[np.ndarray, "m c"], level: float) -> float:
    """Lines that one independent one stands for, where the residual is more than noise."""
    if level < 1.5 or len(left) < 3:
        return 1.0
    power = np.vdot(left, left).real
    rho = float(np.sum(left[1:] * left[:-1].conj()).real / max(power, 1e-300))
    return (1 + min(max(rho, 0.0), 0.9)) / (1 - min(max(rho, 0.0), 0.9))


class Record(NamedTuple):
    """A kind of record that explains the resonances better than a steady state.

    Attributes
    ----------
    kind
        A key of ``RECORDS``.
    duration
        Its length [s].
    frequency_hz, damping_ratio
        Of each mode through it, shape ``(n,)``; NaN for those not asked about.
    probability
        That it is one of this kind rather than a steady state, by the likelihood of the resonances.
    plain
        Whether the resonances show it so plainly that it is to be told.
    """

    kind: str
    duration: float
    frequency_hz: Float[np.ndarray, " n"]
    damping_ratio: Float[np.ndarray, " n"]
    probability: float = 1.0
    plain: bool = True

    def text(self) -> str:
        """The kind of record in words."""
        return RECORDS[self.kind].format(T=self.duration)


def _telling(
    frf: FRF, model: ModalModel, residual: Complex[np.ndarray, "f o i"], order: np.ndarray
) -> list[Neighbourhood]:
    """The lines around the ``STRONG`` modes that come first in an order, and around which no earlier one stands.

    What the window of a record makes of another mode there is still in the data.
    """
    f, found, asked = np.abs(np.asarray(model.poles)), [], []
    for r in order:
        hood = around(frf, model, residual, [int(r)])
        low, high = np.min(hood.s.imag), np.max(hood.s.imag)
        if not any(low <= f[q] <= high for q in asked):
            found.append(hood)
        asked.append(int(r))
        if len(found) == STRONG:
            break
    return found


def record_of(frf: FRF, model: ModalModel, residual: Complex[np.ndarray, "f o i"], which: np.ndarray) -> Record | None:
    r"""The kind of record that some modes show; None where a steady state explains them as well.

    Asked are the ``STRONG`` modes that tell most: a window changes a resonance of the decay rate :math:`\sigma` by a
    part of the order of :math:`(\sigma T)^{-2}`. A kind is plain if it raises twice the log-likelihood by ``PLAIN``, in
    units of what it leaves, and leaves less than half of the misfit. All modes were seen by one record: a kind that one
    mode alone asks for, against the others, is the misfit of that mode.
    """
    T = duration(frf)
    if T is None or not len(which):
        return None
    poles = np.asarray(model.poles)
    size = np.sum(np.abs(np.asarray(model.residues)) ** 2, axis=(1, 2)) / np.abs(poles.real)
    told = size / (1 + (poles.real * T) ** 2) ** 2
    hoods = _telling(frf, model, residual, np.asarray(which)[np.argsort(-told[which])])
    own, excess = {k: np.zeros(len(hoods)) for k in RECORDS}, dict.fromkeys(RECORDS, 0.0)
    for j, hood in enumerate(hoods):
        samples = 2 * hood.data.size - 2 * (1 + hood.data.shape[1])
        leading = hood.leading()
        trials = {k: _trial(hood, hood.poles, kernel_of(frf, k, T), leading) for k in RECORDS}
        least = min(t.chi2 for t in trials.values())
        level = _level(frf, least / max(samples, 1))
        for k, t in trials.items():
            own[k][j] = (trials["steady"].chi2 - t.chi2) / level
            excess[k] += max(t.chi2 / level - samples, 0.0)
    against = {k: len(g) > 1 and g.sum() - g.max() < -CONTRARY for k, g in own.items()}
    gains = {k: -np.inf if against[k] else float(g.sum()) for k, g in own.items()}
    best = max(gains, key=lambda k: gains[k])
    if best == "steady":
        return None
    f, zeta = np.full(len(poles), np.nan), np.full(len(poles), np.nan)
    for r in which:
        hood = around(frf, model, residual, [int(r)])
        pole = best_poles(hood, hood.poles, kernel_of(frf, best, T))[0][0]
        f[r], zeta[r] = abs(pole) / (2 * np.pi), -pole.real / abs(pole)
    plain = gains[best] >= PLAIN and excess[best] <= 0.5 * excess["steady"]
    return Record(best, T, f, zeta, float(scipy.special.expit(gains[best] / 2)), bool(plain))
