"""The answer of the modal domain, with the interface of every other diagnosis."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from modalax.check.finding import Finding
from modalax.diagnose.causes.parameter import Parameter
from modalax.diagnose.decision.advice import advise_modes
from modalax.diagnose.decision.beyond import BeyondUsual
from modalax.diagnose.decision.levels import outweighing
from modalax.diagnose.decision.omnibus import Omnibus
from modalax.diagnose.decision.sets import rivals
from modalax.diagnose.modal_domain.causes.change import UNITS, Change, own_sizes, with_sizes
from modalax.diagnose.modal_domain.fitting.explanation import Explanation
from modalax.diagnose.modal_domain.judged import inaccuracy_of_fit, standing_out
from modalax.diagnose.modal_domain.levels.answer import causes_told, rivals_told
from modalax.diagnose.modal_domain.levels.explain import JointFound
from modalax.diagnose.modal_domain.odd_channels.misplaced import Moved
from modalax.diagnose.modal_domain.records.forced import Forced, force_rivals, force_told
from modalax.diagnose.modal_domain.records.mains import hum_told
from modalax.diagnose.modal_domain.search.screen import errors_of
from modalax.diagnose.modal_domain.stage import Stage
from modalax.diagnose.over_levels import levels_said
from modalax.diagnose.result import Diagnosis, within
from modalax.diagnose.summary import cause_at
from modalax.diagnose.thresholds import THRESHOLDS

PLACES = 300  # of each kind of cause of which the median of what is detectable is taken, of more an even choice
MOSTLY = 0.9  # share of the held-out misfit that goes where the rest, and not the whole simulation, is in question


@dataclass(frozen=True)
class Facts:
    """What was compared: in the place of a comparison line by line."""

    measurement: Any
    notes: tuple[str, ...]
    question: str = "fixed"


@dataclass(frozen=True)
class ModalDiagnosis(Diagnosis):
    """A diagnosis that also gives the general inaccuracy of the simulation.

    Attributes
    ----------
    stage
        Modes, candidates and explanations behind it.
    chosen
        The explanation that the answer is about.
    sets
        What stands out: the set of the answer first, the others by falling probability.
    inaccuracy
        Relative error of stiffness, mass and damping, each with an interval.
    throughout
        By how much stiffness, mass or damping of the simulation are too high throughout, with standard deviations;
        empty where none surely is.
    before, after
        Tests of what the simulation and the extended one leave.
    hum
        Mains hum, which shows on lines only; None where there is none.
    forced
        A force at one place that shows on lines only, without which everything else here is; None where there is none.
    moved
        Outputs that are at other DoFs than their names; None where all are where they should be.
    """

    found: None
    comparison: Facts
    stage: Stage
    chosen: Explanation
    sets: tuple[BeyondUsual, ...]
    inaccuracy: dict[str, Any]
    throughout: dict[str, dict[str, float]]
    before: Omnibus
    after: Omnibus
    hum: Finding | None = None
    forced: Forced | None = None
    moved: Moved | None = None

    def beside_hum(self, hum: Finding) -> "ModalDiagnosis":
        """The same, of the lines without hum, with that told as well."""
        reasons = [reason.replace("nothing stands", "nothing else stands") for reason in self.reasons]
        reasons.append(f"beside it there is mains hum, on lines that are left out: {hum.evidence}")
        return replace(self, verdict=outweighing(self.verdict, "named"), reasons=tuple(reasons), hum=hum)

    @property
    def candidates(self) -> list[Any]:
        """Explanations by falling probability."""
        return self.stage.explanations

    @property
    def candidate_rows(self) -> list[tuple[str, float, float]]:
        """Name, probability and log evidence of each explanation."""
        return [
            (
                " and ".join(cause_at(c.slug, c.where) for c in e.causes) or "the general inaccuracy alone",
                e.probability, e.log_posterior,
            )
            for e in self.stage.explanations
        ]  # fmt: skip

    @property
    def joint(self) -> JointFound | None:
        """The joint that tells the force levels apart."""
        return None if self.stage.seen is None else self.stage.seen.joint

    @property
    def tests(self) -> tuple[Omnibus, Omnibus]:
        """What the simulation leaves, and what the extended one leaves."""
        return self.before, self.after

    @property
    def modes_in_band(self) -> np.ndarray:
        """Frequencies [Hz] and damping ratios of the simulation in the band, shape ``(2, n)``."""
        c = self.stage.coordinates
        w = np.maximum(c.frequencies, 1e-300)
        return within(np.stack([w / 2 / np.pi, np.diag(c.damping) / 2 / w]), self.freq)

    @property
    def _causes(self) -> list[dict[str, Any]]:
        """What stands out beyond the general inaccuracy."""
        if self.verdict == "clean":
            return []
        elsewhere = [] if self.moved is None else self.moved.told()
        return elsewhere + self._linear + self._beyond_modes + ([] if self.hum is None else [hum_told(self.hum)])

    @property
    def _beyond_modes(self) -> list[dict[str, Any]]:
        """What tells the force levels apart, and the force that shows on lines only."""
        levels = (
            []
            if self.stage.seen is None
            else causes_told(self.stage.seen, self.stage.whole, max(self.stage.measured.misfit, 1.0))
        )
        return levels + ([] if self.forced is None else [force_told(self.forced)])

    @property
    def _linear(self) -> list[dict[str, Any]]:
        core, sure = standing_out(self.stage, self.chosen), self.sets[0].probability
        told, covariance, off = [], self.chosen.fit.covariance, inaccuracy_of_fit(self.stage, self.chosen)
        for k, (c, u) in enumerate(with_sizes(self.chosen.causes, self.chosen.fit.u)):
            if c not in core:
                continue
            own = own_sizes(self.chosen.causes, k)
            variance = covariance[own, own] + c.variance_beside(u, off)
            told += [{**each, "probability": float(min(sure, 1.0))} for each in c.told_each(u, variance)]
        return told

    @property
    def alternatives(self) -> list[list[dict[str, Any]]]:
        """Rivals of the leading set; of a named one those that are likely enough."""
        if self.verdict not in ("ambiguous", "named"):
            return []
        others = [] if self.stage.seen is None else rivals_told(self.stage.seen, self.verdict == "named")
        if self.forced is not None:
            others = force_rivals(self.forced, self.verdict == "named")
        if others:
            kept = [{"name": c["name"], "where": c["where"]} for c in self._linear]
            return [[*kept, *one] for one in others]
        beside = [{"name": c["name"], "where": c["where"]} for c in self._beyond_modes]
        return [
            [{"name": slug, "where": list(where)} for slug, where in s.names] + beside
            for s in rivals(self.verdict, self.sets)
        ]

    @property
    def strength_parameters(self) -> dict[str, Parameter]:
        """What the strength of each cause is."""
        return {slug: Parameter(*UNITS[slug]) for slug in UNITS}

    @property
    def smallest_detectable(self) -> dict[str, float]:
        """Strength of each cause that nine in ten such measurements would have shown, at its median place."""
        places: dict[str, list[Change]] = {}
        for c in self.stage.candidates:
            if c.slug in UNITS and c.pattern is None:
                places.setdefault(c.slug, []).append(c)
        some = [c for own in places.values() for c in own[:: 1 + len(own) // PLACES]]
        values: dict[str, list[float]] = {}
        for c, error in zip(some, errors_of(self.stage.setting, self.chosen.fit, some), strict=True):
            if np.isfinite(error):
                values.setdefault(c.slug, []).append(float(error) * c.scale)
        return {slug: float(np.median(v)) * (THRESHOLDS.stands_out + THRESHOLDS.power) for slug, v in values.items()}

    @property
    def askew(self) -> bool:
        """Whether a force or a sensor beyond doubt also acts or measures elsewhere."""
        odd, sure = self.stage.odd, math.log(THRESHOLDS.decisive / (1 - THRESHOLDS.decisive))
        return odd is not None and bool(odd.along) and odd.nats > sure

    @property
    def advice(self) -> str | None:
        """What would tell the alternatives apart."""
        seen, gain = self.stage.seen, self.gain
        by_level = seen is not None and seen.found.before > THRESHOLDS.as_noise
        mostly = gain.chi2_after < (1 - MOSTLY) * gain.chi2_before
        return advise_modes(self.verdict, len(self.alternatives), self.stage.odd, by_level, mostly)

    def to_dict(self) -> dict[str, Any]:
        """The answer as plain data, in the agreed form."""
        return {
            "verdict": self.verdict,
            "causes": self.causes,
            "alternatives": self.alternatives,
            "advice": self.advice,
            "smallest_detectable": self.smallest_detectable,
            "inaccuracy": self.inaccuracy,
            "throughout": self.throughout,
            "reasons": [*self.reasons, *levels_said(self.verdict, self.evidence)],
            "gain": self.gain.to_dict(),
            "question": self.question,
            "notes": list(self.notes),
            "p_value": None,
            "evidence": self.evidence,
        }
