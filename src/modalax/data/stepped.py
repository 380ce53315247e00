"""FRFs of a stepped sine: one line for each frequency at which the force stood, from the steady part of each step."""

import warnings

import numpy as np

from modalax.data.frf import FRF
from modalax.data.recording import Channels
from modalax.data.records import frf_of_spectra
from modalax.data.spectra import Spectra
from modalax.data.steps import Step, grouped, steps_of, waves

BLOCKS = 8  # most parts of a step, whose scatter tells the noise
PERIODS = 2  # least periods in a part
DIGITS = 1e-3  # turns over a step to which a frequency is rounded
MOVING = 0.05  # share of the largest response of a line by which it may change within what is used of a step


def frf_from_steps(channels: Channels, fs: float, estimator: str, band: tuple[float, float] | None) -> FRF:
    """FRF at the frequencies of a stepped sine; the first half of each step is left out, as the response settles.

    Sines at the frequency of a step are fitted by least squares to up to ``BLOCKS`` parts of its second half; their
    scatter makes the variance.

    Parameters
    ----------
    channels
        The records; one force.
    fs
        Sampling rate [Hz].
    estimator
        ``H1``, ``H2`` or ``Hv``.
    band
        Lines to keep [Hz]; all if None.

    Raises
    ------
    ValueError
        If there are several forces, or the force is no stepped sine.
    """
    if channels.force.shape[2] != 1:
        raise ValueError(f"{channels.force.shape[2]} forces; a stepped sine is reduced for one force: choose it")
    records = np.concatenate([channels.force, channels.response], axis=2)
    steps = [(step, record) for record in records for step in steps_of(record[:, 0])]
    if not steps:
        raise ValueError("the force does not stand at one frequency and then at the next, as a stepped sine does")
    held = {id(step): record for step, record in steps}
    groups = grouped([step for step, _ in steps])
    kept = [step for _, group in groups for step in group]
    least = min((step.stop - step.start) / 2 * step.freq for step in kept)
    parts = int(np.clip(least / PERIODS, 1, BLOCKS))
    fits = [np.concatenate([_sines(held[id(s)], s, freq, parts) for s in group]) for freq, group in groups]
    shortest = min(step.stop - step.start for step in kept) / fs
    place = 10.0 ** np.floor(np.log10(DIGITS / shortest))
    freq = np.round(np.array([f for f, _ in groups]) * fs / place) * place
    repeats = min(len(group) for _, group in groups)
    _tell(freq, len(kept), fits)
    return frf_of_spectra(
        _spectra(freq, fits, parts * repeats), freq, estimator, channels.unit, band, outputs=channels.outputs,
        inputs=channels.inputs, level=float(np.median([np.abs(fit[:, 0]).mean() for fit in fits])),
    )  # fmt: skip


def _sines(record: np.ndarray, step: Step, freq: float, parts: int) -> np.ndarray:
    """Complex amplitudes of the channels in the parts of the second half of a step, shape ``(part, c)``."""
    ends = np.linspace((step.start + step.stop) // 2, step.stop, parts + 1).astype(int)
    fits = [
        np.linalg.lstsq(waves(b - a, freq, a - step.start), record[a:b], rcond=None)[0]
        for a, b in zip(ends[:-1], ends[1:], strict=True)
    ]
    return np.array([fit[0] - 1j * fit[1] for fit in fits])


def _spectra(freq: np.ndarray, fits: list[np.ndarray], averages: int) -> Spectra:
    """Mean products of the amplitudes of force and responses at each line."""
    products = [(fit.T @ fit.conj()) / len(fit) for fit in fits]
    return Spectra(
        freq, np.array([p[:1, :1] for p in products]), np.array([p[1:, :1] for p in products]),
        np.array([np.diagonal(p)[1:].real for p in products]), float(averages),
    )  # fmt: skip


def _tell(freq: np.ndarray, count: int, fits: list[np.ndarray]) -> None:
    """Say how many steps there are, and whether the responses have settled in them."""
    warnings.warn(
        f"{count} steps at {len(freq)} frequencies from {freq[0]:g} to {freq[-1]:g} Hz; the first half of each is left "
        "out to settle",
        stacklevel=4,
    )
    moved = []
    for fit in fits:
        H = fit[:, 1:] / fit[:, :1]
        half = len(H) // 2
        change = np.abs(H[:half].mean(axis=0) - H[half:].mean(axis=0)) if half else np.zeros(1)
        moved.append(change.max() / max(float(np.abs(H).mean(axis=0).max()), np.finfo(float).tiny))
    unsettled = np.array(moved) > MOVING
    if unsettled.any():
        warnings.warn(
            f"at {unsettled.sum()} of {len(freq)} frequencies, the first {freq[unsettled.argmax()]:g} Hz, the "
            f"responses still change by up to {100 * max(moved):.2g} % while the force stands; longer steps help",
            stacklevel=4,
        )
