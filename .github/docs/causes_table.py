"""The page of causes, made from the catalogue of the diagnosis: ``python .github/docs/causes_table.py`` prints it."""

STAGES = {
    "WindowCause": "the Laplace variable",
    "UndampedCause": "frequencies and damping of the modes",
    "ModesCause": "the modal equations",
    "HystereticCause": "the modal equations",
    "KernelCause": "the decay of each mode",
    "ElementCause": "a place or a pair",
    "LocalCause": "a place or a pair",
    "CouplingCause": "a pair",
    "JointCause": "a place or a pair",
    "ChannelCause": "channels",
    "PatternCause": "channels",
    "LinesCause": "single lines",
    "GroupCause": "elements that the simulation names",
}
COLUMNS = ("summary", "parameters", "stage", "advice")

TOP = """# Causes that a diagnosis can name

Made from the catalogue by `.github/docs/causes_table.py`; `modalax causes` prints the same in a terminal. *Acts on* is
the stage of the prediction that the cause changes. The first parameter is the strength; at 0 the cause is not there.

| Cause | The simulation lacks | Parameters | Acts on | Told best by |
|---|---|---|---|---|
"""


def page() -> str:
    """The page as Markdown: a row for each name that an answer may give; forms that share one share the row."""
    from modalax.diagnose import catalogue

    rows: dict[str, dict[str, dict[str, None]]] = {}
    for cause in catalogue():
        row = rows.setdefault(cause.slug, {"summary": {}, "parameters": {}, "stage": {}, "advice": {}})
        row["summary"][cause.summary] = None
        row["parameters"].update({f"`{p.name}` [{p.unit}]": None for p in cause.parameters})
        row["stage"][next(STAGES[kind.__name__] for kind in type(cause).__mro__ if kind.__name__ in STAGES)] = None
        if cause.advice:
            row["advice"][cause.advice] = None
    lines = [
        " | ".join([f"| `{slug}`", *("; ".join(row[key]) or "–" for key in COLUMNS)]) + " |"
        for slug, row in rows.items()
    ]
    return TOP + "\n".join(line.replace("\n", " ") for line in lines) + "\n"


if __name__ == "__main__":
    print(page(), end="")
