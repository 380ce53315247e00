"""Rows of fits: the modes of each beside the modes that they are estimates of."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from modalax.study.work import Quantity, Row

REACH = 0.02  # largest distance of a fitted pole from the mode it is an estimate of, relative to its frequency
WIDE = 10.0  # the same in half-bandwidths of the mode, for modes with much damping


def columns(r: int) -> tuple[str, str, str, str]:
    """Columns of mode ``r``, counted from 1: frequency [Hz], damping ratio, and their standard deviations."""
    return f"frequency_hz_{r}", f"damping_ratio_{r}", f"frequency_std_hz_{r}", f"damping_ratio_std_{r}"


def quantities(poles: np.ndarray, refined: bool, known: bool = True) -> list[Quantity]:
    """Frequency and damping ratio of each mode, with their true values where ``known``."""
    found = []
    for r, pole in enumerate(poles, 1):
        f, z, f_std, z_std = columns(r)
        true = (abs(pole) / (2 * np.pi), -pole.real / abs(pole)) if known else (None, None)
        found += [Quantity(f, f_std if refined else None, true[0]), Quantity(z, z_std if refined else None, true[1])]
    return found


def reach(poles: np.ndarray) -> np.ndarray:
    """Largest distance of an estimate from each pole [rad/s]."""
    return np.maximum(REACH * np.abs(poles), WIDE * np.abs(poles.real))


def matched(poles: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Index of the found pole that belongs to each pole, -1 where none does: the assignment of least distance."""
    index = np.full(len(poles), -1)
    if len(found):
        cost = np.abs(np.asarray(found)[None, :] - poles[:, None]) / reach(poles)[:, None]
        for r, k in zip(*linear_sum_assignment(np.minimum(cost, 10.0)), strict=True):
            if cost[r, k] < 1:
                index[r] = k
    return index


def fit_row(frf: Any, settings: Mapping[str, Any], poles: np.ndarray, band: Any = None) -> Row:
    """Fit an FRF; its modes in the columns of the modes that they belong to, and how many were found.

    Raises
    ------
    ValueError
        If no mode is found.
    """
    from modalax.identify import fit

    result = fit(frf, settings["method"], settings["order"], settings["refine"], band)
    answer = result.to_dict()["modes"]
    inside = np.asarray(result.model.poles)[np.asarray(result.inside)]
    return mode_row(poles, inside, answer) | {
        "modes_found": len(answer),
        "converged": result.refined is None or bool(result.refined.success),
    }


def mode_row(poles: np.ndarray, found: np.ndarray, modes: Sequence[Mapping[str, Any]]) -> Row:
    """Frequencies, damping ratios and standard deviations of the modes that belong to ``poles``; NaN without one."""
    row: Row = {}
    for r, k in enumerate(matched(poles, found), 1):
        mode = modes[k] if k >= 0 else {}
        names = ("frequency_hz", "damping_ratio", "frequency_std_hz", "damping_ratio_std")
        for column, name in zip(columns(r), names, strict=True):
            value = mode.get(name)
            row[column] = float("nan") if value is None else float(value)
    return row
