"""Statistics over the draws of a study: mean, standard deviation, bias, coverage and failures."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from modalax.study.work import Quantity, Work

COVERED = 1.959963984540054  # standard deviations on either side of an estimate that a 95 % interval spans
OWN = ("item", "failed", "reason")  # columns of the study itself, and those that only describe a draw
REASONS = 5  # reasons of failures that are listed


def summary(columns: Mapping[str, np.ndarray], work: Work) -> dict[str, Any]:
    r"""Statistics of every quantity, apart for each group of draws.

    Of values :math:`x_1 \dots x_n`: their mean :math:`\bar x`, their standard deviation :math:`s` (with
    :math:`n - 1`), the bias :math:`\bar x - x` against the true value with its standard error :math:`s/\sqrt n`, the
    mean of the standard deviations :math:`\sigma_k` that the draws state, and the coverage: the part of the draws whose
    interval :math:`x_k \pm 1.96\,\sigma_k` holds the true value, 0.95 where the error bars are right.

    Returns
    -------
    dict
        ``draws``, ``failed``, ``reasons`` (with their numbers), and ``groups``: each with ``where`` (the settings of
        the group), ``draws``, ``failed`` and ``quantities``; what does not exist is None.
    """
    failed = np.asarray(columns.get("failed", np.zeros(0, bool)), bool)
    count = len(failed)
    reasons = Counter(str(r) for r in np.asarray(columns.get("reason", np.zeros(count, np.str_)))[failed])
    keys = [tuple(columns[g][k].item() for g in work.group) for k in range(count)] if work.group else [()] * count
    groups = []
    quantities = work.quantities or found_quantities(columns, work.group)
    for key in dict.fromkeys(keys):
        rows = np.array([k == key for k in keys])
        good = rows & ~failed
        groups.append({
            "where": dict(zip(work.group, key, strict=True)), "draws": int(rows.sum()),
            "failed": int((rows & failed).sum()),
            "quantities": [of_quantity(columns, q, good) for q in quantities if q.column in columns],
        })  # fmt: skip
    return {
        "draws": count, "failed": int(failed.sum()), "reasons": dict(reasons.most_common()), "groups": groups,
    }  # fmt: skip


def found_quantities(columns: Mapping[str, np.ndarray], group: Sequence[str]) -> list[Quantity]:
    """Every column of numbers, of a study that does not say what it is about."""
    return [
        Quantity(name) for name, values in columns.items()
        if name not in (*OWN, *group) and np.asarray(values).dtype.kind in "biuf"
    ]  # fmt: skip


def of_quantity(columns: Mapping[str, np.ndarray], q: Quantity, rows: np.ndarray) -> dict[str, Any]:
    """The statistics of one quantity over some rows."""
    x = np.asarray(columns[q.column], float)[rows]
    there = np.isfinite(x)
    n = int(there.sum())
    mean = float(x[there].mean()) if n else None
    std = float(x[there].std(ddof=1)) if n > 1 else None
    truth = q.truth
    if isinstance(truth, str):  # every draw of a group has the same
        truth = float(columns[truth][rows][0]) if rows.any() else None
    found: dict[str, Any] = {
        "name": q.column, "draws": n, "missing": int(len(x) - n), "mean": mean, "std": std, "truth": truth,
        "bias": None, "bias_std": None, "stated_std": None, "coverage": None,
    }  # fmt: skip
    if truth is not None and mean is not None:
        found["bias"] = mean - truth
        found["bias_std"] = None if std is None else std / n**0.5
    if q.std_column is not None and q.std_column in columns:
        stated = np.asarray(columns[q.std_column], float)[rows]
        told = there & np.isfinite(stated)
        if told.any():
            found["stated_std"] = float(stated[told].mean())
            if truth is not None:
                found["coverage"] = float(np.mean(np.abs(x[told] - truth) <= COVERED * stated[told]))
    return found


def reason_lines(told: Mapping[str, Any]) -> list[str]:
    """Why draws failed, the most frequent reasons first."""
    listed = list(told["reasons"].items())
    lines = [f"{n} failed: {reason}" for reason, n in listed[:REASONS]]
    rest = sum(n for _, n in listed[REASONS:])
    return lines + ([f"{rest} failed for {len(listed) - REASONS} other reasons"] if rest else [])
