"""``modalax demo``: identification and diagnosis on a system whose true modes and hidden effects are known."""

import time
from pathlib import Path
from typing import Annotated, Any

import typer

from modalax.cli.common import (
    OverwriteOption,
    can_report,
    check_folder,
    free_folder,
    note,
    start,
    working,
    write_json,
)

NOISE = 0.15
DEFAULT = Path("modalax-demo")


def demo(
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Folder for pictures, results and the report.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the noise and of the randomly chosen hidden effect.")] = 0,
    overwrite: OverwriteOption = False,
) -> None:
    """Identify and diagnose a virtual test of a system of five degrees of freedom."""
    if out is None and DEFAULT.exists() and not overwrite:
        out = free_folder(DEFAULT)
        note(f"{DEFAULT} exists already; writing to {out}")
    out = DEFAULT if out is None else out
    check_folder(out, overwrite)
    report = can_report()
    if not report:
        note("no report is written: that needs plotly and jinja2, which pip install 'modalax[report]' brings")
    begin = time.perf_counter()
    start()
    from rich.console import Console

    from modalax.cli.virtual import hidden_joint, random_effect
    from modalax.files.write import write_text
    from modalax.model.examples import five_dof

    console = Console()
    out.mkdir(parents=True, exist_ok=True)
    sections = identify_story(console, out, seed, report)
    joint, law = hidden_joint()
    sections += diagnosis_story(console, out, "2", "A hidden joint", joint, seed + 1, report, law)
    sections += diagnosis_story(
        console, out, "3", "A randomly chosen hidden effect", random_effect(seed, five_dof().dofs), seed + 2, report
    )
    if report:
        from modalax.show.report import Page

        words = "Five degrees of freedom, measured virtually, so that the truth is known"
        write_text(out / "report.html", Page("modalax demo", words, (), sections).html())
    note(f"done in {time.perf_counter() - begin:.0f} s")
    print(f"Pictures and results: {out.absolute()}")
    if report:
        print(f"Report, opens in any browser: {(out / 'report.html').absolute()}")


def identify_story(console: Any, out: Path, seed: int, report: bool) -> list[Any]:
    """Part 1: modes with standard deviations from noisy FRFs, beside the true modes; its sections for a report."""
    import jax
    import numpy as np

    from modalax.cli.tables import mode_table, print_uncut
    from modalax.identify import fit as identify
    from modalax.model.examples import five_dof
    from modalax.show import save_fit_pictures

    structure = five_dof()
    truth = structure.modal()
    console.rule(f"1. Modes from FRFs with {100 * NOISE:.0f} % noise", align="left")
    frf = structure.frf(np.arange(200, 701) / 10, inputs=["1"]).add_noise(jax.random.key(seed), NOISE)
    with working("Identifying the modes (slower the first time, when programs are compiled)") as progress:
        fit = identify(frf, progress=progress)
    answer = fit.to_dict()
    known = matched(answer, np.asarray(truth.frequency_hz), np.asarray(truth.damping_ratio))
    print_uncut(console, mode_table(answer["modes"], known))
    with working("Drawing"):
        save_fit_pictures(fit, out, truth=known)
        write_json(out / "modes.json", answer)
    if not report:
        return []
    from modalax.show.report.fit import fit_sections

    return numbered("1", fit_sections(fit, answer["modes"], known))


def diagnosis_story(
    console: Any, out: Path, number: str, title: str, hidden: Any, seed: int, report: bool, joint: Any = None
) -> list[Any]:
    """Parts 2 and 3: a virtual test of a structure that differs from its simulation, and what the diagnosis finds."""
    from modalax.cli.tables import print_diagnosis
    from modalax.cli.virtual import LEVELS, virtual_test
    from modalax.diagnose import diagnose
    from modalax.model.examples import five_dof
    from modalax.show.diagnosis import diagnosis_pictures
    from modalax.show.fit import save_pictures

    levels = ", ".join(f"{force:g}" for force in LEVELS)
    console.rule(f"{number}. {title}: a test at {levels} N against the simulation", align="left")
    with working("Testing virtually"):
        measurement = virtual_test(hidden, seed, joint)
    with working("Comparing, screening all causes at all places, refitting (slower the first time)"):
        diagnosis = diagnose(measurement, five_dof())
    answer = diagnosis.to_dict()
    print_diagnosis(console, answer)
    console.print(f"the hidden effect was: {hidden}", style="dim", highlight=False, markup=False)
    with working("Drawing"):
        pictures = diagnosis_pictures(diagnosis)
        save_pictures({f"diagnosis{number}_{name}": figure for name, figure in pictures.items()}, out)
        write_json(out / f"diagnosis{number}.json", answer)
    if not report:
        return []
    from modalax.show.report import Section
    from modalax.show.report.diagnosis import diagnosis_sections

    story = Section("Hidden effect", [f"The structure tested differs from the simulation by this: {hidden}."])
    return numbered(number, [story, *diagnosis_sections(diagnosis, answer)])


def numbered(number: str, sections: list[Any]) -> list[Any]:
    """Put the number of a part before the titles of its sections."""
    from dataclasses import replace

    return [replace(section, title=f"{number}. {section.title}") for section in sections]


def matched(answer: dict[str, Any], frequency_hz: Any, damping_ratio: Any) -> tuple[Any, Any]:
    """True frequency [Hz] and damping ratio of the mode nearest to each identified one."""
    import numpy as np

    found = np.array([m["frequency_hz"] for m in answer["modes"]])
    nearest = np.argmin(np.abs(found[:, None] - frequency_hz[None]), axis=1)
    return frequency_hz[nearest], damping_ratio[nearest]
