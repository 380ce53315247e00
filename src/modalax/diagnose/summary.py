"""A diagnosis as ``print`` shows it: the verdict, the causes with their sizes, the rivals and the gain."""

from collections.abc import Mapping, Sequence
from typing import Any

from modalax._numerics.text import text_table, with_error

MEANING = {
    "clean": "nothing is wrong with the simulation that this data could show",
    "named": "the simulation lacks what follows",
    "ambiguous": "several explanations fit; this data cannot tell them apart",
    "unknown": "something is wrong that no known cause explains",
}


def summary(answer: Mapping[str, Any]) -> str:
    """``Diagnosis.to_dict()`` in a few lines."""
    lines = [f"{answer['verdict']}: {MEANING[answer['verdict']]}"]
    if answer["causes"]:
        rows = [
            [c["name"], place_text(c["where"]), f"{c['probability']:.3f}", parameters_text(c["parameters"])]
            for c in answer["causes"]
        ]
        lines.append(text_table(("Cause", "Where", "Probability", "Parameters"), rows, left=(0, 1, 3)))
    lines += [f"or: {causes_text(rival)}" for rival in answer["alternatives"]]
    lines += [f"because: {reason}" for reason in answer.get("reasons") or ()]
    if answer["advice"]:
        lines.append(f"to tell them apart: {answer['advice']}")
    if answer["gain"]:
        lines.append(gain_text(answer["gain"]))
    return "\n".join(lines)


def causes_text(causes: Sequence[Mapping[str, Any]]) -> str:
    """A set of causes with their places."""
    return " and ".join(f"{c['name']} at {place_text(c['where'])}" for c in causes)


def gain_text(gain: Mapping[str, Any]) -> str:
    """What the extended simulation gains on the data that it was not fitted to."""
    return (
        f"held out: {gain['held_out']}; chi-square per real sample {gain['chi2_before']:.3g} before, "
        f"{gain['chi2_after']:.3g} after; log-likelihood gain "
        f"{with_error(gain['log_likelihood_gain'], gain['log_likelihood_gain_std'])} nats"
    )


def place_text(where: Sequence[Any]) -> str:
    """Where a cause sits, as text."""
    return " - ".join(str(w) for w in where) or "everywhere"


def parameters_text(values: Mapping[str, Mapping[str, Any]]) -> str:
    """Parameters of a cause with standard deviations and units."""
    told = (f"{name} = {with_error(p['value'], p['std'])} {p['unit'].replace('-', '')}" for name, p in values.items())
    return ", ".join(text.strip() for text in told)
