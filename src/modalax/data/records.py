"""FRFs from time records: continuous random excitation, repeated blocks, hammer hits."""

from collections.abc import Sequence
from types import ModuleType
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Complex, Float, Int

from modalax._numerics.checks import as_array, as_double, is_traced, require_finite
from modalax._numerics.cuts import cut
from modalax._numerics.known import Numbers, by_numpy, host, stacked
from modalax.data.frf import FRF, band_slice
from modalax.data.hits import find_hits, good_hits
from modalax.data.spectra import Spectra, estimate, multiple_coherence, ordinary_coherence, spectra, spectral_lines
from modalax.data.windows import effective_averages, exponential_window, force_window, taper


class Quantity(NamedTuple):
    """Form of an FRF, and the factor that brings its response to SI units."""

    form: str
    factor: float


QUANTITIES = {
    "m": Quantity("receptance", 1.0),
    "m/s": Quantity("mobility", 1.0),
    "m/s^2": Quantity("accelerance", 1.0),
    "g": Quantity("accelerance", 9.80665),
}
# Forces whose coherency matrix has a smallest eigenvalue below this cannot be told apart: they act as one force.
DEPENDENT = 1e-10


def quantity(unit: str) -> Quantity:
    """Form of the FRF and factor to SI units of a response in ``unit``.

    Raises
    ------
    ValueError
        If the unit is not known; the message lists those that are.
    """
    if unit not in QUANTITIES:
        raise ValueError(f"unit is {unit!r}; a response can be in {', '.join(QUANTITIES)}")
    return QUANTITIES[unit]


def frf_from_records(
    force: Any,
    response: Any,
    fs: float,
    *,
    unit: str,
    block: float,
    overlap: float = 0.5,
    window: str = "hann",
    estimator: str = "H1",
    band: tuple[float, float] | None = None,
    level: Any = float("nan"),
    outputs: Sequence[str] | None = None,
    inputs: Sequence[str] | None = None,
) -> FRF:
    r"""FRF of a continuous record, by averaging overlapping blocks (Welch).

    Parameters
    ----------
    force
        Forces, shape ``(t,)`` for one or ``(t, i)`` [N].
    response
        Responses, shape ``(t,)`` for one or ``(t, o)`` [``unit``].
    fs
        Sampling rate [Hz].
    unit
        Unit of the responses: ``m``, ``m/s``, ``m/s^2`` or ``g``; it decides the form of the FRF.
    block
        Length of a block [s]; lines are ``1/block`` apart.
    overlap
        Share of a block that the next one repeats.
    window
        Taper of each block by its name in ``scipy.signal``.
    estimator
        ``H1``, ``H2`` or ``Hv``; see :func:`modalax.data.spectra.estimate`.
    band
        Lines to keep [Hz]; all but 0 Hz and half the sampling rate if None.
    level, outputs, inputs
        As in :class:`modalax.data.FRF`.

    Returns
    -------
    FRF
        With its coherences and the variance of the averaged FRF. ``averages`` is the number of independent repeats
        with the degrees of freedom of that variance: effective blocks (:func:`effective_averages`) less inputs plus
        one, rounded down. What leaks out of a block counts as noise in both, but it also makes a bias.

    Raises
    ------
    ValueError
        If shapes, block or unit do not fit, a force is dead at a line, or the forces are one.
    """
    force, response = _record(force, "force"), _record(response, "response")
    if len(force) != len(response):
        raise ValueError(f"force has {len(force)} samples and response {len(response)}; they need the same clock")
    samples, starts, step = welch_starts(len(force), fs, block, overlap)
    factors = taper(window, samples)
    averages = effective_averages(factors, step, len(starts))
    blocks = (_still_blocks(a, starts[:, None] + np.arange(samples)) for a in (force, response))
    averaged = spectra(*blocks, as_array(factors), fs=float(fs), averages=averages)
    lines = spectral_lines(samples, fs)
    return frf_of_spectra(averaged, lines, estimator, unit, band, level=level, outputs=outputs, inputs=inputs)


def welch_starts(length: int, fs: float, block: float, overlap: float) -> tuple[int, Int[np.ndarray, " m"], int]:
    """Samples of a block, where each block of a record begins, and the step from one to the next.

    Raises
    ------
    ValueError
        If the record is shorter than a block, or block or overlap make no sense.
    """
    samples = round(block * fs)
    if not 0 <= overlap < 1 or not 3 <= samples <= length:
        raise ValueError(
            f"blocks of {block:g} s ({samples} samples) with overlap {overlap:g} from a record of {length / fs:g} s; a "
            "block needs at least 3 samples, no more than the record, and an overlap of at least 0 and below 1"
        )
    step = max(1, round(samples * (1 - overlap)))
    return samples, np.arange(0, length - samples + 1, step), step


def frf_from_blocks(
    force: Any,
    response: Any,
    fs: float,
    *,
    unit: str,
    estimator: str = "H1",
    window: Any = None,
    decay: Any = 0.0,
    band: tuple[float, float] | None = None,
    level: Any = float("nan"),
    outputs: Sequence[str] | None = None,
    inputs: Sequence[str] | None = None,
) -> FRF:
    r"""FRF of independent blocks: hits, bursts, sweeps, or periods of a periodic excitation.

    Parameters
    ----------
    force
        Blocks of the forces, shape ``(m, t, i)`` [N].
    response
        Blocks of the responses, shape ``(m, t, o)`` [``unit``].
    fs
        Sampling rate [Hz].
    unit
        Unit of the responses: ``m``, ``m/s``, ``m/s^2`` or ``g``; it decides the form of the FRF.
    estimator
        ``H1``, ``H2`` or ``Hv``; see :func:`modalax.data.spectra.estimate`.
    window
        Factors ``(t,)`` on all channels, such as :func:`modalax.data.windows.taper`; none by default.
    decay
        Decay rate of an exponential window on all channels [1/s]; kept in ``added_decay`` for identification to take
        back out.
    band, level, outputs, inputs
        As for :func:`frf_from_records`.

    Returns
    -------
    FRF
        With coherences, variance and averages where there are more blocks than inputs.

    Raises
    ------
    ValueError
        If shapes or unit do not fit, there are fewer blocks than inputs, a force is dead at a line, or the forces
        are one.
    """
    force, response = as_double(force, "force"), as_double(response, "response")
    if force.ndim != 3 or response.ndim != 3 or force.shape[:2] != response.shape[:2]:
        raise ValueError(
            f"force has shape {force.shape} and response {response.shape}; they need (m, t, i) and (m, t, o) with one "
            "m and t: block, sample, channel"
        )
    count, samples, _ = force.shape
    factors = np.ones(samples) if window is None else as_double(window, "window")
    factors = as_array(host(factors) * host(exponential_window(samples, fs, decay)))
    averaged = spectra(force, response, factors, fs=float(fs), averages=float(count))
    lines = spectral_lines(samples, fs)
    return frf_of_spectra(
        averaged, lines, estimator, unit, band, level=level, outputs=outputs, inputs=inputs, added_decay=decay
    )  # fmt: skip


def frf_from_hits(
    force: Any,
    response: Any,
    fs: float,
    *,
    unit: str,
    block: float,
    trigger: float = 0.2,
    pretrigger: float = 0.0,
    contact: float | None = None,
    decay: Any = 0.0,
    full_scale: Any = None,
    keep_all: bool = False,
    estimator: str = "H1",
    band: tuple[float, float] | None = None,
    outputs: Sequence[str] | None = None,
    input: str | None = None,
) -> FRF:
    """FRF of a record of several hammer hits at one point.

    Hits are found and cut by :func:`modalax.data.hits.find_hits`; double hits and overloads are left out with a
    warning. The mean before the trigger is taken off each channel, the force is windowed around the contact, and the
    exponential window goes on all channels alike.

    Parameters
    ----------
    force
        Force record, shape ``(t,)`` [N].
    response
        Response records, shape ``(t,)`` for one or ``(t, o)`` [``unit``].
    fs
        Sampling rate [Hz].
    unit
        Unit of the responses: ``m``, ``m/s``, ``m/s^2`` or ``g``; it decides the form of the FRF.
    block, trigger, pretrigger, full_scale
        How hits are found; see :func:`modalax.data.hits.find_hits`.
    contact
        Duration of the force window from the trigger on [s]; no force window if None.
    decay
        Decay rate of the exponential window [1/s], for example ``decay_to(0.01, block)``.
    keep_all
        Keep double hits and overloads too. A double hit only thins out the spectrum of the force at some lines; an
        overload makes a wrong FRF.
    estimator, band, outputs
        As for :func:`frf_from_records`; ``input`` names the point hit. ``level`` is left unknown: a hit has no force
        amplitude.

    Raises
    ------
    ValueError
        If no usable hit is found, or shapes or unit do not fit.
    """
    force, response = np.asarray(_record(force, "force")), np.asarray(_record(response, "response"))
    if force.shape[1] != 1:
        raise ValueError(f"force has {force.shape[1]} channels; a record of hits has 1, the hammer")
    hits = find_hits(
        force[:, 0], response, fs, block=block, trigger=trigger, pretrigger=pretrigger, full_scale=full_scale
    )
    if not keep_all:
        hits = good_hits(hits)
    blocks_f, blocks_x = hits.cut(force), hits.cut(response)
    before = round(pretrigger * fs)
    if before:
        blocks_f, blocks_x = (b - b[:, :before].mean(axis=1, keepdims=True) for b in (blocks_f, blocks_x))
    if contact is not None:
        # The threshold is crossed on the way up: what comes before it within one contact is kept as well.
        start = max(0.0, pretrigger - contact)
        keep = force_window(hits.samples, fs, pretrigger + contact, start, ramp=contact / 2)
        blocks_f = blocks_f * np.asarray(keep)[:, None]
    return frf_from_blocks(
        blocks_f, blocks_x, fs, unit=unit, estimator=estimator, decay=decay, band=band, outputs=outputs,
        inputs=None if input is None else [input],
    )  # fmt: skip


def average_frfs(frfs: Sequence[FRF]) -> FRF:
    r"""Mean of repeated FRFs and its variance from their scatter, :math:`\sum_k|H_k-\bar H|^2/(m(m-1))`.

    Raises
    ------
    ValueError
        If there are fewer than 2, or they differ in lines, channels or form.
    """
    if len(frfs) < 2:
        raise ValueError(f"{len(frfs)} FRFs; at least 2 repeats are needed for a variance")
    first = frfs[0]
    for k, frf in enumerate(frfs[1:], start=1):
        same = (frf.outputs, frf.inputs, frf.form, frf.shape) == (first.outputs, first.inputs, first.form, first.shape)
        if not same or not np.array_equal(np.asarray(frf.freq), np.asarray(first.freq)):
            raise ValueError(f"FRF {k} differs from FRF 0 in its lines, channels or form; they must be the same")
        if not is_traced(frf.added_decay) and float(frf.added_decay) != float(first.added_decay):
            raise ValueError(
                f"FRF {k} has an added decay of {float(frf.added_decay):g} 1/s and FRF 0 of "
                f"{float(first.added_decay):g}; average FRFs of one exponential window only"
            )
    mean, variance = _mean_of(stacked([frf.H for frf in frfs]))
    return first.replace(H=mean, variance=variance, coherence=None, multiple_coherence=None, averages=len(frfs))


@by_numpy
def _mean_of(xp: ModuleType, repeats: Numbers) -> tuple[Complex[Numbers, "f o i"], Float[Numbers, "f o i"]]:
    """Mean of repeats and the variance of it."""
    mean = repeats.mean(axis=0)
    scatter, count = repeats - mean, len(repeats)
    return mean, xp.sum(scatter.real**2 + scatter.imag**2, axis=0) / (count * (count - 1))


@by_numpy
def _still_blocks(xp: ModuleType, record: Numbers, samples: Any) -> Float[Numbers, "m s c"]:
    """Blocks of the record at these samples, each without its mean."""
    blocks = record[samples]
    return blocks - blocks.mean(axis=1, keepdims=True)


def pooled_frfs(parts: Sequence[FRF]) -> FRF:
    """The mean FRF over records, with its variance from the variance of each."""
    if len(parts) == 1:
        return parts[0]
    mean = lambda name: np.mean([np.asarray(getattr(p, name)) for p in parts], axis=0)
    several = all(p.multiple_coherence is not None for p in parts)
    known = all(p.variance is not None for p in parts)
    return parts[0].replace(
        H=mean("H"), variance=mean("variance") / len(parts) if known else None,
        coherence=mean("coherence") if known else None,
        multiple_coherence=mean("multiple_coherence") if several else None,
        averages=sum(p.averages or 0 for p in parts) if known else None,
    )  # fmt: skip


def _record(value: Any, what: str) -> Float[Array, "t c"]:
    record = as_double(value, what)
    if record.ndim not in (1, 2):
        raise ValueError(f"{what} has shape {record.shape}; a record needs (t,) for one channel or (t, channel)")
    require_finite(record, what)
    return record[:, None] if record.ndim == 1 else record


def frf_of_spectra(
    s: Spectra,
    freq: Float[np.ndarray, " f"],
    estimator: str,
    unit: str,
    band: tuple[float, float] | None,
    **rest: Any,
) -> FRF:
    """The FRF in SI units, with its variance and the number of averages behind it."""
    form, factor = quantity(unit)
    if band is not None:
        which = band_slice(freq, *band)
        freq = freq[which]
        s = jax.tree.map(lambda a: cut(a, which), s)
    _check_forces(s, freq)
    H, variance = _in_si_units(*estimate(s, estimator=estimator), factor)
    coherence = ordinary_coherence(s)
    # With as many blocks as inputs an H fits them exactly, so that nothing is known about the noise.
    inputs = s.force.shape[-1]
    freedom = s.averages - inputs
    known = freedom > 1e-9
    return FRF(
        freq, H, form=form, variance=variance if known else None,
        coherence=coherence if known else None, averages=int(freedom + 1 + 1e-9) if known else None,
        multiple_coherence=multiple_coherence(s) if known and inputs > 1 else None, **rest,
    )  # fmt: skip


@by_numpy
def _in_si_units(xp: ModuleType, H: Numbers, variance: Numbers, factor: Numbers) -> tuple[Numbers, Numbers]:
    return factor * H, factor**2 * variance


def _check_forces(s: Spectra, freq: Float[np.ndarray, " f"]) -> None:
    inputs = s.force.shape[-1]
    if s.averages < inputs * (1 - 1e-9):
        raise ValueError(f"{s.averages:.3g} independent blocks for {inputs} forces; at least {inputs} are needed")
    if is_traced(s.force):
        return
    force = np.asarray(s.force)
    power = np.real(np.diagonal(force, axis1=1, axis2=2))
    dead = np.argwhere(power <= 0)
    if len(dead):
        line, channel = dead[0]
        raise ValueError(
            f"force {channel + 1} is zero at {len(dead)} lines, the first at {freq[line]:g} Hz; keep to a band that is "
            "excited"
        )
    size = np.sqrt(power)
    smallest = np.linalg.eigvalsh(force / (size[:, :, None] * size[:, None, :]))[:, 0]
    if smallest.min() < DEPENDENT:
        raise ValueError(
            f"the {inputs} forces are one at {freq[smallest.argmin()]:g} Hz: their coherency matrix has a smallest "
            f"eigenvalue of {smallest.min():.1g}, at least {DEPENDENT:g} is needed; drive them by independent signals"
        )
