"""What is to be known of a mode before it is used, in words, and a grade of how sure it is a mode at all."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from modalax.data.frf import FRF
from modalax.identify.disagreement import CERTAIN, Spread
from modalax.identify.kernels import UNDAMPED
from modalax.identify.quality import ModeQuality
from modalax.identify.record_kind import Record
from modalax.model.indicators import mac
from modalax.model.modal import ModalModel

COMPLEX = 0.8  # MPC below which a shape is called complex
HEAVY = 0.25  # damping ratio above which a pole is background
ALONE = 1.1  # channels that a mode is spread over, below which one sensor holds it, of at least three
VAGUE = 0.5  # standard deviation of the damping over the damping itself from which on it is called uncertain
BROADENED = 0.05  # part of the damping that a record's window adds from which on the record is called too short
MATTERS = 0.1  # disagreement on a frequency, in half-bandwidths, from which on it bends the FRFs visibly
BINS = {
    "padded": 2.0,
    "random": 1.0,
    "burst_half": 1.0,
    "burst_most": 1.0,
    "hann": 1.5,
}  # equivalent noise bandwidths of the records' windows, in lines
AROUND = 4  # lines on either side of a mode whose distances are those of the lines there
HALF_SURE = 3.0  # gain over that of noise at which evidence is half sure


class Modes(NamedTuple):
    """What is known of the modes of a fit when flags and grades are given.

    Attributes
    ----------
    frf, model
        The FRF and the modal model.
    frequency_std_hz, damping_std
        Standard deviations, or the scatter over the orders of the diagram where there are none, shape ``(n,)``; without
        what the window of a record changes, which says nothing against a mode.
    refined
        Whether they are standard deviations.
    stability
        Part of the orders at which each mode stands in the diagram, shape ``(n,)``.
    mpc
        Modal phase collinearity, shape ``(n,)``.
    quality
        What the data tell of each mode.
    record
        The kind of record that the resonances show, if another than a steady state.
    pairs
        Modes that the data do not tell apart, two and two.
    """

    frf: FRF
    model: ModalModel
    frequency_std_hz: Float[np.ndarray, " n"]
    damping_std: Float[np.ndarray, " n"]
    refined: bool
    stability: Float[np.ndarray, " n"]
    mpc: Float[np.ndarray, " n"]
    quality: list[ModeQuality]
    record: Record | None
    pairs: Sequence[tuple[int, int]] = ()

    @property
    def frequency(self) -> Float[np.ndarray, " n"]:
        """Natural frequencies [Hz]."""
        return np.asarray(self.model.frequency_hz)

    @property
    def half_bandwidth(self) -> Float[np.ndarray, " n"]:
        """Half of the half-power bandwidth of each mode [Hz]."""
        return -np.asarray(self.model.poles.real) / (2 * np.pi)

    def twins(self, r: int) -> list[int]:
        """Modes that the data do not tell from one of them."""
        return [b if a == r else a for a, b in self.pairs if r in (a, b)]

    def step(self, r: int) -> float:
        """Distance between the lines about a mode [Hz], which a stepped sine has closer there than elsewhere."""
        freq = np.asarray(self.frf.freq)
        k = int(np.searchsorted(freq, self.frequency[r]))
        first = max(0, min(k - AROUND, len(freq) - 2 * AROUND))
        return float(np.median(np.diff(freq[first : first + 2 * AROUND])))


def flags_of(modes: Modes) -> tuple[tuple[str, ...], ...]:
    """Flags of each mode, in words; an empty tuple for a mode of which there is nothing to be said."""
    return tuple(tuple(word for word in _words(modes, r) if word) for r in range(len(modes.frequency)))


def _words(modes: Modes, r: int) -> list[str]:
    """Flags of one mode; empty texts for those that do not apply."""
    f, width, step, q = float(modes.frequency[r]), float(modes.half_bandwidth[r]), modes.step(r), modes.quality[r]
    zeta = float(np.asarray(modes.model.damping_ratio)[r])
    first, last = modes.frf.ends
    inside = first <= f <= last
    lost = inside and modes.refined and not np.isfinite(modes.damping_std[r])
    bound = zeta <= 1.01 * UNDAMPED or zeta > HEAVY or lost
    weak = q.gain < q.chance_gain
    count = modes.frf.shape[1] * modes.frf.shape[2]
    edge = min(f - first, last - f) < max(width, 1.5 * step)
    vague = np.isfinite(modes.damping_std[r]) and modes.damping_std[r] > VAGUE * zeta
    return [
        "at a bound: the data do not determine its damping" if bound else "",
        "below the noise" if weak or q.peak < 1 else "",
        "one sensor only" if count >= 3 and q.channels < ALONE else "",
        _unresolved(modes, r),
        "edge of the band" if inside and edge else "outside the band" if not inside else "",
        f"complex (MPC {float(modes.mpc[r]):.2f})" if modes.mpc[r] < COMPLEX else "",
        _vague(modes, r) if vague else "",
        _record(modes, r),
        *(_disagreeing(spread, names, kind, f, width) for spread, names, kind in _sides(modes, r)),
    ]


def _vague(modes: Modes, r: int) -> str:
    part = 100 * float(modes.damping_std[r]) / float(np.asarray(modes.model.damping_ratio)[r])
    return f"damping uncertain by {part:.0f} %" + ("" if modes.refined else ", as it scatters over the orders")


def _unresolved(modes: Modes, r: int) -> str:
    """Whether a neighbour is nearer than the lines are, or the peak narrower."""
    others = np.delete(np.arange(len(modes.frequency)), r)
    apart = np.abs(modes.frequency[others] - modes.frequency[r])
    twins, step = modes.twins(r), modes.step(r)
    if len(twins):
        f = float(modes.frequency[twins[0]])
        return f"unresolved: one mode explains this one and that at {f:.5g} Hz as well"
    wide = 1.0 if modes.record is None else 2 * BINS[modes.record.kind]
    if len(others) and apart.min() < wide * step:
        f = float(modes.frequency[others[np.argmin(apart)]])
        seen = "" if modes.record is None else f" and the window of the record makes each peak {wide / 2:.2g} wide"
        return f"unresolved: {apart.min():.2g} Hz from the mode at {f:.5g} Hz, lines are {step:.2g} Hz apart{seen}"
    q, width = modes.quality[r], float(modes.half_bandwidth[r])
    if modes.record is None and stands_for_two(q, width):
        return (
            f"unresolved: one mode leaves {100 * q.rest.part:.2g} % of its response here, more than noise; two close "
            "modes, or a frequency that is not the same in all channels, would explain it"
        )
    lines = 2 * width / step
    return f"narrow: {lines:.2g} lines in its half-power bandwidth" if lines < 1 else ""


def _record(modes: Modes, r: int) -> str:
    """Whether the record ends before the mode has died out, where the resonances show that it matters."""
    record = modes.record
    if record is None or not np.isfinite(record.damping_ratio[r]):
        return ""
    zeta = float(record.damping_ratio[r])
    broader = float(np.asarray(modes.model.damping_ratio)[r]) > (1 + BROADENED) * zeta
    return f"record too short: without its window the damping is {100 * zeta:.3g} %" if broader else ""


def _sides(modes: Modes, r: int) -> list[tuple[Spread | None, tuple[str, ...], str]]:
    q = modes.quality[r]
    return [(q.inputs, modes.frf.inputs, "inputs"), (q.outputs, modes.frf.outputs, "outputs")]


def matters(spread: Spread | None, width: float) -> bool:
    """Whether parts of the data disagree on a frequency by more than noise and enough to bend the FRFs."""
    return spread is not None and spread.largest > MATTERS * width


def stands_for_two(quality: ModeQuality, width: float) -> bool:
    """Whether a mode leaves what a second one would, and inputs or outputs that disagree do not explain it."""
    return quality.rest.plain and not any(matters(s, width) for s in (quality.inputs, quality.outputs))


def _disagreeing(spread: Spread | None, names: tuple[str, ...], kind: str, f: float, width: float) -> str:
    if spread is None or not matters(spread, width):
        return ""
    size = spread.largest
    low, high = int(np.nanargmin(spread.shift)), int(np.nanargmax(spread.shift))
    return (
        f"{kind} disagree by up to {size:.2g} Hz ({100 * size / f:.2g} %), lowest {names[low]} "
        f"({spread.shift[low]:+.2g} Hz), highest {names[high]} ({spread.shift[high]:+.2g} Hz)"
    )


def grades_of(modes: Modes) -> Float[np.ndarray, " n"]:
    r"""How sure each mode is a mode, from 0 to 1: the product of what would give a false one away, shape ``(n,)``.

    - Evidence :math:`g/(g + 3 g_0)`, :math:`g` the gain of the likelihood and :math:`g_0` what noise alone reaches.
    - Strength: the mode's part of the response about its peak, against what is left there.
    - Deviations: :math:`1/(1 + (2\sigma_\zeta/\zeta)^2)` and :math:`1/(1 + (\sigma_f/\zeta f)^2)`.
    - Agreement: :math:`1/(1 + (\tau/\zeta f)^2)`, :math:`\tau` by how much flanks, inputs and outputs disagree.
    - Resolution: :math:`1 - c\,g'/(g + g')` for the nearest neighbours, :math:`g'` their gain and :math:`c` the chance
      that both are one mode: 1 where the data do not tell them apart, else :math:`\mathrm{MAC}/(1 + (d/d_0)^2)`,
      :math:`d_0` half a line, or the width of the window of a record (:data:`BINS`), or a tenth of the half-bandwidths,
      whichever is larger. One mode that is split into two of like strength so gives each an even chance.
    - Half of the weight each: stability in the diagram (:math:`(1+s)/2`) and MPC (:math:`(2+\mathrm{MPC})/3`).

    Each is a ratio of like quantities, none a constant fitted to data; a mode at a bound has grade 0.
    """
    return np.array([_grade(modes, r) for r in range(len(modes.frequency))])


def _grade(modes: Modes, r: int) -> float:
    q, f, width = modes.quality[r], float(modes.frequency[r]), float(modes.half_bandwidth[r])
    zeta = float(np.asarray(modes.model.damping_ratio)[r])
    inside = modes.frf.ends[0] <= f <= modes.frf.ends[1]
    std, f_std = float(modes.damping_std[r]), float(modes.frequency_std_hz[r])
    if zeta <= 1.01 * UNDAMPED or zeta > HEAVY or (inside and modes.refined and not np.isfinite(std)):
        return 0.0
    noise = HALF_SURE * q.chance_gain
    deviation = 1.0
    if np.isfinite(std) and np.isfinite(f_std):
        deviation = 1 / (1 + (2 * std / zeta) ** 2) / (1 + (f_std / width) ** 2)
    told = [s.between[0] for s in (q.lines, q.inputs, q.outputs) if s is not None and s.chance < CERTAIN]
    agreement = 1 / (1 + sum((t / width) ** 2 for t in told))
    soft = np.sqrt((1 + float(modes.stability[r])) / 2 * (2 + float(modes.mpc[r])) / 3)
    gain = max(q.gain, 0.0)
    return float(gain / (gain + noise) * q.share * deviation * agreement * _resolution(modes, r) * soft)


def _resolution(modes: Modes, r: int) -> float:
    """How well the mode is told from its neighbours by place or by shape; where it is not, its share of their gain."""
    model = modes.model
    shapes = model.shapes if model.shapes.shape[1] >= model.participation.shape[1] else model.participation
    alike = np.asarray(mac(np.asarray(shapes)[r][None], shapes))[0]
    apart = np.abs(modes.frequency - modes.frequency[r])
    bins = 0.5 if modes.record is None else BINS[modes.record.kind]
    unit = np.maximum(bins * modes.step(r), 0.1 * (modes.half_bandwidth + modes.half_bandwidth[r]))
    same = alike / (1 + (apart / unit) ** 2)
    same[modes.twins(r)] = 1.0
    same[r] = 0.0
    gain = np.maximum([q.gain for q in modes.quality], 0.0)
    return float(1 - np.max(same * gain / np.maximum(gain + gain[r], 1e-300)))


def notes_of(modes: Modes, grades: np.ndarray, noise: float, unexplained: float) -> list[str]:
    """Sentences on the measurement as a whole: records, disagreeing inputs or outputs, damping alike in all modes."""
    told = []
    if modes.record is not None:
        decay = 2 * np.pi * np.nanmin(modes.record.damping_ratio * modes.record.frequency_hz)
        left = np.exp(-decay * modes.record.duration)
        told.append(
            f"The resonances look like those of {modes.record.text()}, at the end of which up to {100 * left:.0f} % of "
            "the amplitude is left: frequencies stand, damping ratios are too large by the window; measure longer "
            "records or with a periodic excitation."
        )
    for side in ("inputs", "outputs"):
        told += _side_note(modes, side)
    told += _equal_decay(modes, grades)
    if unexplained > 0.02 and noise > 0.5 * unexplained:
        told.append(
            f"{100 * unexplained:.3g} % of the FRFs' sum of squares is not explained, of which "
            f"{100 * noise / unexplained:.0f} % is noise."
        )
    return told


def _side_note(modes: Modes, side: str) -> list[str]:
    """Which inputs, or outputs, disagree most over the modes in the band, in per cent of the frequencies."""
    spreads, f = [getattr(q, side) for q in modes.quality], modes.frequency
    inside = (f >= modes.frf.ends[0]) & (f <= modes.frf.ends[1])
    seen = [r for r, s in enumerate(spreads) if inside[r] and matters(s, float(modes.half_bandwidth[r]))]
    if not seen:
        return []
    names = getattr(modes.frf, side)
    size = max((spreads[r].largest / modes.frequency[r], r) for r in seen)
    relative = np.array([spreads[r].shift / modes.frequency[r] for r in seen])
    weight = np.array([np.nan_to_num(modes.frequency[r] / spreads[r].std, nan=0.0) ** 2 for r in seen])
    mean = np.sum(np.nan_to_num(relative) * weight, axis=0) / np.maximum(weight.sum(axis=0), 1e-300)
    worst = int(np.argmax(np.abs(mean)))
    many = f"{len(seen)} mode{'s' * (len(seen) > 1)}"
    return [
        f"The {side} disagree on the frequencies of {many}, most by {100 * size[0]:.2g} % at "
        f"{modes.frequency[size[1]]:.5g} Hz; {names[worst]} has them {100 * mean[worst]:+.2g} % off: the structure "
        "changed between the measurements, or the mass of a moving sensor loads it."
    ]


def _equal_decay(modes: Modes, grades: np.ndarray) -> list[str]:
    """Whether all modes that are sure decay at one rate, as an exponential window would have it."""
    first, last = modes.frf.ends
    inside = [r for r, f in enumerate(modes.frequency) if first <= f <= last and grades[r] > 0.5]
    rates = 2 * np.pi * modes.half_bandwidth[inside]
    f = modes.frequency[inside]
    if len(rates) < 3 or f.max() < 2 * f.min() or rates.max() > 1.3 * rates.min():
        return []
    if rates.min() < min(modes.step(r) for r in inside):
        return []
    return [
        f"All modes decay at nearly the same rate, {rates.min():.3g} to {rates.max():.3g} 1/s, as an exponential "
        "window makes them: if one was used, subtract its rate from the decay rates."
    ]
