"""Advice on what to measure to tell rival causes apart."""

from collections.abc import Sequence

from modalax.diagnose.decision.beyond import OddChannel
from modalax.diagnose.decision.posterior import Ranked

AT_LEVELS = "measure at three force levels or more, spread over a factor of ten, and look at the third harmonic"
LOWER = (
    "measure at lower force levels too, until the modes no longer move, and on either side of each joint that may be "
    "what changes with the level"
)
REST = (
    "something remains that no known cause explains: look at the residual map for where it lives, repeat at another "
    "force level and with another input"
)
MOST_PLACES, MOST_PARTS = 6, 3  # most places in one sentence, and most parts of the advice


def advise(verdict: str, sets: Sequence[Ranked], by_level: bool = False) -> str:
    """What would tell the candidates apart, in one sentence.

    Parameters
    ----------
    verdict
        As the answer has it.
    sets
        Sets of causes that are in question, the leading one first.
    by_level
        Whether the modes change with the force level.
    """
    if verdict == "unknown" and by_level:
        return LOWER
    if verdict == "unknown":
        return REST
    causes = {cause.slug: cause for r in sets for cause, _ in r.best.parts}
    by_levels = [c for c in causes.values() if c.told_by_levels]
    places = {where for r in sets for _, where in r.names}
    parts = []
    if by_levels and len(causes) > 1:
        parts += [AT_LEVELS, *(c.advice for c in by_levels if c.advice)]
    if len(places) > 1:
        names = sorted({str(n) for where in places for n in where})
        parts.append(f"add a sensor or an input at {', '.join(names[:MOST_PLACES])}")
    others = [causes[slug].advice for slug in sorted(causes) if not causes[slug].told_by_levels]
    parts += [advice for advice in others if advice][: MOST_PARTS - len(parts[:2])]
    return "; ".join(dict.fromkeys(parts)) or "measure another column of the FRF matrix"


def advise_modes(
    verdict: str, rivals: int, odd: OddChannel | None = None, by_level: bool = False, mostly: bool = False
) -> str | None:  # fmt: skip
    """What to do next after an answer of the modal domain, in one sentence; None where nothing is left open.

    Parameters
    ----------
    verdict
        As the answer has it.
    rivals
        How many other sets of causes are in question.
    odd
        A channel that differs from all others as no cause explains, where that is why the answer is ``unknown``.
    by_level
        Whether force levels differ by more than noise.
    mostly
        Whether what was found takes most of the misfit.
    """
    if verdict == "clean" or (verdict == "named" and not rivals):
        return None
    if verdict == "unknown" and odd is not None:
        what, instead = ("force", "excite at another point") if odd.force else ("sensor", "measure with another one")
        of = "direction, contact elsewhere, load cell" if odd.force else "mounting, cable, axis, range, calibration"
        return f"check the {what} at {odd.name} ({of}), or {instead}"
    if verdict == "unknown" and (by_level or mostly):
        return LOWER if by_level else REST
    if verdict == "unknown":
        return "check that the simulation is of this structure: its supports, its units and the names of its DoFs"
    return "measure at a further point near these places, or change one of them on purpose and measure again"


def advise_joint(verdict: str, rivals: int) -> str | None:
    """What to do next where a joint explains the force levels, in one sentence; None where nothing is left open.

    Parameters
    ----------
    verdict
        As the answer has it.
    rivals
        How many other sets of laws are in question.
    """
    if verdict == "named" and not rivals:
        return None
    if verdict == "unknown":
        return (
            "use the joint without a law that extends the simulation, within the amplitudes that were measured; time "
            "records of its motion and force would show its law"
        )
    return (
        "measure at higher levels, where laws differ most, and on either side of each joint that may move; record the "
        "third harmonic"
    )
