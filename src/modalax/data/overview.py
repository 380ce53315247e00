"""What measured FRFs hold, as text for ``print``: their lines, channels, force levels and noise, a line each."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import jax
import numpy as np

from modalax._numerics.checks import is_traced

if TYPE_CHECKING:
    from modalax.data.frf import FRF
    from modalax.data.measurement import Measurement

UNITS = {"receptance": "m/N", "mobility": "(m/s)/N", "accelerance": "(m/s^2)/N"}
NAMED = 8  # names that a line shows before it leaves some out


def counted(number: int, thing: str) -> str:
    """A number with its noun: ``1 line``, ``3 lines``."""
    return f"{number} {thing}{'' if number == 1 else 's'}"


def shortened(names: Sequence[str], most: int = NAMED) -> str:
    """Names separated by commas; of many the first ones and the last."""
    return ", ".join(names if len(names) <= most else [*names[: most - 2], "...", names[-1]])


def of_frfs(data: "FRF | Measurement", title: str) -> str:
    """The text of an FRF or of several runs, with a title; the plain ``repr`` while they are traced."""
    if is_traced(*jax.tree_util.tree_leaves(data)) or data.freq.ndim != 1:
        return repr(data)
    freq, levels, decay = np.asarray(data.freq), np.ravel(data.level), float(data.added_decay)
    steps = np.diff(freq)
    even = len(steps) and np.ptp(steps) <= 1e-6 * steps.mean()
    apart = f", {steps.mean():.4g} Hz apart" if even else ", unevenly spaced" if len(steps) else ""
    amplitudes = ["unknown" if np.isnan(level) else f"{level:.4g} N" for level in levels]
    said = [
        f"{title}: {data.form} [{UNITS[data.form]}]",
        f"  {counted(len(freq), 'line')} from {freq[0]:.6g} to {freq[-1]:.6g} Hz{apart}",
        f"  {counted(len(data.outputs), 'output')}: {shortened(data.outputs)}",
        f"  {counted(len(data.inputs), 'input')}: {shortened(data.inputs)}",
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
