"""Lines and channels of a file that hold no numbers at all are left out, and that is said."""

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

SHOWN = 6  # names or frequencies that a sentence lists


def without_gaps(
    freq: np.ndarray, H: np.ndarray, outputs: Sequence[str], inputs: Sequence[str], beside: dict[str, Any],
    stacklevel: int,
) -> tuple[np.ndarray, np.ndarray, list[str], list[str], dict[str, Any]]:  # fmt: skip
    """The arrays of a measurement without channels and lines at which no sample is finite.

    A sensor that failed, and the line at 0 Hz of a force without mean, are often written as NaN throughout. A file with
    single samples that are not finite is damaged, and is left as it is for :class:`Measurement` to refuse.

    Parameters
    ----------
    freq, H, outputs, inputs
        Lines ``(f,)``, FRFs ``(run, f, o, i)`` and names.
    beside
        Arrays of the axes of H (``variance``, ``coherence``) or ``(run, f)`` (``force``); others are kept as they are.
    stacklevel
        Of the warning that says what was left out.
    """
    if H.ndim != 4 or H.shape != (len(H), len(freq), len(outputs), len(inputs)):
        return freq, H, list(outputs), list(inputs), beside
    sound = np.isfinite(H)
    if sound.all() or not sound.any():
        return freq, H, list(outputs), list(inputs), beside
    f, o, i = (sound.any(axis=axes) for axes in ((0, 2, 3), (0, 1, 3), (0, 1, 2)))
    if not (np.isfinite(H[:, f][:, :, o][..., i]).all() and np.isfinite(freq).all()):
        return freq, H, list(outputs), list(inputs), beside
    told = [
        _listed(kind, [name for name, keep in zip(names, kept, strict=True) if not keep])
        for kind, names, kept in (
            ("output", outputs, o), ("input", inputs, i), ("line", [f"{x:g} Hz" for x in freq], f),
        ) if not kept.all()
    ]  # fmt: skip
    warnings.warn(
        f"no finite number at {' and at '.join(told)}; left out", UserWarning, stacklevel=stacklevel
    )  # fmt: skip
    take = lambda a: a[:, f][:, :, o][..., i]
    beside = {
        k: take(v) if np.shape(v) == H.shape else v[:, f] if k == "force" and np.shape(v) == H.shape[:2] else v
        for k, v in beside.items()
    }
    named = lambda names, kept: [name for name, keep in zip(names, kept, strict=True) if keep]
    return freq[f], take(H), named(outputs, o), named(inputs, i), beside


def _listed(kind: str, names: Sequence[str]) -> str:
    shown = ", ".join(names[:SHOWN]) + (f", ... ({len(names)} in all)" if len(names) > SHOWN else "")
    return f"{kind}{'s' * (len(names) > 1)} {shown}"
