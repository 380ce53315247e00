"""The result of a diagnosis: verdict, causes, gain, and all that stands behind them."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from modalax.data.frf import DERIVATIVES
from modalax.diagnose.causes.base import Cause
from modalax.diagnose.causes.mains_hum import MainsHum
from modalax.diagnose.causes.parameter import Parameter
from modalax.diagnose.comparison import Comparison
from modalax.diagnose.decision.advice import advise
from modalax.diagnose.decision.gain import Gain
from modalax.diagnose.decision.omnibus import Omnibus
from modalax.diagnose.decision.posterior import Ranked
from modalax.diagnose.decision.sets import as_stated, rivals
from modalax.diagnose.evidence import Compared, evidence_of
from modalax.diagnose.extend import ExtendedSimulation
from modalax.diagnose.fitting.hypothesis import Hypothesis, slopes
from modalax.diagnose.over_levels import levels_said, over_levels
from modalax.diagnose.rotations import in_own_units, rotations_in
from modalax.diagnose.search.explain import Explanation
from modalax.diagnose.summary import causes_text, summary
from modalax.diagnose.thresholds import THRESHOLDS


@dataclass(frozen=True)
class Diagnosis:
    """What a simulation gets wrong.

    Attributes
    ----------
    verdict
        ``clean``, ``named``, ``ambiguous`` or ``unknown``.
    reasons
        Why this verdict, one clause each.
    found
        Everything behind the verdict: ``ranked`` sets of causes with probabilities, ``look`` with all trials and the
        tests of the simulation alone, ``after`` with the test of what the leading set leaves.
    comparison
        Data, noise, nuisances; ``notes`` says what was assumed.
    extended
        The extended simulation; None where nothing was found.
    gain
        On the held-out block.
    freq
        Lines [Hz], shape ``(f,)``.
    residual_before, residual_after
        Whitened residuals (both parts of unit variance under noise), complex, shape ``(run, f, o, i)``.
    predicted_before, predicted_after
        FRFs in the form of the measurement, shape ``(run, f, o, i)``.
    """

    verdict: str
    reasons: tuple[str, ...]
    found: Explanation
    comparison: Comparison
    extended: ExtendedSimulation | None
    gain: Gain
    freq: np.ndarray
    residual_before: np.ndarray
    residual_after: np.ndarray
    predicted_before: np.ndarray
    predicted_after: np.ndarray

    def __str__(self) -> str:
        """Verdict, causes and gain."""
        return summary(self.to_dict())

    @property
    def question(self) -> str:
        """``fixed`` (against this simulation) or ``free`` (against any linear modal model)."""
        return self.comparison.question

    @property
    def notes(self) -> tuple[str, ...]:
        """What was assumed, in sentences."""
        return self.comparison.notes

    @property
    def candidates(self) -> list[Ranked]:
        """Sets of causes by falling probability."""
        return self.found.ranked

    @property
    def candidate_rows(self) -> list[tuple[str, float, float]]:
        """Name, probability and log evidence of each set of causes."""
        return [(causes_text(_names(r.best)), r.probability, r.log_evidence) for r in self.candidates]

    @property
    def tests(self) -> tuple[Omnibus, Omnibus]:
        """Tests of what the simulation leaves, and of what the extended one leaves."""
        return self.found.look.omnibus, self.found.after

    @property
    def modes_in_band(self) -> np.ndarray:
        """Frequencies [Hz] and damping ratios of the simulation in the band, shape ``(2, n)``."""
        scene = self.comparison.scene
        return within(np.stack([scene.frequency_hz, scene.damping_ratio]), self.freq)

    @cached_property
    def evidence(self) -> dict[str, Any] | None:
        """What the data show beside the verdict: tests with their chances, errors by mode, channel and level."""
        if not len(self.freq):
            return None
        data = self.comparison.measurement
        H = np.asarray(data.H)
        before, after = (np.broadcast_to(p, H.shape) for p in (self.predicted_before, self.predicted_after))
        compared = Compared(
            np.asarray(self.freq), H, before, after, (self.residual_before, self.residual_after), self.tests,
            np.asarray(data.level), data.outputs, data.inputs, DERIVATIVES[data.form], self.modes_in_band,
        )  # fmt: skip
        found = evidence_of(compared)
        return None if found is None else {**found, "over_levels": over_levels(compared)}

    @property
    def causes(self) -> list[dict[str, Any]]:
        """What the extended model contains, no likelier than the verdict leaves room for."""
        rotations = rotations_in(None if self.extended is None else self.extended.base)
        return as_stated(self.verdict, in_own_units(self._causes, rotations))

    @property
    def _causes(self) -> list[dict[str, Any]]:
        """The same, with units as of displacements and forces everywhere."""
        if not self.found.ranked or self.verdict == "clean":
            return []
        return _told(self.found.best, self.found.ranked[0].probability)

    @property
    def alternatives(self) -> list[list[dict[str, Any]]]:
        """Rivals of the leading set, without parameters; of a named one those that differ in the place."""
        if self.verdict not in ("ambiguous", "named"):
            return []
        limit = [{"name": slug, "where": list(where)} for slug, where in self.found.best.at_limits]
        others = [_names(r.best) for r in rivals(self.verdict, self.found.ranked)]
        return [limit, *(o for o in others if o != limit)] if limit else others

    @property
    def strength_parameters(self) -> dict[str, Parameter]:
        """What the strength of each cause is: the first parameter of the first of its forms."""
        out: dict[str, Parameter] = {}
        for t in self.found.look.screening.trials:
            if t.cause.parameters:
                out.setdefault(t.cause.slug, t.cause.parameters[0])
        return out

    @property
    def smallest_detectable(self) -> dict[str, float]:
        """Strength of each cause that nine in ten such measurements would show, at a place of median sensitivity.

        Of the forms of a cause (a drift of everything, of one spring) those that have the same strength.
        """
        errors: dict[str, list[float]] = {}
        strengths = self.strength_parameters
        for t in self.found.look.screening.trials:
            if t.cause.parameters and t.cause.parameters[0] == strengths[t.cause.slug] and np.isfinite(t.error):
                errors.setdefault(t.cause.slug, []).append(t.error)
        least = self.found.look.detection.threshold + THRESHOLDS.power
        return {slug: float(np.median(values) * least) for slug, values in errors.items()}

    @property
    def advice(self) -> str | None:
        """What to measure to tell the alternatives apart, and what without a name the data looks like."""
        if self.verdict == "clean" or (self.verdict == "named" and not self.alternatives):
            return None
        ranked = self.found.ranked
        sets = [ranked[0], *rivals(self.verdict, ranked)] if ranked else []
        told = advise(self.verdict, sets, bool(levels_said(self.verdict, self.evidence)))
        return "; ".join([*self.found.notes, told])

    def to_dict(self) -> dict[str, Any]:
        """The answer as plain data, in the agreed form."""
        return {
            "verdict": self.verdict,
            "causes": self.causes,
            "alternatives": self.alternatives,
            "advice": self.advice,
            "smallest_detectable": self.smallest_detectable,
            "inaccuracy": None,  # line by line all but the causes is taken as exact
            "throughout": {},
            "reasons": [*self.reasons, *levels_said(self.verdict, self.evidence)],
            "gain": self.gain.to_dict(),
            "question": self.question,
            "notes": list(self.notes),
            "p_value": self.found.look.detection.p_value,
            "evidence": self.evidence,
        }


def within(modes: np.ndarray, freq: np.ndarray) -> np.ndarray:
    """Those of some modes, frequencies [Hz] and damping ratios ``(2, n)``, that lie in the band and are damped."""
    return modes[:, (modes[0] > freq[0]) & (modes[0] < freq[-1]) & (modes[1] > 0)]


def _names(h: Hypothesis) -> list[dict[str, Any]]:
    return [{"name": c.slug, "where": list(p.where)} for c, p in h.parts]


def _told(h: Hypothesis, probability: float) -> list[dict[str, Any]]:
    out, k = [], 0
    for cause, place, p in zip(h.causes, h.places, h.params, strict=True):
        count = len(p)
        cov = np.zeros((count, count)) if h.covariance is None else h.covariance[k : k + count, k : k + count]
        scale = slopes(cause, p)
        out.append(
            {
                "name": cause.slug, "where": list(place.where), "probability": float(probability),
                "parameters": parameters_told(cause, place, p, cov * np.outer(scale, scale)),
            }
        )  # fmt: skip
        k += count
    if h.hum is not None:
        hum = MainsHum()
        told = {name: {"value": value, "std": None, "unit": unit} for name, (value, unit) in hum.told(h.hum).items()}
        out.append({"name": hum.slug, "where": [], "probability": float(probability), "parameters": told})
    return out


def parameters_told(cause: Cause, place: Any, p: np.ndarray, cov: np.ndarray) -> dict[str, Any]:
    """Values and standard deviations as reported, by first-order propagation."""
    values = cause.report(p, place)
    out = {}
    for key, (value, unit) in values.items():
        slope = np.zeros(len(p))
        for j in range(len(p)):
            step = 1e-6 * max(abs(p[j]), 1e-300)
            moved = p.copy()
            moved[j] += step
            slope[j] = (cause.report(moved, place)[key][0] - value) / step
        variance = float(slope @ cov @ slope) if len(p) else np.nan
        out[key] = {"value": float(value), "std": float(np.sqrt(variance)) if variance > 0 else None, "unit": unit}
    return out
