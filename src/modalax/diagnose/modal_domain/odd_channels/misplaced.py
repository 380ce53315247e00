r"""Sensors that are not where the channel table says: each output's shapes beside those of the simulation at any DoF.

Of every measured mode the residues at an output are compared with those that the simulation has at each of its DoFs,
:math:`E_{od} = \sum_k |R_{ko} - \hat R_{kd}|^2 / w_k`, all modes with the same weight. Which DoF each output is at is
the assignment with the least sum (Kuhn 1955). An output is at another than its own where that is far nearer, also than
its own is with any factor, as a wrong gain or sign has it.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.optimize

from modalax.diagnose.causes.base import RARE
from modalax.diagnose.modal_domain.fitting.state import Setting, state_at
from modalax.diagnose.modal_domain.structure.nodes import nodes_of

NEARER = 0.25  # part of what an output is off by at its own place, with any factor, that it may be off by at another
ALIKE = 0.1  # part of its energy that an output may be off by where it is
FEWEST = 3  # modes that tell a place; of fewer many DoFs have the shapes, but for a factor


@dataclass(frozen=True)
class Moved:
    """Outputs that are at other DoFs than their names, and how sure that is.

    Attributes
    ----------
    places
        Name and DoF of each.
    probability
        Against the general inaccuracy alone with all sensors where their names are.
    """

    places: tuple[tuple[str, str], ...]
    probability: float

    def told(self) -> list[dict[str, Any]]:
        """As in the answer."""
        return [
            {"name": "sensor_place", "where": [name, at], "probability": self.probability, "parameters": {}}
            for name, at in self.places
        ]

    def said(self) -> str:
        """In a sentence."""
        what = " and ".join(f"{name} measures what the simulation has at {at}" for name, at in self.places)
        return f"{what}: from here on it goes by that name"


def other_places(setting: Setting, dofs: tuple[str, ...], outputs: tuple[str, ...]) -> dict[str, str]:
    """Outputs that are at another DoF, and which; without two that are exchanged, and none where two would be at one.

    Parameters
    ----------
    dofs, outputs
        Names of the simulation's DoFs and of the outputs.
    """
    c, f = setting.coordinates, setting.features
    if len(f.poles) < FEWEST:
        return {}
    try:
        state = state_at(setting, np.zeros(len(setting.inaccuracy.group_of)))
    except np.linalg.LinAlgError:  # a simulation of fewer modes than are measured
        return {}
    simulated = state.together.whole(state.modes.poles, state.modes.residues(replace(c, outputs=c.shapes)))
    measured = f.residues * f.units
    # one of each mode: residues of an input that hardly drives it are noise
    weight = 1 / (np.abs(measured) ** 2).mean(axis=(1, 2), keepdims=True)
    energy = (np.abs(measured) ** 2 * weight).sum(axis=(0, 2))
    off = np.stack(
        [(np.abs(measured[:, k, None] - simulated) ** 2 * weight).sum(axis=(0, 2)) for k in range(len(outputs))]
    )
    own = np.array([dofs.index(name) for name in outputs])
    straight = np.isin(np.arange(len(dofs)), own) | (nodes_of(dofs).axis < 3)  # sensors of rotation are rare
    inner = np.einsum("koi,koi,koi->o", simulated[:, own].conj(), measured, np.broadcast_to(weight, measured.shape))
    size = np.einsum("koi,koi->o", np.abs(simulated[:, own]) ** 2, np.broadcast_to(weight, measured.shape))
    here = energy - np.abs(inner) ** 2 / np.maximum(size, 1e-300)
    at = np.flatnonzero(straight)[scipy.optimize.linear_sum_assignment(off[:, straight])[1]]
    found = {
        name: dofs[at[k]] for k, name in enumerate(outputs)
        if at[k] != own[k] and off[k, at[k]] < min(NEARER * here[k], ALIKE * energy[k])
    }  # fmt: skip
    found = {name: at for name, at in found.items() if found.get(at) != name}  # two exchanged are a cause by themselves
    names = [found.get(name, name) for name in outputs]
    return found if len(set(names)) == len(names) else {}


def moved(places: dict[str, str], beside: float, before: float, among: int) -> Moved:
    """What the answer tells of outputs that are elsewhere.

    Parameters
    ----------
    beside, before
        Log probability of the likeliest explanation with them there, and with all where their names are: that of the
        general inaccuracy alone, as no gain or sign of theirs is likelier, or that of other causes.
    among
        Number of outputs times DoFs.
    """
    odds = beside + len(places) * math.log(RARE / among) - before
    return Moved(tuple(places.items()), float(1 / (1 + math.exp(-np.clip(odds, -700, 700)))))
