"""Causes of one size at several places, which are told one by one."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from modalax.diagnose.decision.beyond import Names
from modalax.diagnose.modal_domain.causes import Change
from modalax.diagnose.modal_domain.coordinates import Coordinates
from modalax.diagnose.modal_domain.nodes import nodes_of


@dataclass(frozen=True)
class Together(Change):
    """One change at each of the places ``where``.

    Attributes
    ----------
    each
        Name and unit of what is told at each place, and how much of it there is for a size of one.
    """

    each: tuple[tuple[str, str, float], ...] = ()

    @property
    def told_as(self) -> Names:
        """Each place by itself."""
        return tuple((self.slug, (where,)) for where in self.where)

    def told_each(self, u: np.ndarray, covariance: np.ndarray) -> list[dict[str, Any]]:
        """The change at each place."""
        std, out = float(np.sqrt(max(covariance[0, 0], 0.0))) * self.scale, []
        for where, (name, unit, one) in zip(self.where, self.each, strict=True):
            value = {"value": self.size(u) * one, "std": std * abs(one), "unit": unit}
            out.append({"name": self.slug, "where": [where], "parameters": {name: value}})
        return out


class SensorMasses(Together):
    """As much mass under every sensor: all stay in place while all are measured, and the simulation has none."""

    def said(self) -> str:
        """That it is as if all sensors had mass."""
        return "there is as much mass under every sensor, as that of sensors which the simulation lacks"


def sensor_masses(outputs: Sequence[str], c: Coordinates, usual: float, weight: float) -> list[Change]:
    """The mass of all sensors as one cause, moving with all displacements of their nodes; none of fewer than two.

    Parameters
    ----------
    usual
        Mass of one [kg] that is usual where there is one.
    weight
        Weight among the places of added masses.
    """
    nodes = nodes_of(c.names)
    at = [c.names.index(name) for name in outputs]
    first: dict[int, str] = {}
    for k in at:
        if nodes.axis[k] < 3:
            first.setdefault(int(nodes.of_dofs[k]), c.names[k])
    if len(first) < 2:
        return []
    moved = [int(k) for node in first for k in nodes.members[node] if nodes.axis[k] < 3]
    factor = np.eye(len(c.names))[:, moved]
    pattern = c.everywhere[moved].T @ c.everywhere[moved]
    where = tuple(first.values())
    each = (("mass", "kg", 1.0),) * len(where)
    return [SensorMasses("added_mass", where, usual, pattern=pattern, factor=factor, weight=weight, each=each)]
