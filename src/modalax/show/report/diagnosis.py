"""The report of a diagnosis."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from modalax._numerics.text import with_error
from modalax.diagnose.result import Diagnosis
from modalax.diagnose.summary import (
    advice_text,
    attempt_text,
    causes_text,
    determined,
    meaning,
    place_text,
    probability_text,
    size_text,
)
from modalax.show.diagnosis import residual_rows, run_names
from modalax.show.report.evidence import evidence_sections
from modalax.show.report.page import Page, Plot, Section, Table
from modalax.show.report.plots import bar_plot, comparison_plot, residual_plot

MOST_CANDIDATES = 12  # rows of the table of candidates


def interval(value: float | None, std: float | None) -> str:
    """95 % interval of a value, as text."""
    if value is None or std is None or not math.isfinite(std):
        return "not known"
    return f"{value - 1.96 * std:.5g} to {value + 1.96 * std:.5g}"


def cause_rows(answer: Mapping[str, Any]) -> Table:
    """Table of the causes and their parameters with intervals."""
    rows = []
    for cause in answer["causes"]:
        first = [cause["name"], place_text(cause["where"]), probability_text(answer, cause)]
        items = list(cause["parameters"].items()) or [("", None)]
        for k, (name, p) in enumerate(items):
            cells = ["", "", ""] if p is None else [
                f"{name} [{p['unit']}]", size_text(p), interval(p["value"], p["std"] if determined(p) else None)
            ]  # fmt: skip
            rows.append([*(first if k == 0 else ["", "", ""]), *cells])
    head = ["Cause", "Where", "Probability", "Parameter", "Value ± standard deviation", "95 % interval"]
    title = "The best attempt." if answer["verdict"] == "unknown" else "Causes that the extended simulation contains."
    return Table(head, rows, title, text_columns=(0, 1, 3))


def gain_rows(gain: Mapping[str, Any]) -> Table:
    """Table of how much better the extended simulation predicts data that it was not fitted to."""
    likelihood = with_error(gain["log_likelihood_gain"], gain["log_likelihood_gain_std"])
    rows = [
        ["Chi-square per real sample (1 is noise alone)", f"{gain['chi2_before']:.4g}", f"{gain['chi2_after']:.4g}"],
        ["Gain of log-likelihood [nats]", "", likelihood],
    ]
    return Table(["On the held-out block", "Simulation", "Extended"], rows, f"Held out of the fit: {gain['held_out']}.")


def diagnosis_sections(diagnosis: Diagnosis, answer: Mapping[str, Any]) -> list[Section]:
    """Sections of a diagnosis: answer, gain, FRFs, residuals, candidates, smallest detectable effects."""
    text = [_sentence(meaning(answer))]
    if answer["reasons"]:
        text.append(f"Why: {'; '.join(answer['reasons'])}.")
    if answer["verdict"] == "unknown" and answer["causes"] and answer["gain"]:
        text.append(_sentence(attempt_text(answer)))
    text += [f"It may also be {causes_text(rival)}." for rival in answer["alternatives"]]
    if answer["advice"]:
        text.append(_sentence(advice_text(answer)))
    # A probability of 0.95 allows 1 in 20 to be wrong; a reader must know what it is a probability of.
    text.append("The probabilities compare the causes of the catalogue with one another, at all places and parameters.")
    first = Section("Answer", text, [cause_rows(answer)] if answer["causes"] else [])
    names, before, after = residual_rows(
        diagnosis.comparison.measurement, diagnosis.residual_before, diagnosis.residual_after
    )
    maps = [("simulation", before)] + ([("extended simulation", after)] if diagnosis.extended is not None else [])
    sections = [first]
    if diagnosis.extended is not None:
        sections.append(Section("Gain", [], [gain_rows(answer["gain"])]))
    sections += [
        Section("Measured and simulated FRFs", [], [_frfs(diagnosis)]),
        Section("Residuals", [_tests(diagnosis)], [residual_plot(diagnosis.freq, maps, names)]),
    ]
    sections += evidence_sections(diagnosis.evidence)
    if diagnosis.candidates:
        sections.append(Section("Candidates", [], _candidates(diagnosis)))
    sections += smallest_sections(diagnosis, answer)
    sections.append(Section("What was assumed", [_sentence(note) for note in diagnosis.notes]))
    return sections


def _sentence(clause: str) -> str:
    return f"{clause[:1].upper()}{clause[1:].rstrip('.')}."


def _frfs(diagnosis: Diagnosis) -> Plot:
    data = diagnosis.comparison.measurement
    extended = diagnosis.predicted_after if diagnosis.extended is not None else None
    return comparison_plot(
        diagnosis.freq, data.H, diagnosis.predicted_before, extended, data.form, data.outputs, data.inputs,
        run_names(np.asarray(data.level)),
    )  # fmt: skip


def _tests(diagnosis: Diagnosis) -> str:
    before, after = diagnosis.tests
    text = f"The largest deviation from the simulation is {before.z:.3g} standard deviations ({before.where})"
    if diagnosis.extended is None:
        return f"{text}."
    return f"{text}, from the extended one {after.z:.3g} (chance of that under noise alone: {after.p_value:.2g})."


def _candidates(diagnosis: Diagnosis) -> list[Table | Plot]:
    leading = diagnosis.candidate_rows[:MOST_CANDIDATES]
    names = [name for name, _, _ in leading]
    rows = [[name, f"{p:.4f}", f"{value - leading[0][2]:.4g}"] for name, p, value in leading]
    caption = f"The {len(leading)} leading of {len(diagnosis.candidates)} sets that were fitted in full."
    head = ["Set of causes", "Probability", "Log evidence relative to the first [nats]"]
    chart = bar_plot(names[:6], [p for _, p, _ in leading[:6]], "Probability [-]", "Probabilities of the leading sets.")
    return [chart, Table(head, rows, caption)]


def smallest_sections(diagnosis: Diagnosis, answer: Mapping[str, Any]) -> list[Section]:
    """Smallest detectable effects; no section where only force levels were compared, which do not tell them."""
    if not answer["smallest_detectable"]:
        return []
    strengths = diagnosis.strength_parameters
    rows = [
        [slug, f"{strengths[slug].name} [{strengths[slug].unit}]", f"{value:.3g}"]
        for slug, value in sorted(answer["smallest_detectable"].items())
    ]
    caption = "Strength that nine in ten such measurements would have shown, at a place of median sensitivity."
    table = Table(["Cause", "Strength", "Smallest"], rows, caption, text_columns=(0, 1))
    return [Section("Smallest effects that would have been seen", [], [table])]


def diagnosis_facts(diagnosis: Diagnosis, answer: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Key facts at the top of the page."""
    data = diagnosis.comparison.measurement
    facts = [("Verdict", answer["verdict"])]
    if answer["causes"]:
        facts.append(("Cause", causes_text(answer["causes"])))
        facts.append(("Probability", probability_text(answer, answer["causes"][0])))
        facts.append(
            ("Held-out chi-square", f"{answer['gain']['chi2_before']:.3g} to {answer['gain']['chi2_after']:.3g}")
        )
    facts.append(("Runs, outputs, inputs", f"{data.runs}, {len(data.outputs)}, {len(data.inputs)}"))
    facts.append(("Band", f"{diagnosis.freq[0]:.5g} to {diagnosis.freq[-1]:.5g} Hz"))
    facts.append(("Question", diagnosis.question))
    return facts


def diagnosis_report(diagnosis: Diagnosis, title: str = "Diagnosis") -> str:
    """Make the report of a :class:`modalax.diagnose.Diagnosis` as the text of one self-contained HTML file.

    Raises
    ------
    ImportError
        If plotly or jinja2 is not installed.
    """
    answer = diagnosis.to_dict()
    sections = diagnosis_sections(diagnosis, answer)
    return Page(title, "What a simulation gets wrong", diagnosis_facts(diagnosis, answer), sections).html()
