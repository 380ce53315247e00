"""What measured data hold, as text for ``print``: lines, channels, force levels and noise, a line each."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import jax
import numpy as np

from modalax._numerics.checks import is_traced

if TYPE_CHECKING:
    from modalax.data.bla import BestLinear
    from modalax.data.frf import FRF
    from modalax.data.geometry import Geometry
    from modalax.data.measurement import Measurement
    from modalax.data.recording import Recording

UNITS = {"receptance": "m/N", "mobility": "(m/s)/N", "accelerance": "(m/s^2)/N"}
NAMED = 8  # names that a line shows before it leaves some out


def counted(number: int, thing: str) -> str:
    """A number with its noun: ``1 line``, ``3 lines``."""
    return f"{number} {thing}{'' if number == 1 else 's'}"


def shortened(names: Sequence[str], most: int = NAMED) -> str:
    """Names separated by commas; of many the first ones and the last."""
    return ", ".join(names if len(names) <= most else [*names[: most - 2], "...", names[-1]])


def channels_text(outputs: Sequence[str], inputs: Sequence[str]) -> list[str]:
    """How many outputs and inputs there are, and their names, a line each."""
    return [
        f"  {counted(len(names), side)}: {shortened(names)}" for side, names in (("output", outputs), ("input", inputs))
    ]


def lines_text(freq: np.ndarray) -> str:
    """Number, range and spacing of lines [Hz]."""
    steps = np.diff(freq)
    even = len(steps) and np.ptp(steps) <= 1e-6 * steps.mean()
    apart = f", {steps.mean():.4g} Hz apart" if even else ", unevenly spaced" if len(steps) else ""
    return f"{counted(len(freq), 'line')} from {freq[0]:.6g} to {freq[-1]:.6g} Hz{apart}"


def unreadable(data: object, *first: object) -> bool:
    """Whether values are being traced, or are those of many at once (``first`` has more than one axis)."""
    return is_traced(*jax.tree_util.tree_leaves(data)) or any(np.ndim(a) != 1 for a in first)


def of_frfs(data: "FRF | Measurement", title: str) -> str:
    """The text of an FRF or of several runs, with a title; the plain ``repr`` while they are traced."""
    if unreadable(data, data.freq):
        return repr(data)
    freq, levels, decay = np.asarray(data.freq), np.ravel(data.level), float(data.added_decay)
    amplitudes = ["unknown" if np.isnan(level) else f"{level:.4g} N" for level in levels]
    said = [
        f"{title}: {data.form} [{UNITS[data.form]}]",
        f"  {lines_text(freq)}",
        *channels_text(data.outputs, data.inputs),
        f"  force: {shortened(amplitudes)}" if np.isfinite(levels).any() else "",
        f"  noise: {_noise(data)}",
        f"  an exponential window added a decay of {decay:.4g} 1/s" if decay else "",
    ]
    return "\n".join(filter(None, said))


def _noise(data: "FRF | Measurement") -> str:
    """What is known of the noise."""
    repeats = "" if data.averages is None else f", estimated from {counted(data.averages, 'average')}"
    known = [] if data.variance is None else [f"variance of each sample{repeats}"]
    return ", ".join([*known, *([] if data.coherence is None else ["coherence"])]) or "not known"


def of_best_linear(data: "BestLinear") -> str:
    """The FRF, and how large noise and distortion are beside it."""
    if unreadable(data, data.frf.freq):
        return repr(data)
    size = np.sqrt(np.mean(np.abs(np.asarray(data.frf.H)) ** 2))
    parts = (("noise", data.noise_variance), ("distortion", data.distortion_variance))
    told = [
        f"{name} {100 * np.sqrt(np.mean(np.asarray(variance))) / size:.3g} %"
        for name, variance in parts
        if variance is not None
    ]
    return "\n".join([
        of_frfs(data.frf, "Best linear approximation"),
        f"  part of the FRF (root mean square): {', '.join(told) or 'noise and distortion not known apart'}",
        f"  lines without force: {len(data.even.freq)} even, {len(data.odd.freq)} odd",
    ])  # fmt: skip


def of_geometry(geometry: "Geometry") -> str:
    """Number of nodes and lines, and how large the structure is."""
    if unreadable(geometry):
        return repr(geometry)
    low, high = (f(np.asarray(geometry.xyz), axis=0) for f in (np.min, np.max)) if geometry.nodes else (0.0, 0.0)
    size = " x ".join(f"{side:.4g}" for side in np.broadcast_to(np.subtract(high, low), 3))
    return "\n".join([
        f"Geometry of {counted(len(geometry.nodes), 'node')}: {shortened(geometry.nodes)}",
        f"  {counted(len(geometry.lines), 'line')}",
        f"  extent in x, y, z: {size} m",
    ])  # fmt: skip


def of_recording(data: "Recording") -> str:
    """Duration, rate and channels of time records."""
    segments, samples, _ = data.data.shape
    pieces = "" if segments == 1 else f"{segments} records of "
    return "\n".join([
        f"Recording: {pieces}{samples / data.fs:.6g} s, {counted(samples, 'sample')} at {data.fs:g} Hz",
        f"  {counted(len(data.channels), 'channel')}: {data.listed()}",
    ])  # fmt: skip
