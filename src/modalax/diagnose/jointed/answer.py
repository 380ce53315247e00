"""The answer where a joint fitted together with the linear modes explains the force levels."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from modalax._numerics.text import percent
from modalax.data import Measurement
from modalax.data.frf import DERIVATIVES
from modalax.diagnose.causes import Cause, JointCause, Parameter, catalogue
from modalax.diagnose.deadline import Deadline
from modalax.diagnose.decision.advice import advise_joint
from modalax.diagnose.decision.gain import Gain
from modalax.diagnose.decision.joint import joint_verdict
from modalax.diagnose.decision.omnibus import Omnibus, omnibus
from modalax.diagnose.fitting.hypothesis import slopes
from modalax.diagnose.joint_laws import modes_at
from modalax.diagnose.jointed.bent import modes_are_bent
from modalax.diagnose.jointed.fits import Fitted, Jointed, fit_joints, suited
from modalax.diagnose.modal_domain.answer import Facts
from modalax.diagnose.over_levels import levels_said
from modalax.diagnose.result import Diagnosis, parameters_told, within
from modalax.diagnose.summary import causes_text
from modalax.diagnose.thresholds import THRESHOLDS
from modalax.model import ModalModel, Structure
from modalax.model.receptance import seen_at

AMPLITUDES = 12  # at which frequency and damping are told
SAID = (0.1, 0.5, 1.0)  # parts of the largest fitted amplitude at which the reasons say them
BLOCK = 8  # neighbouring lines that are resampled together for the gain
RESAMPLED = 400


@dataclass(frozen=True)
class JointDiagnosis(Diagnosis):
    """A diagnosis in which the linear modes are fitted together with a joint, by all force levels but the highest.

    Attributes
    ----------
    joints
        Everything that was fitted.
    chosen
        What the extended simulation has: the leading set of laws, or the joint without a law.
    before, after
        Tests of what modes alone and the extended simulation leave.
    """

    found: None
    comparison: Facts
    joints: Jointed
    chosen: Fitted
    before: Omnibus
    after: Omnibus

    @property
    def candidates(self) -> list[Any]:
        """Sets of laws by falling probability, then joints without a law."""
        return [*self.joints.laws, *self.joints.free]

    @property
    def candidate_rows(self) -> list[tuple[str, float, float]]:
        """Name, probability and log evidence of each set of laws."""
        return [(causes_text(_names(f)), f.probability, f.evidence) for f in self.candidates]

    @property
    def tests(self) -> tuple[Omnibus, Omnibus]:
        """What the modes alone leave, and what the extended simulation leaves."""
        return self.before, self.after

    @property
    def modes_in_band(self) -> np.ndarray:
        """Frequencies [Hz] and damping ratios of the modes, shape ``(2, n)``."""
        base = self.chosen.explained.extended.base
        assert isinstance(base, ModalModel)
        return within(np.stack([np.asarray(base.frequency_hz), np.asarray(base.damping_ratio)]), self.freq)

    @property
    def _causes(self) -> list[dict[str, Any]]:
        """The leading set of laws, or the joint without one."""
        e, k, out = self.chosen.explained, 0, []
        for cause, place, p in zip(e.extended.causes, e.extended.places, e.extended.params, strict=True):
            own, p = slice(k, k + len(p)), np.asarray(p)
            scale = slopes(cause, p)
            told = parameters_told(cause, place, p, e.covariance[own, own] * np.outer(scale, scale))
            out.append(
                {"name": cause.slug, "where": list(place.where), "probability": self.chosen.probability,
                 "parameters": told}
            )  # fmt: skip
            k += len(p)
        return out

    @property
    def alternatives(self) -> list[list[dict[str, Any]]]:
        """Other sets of laws."""
        others = [f for f in self.joints.laws if f is not self.chosen and f.probability > THRESHOLDS.rival]
        return [_names(f) for f in others] if self.verdict in ("named", "ambiguous") else []

    @property
    def strength_parameters(self) -> dict[str, Parameter]:
        """None: what a joint had to be to be seen is not told."""
        return {}

    @property
    def smallest_detectable(self) -> dict[str, float]:
        """None: what a joint had to be to be seen is not told."""
        return {}

    @property
    def advice(self) -> str | None:
        """What to measure next."""
        return advise_joint(self.verdict, len(self.alternatives))

    @cached_property
    def over_amplitude(self) -> list[dict[str, list[float]]]:
        """Frequency and damping of every mode over the amplitude across the joint, with standard deviations.

        By the joint that was chosen, and as ``free`` by the one without a law.
        """
        A = self.reach * np.linspace(1 / AMPLITUDES, 1.0, AMPLITUDES)
        out = []
        for which, one in (("chosen", self.chosen), ("free", self.joints.free[0])):
            (f, z), (df, dz) = modes_at(one.explained, A)
            out += [
                {"joint": which, "amplitude_m": A.tolist(), "frequency_hz": f[k].tolist(),
                 "frequency_std_hz": df[k].tolist(), "damping_ratio": z[k].tolist(),
                 "damping_ratio_std": dz[k].tolist()}
                for k in range(len(f))
            ]  # fmt: skip
        return out

    @property
    def reach(self) -> float:
        """Largest amplitude across the joint at the fitted levels [m]."""
        free = self.joints.free[0].explained.extended.causes[0]
        return float(free.reach)

    def to_dict(self) -> dict[str, Any]:
        """The answer as plain data, in the agreed form."""
        told = self.evidence
        return {
            "verdict": self.verdict,
            "causes": self.causes,
            "alternatives": self.alternatives,
            "advice": self.advice,
            "smallest_detectable": {},
            "inaccuracy": None,
            "throughout": {},
            "reasons": [*self.reasons, *self.moving(), *levels_said("unknown", told)],
            "gain": self.gain.to_dict(),
            "question": self.question,
            "notes": list(self.notes),
            "p_value": None,
            "evidence": None if told is None else {**told, "over_amplitude": self.over_amplitude},
        }

    def moving(self) -> list[str]:
        """How each mode moves with the amplitude, in words, with 95 % intervals."""
        A = self.reach * np.array(SAID)
        (f, z), (df, dz) = modes_at(self.chosen.explained, A)
        out = []
        for k in range(len(f)):
            points = [
                f"{f[k, j]:.5g} ± {1.96 * df[k, j]:.1g} Hz with {100 * z[k, j]:.3g} ± {196 * dz[k, j]:.1g} % damping "
                f"at {1e6 * A[j]:.3g} µm" for j in range(len(A))
            ]  # fmt: skip
            out.append(f"with it a mode is at {', '.join(points)}")
        return out


def diagnose_joint(
    measurement: Measurement, simulation: object, causes: Sequence[Cause] | None, late: Deadline,
    tell: Callable[[str], None],
) -> JointDiagnosis | None:  # fmt: skip
    """Diagnose a joint over force levels with the modes free; None where there is none that explains them.

    Parameters
    ----------
    measurement
        Runs at three levels or more.
    simulation
        Its modes in the band are what the fits start from.
    causes
        What to look for; the whole catalogue if None.
    late
        When no further fit begins.
    tell
        Called with each step, in words.
    """
    modes = modes_of(simulation, measurement)
    given = catalogue(len(measurement.level)) if causes is None else causes
    laws = [c for c in given if isinstance(c, JointCause) and not c.each_run]
    if modes is None or not laws or not suited(measurement, modes):
        return None
    found = fit_joints(measurement, modes, laws, late, tell)
    if not found.explains(found.free[0]):
        return None
    alone = found.places == 1 and isinstance(simulation, ModalModel)
    best = found.laws[0] if found.laws and found.explains(found.laws[0]) else None
    word, reasons = joint_verdict(
        None if best is None else best.names, 0.0 if best is None else best.probability, alone
    )
    chosen = found.free[0] if best is None else best
    H, held = np.asarray(measurement.H), found.held
    level = float(np.asarray(measurement.level)[held])
    said = (
        f"fitted to all levels but the highest, {causes_text(_names(chosen))} with the modes leaves "
        f"{percent(chosen.fitted)} of the FRFs there and {percent(chosen.held)} of those at {level:.3g} N; the modes "
        f"alone leave {percent(found.linear.fitted)} and {percent(found.linear.held)}, a joint without a law "
        f"{percent(found.free[0].fitted)} and {percent(found.free[0].held)}; probabilities are among "
        f"{len(found.laws)} sets of laws that came nearest to that joint"
    )  # fmt: skip
    free = found.free[0].explained
    scale = np.sqrt(free.chi2 / free.samples)
    turn = (1j ** DERIVATIVES[measurement.form]) / scale
    residuals = [turn * f.explained.residual for f in (found.linear, chosen)]
    sigma = found.sigma * scale
    tests = [omnibus(r, np.ones(r.shape, bool), np.inf) for r in residuals]
    notes = (
        "the modes are fitted together with the joint, whatever the simulation has (FREE question)",
        f"each sample is taken to be off by {percent(float(np.median(sigma / np.abs(H))))} of itself, which is what a "
        "joint without a law leaves",
    )
    return JointDiagnosis(
        word, (*reasons, said), None, Facts(measurement, notes, "free"), chosen.explained.extended,
        gain_of(residuals[0][held], residuals[1][held], f"run {held + 1} at {level:.4g} N, the highest level"),
        np.asarray(measurement.freq), residuals[0], residuals[1],
        H + residuals[0] * sigma / np.sqrt(2), H + residuals[1] * sigma / np.sqrt(2), found, chosen, tests[0], tests[1],
    )  # fmt: skip


def may_have_joint(measurement: Measurement, simulation: object) -> bool:
    """Whether a joint can be fitted together with the modes of a simulation."""
    modes = modes_of(simulation, measurement)
    return modes is not None and suited(measurement, modes)


def joint_comes_first(measurement: Measurement, simulation: object) -> bool:
    """Whether no joint of any law added to the simulation can explain the levels, but one fitted with the modes may."""
    modes = modes_of(simulation, measurement)
    if not isinstance(simulation, ModalModel) or modes is None or len(modes.poles) < len(simulation.poles):
        return False  # what a simulation has beyond its modes in the band would be missing beside the modes as they are
    return modes_are_bent(measurement, modes)


def modes_of(simulation: object, measurement: Measurement) -> ModalModel | None:
    """The modes of a simulation that lie in the band, at the measured DoFs; None where it has none there."""
    try:
        model = simulation.modal() if isinstance(simulation, Structure) else simulation
        if not isinstance(model, ModalModel):
            return None
        model = seen_at(model, list(dict.fromkeys([*measurement.outputs, *measurement.inputs])))
    except ValueError:  # no poles, or a DoF that it does not have
        return None
    f, freq = np.asarray(model.frequency_hz), np.asarray(measurement.freq)
    inside = np.flatnonzero((f > freq[0]) & (f < freq[-1]))
    if not len(inside):
        return None
    take = lambda a: np.asarray(a)[inside]
    return model.replace(
        poles=take(model.poles), shapes=take(model.shapes), participation=take(model.participation),
        frequency_std=take(model.frequency_std), damping_std=take(model.damping_std),
    )  # fmt: skip


def gain_of(before: np.ndarray, after: np.ndarray, which: str) -> Gain:
    """Whitened residuals of the highest level, with and without the joint, compared."""
    each = [(np.abs(r) ** 2).reshape(len(r), -1).sum(axis=1) for r in (before, after)]
    gained = 0.5 * (each[0] - each[1])
    parts = np.array([gained[k : k + BLOCK].sum() for k in range(0, len(gained), BLOCK)])
    drawn = np.random.default_rng(0).choice(parts, (RESAMPLED, len(parts))).sum(axis=1)
    real = 2 * before.size
    chi2 = [float(e.sum()) / real for e in each]
    return Gain(which, chi2[0], chi2[1], float(gained.sum()), float(drawn.std()))


def _names(one: Fitted) -> list[dict[str, Any]]:
    return [{"name": slug, "where": list(where)} for slug, where in one.names]
