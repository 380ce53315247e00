"""Pictures of the marks."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from marks import Mark, Share, coverage, near, oracle, reliability

SPECIAL = ["set with truth", "set without truth", "unknown", "clean", "error"]


def draw_all(marks: list[Mark], out: Path) -> list[Path]:
    """Draw every figure that has data; returns the files."""
    files = []
    for draw in (power, confusion, calibration, intervals):
        figure = draw(marks)
        if figure is not None:
            files.append(out / f"{draw.__name__}.png")
            figure.savefig(files[-1], dpi=130, bbox_inches="tight")
            plt.close(figure)
    return files


def power(marks: list[Mark]):
    """Share found by distance, beside the oracle."""
    single = [m for m in marks if m.kind in ("single", "clean")]
    sizes = sorted({m.truth["d_asked"] for m in single if m.truth["d"] < 100})
    groups = [(d, [m for m in single if m.truth["d_asked"] == d and m.truth["d"] < 1.2 * d + 0.1]) for d in sizes]
    groups = [(d, g) for d, g in groups if g]
    if not groups:
        return None
    figure, axes = plt.subplots(figsize=(6, 4))
    grid = np.linspace(0, max(d for d, _ in groups) + 1, 200)
    axes.plot(grid, oracle(grid), color="0.5", label="perfect detector")
    for label, hit in (
        ("found", lambda m: m.detected),
        ("right name alone", lambda m: m.named_right),
        ("truth within the set", lambda m: m.verdict in ("named", "ambiguous") and m.within),
    ):
        shares = [(d, Share.of(g, hit)) for d, g in groups if d > 0 or label == "found"]
        d = np.array([v for v, _ in shares])
        y = np.array([s.value for _, s in shares])
        limits = np.array([s.limits for _, s in shares])
        axes.errorbar(d, y, np.abs(limits.T - y), fmt="o-", ms=4, lw=1, capsize=2, label=label)
    axes.set(xlabel="distance d [standard deviations]", ylabel="share of cases", ylim=(-0.02, 1.02))
    axes.legend(frameon=False)
    return figure


def confusion(marks: list[Mark]):
    """Rows: hidden at d >= 8; columns: named, or otherwise answered."""
    marks = near([m for m in marks if m.kind in ("single", "outside")], 8) + [m for m in marks if m.kind == "clean"]
    rows = sorted({m.cause for m in marks}, key=lambda c: (c.startswith("outside"), c == "clean", c))
    names = sorted({m.outcome for m in marks} - set(SPECIAL), key=lambda c: (c not in rows, "+" in c, c))
    columns = [c for c in rows if c in names] + [c for c in names if c not in rows and "+" not in c]
    columns += (["several"] if any("+" in c for c in names) else []) + SPECIAL
    if not rows:
        return None
    counts = np.zeros((len(rows), len(columns)))
    for m in marks:
        column = "several" if "+" in m.outcome else m.outcome
        counts[rows.index(m.cause), columns.index(column)] += 1
    share = counts / counts.sum(axis=1, keepdims=True)
    figure, axes = plt.subplots(figsize=(0.36 * len(columns) + 3, 0.28 * len(rows) + 2.5))
    axes.imshow(share, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    for r, c in np.argwhere(share >= 0.005):
        axes.text(
            c,
            r,
            f"{100 * share[r, c]:.0f}",
            ha="center",
            va="center",
            fontsize=6,
            color="white" if share[r, c] > 0.6 else "black",
        )
    axes.set_xticks(range(len(columns)), columns, rotation=90, fontsize=7)
    axes.set_yticks(range(len(rows)), rows, fontsize=7)
    axes.set(xlabel="said [% of the row]", ylabel="hidden, d >= 8")
    return figure


def calibration(marks: list[Mark]):
    """Share right against the probability stated."""
    rows = reliability([m for m in marks if m.kind in ("single", "pair")])
    if not rows:
        return None
    figure, axes = plt.subplots(figsize=(4.5, 4.5))
    axes.plot([0, 1], [0, 1], color="0.6", lw=1)
    for _, _, stated, share in rows:
        low, high = share.limits
        axes.errorbar(stated, share.value, [[share.value - low], [high - share.value]], fmt="o", color="C0", capsize=2)
        axes.annotate(str(share.count), (stated, share.value), textcoords="offset points", xytext=(5, -9), fontsize=7)
    axes.set(
        xlabel="stated probability of the leading set",
        ylabel="share with name and place right",
        xlim=(0, 1.02),
        ylim=(0, 1.02),
    )
    return figure


def intervals(marks: list[Mark]):
    """Share of intervals that hold the truth, by parameter."""
    shares = {k: s for k, s in coverage(marks).items() if s.count >= 3}
    if not shares:
        return None
    figure, axes = plt.subplots(figsize=(6, 0.25 * len(shares) + 1.2))
    axes.axvspan(0.90, 0.98, color="0.9")
    for k, (name, share) in enumerate(sorted(shares.items())):
        low, high = share.limits
        axes.errorbar(
            share.value, k, xerr=[[share.value - low], [high - share.value]], fmt="o", ms=4, color="C0", capsize=2
        )
        axes.text(1.02, k, f"{name} ({share.count})", va="center", fontsize=7)
    axes.set(xlabel="share of 95 % intervals that hold the truth", xlim=(0, 1.01), yticks=[])
    return figure
