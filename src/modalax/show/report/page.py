"""One self-contained HTML page: headings, text, tables and plotly figures, with nothing to load from a network."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from modalax.show.report.moving import Shapes

HERE = Path(__file__).parent
NEEDS = "a report needs plotly and jinja2; install them by: pip install 'modalax[report]'"


@dataclass(frozen=True)
class Table:
    """A table of texts; columns of numbers are set flush right."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    text_columns: Sequence[int] = (0,)


@dataclass(frozen=True)
class Plot:
    """Plotly figures that share one place: ``figures`` holds (label, figure), chosen from a list if there are several.

    ``description`` is what a reader who cannot see the picture is told. Traces whose ``meta`` is ``ink`` are drawn in
    the colour of the text, so that they are seen on light and dark ground. On paper stand, ``across`` of
    them side by side, the figures whose places are in ``on_paper``, unless the reader selects others; if empty, the one
    that is shown.
    """

    figures: Sequence[tuple[str, Any]]
    caption: str
    description: str
    choose: str = "Channel"
    height: int = 420
    on_paper: Sequence[int] = ()
    across: int = 1


@dataclass(frozen=True)
class Section:
    """A heading with paragraphs, then tables and plots in the order given."""

    title: str
    text: Sequence[str] = ()
    parts: Sequence[Table | Plot | Shapes] = ()


@dataclass(frozen=True)
class Page:
    """A report: a title, a line below it, key facts (name, value) and sections."""

    title: str
    subtitle: str = ""
    facts: Sequence[tuple[str, str]] = ()
    sections: Sequence[Section] = field(default_factory=tuple)

    def html(self) -> str:
        """Render the page.

        Raises
        ------
        ImportError
            If plotly or jinja2 is not installed.
        """
        try:
            import jinja2

            plotly = plotly_script()
        except ImportError as error:
            raise ImportError(NEEDS) from error
        environment = jinja2.Environment(
            loader=jinja2.FileSystemLoader(HERE), autoescape=True, undefined=jinja2.StrictUndefined
        )
        tests: dict = environment.tests
        tests["table"] = lambda part: isinstance(part, Table)
        tests["moving"] = lambda part: isinstance(part, Shapes)
        environment.filters["figure_json"] = figure_json
        return environment.get_template("page.html.j2").render(
            page=self,
            # Files of this package and of plotly, not data: they go in as they are.
            plotly=in_script(plotly),
            css=(HERE / "page.css").read_text(encoding="utf-8"),
            script=shape_script() + (HERE / "page.js").read_text(encoding="utf-8"),
        )


def plotly_script() -> str:
    """Plotly's program for browsers, as its Python package brings it; ``ImportError`` where that is not installed."""
    from plotly.offline import get_plotlyjs

    return get_plotlyjs()


def shape_script() -> str:
    """Program for browsers that draws a moving shape: ``ModalShape`` of ``shape.js``."""
    return (HERE / "shape.js").read_text(encoding="utf-8")


def figure_json(plot: Plot) -> str:
    """All figures of a plot as JSON that may stand inside a script element."""
    choices = [
        f'{{"label": {_json(label)}, "figure": {figure.to_json()}}}'  # to_json packs arrays in base64
        for label, figure in plot.figures
    ]
    text = "[" + ", ".join(choices) + "]"
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _json(text: str) -> str:
    import json

    return json.dumps(text)


def in_script(source: str) -> str:
    """Program text that cannot end its script element early."""
    return source.replace("</script", "<\\/script")
