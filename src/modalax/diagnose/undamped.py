"""A simulation without damping, as finite-element models mostly are: its modes get the usual damping of those measured.

No author means that a structure does not damp; it is left open how much. The median ratio of the measured modes is what
their general inaccuracy is about, and how far single dampings are off from it is learnt and told as for any simulation.
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from modalax._numerics.text import percent
from modalax.data import Measurement
from modalax.diagnose.modal_domain.fitting.inaccuracy import RIGID, USUAL
from modalax.diagnose.modal_domain.modes.measured import identify
from modalax.diagnose.modal_domain.structure.coordinates import Coordinates, coordinates_of
from modalax.model import ModalModel, Structure
from modalax.model.modal import poles_from
from modalax.model.mode_table import UNTOLD, ModeTable

LEAST = 1e-5  # damping ratio below which a mode has none; the least damped structures have a few times that


def with_damping(
    measured: Measurement | ModeTable, simulation: Any, tell: Callable[[str], None] = lambda _: None
) -> tuple[Any, str]:
    """The simulation with the damping of the measured modes if it has none, and a sentence on it; empty if it has.

    Of a modal model, whose elements cannot be off, every damping ratio may differ from it by what is usual.
    """
    if isinstance(simulation, Structure):
        freq = measured.freq if isinstance(measured, Measurement) else measured.frequency_hz
        channels = (measured.outputs, measured.inputs) if isinstance(measured, Measurement) else (measured.dofs,) * 2
        names = [tuple(name for name in some if name in simulation.dofs) for some in channels]
        c = coordinates_of(simulation, names[0], names[1], 2 * np.pi * float(np.max(freq)))
        damped = has_damping(c)
    else:
        c = None
        damped = not isinstance(simulation, ModalModel) or bool((np.asarray(simulation.damping_ratio) > LEAST).any())
    ratio = None if damped else median_ratio(measured, c, tell)
    of = "the median ratio of those measured"
    if ratio is None and not damped and isinstance(measured, ModeTable):  # neither tells; some ratio has to stand there
        ratio, of = UNTOLD, "as the measured modes tell none either; damping is not compared"
    if ratio is None:
        return simulation, ""
    said = f"the simulation has no damping; its modes were given {percent(ratio)}, {of}"
    if c is not None:
        left = np.asarray(simulation.M) @ c.shapes[:, :-1]  # but for the spare coordinate
        C = left @ ((2 * ratio * c.frequencies[:-1])[:, None] * left.T)
        return simulation.replace(C=jnp.asarray((C + C.T) / 2)), said
    frequency, claimed = np.abs(np.asarray(simulation.poles)) / 2 / np.pi, np.asarray(simulation.damping_std)
    spread = np.where(claimed > 0, claimed, USUAL["damping"])
    return simulation.replace(poles=poles_from(frequency, ratio), damping_std=jnp.asarray(spread)), said


def has_damping(c: Coordinates) -> bool:
    """Whether any mode of a simulation loses energy; a rigid body may without damping of its own."""
    w, loss = c.frequencies[:-1], np.diag(c.damping)[:-1]
    elastic = w > RIGID * np.median(w)
    return not elastic.any() or bool((loss[elastic] > 2 * LEAST * w[elastic]).any())


def median_ratio(
    measured: Measurement | ModeTable, c: Coordinates | None, tell: Callable[[str], None]
) -> float | None:  # fmt: skip
    """Median damping ratio of the measured modes; None where none is known."""
    if isinstance(measured, ModeTable):
        zeta = np.asarray(measured.damping_ratio)
    else:
        tell("measuring the damping, of which the simulation has none")
        try:
            poles = identify(measured, c).features.poles
        except (np.linalg.LinAlgError, ValueError):
            return None
        zeta = -poles.real / np.abs(poles)
    zeta = zeta[np.isfinite(zeta) & (zeta > 0)]
    return float(np.median(zeta)) if len(zeta) else None
