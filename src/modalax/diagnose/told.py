"""What a search line by line has found, as an answer: held-out data predicted, verdict, residuals and predictions."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from modalax.data.frf import DERIVATIVES
from modalax.diagnose.decision.gain import Gain
from modalax.diagnose.decision.verdict import verdict
from modalax.diagnose.extend import extend
from modalax.diagnose.holdout import measure
from modalax.diagnose.result import Diagnosis
from modalax.diagnose.search.explain import Explanation
from modalax.diagnose.search.rows import lines_aside
from modalax.diagnose.search.tolerance import widened


def told(found: Explanation, progress: Callable[[str], None]) -> Diagnosis:
    """Predict what was held out, and decide."""
    comparison = found.comparison
    progress("predicting the held-out data")
    gain = measure((found.look.comparison, found.comparison), found.look.null, found.best, found.leftover.tolerated)
    leftover = found.leftover
    if comparison.late() and len({slug for slug, _ in found.best.names}) > 1 and not leftover.untried:
        leftover = replace(leftover, untried=("other sets of causes",))
    word, reasons = verdict(found.ranked, leftover, gain)
    if aside := lines_aside(found.best):
        lines = "1 line, which was" if aside == 1 else f"{aside} lines, which were"
        reasons = (*reasons, f"no steady motion of the joint explains {lines} set aside")
    if comparison.late():
        reasons = (*reasons, "time was up before every explanation had been tried")
    null = found.look.null.chi2
    found = replace(found, ranked=[replace(r, best=widened(r.best, null)) for r in found.ranked])
    return answer(word, reasons, found, gain)


def answer(word: str, reasons: tuple[str, ...], found: Explanation, gain: Gain) -> Diagnosis:
    """Lay out residuals and predictions before and after, in the form of the measurement."""
    alone, comparison = found.look.comparison, found.comparison
    n_out, n_in = comparison.problem.channels
    order = DERIVATIVES[comparison.measurement.form]
    unit = (2j * np.pi * comparison.scene.freq[:, None, None]) ** order

    def cut(residual: np.ndarray) -> np.ndarray:
        return residual[:, : comparison.problem.lines, :n_out, :n_in]

    return Diagnosis(
        word, reasons, found, comparison, extend(comparison, found.best) if found.best.causes else None,
        gain, comparison.scene.freq,
        cut(alone.residual(found.look.null)), cut(comparison.residual(found.best)),
        alone.prediction(found.look.null) * unit, comparison.prediction(found.best) * unit,
    )  # fmt: skip
