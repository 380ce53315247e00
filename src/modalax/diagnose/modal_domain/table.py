"""The diagnosis of measured modes alone, a table as test reports have it: no FRFs, no noise of samples.

Frequencies, damping ratios and shapes stand in for what is otherwise identified, with the standard deviations that are
stated, or else with usual ones. A shape without scale tells directions only, so that the size of residues is left free.
Nothing can be said of single samples, and no block of data can be left out: chi-squares and gain do not exist.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from modalax.diagnose.causes.base import Cause
from modalax.diagnose.deadline import Deadline
from modalax.diagnose.decision.gain import Gain
from modalax.diagnose.decision.omnibus import Omnibus
from modalax.diagnose.modal_domain.answer import Facts, ModalDiagnosis
from modalax.diagnose.modal_domain.causes.places import candidates_of
from modalax.diagnose.modal_domain.corrected import extension_of, inaccuracy_said, inaccuracy_told
from modalax.diagnose.modal_domain.fitting.inaccuracy import inaccuracy_of
from modalax.diagnose.modal_domain.fitting.state import Setting
from modalax.diagnose.modal_domain.fitting.throughout import throughout_said, throughout_told
from modalax.diagnose.modal_domain.judged import judge
from modalax.diagnose.modal_domain.modes.features import FLOOR, Features, tangent_of, values_of, whitener_of
from modalax.diagnose.modal_domain.search.explain import explain
from modalax.diagnose.modal_domain.stage import Stage
from modalax.diagnose.modal_domain.structure.coordinates import coordinates_of
from modalax.diagnose.modal_domain.structure.modes_only import ModesOnly, Simulation, modes_only
from modalax.diagnose.summary import cause_at
from modalax.model import ModalModel, Structure
from modalax.model.entry import check_passive
from modalax.model.mode_table import UNTOLD, USUAL, ModeTable

UNSCALED = 30.0  # standard deviation of ln size where a shape has no scale
UNMEASURED = 3.0  # of ln damping where no damping ratio is told
SEEN = 5.0  # standard deviations by which the reference DoF moves in every mode that is compared
ABOVE = 1.02  # end of the band over the highest mode told
TRIED = 3  # DoFs to which signs may refer, one after the other
EACH = 0.5  # share of the time left that is spent on each of them


@dataclass(frozen=True)
class TableFacts:
    """What stands in for an identified measurement.

    Attributes
    ----------
    freq
        Ends of the band [Hz].
    features
        Of the modes that are compared.
    outputs, inputs
        DoFs of the shapes, and the one to which their signs refer.
    """

    freq: np.ndarray
    features: Features
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]


def by_table(
    table: ModeTable, simulation: object, causes: Sequence[Cause] | None, usual: tuple[float, float, float] | None,
    time: float, tell: Callable[[str], None],
) -> ModalDiagnosis:  # fmt: skip
    """Diagnose by modes alone; ``ValueError`` if the simulation is neither of matrices nor of real modes."""
    compared = modes_only(simulation) if isinstance(simulation, ModalModel) else simulation
    if compared is None:
        raise ValueError(
            "modes alone are compared with matrices, or with real modes whose modal masses are known; those of the "
            "simulation are complex, or it has no DoF that is both output and input"
        )
    if not isinstance(compared, Structure | ModesOnly):
        raise ValueError(f"modes alone are compared with matrices or modes, not with an {type(simulation).__name__}")
    if isinstance(compared, Structure):
        check_passive(compared)
    slugs = None if causes is None else {c.slug for c in causes}
    return diagnose_table(
        table, compared, usual=usual, budget=time, wanted=lambda s: slugs is None or s in slugs, tell=tell
    )


def diagnose_table(
    table: ModeTable, simulation: Simulation, *, usual: tuple[float, float, float] | None = None,
    budget: float = 120.0, wanted: Callable[[str], bool] = lambda _: True,
    tell: Callable[[str], None] = lambda _: None,
) -> ModalDiagnosis:  # fmt: skip
    """Diagnose a simulation by measured modes alone.

    Parameters
    ----------
    usual
        Relative standard deviations of frequencies and damping ratios where the table states none, and that of the
        components of shapes over the largest; ``USUAL`` if None.

    Raises
    ------
    ValueError
        If the simulation lacks a DoF of the table, or no mode can be compared.
    """
    lacking = [d for d in table.dofs if d not in simulation.dofs]
    if lacking:
        raise ValueError(
            f"DoFs {', '.join(lacking[:4])} of the modes are not in the simulation; there are "
            f"{', '.join(simulation.dofs[:4])}, ..."
        )
    stds = USUAL if usual is None else usual
    if len(stds) != 3 or not all(np.isfinite(s) and 0 < s < 1 for s in stds):
        raise ValueError(f"standard deviations of modes are {stds}; three between 0 and 1 are needed")
    late, answers = Deadline(budget), []
    for reference in references(table, stds[2]):
        # A sensor that is faulty itself is no reference for the others; another may be.
        facts, notes = facts_of(table, stds, reference, usual is not None)
        tell(f"comparing the modes with those of the simulation, signs by {facts.inputs[0]}")
        answers.append(_answer(_staged(facts, simulation, wanted, late.part(EACH), tell), notes))
        if not _far_off(answers[-1]) or late():
            break
    best = min(answers, key=lambda found: (found.verdict == "unknown", found.inaccuracy["stiffness"]["value"]))
    return unlike(best, [found for found in answers if found is not best]) if _far_off(best) else best


def _far_off(found: ModalDiagnosis) -> bool:
    """Whether elements are off by more than is usual beside what explains the modes, or nothing explains them."""
    least, usual = found.inaccuracy["stiffness"]["interval"][0], found.stage.setting.inaccuracy.usual[0]
    return found.verdict == "unknown" or least > usual


def unlike(best: ModalDiagnosis, others: list[ModalDiagnosis]) -> ModalDiagnosis:
    """The answer, unknown where signs by another DoF, and the modes that it sees, have no room for its causes."""
    leads = _leading(best.causes)
    for other in others if best.verdict in ("named", "ambiguous") else ():
        if not leads <= _leading([*other.causes, *(c for one in other.alternatives for c in one)]):
            said = "; ".join(
                f"{' and '.join(cause_at(*c) for c in sorted(_leading(found.causes))) or 'no cause'} where signs refer "
                f"to {found.comparison.measurement.inputs[0]}"
                for found in (best, other)
            )
            return replace(best, verdict="unknown", reasons=(*best.reasons, f"what stands out is not sure: {said}"))
    return best


def _leading(causes: Sequence[Any]) -> set[tuple[str, tuple[str, ...]]]:
    """Names and places of causes."""
    return {(c["name"], tuple(sorted(c["where"]))) for c in causes}


def _staged(
    facts: TableFacts, simulation: Simulation, wanted: Callable[[str], bool], late: Deadline,
    tell: Callable[[str], None],
) -> Stage:  # fmt: skip
    highest = 2 * np.pi * float(facts.freq[-1])
    c = coordinates_of(simulation, facts.outputs, facts.inputs, highest)
    whitener = whitener_of(facts.features)
    setting = Setting(c, inaccuracy_of(simulation, c, highest), facts.features, whitener)
    setting = replace(setting, sought=("stiffness",) if simulation.groups is None else ())
    pairs = None if simulation.pairs is None else list(simulation.pairs)
    every = candidates_of(simulation, c, facts.outputs, facts.inputs, pairs, highest)
    candidates = [k for k in every if k.in_shapes and wanted(k.slug)]
    setting, candidates, explanations = explain(setting, candidates, late, tell)
    if not explanations:
        raise ValueError("the simulation has fewer modes than the table in its band; none can be compared")
    seen: Any = facts  # in the place of a measurement, of which only names and the band are looked at
    return Stage(seen, simulation, c, seen, setting, candidates, explanations, not late())


def _answer(stage: Stage, notes: list[str]) -> ModalDiagnosis:
    judged = judge(stage)
    chosen, inaccuracy = judged.chosen, inaccuracy_told(stage.setting, judged.chosen.fit)
    throughout = throughout_told(stage.setting, judged.chosen.fit)
    reasons = [inaccuracy_said(inaccuracy), *throughout_said(throughout), *judged.reasons]
    reasons.append("modes alone were given: causes that show in FRFs only are not seen")
    if not stage.in_time:
        reasons.append("time was up before every explanation had been tried")
    none, unknown = float("nan"), np.zeros((1, 0, len(stage.measurement.outputs), 1), complex)
    gain = Gain("a table of modes holds no data to leave out", none, none, none, none)
    test = Omnibus(none, none, "none: no samples", (none, none))
    facts: Any = stage.measurement
    return ModalDiagnosis(
        judged.word, tuple(reasons), None, Facts(facts, tuple(notes)), extension_of(stage, chosen.fit), gain,
        np.zeros(0), unknown, unknown, unknown, unknown, stage, chosen, judged.sets, inaccuracy, throughout,
        test, test,
    )  # fmt: skip


def references(table: ModeTable, shape_std: float) -> list[int]:
    """DoFs to which signs may refer: those that move in most modes, and most in the one where they move least."""
    relative = np.abs(table.shapes) / np.abs(table.shapes).max(axis=1)[:, None]
    moves = relative > SEEN * shape_std
    order = sorted(
        range(len(table.dofs)), key=lambda k: (-moves[:, k].sum(), -relative[moves[:, k], k].min(initial=1.0))
    )
    if not moves.any():
        raise ValueError(f"no DoF moves by over {SEEN * shape_std:.2g} of the largest in any mode; nothing to compare")
    return [k for k in order if moves[:, k].any()][:TRIED]


def facts_of(
    table: ModeTable, stds: tuple[float, float, float], reference: int, stated: bool = False
) -> tuple[TableFacts, list[str]]:
    """Features of the modes with their covariance, and what was assumed, in sentences."""
    size = np.abs(table.shapes).max(axis=1)
    kept = np.abs(table.shapes[:, reference]) > SEEN * stds[2] * size
    notes = [_of_errors(table, stds, stated)]
    if not kept.all():
        left = ", ".join(f"{f:.4g} Hz" for f in table.frequency_hz[~kept])
        notes.append(f"modes at {left} are left out: they hardly move at {table.dofs[reference]}, to which signs refer")
    frequency, zeta = table.frequency_hz[kept], table.damping_ratio[kept]
    stated_f, stated_z = table.frequency_std[kept], table.damping_std[kept]
    known = np.where(np.isnan(zeta), UNTOLD, np.maximum(zeta, 1e-6))
    omega = 2 * np.pi * frequency
    poles = -known * omega + 1j * omega * np.sqrt(1 - known**2)
    shapes = table.shapes[kept] / size[kept, None]
    raw = -1j * (shapes * shapes[:, [reference]])[:, :, None]  # residues are shapes over 2j times the frequency
    units = np.broadcast_to((stds[2] * np.abs(shapes[:, reference]))[:, None, None], raw.shape)
    residues = raw / units
    tangent = np.stack([tangent_of(A) for A in residues])
    values = values_of(poles, residues, tangent)
    error = np.full(values.shape, 1.0)
    error[:, 0] = np.where(np.isnan(stated_f), stds[0], stated_f)
    error[:, 1] = np.where(np.isnan(zeta), UNMEASURED, np.where(np.isnan(stated_z), stds[1], stated_z))
    error[:, 2] = UNSCALED
    error[:, 3:] = 1 / np.sqrt((np.abs(residues) ** 2).sum(axis=(1, 2)))[:, None]
    floor = np.concatenate([FLOOR[:3], np.full(values.shape[1] - 3, FLOOR[3])])
    covariance = np.diag((error**2 + floor**2).ravel())
    features = Features(poles, residues, units, tangent, values, covariance)
    band = np.array([frequency.min() / ABOVE, frequency.max() * ABOVE])
    return TableFacts(band, features, table.dofs, (table.dofs[reference],)), notes


def _of_errors(table: ModeTable, stds: tuple[float, float, float], stated: bool) -> str:
    """What is taken as known of the errors."""
    own = bool(np.isfinite(table.frequency_std).any())
    words = "as told" if stated else "usual ones, since none are told"
    return (
        f"{len(table.frequency_hz)} modes at {len(table.dofs)} DoFs; standard deviations "
        + ("of the table where it states them, else " if own else "")
        + f"{100 * stds[0]:g} % of frequencies, {100 * stds[1]:g} % of damping ratios, {100 * stds[2]:g} % of the "
        f"largest component of shapes ({words})"
    )
