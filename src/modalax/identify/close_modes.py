"""Test whether two close modes are two, or one that a short record or unequal hits make look like two."""

from collections.abc import Iterable, Sequence

import numpy as np
import scipy.special
from jaxtyping import Complex, Float

from modalax.data.frf import FRF
from modalax.identify.best_poles import Trial, trial
from modalax.identify.neighbourhood import Neighbourhood, around
from modalax.identify.record_kind import duration, noise_level, through
from modalax.identify.record_window import RECORDS
from modalax.model.indicators import mac
from modalax.model.modal import ModalModel

CHANCE = 1e-6  # chance at which a second mode is found that is not there
NEAR = 1.5  # distance of modes, in lines or in sums of their half-bandwidths, below which they are asked about
ALIKE, FEW = 0.9, 4  # MAC from which on shapes are alike, and DoFs below which all are
UNLIKE = 0.5  # MAC of shapes of many DoFs below which they are those of two modes
MISFIT = 4.0  # power of what two modes leave, over the noise's, above which no evidence for the second is taken
MOSTLY = 0.7  # part of what a second mode explains from which on a record that is cut short takes its place
MANY = 16  # DoFs from which on shapes tell modes apart, and groups of channels that get a step, not a search, each
NARROWER = 0.2  # part of its half-bandwidth from which a peak is sought through the window of a record too
RANK = 10  # steps of alternating least squares
SURELY = 2.0  # times the evidence needed at which two modes are two without a search for the best one


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
    to input or from output to output, all with residues of rank one: two inputs tell two modes of one frequency. Two
    modes stay two if they are likelier than each of these by a likelihood ratio test at ``CHANCE``, its noise that of
    the lines or, where larger and correlated, what the best one leaves. Where two poles leave far more than the noise
    and look alike, the second is a sign of misfit and not of a mode.

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
    if likeness is not None and likeness < UNLIKE and max(frf.shape[1:]) >= MANY:
        # one mode has one shape in any record and at any hit, so only plain evidence is asked for
        two = _at(hood, hood.poles)
        level = noise_level(frf, two.chi2 / max(2 * hood.data.size - two.unknowns, 1))
        need = level * scipy.special.chdtri(two.unknowns // 2, CHANCE)
        if 2 * hood.least_of_one() - two.chi2 > SURELY * need:
            return True
        return bool(_best(hood, [_mean(hood)]).chi2 - two.chi2 > need)
    two = trial(hood, hood.poles)
    others = _of_one(frf, hood)
    one, least = others[0].poles, min(other.chi2 for other in others)
    if cut and others[0].chi2 - least > MOSTLY * (others[0].chi2 - two.chi2):
        return False
    _, n_out, n_in = frf.shape
    places = np.divmod(np.arange(n_out * n_in), n_in)
    others += [_apart(hood, one, place) for place in places if place.max() > 0]
    left = two.chi2 / max(2 * hood.data.size - two.unknowns, 1)
    scale = noise_level(frf, left) * _correlation(hood.left(two.poles), left)
    for other in others:
        need = scipy.special.chdtri(max(two.unknowns - other.unknowns, 1), CHANCE)
        if (other.chi2 - two.chi2) / scale < need:
            return False
    return bool(left < MISFIT) or (likeness is not None and likeness <= ALIKE)


def windows_split(frf: FRF, hoods: Iterable[Neighbourhood]) -> bool:
    """Whether one kind of record explains ``MOSTLY`` what the second of each two close modes does, for several of them.

    All modes were seen by one record; besides that with the strongest second mode the others must speak for it too, so
    that no single pair of true modes is taken for the work of a window.
    """
    seconds, gains = [], []
    for hood in hoods:
        two, others = trial(hood, hood.poles), _of_one(frf, hood)
        level = noise_level(frf, two.chi2 / max(2 * hood.data.size - two.unknowns, 1))
        seconds.append(max(others[0].chi2 - two.chi2, 0.0) / level)
        gains.append([min(max(others[0].chi2 - other.chi2, 0.0) / level, seconds[-1]) for other in others])
    if len(seconds) < 2:
        return False
    second, gain = np.array(seconds), np.array(gains)
    best, rest = int(np.argmax(gain.sum(axis=0))), np.arange(len(second)) != np.argmax(second)
    most = gain[:, best].sum() > MOSTLY * second.sum()
    return bool(most and gain[rest, best].sum() > 0.5 * second[rest].sum())


def _of_one(frf: FRF, hood: Neighbourhood) -> list[Trial]:
    """One mode in the place of two in a steady state, first, and in all other kinds of record."""
    mean, T = _mean(hood), duration(frf)
    broad = complex(mean.real - np.ptp(hood.poles.imag) / 2, mean.imag)
    steady = _best(hood, [*hood.poles, mean, broad])
    if T is None:
        return [steady]
    pole = complex(steady.poles[0])  # which the window of a record broadens
    starts = [pole, complex(NARROWER * pole.real, pole.imag)]
    return [steady, *(_best(through(hood, r, T), starts) for r in RECORDS if r != "steady")]


def _mean(hood: Neighbourhood) -> complex:
    """Mean of the poles, weighed by their peaks."""
    return complex(
        np.average(hood.poles, weights=np.sum(np.abs(hood.residues / hood.poles.real[:, None]) ** 2, axis=1))
    )


def _likeness(model: ModalModel, pair: tuple[int, int]) -> float | None:
    """MAC of the shapes of two modes; None where they have so few DoFs that all shapes are alike."""
    longer = model.shapes if model.shapes.shape[1] >= model.participation.shape[1] else model.participation
    if longer.shape[1] < FEW:
        return None
    return float(mac(longer[pair[0]][None], longer[pair[1]][None])[0, 0])


def _at(hood: Neighbourhood, poles: np.ndarray) -> Trial:
    """The poles as they are."""
    return Trial(2 * hood.squares_left(poles), 2 * len(poles) * (1 + hood.data.shape[1]), poles)


def _best(hood: Neighbourhood, starts: Sequence[complex]) -> Trial:
    leading = hood.leading()
    found = min((trial(hood, [s], leading) for s in starts), key=lambda t: t.chi2)
    size, residues = _residues(hood, found.poles[0])
    return _of_rank_one(hood, found, residues, np.full(len(residues), size))


def _residues(hood: Neighbourhood, pole: complex) -> tuple[float, Complex[np.ndarray, " c"]]:
    """Residues of one mode over the channels' noise, and the sum of squares that one of size one makes of its own."""
    Q = np.linalg.qr(hood.columns(()))[0]
    own = hood.seen([pole])[:, 0]
    own = own - Q @ (Q.conj().T @ own)
    size = max(float(np.vdot(own, own).real), 1e-300)
    return size, own.conj() @ hood.data / size


def _of_rank_one(hood: Neighbourhood, free: Trial, residues: np.ndarray, size: np.ndarray, bend: float = 0.0) -> Trial:
    r"""A trial of one mode with residues free in every channel, as one whose residues are of rank one, as a mode's are.

    Of the residues, whose errors go with the noise over ``size``, the nearest matrix of rank one is taken by
    alternating least squares. Each may be off it by a part ``bend`` of their root mean square: a normal deviation, with
    the unknowns that it stands for (MacKay 1992, equation 4.9).
    """
    shape = (-1, hood.inputs)
    if hood.inputs == 1 or len(residues) <= hood.inputs:
        return free
    noise = hood.noise.reshape(shape)
    R = residues.reshape(shape) * noise
    by_noise = 1 / np.maximum(size, 1e-300)
    off = bend**2 * float(np.mean(np.abs(residues) ** 2))
    weight = (1 / (by_noise + off)).reshape(shape) / noise**2
    y = np.linalg.svd(R, full_matrices=False)[2][0]
    x = np.zeros(len(R), complex)
    for _ in range(RANK):
        x = (weight * R) @ y.conj() / np.maximum(weight @ np.abs(y) ** 2, 1e-300)
        y = x.conj() @ (weight * R) / np.maximum(np.abs(x) ** 2 @ weight, 1e-300)
    lost = 2 * float(np.sum(weight * np.abs(R - np.outer(x, y)) ** 2))
    freedom = 2 * (R.size - sum(R.shape) + 1) * float(np.mean(by_noise / (by_noise + off)))
    return Trial(free.chi2 + lost, free.unknowns - round(freedom), free.poles)


def _apart(hood: Neighbourhood, start: Sequence[complex] | np.ndarray, place: np.ndarray) -> Trial:
    r"""One pole for each group of channels; of ``MANY`` groups or more, one step from the pole of all.

    What changes a pole by :math:`\delta` adds to a shape parts of other modes, of the size :math:`\delta` over their
    distance (a perturbation of first order), and one peak is seen only if that is more than its half-bandwidth. So the
    residues are of rank one but for a part that is the scatter of the poles over the half-bandwidth.
    """
    fitted = _searched if int(place.max()) + 1 < MANY else _stepped
    free, poles, residues, size = fitted(hood, np.asarray(start), place)
    told = size * np.abs(residues) ** 2
    own = poles[place]
    scatter = np.sqrt(np.average(np.abs(own - np.average(own, weights=told)) ** 2, weights=told))
    return _of_rank_one(hood, free, residues, size, float(scatter / -np.real(start[0])))


Groups = tuple[Trial, Complex[np.ndarray, " g"], Complex[np.ndarray, " c"], Float[np.ndarray, " c"]]


def _searched(hood: Neighbourhood, start: np.ndarray, place: np.ndarray) -> Groups:
    """Poles of groups of channels, each searched by itself, with residues and the squares that one of size 1 makes."""
    parts = [hood.channels(place == k) for k in range(int(place.max()) + 1)]
    trials = [trial(part, start) for part in parts]
    residues, size = np.zeros(len(place), complex), np.zeros(len(place))
    for k, (part, found) in enumerate(zip(parts, trials, strict=True)):
        size[place == k], residues[place == k] = _residues(part, found.poles[0])
    free = Trial(sum(t.chi2 for t in trials), sum(t.unknowns for t in trials), start)
    return free, np.array([t.poles[0] for t in trials]), residues, size


def _stepped(hood: Neighbourhood, start: np.ndarray, place: np.ndarray) -> Groups:
    """As :func:`_searched`, by one step from the pole of all channels."""
    count, pole = int(place.max()) + 1, complex(start[0])
    Q = np.linalg.qr(hood.columns([pole]))[0]
    left = hood.data - Q @ (Q.conj().T @ hood.data)
    change = hood.weight * hood.s**hood.power / (hood.s - pole) ** 2
    change = change - Q @ (Q.conj().T @ change)
    own, R = _residues(hood, pole)
    size = np.maximum(np.bincount(place, np.abs(R) ** 2, count) * np.sum(np.abs(change) ** 2), 1e-300)
    asked = R.conj() * (change.conj() @ left)
    asked = np.bincount(place, asked.real, count) + 1j * np.bincount(place, asked.imag, count)
    chi2 = 2 * (float(np.sum(np.abs(left) ** 2)) - float(np.sum(np.abs(asked) ** 2 / size)))
    free = Trial(chi2, 2 * (count + hood.data.shape[1]), start)
    return free, pole + asked / size, R, np.full(len(R), own)


def _correlation(left: Complex[np.ndarray, "m c"], level: float) -> float:
    """Lines that one independent one stands for, where the residual is more than noise."""
    if level < 1.5 or len(left) < 3:
        return 1.0
    power = np.vdot(left, left).real
    rho = float(np.sum(left[1:] * left[:-1].conj()).real / max(power, 1e-300))
    return (1 + min(max(rho, 0.0), 0.9)) / (1 - min(max(rho, 0.0), 0.9))
