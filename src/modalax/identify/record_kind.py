"""The kind of record that resonances show, and the lines around modes as a kind of record would have them."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy.special
from jaxtyping import Complex, Float

from modalax.data.frf import FRF
from modalax.identify.best_poles import best_poles, trial
from modalax.identify.neighbourhood import LINES, MOST, WIDTH, Kernel, Neighbourhood, around
from modalax.identify.record_window import RECORDS, record_kernel
from modalax.model.modal import ModalModel

STRONG = 8  # modes that are asked about the record
CONTRARY = 2.0  # fall of the same, over all modes but the one most for a record, from which on they are against it
PLAIN = 60.0  # rise of twice the log-likelihood, over those modes, from which on a record is named


def duration(frf: FRF) -> float | None:
    """Length of a record whose lines these are, the inverse of their distance [s]; None where they are uneven."""
    steps = np.diff(np.asarray(frf.freq))
    if len(steps) < 2 or np.ptp(steps) > 1e-3 * np.median(steps):
        return None
    return float(1 / np.median(steps))


def noise_level(frf: FRF, left: float) -> float:
    """Power of the noise in units of what whitened the data: what the best trial leaves, unless less than is known."""
    return max(1.0, left) if frf.variance is not None else max(left, 1e-12)


def through(hood: Neighbourhood, record: str, T: float) -> Neighbourhood:
    """The lines around some modes as records of a kind and a length [s] would have them.

    What neighbours made as steady resonances is put back, and they are seen through the record too, with residues as
    free as before: all kinds of record have the same unknowns.
    """
    if record == "steady":
        return hood
    decay, step = float(hood.s[0].real), 2 * np.pi / T
    first = round(float(hood.s[0].imag) % step, 9)
    poles = np.array([decay + _as_recorded(complex(p) - decay, first, record, T) for p in hood.near])
    seen = hood._replace(kernel=_kernel(record, T))
    steady = hood.seen(hood.near)
    return seen._replace(
        data=hood.data + steady @ hood.near_residues, near=poles,
        fixed=np.concatenate([hood.fixed[:, : hood.fixed.shape[1] - len(poles)], seen.seen(poles)], axis=1),
    )  # fmt: skip


def _kernel(record: str, T: float) -> Kernel:
    """The kernel of a record, scaled as that of the steady state in the form of the FRF is at its peak."""
    return lambda s, pole: record_kernel(s, pole, T, record)


@lru_cache(maxsize=4096)
def _as_recorded(pole: complex, first: float, record: str, T: float) -> complex:
    """The pole whose resonance in a record looks most like a steady one, on lines ``first`` beside multiples of 1/T."""
    step = 2 * np.pi / T
    reach = max(WIDTH * -pole.real, LINES * step)
    lower, upper = max(1.0, np.ceil((pole.imag - reach) / step)), np.floor((pole.imag + reach) / step)
    s = 1j * (first + step * np.arange(lower, upper + 1, max(1, (upper - lower) // MOST)))
    one = np.ones((1, 1), complex)
    straight = np.stack([np.ones(len(s)), np.linspace(-1, 1, len(s))], axis=1).astype(complex)
    lines = Neighbourhood(
        s, (1 / (s - pole))[:, None], np.ones(len(s)), straight, one, np.array([pole]), 0, np.zeros(0, complex),
        one[:0], np.ones(1), 1, _kernel(record, T),
    )  # fmt: skip
    return complex(best_poles(lines, [pole])[0][0])


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
        trials = {k: trial(through(hood, k, T), hood.poles) for k in RECORDS}
        least = min(t.chi2 for t in trials.values())
        level = noise_level(frf, least / max(samples, 1))
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
        hood = through(hood.beside_twins() or hood, best, T)
        pole = best_poles(hood, hood.poles)[0][0]
        f[r], zeta[r] = abs(pole) / (2 * np.pi), -pole.real / abs(pole)
    plain = gains[best] >= PLAIN and excess[best] <= 0.5 * excess["steady"]
    return Record(best, T, f, zeta, float(scipy.special.expit(gains[best] / 2)), bool(plain))
