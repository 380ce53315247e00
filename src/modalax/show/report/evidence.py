"""Tables of what the data show beside the verdict: tests with their chances, errors by mode, channel and level."""

from collections.abc import Mapping
from typing import Any

from modalax.show.report.page import Section, Table

MOST = 40  # channels in the table, those of the largest error


def evidence_sections(evidence: Mapping[str, Any] | None) -> list[Section]:
    """Sections of :attr:`modalax.diagnose.result.Diagnosis.evidence`."""
    if evidence is None:
        return []
    tables = [test_rows(evidence["tests"]), mode_rows(evidence["by_mode"]), level_rows(evidence["by_level"])]
    channels = channel_rows(evidence["by_channel"])
    return [Section("What the data show", [], [*(t for t in tables if t.rows), channels])]


def _number(value: float | None, text: str = "{:.3g}") -> str:
    return "" if value is None else text.format(value)


def _chance(test: Mapping[str, Any] | None) -> str:
    """A p-value; one too small for a double is a bound, as no chance is 0."""
    if test is None:
        return ""
    return "< 1e-300" if test["p_value"] < 1e-300 else _number(test["p_value"])


def test_rows(tests: Mapping[str, Any]) -> Table:
    """What is usually assumed, and the chance under noise alone of so large a deviation from it."""
    single = {"Reciprocity": tests["reciprocity"], "Same response in every run and at every level":
              tests["level_homogeneity"]}  # fmt: skip
    rows = [[name, _chance(test), ""] for name, test in single.items() if test is not None]
    both = {"Same factor in the lower half of the band (Hausman)": tests["band"],
            "Residuals of neighbouring lines are independent": tests["whiteness"]}  # fmt: skip
    for name, pair in both.items():
        rows.append([name, *(_chance(t) for t in (pair["before"], pair["after"]))])
    return Table(["Test", "Chance, data or simulation", "Chance, extended"], rows, "Small chances speak against.")


def mode_rows(modes: list[Mapping[str, Any]]) -> Table:
    """Errors of frequency, damping and peak, mode by mode."""
    rows = [
        [
            f"{m['frequency_hz']:.5g}", f"{100 * m['damping_ratio']:.3g}",
            *(_pair(m, f"{name}_error", 100.0) for name in ("frequency", "damping")),
            " / ".join(_number(m[f"peak_error_db_{when}"], "{:+.2g}") or "-" for when in ("before", "after")),
            _pair(m, "chi2", 1.0, ""),
        ] for m in modes
    ]  # fmt: skip
    head = ["Frequency [Hz]", "Damping ratio [%]", "Its error [%]", "Error of damping [%]", "Error of the peak [dB]",
            "Chi-square per sample"]  # fmt: skip
    return Table(head, rows, "Modes as measured; errors and chi-square within the bandwidth, before / after.")


def _pair(row: Mapping[str, Any], name: str, times: float, sign: str = "+") -> str:
    values = (row[f"{name}_{when}"] for when in ("before", "after"))
    return " / ".join("-" if v is None else f"{times * v:{sign}.3g}" for v in values)


def level_rows(levels: list[Mapping[str, Any]]) -> Table:
    """Residual and Hilbert transform, run by run."""
    rows = [
        [str(v["run"]), _number(v["level"], "{:.4g}"), _pair(v, "chi2", 1.0, ""), _number(v["hilbert_measured"]),
         _number(v["hilbert_extended"])] for v in levels
    ]  # fmt: skip
    head = ["Run", "Force [N]", "Chi-square per sample", "Missed by the Hilbert transform, measured", "Extended"]
    return Table(head, rows, "Of a linear structure the Hilbert transform misses nothing; before / after.")


def channel_rows(channels: list[Mapping[str, Any]]) -> Table:
    """Residual and frequency response assurance criterion, channel by channel, the worst first."""
    worst = sorted(channels, key=lambda c: -(c["chi2_before"] or 0.0))[:MOST]
    rows = [[c["output"], c["input"], _pair(c, "chi2", 1.0, ""), _pair(c, "frac", 1.0, "")] for c in worst]
    head = ["Output", "Input", "Chi-square per sample", "FRAC"]
    return Table(head, rows, "Channels by the error of the simulation; before / after.", text_columns=(0, 1))
