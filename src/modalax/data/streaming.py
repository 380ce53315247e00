"""FRFs of records too large for memory: read piece by piece, their spectra averaged."""

import mmap
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.lib.stride_tricks import sliding_window_view

from modalax._numerics.checks import as_array
from modalax.data.checks import require_samples
from modalax.data.frf import FRF
from modalax.data.recording import Channels, Recording, channels_of
from modalax.data.records import frf_of_spectra, welch_starts
from modalax.data.spectra import Spectra, spectral_lines
from modalax.data.windows import effective_averages, taper

MEMORY_MB = 40.0  # memory that a piece may take, with its copies: about what the processor's caches hold
COPIES = 8  # of a piece that are held at once: as read, scaled, in blocks, their spectra
HEAD = 2**18  # samples from which the kind of excitation is told

Read = Callable[[int, int], tuple[Float[np.ndarray, "t i"], Float[np.ndarray, "t o"]]]


@dataclass(frozen=True)
class Streamed(Recording):
    """A recording whose samples stay in its file, ``data`` being a view of it, until a piece is asked for.

    Attributes
    ----------
    gain
        Factor of each channel.
    """

    gain: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not self.gain:
            object.__setattr__(self, "gain", (1.0,) * len(self.channels))

    def scaled(self, factors: Any) -> "Streamed":
        """The recording with some channels multiplied by a factor, once they are read."""
        gain = list(self.gain)
        for name, factor in factors.items():
            gain[self.index(name)] *= factor
        return replace(self, gain=tuple(gain))

    def piece(self, first: int, last: int) -> Recording:
        """The samples from ``first`` up to ``last``, read into memory.

        Raises
        ------
        ValueError
            If some of them are not finite.
        """
        samples = self.data[:, first:last].astype(float)
        require_samples(samples, self.fs, self.channels, first)
        if any(gain != 1 for gain in self.gain):
            samples *= self.gain
        release(self.data)
        return Recording(samples, self.fs, self.channels, self.units, self.numbers)

    def whole(self) -> Recording:
        """All of it in memory."""
        return self.piece(0, self.data.shape[1])


def release(view: np.ndarray) -> None:
    """Give back the pages of a mapped file that were read."""
    base: Any = view
    while isinstance(base, np.ndarray):
        base = base.base
    if isinstance(base, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
        base.madvise(mmap.MADV_DONTNEED)


def frf_from_pieces(
    read: Read, length: int, fs: float, *, block: float, overlap: float = 0.5, window: str = "hann",
    estimator: str = "H1", memory_mb: float | None = None, **rest: Any,
) -> FRF:  # fmt: skip
    """FRF of a continuous record as :func:`modalax.data.records.frf_from_records` gives it, read piece by piece.

    Parameters
    ----------
    read
        Gives forces [N] and responses between two samples, shapes ``(t, i)`` and ``(t, o)``.
    length
        Number of samples of the record.
    fs, block, overlap, window, estimator
        As for :func:`modalax.data.records.frf_from_records`, and so are further arguments.
    memory_mb
        Memory that a piece may take, with its copies [MB]; ``MEMORY_MB`` if None, one block in any case.

    Raises
    ------
    ValueError
        As of :func:`modalax.data.records.frf_from_records`.
    """
    samples, starts, step = welch_starts(length, fs, block, overlap)
    factors = taper(window, samples)
    averages = effective_averages(factors, step, len(starts))
    channels = sum(part.shape[1] for part in read(0, 1))
    several = max(1, int(((memory_mb or MEMORY_MB) * 1e6 / (8 * COPIES * channels) - samples) / step))
    sums: list[Any] = [0.0, 0.0, 0.0]
    for k in range(0, len(starts), several):
        own = starts[k : k + several]
        parts = (np.ascontiguousarray(part.T) for part in read(int(own[0]), int(own[-1]) + samples))
        force, response = (sliding_window_view(part, samples, axis=1)[:, ::step] for part in parts)
        for block in range(len(own)):
            found = _products(force[:, block], response[:, block], factors)
            sums = [old + new for old, new in zip(sums, found, strict=True)]
    density = 2 / (fs * np.sum(factors**2) * len(starts))
    force, cross, response = (as_array(np.moveaxis(density * total, -1, 0)) for total in sums)
    lines = spectral_lines(samples, fs)
    whole = Spectra(as_array(lines), force, cross, response, averages)
    return frf_of_spectra(whole, lines, estimator, **rest)


def _products(
    force: Float[np.ndarray, "i t"], response: Float[np.ndarray, "o t"], window: Float[np.ndarray, " t"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Products of the spectra of one block, its mean taken off: ``(i, i, f)``, ``(o, i, f)`` and ``(o, f)``."""
    lines = slice(1, (len(window) + 1) // 2)
    F, X = (np.fft.rfft((a - a.mean(axis=1, keepdims=True)) * window)[:, lines] for a in (force, response))
    return F[:, None] * F.conj(), X[:, None] * F.conj(), X.real**2 + X.imag**2


def frfs_of_stream(recording: Streamed, asked: tuple[Any, Any, Any], names: Channels, **how: Any) -> list[FRF]:
    """FRFs of the segments of continuous records whose samples stay in their file.

    Parameters
    ----------
    recording
        The records.
    asked
        Forces, responses and unit as for :func:`modalax.data.recording.channels_of`.
    names
        What that function told of the beginning: the unit, and the names that the DoFs shall have.
    **how
        As for :func:`frf_from_pieces`.
    """

    def reader(one: Streamed) -> Read:
        def read(first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
            with warnings.catch_warnings():  # what is assumed was told of the beginning
                warnings.simplefilter("ignore", UserWarning)
                found = channels_of(one.piece(first, last), *asked)
            return found.force[0], found.response[0]

        return read

    segments, length, _ = recording.data.shape
    ends = {"unit": names.unit, "outputs": names.outputs, "inputs": names.inputs}
    return [
        frf_from_pieces(reader(replace(recording, data=recording.data[k : k + 1])), length, recording.fs, **ends, **how)
        for k in range(segments)
    ]
