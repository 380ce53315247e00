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

TOP = """# Causes that a diagnosis can name

Made from the catalogue by `.github/docs/causes_table.py`; `modalax causes` prints names, parameters and meaning in a
terminal. *Acts on* is the stage of the prediction that the cause changes.

*Parameters* are those that an answer gives. At rotations their units are those of moments and angles, N m/rad instead
of N/m. A `gain` is a factor less one; factors of groups of elements are 1 where nothing is wrong. Where elements are
read off the matrices, a `joint_stiffness` may have other parameters: `relative_change` [-] of the whole element,
`relative_change_in_plane` [-] of a beam that is wrong in one plane of bending, or `rotational_stiffness` [N m/rad] of
a beam's end that gives way against its node or its clamp. One of several springs that hold a body, as the isolators of
a machine, has the change of its `stiffness` [N/m] and, as `offset_x` to `offset_z` [m], the place of its line of action
from the node, across that line. A body whose centre of mass is off its node is an `added_mass` with such offsets and a
`radius_of_gyration` [m] about its centre.

| Cause | The simulation lacks | Parameters | Acts on | Told best by |
|---|---|---|---|---|
"""


def page() -> str:
    """The page as Markdown: a row for each name that an answer may give; forms that share one share the row."""
    from modalax.diagnose import catalogue
    from modalax.diagnose.causes.listing import listing

    lines = []
    for row in listing(catalogue()):
        units = [f"`{name}` [{unit}]" for name, unit in row.units.items()]
        stages = dict.fromkeys(stage(form) for form in row.forms)
        cells = ("; ".join(each) or "–" for each in (row.summaries, units, stages, row.advice))
        lines.append(" | ".join([f"| `{row.slug}`", *cells]).replace("\n", " ") + " |")
    return TOP + "\n".join(lines) + "\n"


def stage(cause) -> str:
    """The stage of the prediction that a cause changes."""
    return next(STAGES[kind.__name__] for kind in type(cause).__mro__ if kind.__name__ in STAGES)


if __name__ == "__main__":
    print(page(), end="")
