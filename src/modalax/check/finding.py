"""Findings of a check: faults of a measurement, with size, evidence and advice."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from modalax.check.overview import of_finding, of_findings

WORDS = (
    "reversed", "swapped", "dead", "duplicated", "clipped", "drift", "double_hit", "short_pulse", "force_rolloff",
    "record_too_short", "not_reciprocal", "calibration", "frequency_shift", "hum", "conjugated", "wrong_form", "delay",
    "too_few_lines",
)  # fmt: skip
EVEN = 0.5  # probability of a fault whose score just reaches its threshold
FOLD = 2.0  # by how much the logarithm of the doubt falls with each further threshold's worth of score


@dataclass(frozen=True)
class Picture:
    """Curves that show the evidence: ``(label, x, y)`` each, with the titles of both axes."""

    curves: Sequence[tuple[str, np.ndarray, np.ndarray]]
    x: str
    y: str
    logarithmic: bool = False
    dots: bool = False


@dataclass(frozen=True)
class Finding:
    """One fault of a measurement.

    Attributes
    ----------
    what
        One of ``WORDS``.
    where
        Names of the channels at fault (all that may be, where the data cannot tell them apart); empty: everywhere.
    size, interval, unit
        Size of the fault, its 95 % interval, and their unit; None where it has no size.
    sure
        Probability that the fault is this one and here, not chance or another fault that looks like it: even odds where
        its evidence just reaches the threshold (:func:`sureness`).
    evidence, advice
        What was seen in the data, and what to do.
    picture
        Curves that show it, or None.
    bands
        Ranges of frequency that the fault spoils [Hz], which later detectors leave out.
    """

    what: str
    where: tuple[str, ...]
    evidence: str
    advice: str
    sure: float
    size: float | None = None
    unit: str | None = None
    interval: tuple[float, float] | None = None
    picture: Picture | None = field(default=None, repr=False, compare=False)
    bands: tuple[tuple[float, float], ...] = field(default=(), repr=False, compare=False)

    def __post_init__(self):
        if self.what not in WORDS:
            raise ValueError(f"a finding of {self.what!r}; it must be one of {', '.join(WORDS)}")

    @property
    def place(self) -> str:
        """Place of the fault, as text."""
        return ", ".join(self.where) or "everywhere"

    @property
    def measure(self) -> str:
        """Size of the fault, as text."""
        return "" if self.size is None else f"{self.size:.4g} {(self.unit or '').replace('-', '')}".strip()

    def __str__(self) -> str:
        """What was seen, how large and how sure it is, and what to do."""
        size = f"{self.measure}, " if self.measure else ""
        return f"{of_finding(self)}\n  {size}sure: {self.sure:.2f}"

    def to_dict(self) -> dict[str, Any]:
        """The finding as plain values."""
        return {
            "what": self.what, "where": list(self.where), "size": self.size, "unit": self.unit,
            "interval": None if self.interval is None else list(self.interval), "sure": self.sure,
            "evidence": self.evidence, "advice": self.advice,
        }  # fmt: skip


@dataclass(frozen=True)
class Findings:
    """All findings of a check, the surest first; empty for a sound measurement.

    Attributes
    ----------
    findings
        The faults.
    about
        Sentences that say what was checked and what could not be.
    """

    findings: tuple[Finding, ...]
    about: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.findings)

    def __iter__(self):
        return iter(self.findings)

    def __str__(self) -> str:
        """A table of the findings, and the evidence and the advice of each, as ``modalax check`` prints them."""
        return of_findings(self)

    def to_dict(self) -> dict[str, Any]:
        """The findings as plain values, as ``modalax check --json`` writes them."""
        return {"findings": [f.to_dict() for f in self.findings]}


def sureness(z: float, threshold: float) -> float:
    r"""Probability of a fault from how far its score exceeds the threshold at which it is reported.

    A threshold stands where a fault and what imitates it are as likely as each other; beyond it the doubt falls
    exponentially, as a tail of errors does, :math:`1 - e^{-2(z/z_0 - 1)}/2`, :math:`z_0` the threshold.
    """
    return float(1 - EVEN * np.exp(-FOLD * max(z / threshold - 1, 0.0)))


def deviations(squares: float, freedom: int) -> float:
    """Standard deviations at which one number is as unlikely as this sum of squares (Wilson and Hilferty 1931)."""
    spread = 2 / (9 * freedom)
    return float(((squares / freedom) ** (1 / 3) - 1 + spread) / np.sqrt(spread))
