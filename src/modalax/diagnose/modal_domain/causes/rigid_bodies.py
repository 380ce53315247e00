r"""A rigid body that sits on a node with its centre of mass elsewhere, as a motor on a bracket.

With :math:`Fq`, :math:`F=[I,\,-[c]_\times]`, the displacement of the centre of mass by the node's six motions ``q``,
``c`` the offset and :math:`\rho_a` the radius of gyration about axis a through that centre, the mass is

.. math:: \Delta M = m\,(F^TF + \mathrm{diag}(0, 0, 0, \rho_x^2, \rho_y^2, \rho_z^2)).
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from modalax.diagnose.modal_domain.causes.change import Followed

CROSS = -np.cross(np.eye(3)[:, None], np.eye(3)[None])  # of the components of c, which sum to [c]_x


@dataclass(frozen=True)
class RigidBody(Followed):
    """A mass at an offset from its node; its sizes are those of the mass, the offset and the radii of gyration.

    Attributes
    ----------
    moves
        Displacements and rotations of the node by modal coordinates, zero where it has none, shape ``(6, n)``.
    axes
        Components of the offset that couple motions of the node; others show in the inertia alone.
    turns
        Axes about which the node turns.
    reach
        Usual offset and radius of gyration [m].
    """

    moves: np.ndarray = field(default_factory=lambda: np.zeros((6, 0)), compare=False)
    axes: tuple[int, ...] = ()
    turns: tuple[int, ...] = ()
    reach: float = 1.0

    @property
    def count(self) -> int:
        """Mass, components of the offset, and radii."""
        return 1 + len(self.axes) + len(self.turns)

    def possible(self, u: np.ndarray) -> bool:
        """It has mass."""
        return bool(u[0] > 0)

    def round(self, mass: float, offset: np.ndarray, radius: float) -> np.ndarray:
        """Sizes of a body with one radius about all axes."""
        return np.concatenate([[mass], offset, np.full(len(self.turns), radius)])

    def _body(self, u: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        """Mass matrix of a unit mass over the six motions, and its derivatives by all sizes but the first."""
        offset, radii = np.split(u[1:], [len(self.axes)])
        by_offset = [np.hstack([np.zeros((3, 3)), -self.reach * CROSS[k]]) for k in self.axes]
        F = np.hstack([np.eye(3), np.zeros((3, 3))]) + np.tensordot(offset, np.reshape(by_offset, (-1, 3, 6)), 1)
        by_square = [np.diag(np.eye(6)[3 + k]) * self.reach**2 for k in self.turns]
        inertia = np.tensordot(radii**2, np.array(by_square), 1)
        slopes = [dF.T @ F + F.T @ dF for dF in by_offset]
        return F.T @ F + inertia, slopes + [2 * rho * by for rho, by in zip(radii, by_square, strict=True)]

    def over_dofs(self, u: np.ndarray) -> np.ndarray:
        """Change of the mass over DoFs; its factor tells which of them are the six motions."""
        assert self.factor is not None, "the motions of the node are needed"
        return self.scale * float(u[0]) * self.factor @ self._body(u)[0] @ self.factor.T

    def changes(self, u: np.ndarray) -> dict[str, np.ndarray]:
        """Change of the mass."""
        return {"M": self.scale * u[0] * self.moves.T @ self._body(u)[0] @ self.moves}

    def slopes(self, u: np.ndarray) -> list[dict[str, np.ndarray]]:
        """Derivatives of :meth:`changes` by each size."""
        unit, by = self._body(u)
        every = [self.scale * unit, *(self.scale * u[0] * part for part in by)]
        return [{"M": self.moves.T @ part @ self.moves} for part in every]

    def told(self, u: np.ndarray, covariance: np.ndarray) -> dict[str, dict[str, Any]]:
        """Mass, offset of its centre and radii of gyration."""
        about = (
            [f"radius_of_gyration_{'xyz'[k]}" for k in self.turns] if len(self.turns) > 1 else ["radius_of_gyration"]
        )
        names = ["mass", *(f"offset_{'xyz'[k]}" for k in self.axes), *about]
        scale = np.array([self.scale] + [self.reach] * (self.count - 1))
        value, std = scale * u, scale * np.sqrt(np.maximum(np.diag(covariance), 0.0))
        value[1 + len(self.axes) :] = np.abs(value[1 + len(self.axes) :])
        return {
            name: {"value": float(v), "std": float(s), "unit": "m" if k else "kg"}
            for k, (name, v, s) in enumerate(zip(names, value, std, strict=True))
        }

    def said(self) -> str:
        """How it sits."""
        return f"the mass at {self.where[0]} is that of a body that turns with the node, its centre of mass beside that"
