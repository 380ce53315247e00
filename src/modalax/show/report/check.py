"""The report of a check, with a section and a picture of the evidence for each finding."""

from modalax.check.finding import Finding, Findings, Picture
from modalax.show.report.page import Page, Plot, Section, Table
from modalax.show.report.plots import BLUE, ORANGE, base_figure, escape, graph_objects

COLOURS = (BLUE, ORANGE, "#2a9d6f", "#8c8c8c")


def check_report(result: Findings, title: str = "Check of a measurement") -> str:
    """Make the report of :func:`modalax.check` as the text of one self-contained HTML file.

    Raises
    ------
    ImportError
        If plotly or jinja2 is not installed.
    """
    facts = [("Findings", str(len(result)))]
    if len(result):
        facts.append(("Surest", f"{result.findings[0].what}: {result.findings[0].place}"))
    return Page(title, "Faults of a measurement, found without a model", facts, check_sections(result)).html()


def check_sections(result: Findings) -> list[Section]:
    """A table of all findings, then each with its evidence, its advice and its picture."""
    if not len(result):
        return [Section("Findings", ["Nothing wrong was found.", *result.about])]
    rows = [[f.what, f.place, f.measure, f"{f.sure:.3f}"] for f in result]
    head = ["What", "Where", "Size", "Sure [-]"]
    table = Table(head, rows, "Sure: probability that the fault is real.", text_columns=(0, 1))
    return [Section("Findings", list(result.about), [table]), *(_section(f) for f in result)]


def _section(found: Finding) -> Section:
    sentence = lambda text: f"{text[:1].upper()}{text[1:]}."
    text = [sentence(found.evidence), f"What to do: {found.advice}."]
    if found.interval is not None:
        text.insert(1, f"95 % interval of the size: {found.interval[0]:.5g} to {found.interval[1]:.5g} {found.unit}.")
    parts = [] if found.picture is None else [picture_plot(found.picture, f"Evidence: {found.evidence}.")]
    return Section(f"{found.what}: {found.place}", text, parts)


def picture_plot(picture: Picture, caption: str) -> Plot:
    """Draw the curves of a picture."""
    go = graph_objects()
    fig = base_figure(1)
    for k, (label, x, y) in enumerate(picture.curves):
        style = {"mode": "markers", "marker": {"color": COLOURS[k % len(COLOURS)], "size": 8}}
        if not picture.dots or len(x) == 2:
            style = {"mode": "lines", "line": {"color": COLOURS[k % len(COLOURS)], "width": 1.4}}
        fig.add_trace(go.Scatter(x=x, y=y, name=escape(label), **style))
    fig.update_xaxes(title=escape(picture.x))
    fig.update_yaxes(title=escape(picture.y), type="log" if picture.logarithmic else "linear")
    return Plot([("", fig)], caption, caption)
