"""A diagnosis as ``print`` shows it: the verdict, the causes with their sizes, the rivals and the gain."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from modalax._numerics.text import text_table, with_error

OPEN = 1e3  # standard deviation, over its value, from which on a parameter is not determined
MEANING = {
    "clean": "this data shows nothing wrong with the simulation",
    "named": "the simulation lacks the causes listed here",
    "ambiguous": "several explanations fit; this data cannot tell them apart",
    "unknown": "something is wrong that no known cause explains",
}


def summary(answer: Mapping[str, Any]) -> str:
    """``Diagnosis.to_dict()`` in a few lines."""
    lines = [f"{answer['verdict']}: {meaning(answer)}"]
    if answer["causes"]:
        lines.append(text_table(CAUSE_COLUMNS, cause_rows(answer), left=(0, 1, 3)))
    return "\n".join([*lines, *explanation_lines(answer)])


def meaning(answer: Mapping[str, Any]) -> str:
    """The verdict in words."""
    if answer["verdict"] == "clean" and answer.get("inaccuracy"):
        return "nothing stands out beyond what is usual for such a simulation"
    return MEANING[answer["verdict"]]


CAUSE_COLUMNS = ("Cause", "Where", "Probability", "Parameters")


def cause_rows(answer: Mapping[str, Any]) -> list[list[str]]:
    """Rows of a table with the columns ``CAUSE_COLUMNS``."""
    return [
        [c["name"], place_text(c["where"]), probability_text(answer, c), parameters_text(c["parameters"])]
        for c in answer["causes"]
    ]


def probability_text(answer: Mapping[str, Any], cause: Mapping[str, Any]) -> str:
    """The probability of a cause; none where nothing explains the data: it would only rank what fails."""
    return "-" if answer["verdict"] == "unknown" else f"{cause['probability']:.3f}"


def attempt_text(answer: Mapping[str, Any]) -> str:
    """How far the causes of an ``unknown`` answer go."""
    gain = answer["gain"]
    before, after = gain["chi2_before"] - 1, gain["chi2_after"] - 1
    share = f"explains {100 * min(max(1 - after / before, 0.0), 1.0):.0f} % of the misfit and " if before > 0 else ""
    return (
        f"best attempt, not an explanation: on data left out of the fit it {share}leaves a chi-square of "
        f"{gain['chi2_after']:.3g} per real sample (1 is noise alone)"
    )


def explanation_lines(answer: Mapping[str, Any]) -> list[str]:
    """How far an unknown answer goes, rivals, reasons, advice and gain, a line each."""
    unknown = answer["verdict"] == "unknown" and answer["causes"] and answer["gain"]
    lines = [attempt_text(answer)] if unknown else []
    lines += [f"or: {causes_text(rival)}" for rival in answer["alternatives"]]
    lines += [f"because: {reason}" for reason in answer.get("reasons") or ()]
    lines += [advice_text(answer)] if answer["advice"] else []
    return lines + ([gain_text(answer["gain"])] if answer["gain"] else [])


def advice_text(answer: Mapping[str, Any]) -> str:
    """What to measure or check next, and what for."""
    return f"{'to tell them apart' if answer['alternatives'] else 'what to do next'}: {answer['advice']}"


def causes_text(causes: Sequence[Mapping[str, Any]]) -> str:
    """A set of causes with their places."""
    return " and ".join(cause_at(c["name"], c["where"]) for c in causes) or "no cause at all"


def cause_at(name: str, where: Sequence[Any]) -> str:
    """A cause and its place; a cause of the whole measurement has none."""
    return f"{name} at {place_text(where)}" if where else name


def gain_text(gain: Mapping[str, Any]) -> str:
    """How much better the extended simulation predicts the data that it was not fitted to."""
    if not math.isfinite(gain["chi2_before"]):
        return f"no gain can be told: {gain['held_out']}"
    return (
        f"on data left out of the fit ({gain['held_out']}): chi-square per real sample {gain['chi2_before']:.3g} "
        f"before, {gain['chi2_after']:.3g} after (1 is noise alone); log-likelihood gain "
        f"{with_error(gain['log_likelihood_gain'], gain['log_likelihood_gain_std'])} nats"
    )


def place_text(where: Sequence[Any]) -> str:
    """Where a cause sits, as text."""
    return " - ".join(str(w) for w in where) or "everywhere"


def parameters_text(values: Mapping[str, Mapping[str, Any]]) -> str:
    """Parameters of a cause with standard deviations and units."""
    told = (f"{name} = {size_text(p)} {p['unit'].replace('-', '')}" for name, p in values.items() if determined(p))
    open_ones = (f"{name} is not determined by this data" for name, p in values.items() if not determined(p))
    return ", ".join(text.strip() for text in (*told, *open_ones))


def size_text(parameter: Mapping[str, Any]) -> str:
    """A parameter with its standard deviation, where the data determines it."""
    return with_error(parameter["value"], parameter["std"]) if determined(parameter) else "not determined"


def determined(parameter: Mapping[str, Any]) -> bool:
    """Whether the data tells a parameter at least to within a factor of a thousand."""
    value, std = parameter["value"], parameter["std"]
    return std is None or not math.isfinite(std) or value == 0 or std < OPEN * abs(value)
