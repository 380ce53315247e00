"""Text of a fit for ``print``: a line about the whole, and a line about each mode."""

from collections.abc import Mapping
from typing import Any

from modalax._numerics.text import text_table, with_error

GRADE = "Grade: how sure it is that this is a mode, 0 to 1."
MASS = "Modal mass: real part, for the shape as it is scaled here, its largest component 1."
BIAS = (
    "Bias: predicted error of the damping in the stabilization diagram due to noise (empty: not known, or the mode is "
    "lost in noise); the refinement removes it."
)


def summary(answer: Mapping[str, Any]) -> str:
    """The table of modes of ``Fit.to_dict()``: frequency and damping with standard deviations, MPC, flags."""
    modes, (low, high) = answer["modes"], answer["band_hz"]
    rows = [
        [
            str(k + 1),
            with_error(mode["frequency_hz"], mode["frequency_std_hz"]),
            with_error(mode["damping_ratio"], mode["damping_ratio_std"], 100.0),
            f"{mode['mpc']:.3f}",
        ]
        for k, mode in enumerate(modes)
    ]
    count = "1 mode" if len(modes) == 1 else f"{len(modes)} modes"
    head = (
        f"{count} from {low:g} to {high:g} Hz, {answer['method']} of order {answer['order']}, {_refinement(answer)}; "
        f"unexplained part of the measured energy: {100 * answer['unexplained']:.3g} %"
    )
    table = text_table(("Mode", "Frequency [Hz]", "Damping [%]", "MPC"), rows)
    flags = [f"mode {k + 1}: {'; '.join(mode['flags'])}" for k, mode in enumerate(modes) if mode["flags"]]
    return "\n".join([head, table, *flags, *(f"note: {text}" for text in answer["notes"])])


def _refinement(answer: Mapping[str, Any]) -> str:
    if answer["refined"]:
        return "refined (± one standard deviation)"
    return "not refined" if answer["reason"] is None else f"refinement did not converge ({answer['reason']})"
