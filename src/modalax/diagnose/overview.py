"""Causes, extended simulations and joint laws that were compared, as text for ``print``."""

from typing import TYPE_CHECKING

import numpy as np

from modalax._numerics.text import with_error
from modalax.data.overview import counted, unreadable
from modalax.diagnose.summary import cause_at

if TYPE_CHECKING:
    from modalax.diagnose.causes.base import Cause
    from modalax.diagnose.extend import ExtendedSimulation
    from modalax.diagnose.joint_laws import Explained


def of_cause(cause: "Cause") -> str:
    """Name, what it means, and its unknowns with units."""
    unit = lambda text: f" [{text}]" if text.strip("-") else ""
    unknowns = ", ".join(f"{q.name}{unit(q.unit)}" for q in cause.parameters)
    name, meaning = cause.slug or type(cause).__name__, f": {cause.summary}" if cause.summary else ""
    return f"{name}{meaning} ({unknowns})" if unknowns else f"{name}{meaning}"


def of_extended(found: "ExtendedSimulation") -> str:
    """What was added where, with sizes and standard deviations, and the simulation as it was."""
    if unreadable(found) or found.theta.ndim != 2:
        return repr(found)
    return "\n".join([f"Simulation with {counted(len(found.causes), 'cause')}", *_causes(found), str(found.base)])


def of_explained(found: "Explained") -> str:
    """Laws with their sizes, how probable they are among those compared, and how well they fit."""
    laws = " and ".join(found.slugs) or "linear modes alone"
    return "\n".join([
        f"{laws}: probability {found.probability:.3f}, chi-square {found.chi2:.6g} of {found.samples} real samples "
        f"with {found.unknowns} unknowns",
        *_causes(found.extended),
    ])  # fmt: skip


def _causes(found: "ExtendedSimulation") -> list[str]:
    said = []
    for cause, place, params, spread in zip(found.causes, found.places, found.params, found.spread, strict=True):
        sizes = ", ".join(
            f"{q.name} = {with_error(float(p), float(s))} {q.unit.strip('-')}".strip()
            for q, p, s in zip(cause.parameters, np.asarray(params), np.asarray(spread), strict=True)
        )
        said.append(f"  {cause_at(cause.slug, place.where)}{f': {sizes}' if sizes else ''}")
    return said
