"""The report of a fit."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from modalax._numerics.text import with_error
from modalax.data.geometry import Geometry
from modalax.identify.summary import BIAS, GRADE, MASS
from modalax.model.indicators import auto_mac
from modalax.show.matrices import mode_names
from modalax.show.report.moving import shapes_on
from modalax.show.report.page import Page, Section, Table
from modalax.show.report.plots import frf_plot, mac_plot, modes_plot, shape_plot, stabilization_plot
from modalax.show.shapes import along


def mode_rows(modes: Sequence[Mapping[str, Any]], truth: tuple[Any, Any] | None = None) -> Table:
    """Table of modes, from ``Fit.to_dict()["modes"]``."""
    biased = any(m.get("predicted_damping_bias") is not None for m in modes)
    refined = any(m["frequency_std_hz"] is not None for m in modes)
    # Beside the truth there is no room for them on a page.
    massive = truth is None and any(m.get("modal_mass_kg") is not None for m in modes)
    head = ["Mode", "Frequency [Hz]", "Damping [%]", *(["Modal mass [kg]"] if massive else []), "MPC [-]", "Grade [-]"]
    head += ["Bias of damping [%]"] if biased else []
    rows = [
        [
            str(k + 1),
            with_error(m["frequency_hz"], m["frequency_std_hz"]),
            with_error(m["damping_ratio"], m["damping_ratio_std"], 100.0),
            *([_mass(m)] if massive else []),
            f"{m['mpc']:.4f}",
            f"{m['grade']:.2f}" if "grade" in m else "",
            *([_bias(m)] if biased else []),
        ]
        for k, m in enumerate(modes)
    ]
    if truth is not None:
        head += ["True frequency [Hz]", "True damping [%]"]
        for k, row in enumerate(rows):
            row += [f"{float(truth[0][k]):.5g}", f"{100 * float(truth[1][k]):.4g}"]
    words = [(refined, "± is one standard deviation."), (massive, MASS), (True, GRADE), (biased, BIAS)]
    return Table(head, rows, " ".join(text for said, text in words if said), text_columns=())


def remarks(modes: Sequence[Mapping[str, Any]]) -> list[Table]:
    """What is to be known of single modes before they are used; no table where there is nothing."""
    rows = [
        [str(k + 1), f"{m['frequency_hz']:.5g}", "; ".join(m["flags"])] for k, m in enumerate(modes) if m.get("flags")
    ]
    return [Table(["Mode", "Frequency [Hz]", "Remarks"], rows, text_columns=(2,))] if rows else []


def _mass(mode: Mapping[str, Any]) -> str:
    """Real part of the modal mass; a dash for a mode that does not move the drive point."""
    mass = mode.get("modal_mass_kg")
    if mass is None or not math.isfinite(mass[0]):
        return "-"
    return with_error(mass[0], mode.get("modal_mass_std_kg"))


def _bias(mode: Mapping[str, Any]) -> str:
    """Predicted bias over the damping itself; nothing where the noise or the mode's place in it is not known."""
    bias = mode.get("predicted_damping_bias")
    return "" if bias is None else f"{100 * bias / mode['damping_ratio']:+.2g}"


def _unexplained(answer: Mapping[str, Any]) -> str:
    """The unexplained part of the measured energy, and how much of it is noise where that is known."""
    whole = f"{100 * answer['unexplained']:.3g} %"
    noise = answer.get("unexplained_noise")
    return whole if noise is None else f"{whole}, of which {100 * noise:.2g} % noise"


def fit_sections(
    fit: Any,
    modes: Sequence[Mapping[str, Any]],
    truth: tuple[Any, Any] | None = None,
    geometry: Geometry | None = None,
) -> list[Section]:
    """Sections of a fit: modes, FRFs, stabilization, shapes."""
    model = fit.model
    refined = fit.refined
    if refined is None:
        how = (
            "The poles were read from the stabilization diagram and not refined, so they have no standard deviations; "
            "their damping ratios may be far off where they scatter over the orders."
        )
    elif bool(refined.success):
        how = "The poles, shapes and residual terms were refined together by maximum likelihood."
    else:
        how = f"The refinement by maximum likelihood did not converge: {refined.reason}"
    inside = np.asarray(fit.inside)
    seen = model.along_longer_side()
    psi, frequency = seen.shapes[inside], np.asarray(model.frequency_hz)[inside]
    turned = len(model.inputs) > len(model.outputs)
    at = " at the inputs (a roving hammer's hits)" if turned else ""
    dofs, moved = ([], psi) if geometry is None else along(geometry, model)
    shapes: list[Any] = [shape_plot(psi, seen.outputs, frequency, at, paper=not dofs)]
    if geometry is not None and dofs:
        shapes.insert(0, shapes_on(geometry, dofs, moved[inside], frequency))
    if len(seen.outputs) > 1 and len(modes) > 1:
        names = mode_names(frequency)
        shapes.append(mac_plot(auto_mac(psi), names, names, "Auto-MAC of the mode shapes."))
    return [
        Section(
            "Modes",
            [how, *getattr(fit, "notes", ())],
            [mode_rows(modes, truth), modes_plot(modes, truth), *remarks(modes)],
        ),
        Section("Measured and synthesised FRFs", [], [frf_plot(fit.frf, model)]),
        Section(
            "Stabilization diagram",
            [f"Estimator: {fit.table.method}, orders {min(fit.table.orders)} to {max(fit.table.orders)}."],
            [stabilization_plot(fit.table, fit.stability, fit.frf, frequency)],
        ),
        Section("Mode shapes", [], shapes),
    ]


def fit_report(
    fit: Any, title: str = "Modes", truth: tuple[Any, Any] | None = None, geometry: Geometry | None = None
) -> str:
    """Make the report of a :class:`modalax.identify.Fit` as the text of one self-contained HTML file.

    With a geometry the mode shapes are drawn on it as well.

    Raises
    ------
    ImportError
        If plotly or jinja2 is not installed.
    """
    answer = fit.to_dict()
    freq = np.asarray(fit.frf.freq)
    lines, outputs, inputs = fit.frf.shape
    facts = [
        ("Modes", str(len(answer["modes"]))),
        ("Band", f"{freq[0]:.5g} to {freq[-1]:.5g} Hz"),
        ("Lines", str(lines)),
        ("Outputs x inputs", f"{outputs} x {inputs}"),
        ("FRF", fit.frf.form),
        ("Unexplained energy", _unexplained(answer)),
    ]
    page = Page(title, "Experimental modal analysis", facts, fit_sections(fit, answer["modes"], truth, geometry))
    return page.html()
