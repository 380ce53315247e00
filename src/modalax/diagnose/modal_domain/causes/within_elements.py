r"""Causes within one element :math:`K_e=FF^T` that a matrix shows as one: ways of being strained that are off unlike.

Where several members act in parallel, as the columns of a storey or the isolators under a machine, a matrix shows their
sum. One of them that is wrong changes it to :math:`F(I+Z)F^T` with ``Z`` symmetric, no eigenvalue below -1. A spring is
strained in one way only: :math:`Z=\pm aa^T`, and where it holds a node that can turn, its lever shows.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from modalax.diagnose.modal_domain.causes.change import UNITS, Change, Followed


def of_rows(sizes: np.ndarray) -> np.ndarray:
    """``Z`` of its sizes as :func:`modalax.diagnose.modal_domain.fitting.throughout.uneven_patterns` has them."""
    rank = int(np.sqrt(2 * len(sizes)))
    Z, rows = np.zeros((rank, rank)), [(a, b) for a in range(rank) for b in (a, *range(a))]
    for (a, b), size in zip(rows, sizes, strict=True):
        Z[a, b] = Z[b, a] = size if a == b else size / np.sqrt(2)
    return Z


@dataclass(frozen=True)
class PlateElement(Change):
    """The whole of an element of several nodes, told at two opposite corners; ``corners`` are all of them."""

    corners: tuple[str, ...] = ()

    def said(self) -> str:
        """Which element it is, and what changes with it."""
        which = f"it is the element with the corners {', '.join(self.corners[:-1])} and {self.corners[-1]}, as a whole"
        return "; ".join(filter(None, (which, super().said())))


@dataclass(frozen=True)
class WithinElement(Followed):
    """A change within an element, followed where elements seem to be off unevenly.

    Attributes
    ----------
    ways
        What each of its sizes changes, an array with one entry a size.
    """

    ways: np.ndarray = field(default_factory=lambda: np.zeros(0), compare=False)

    @property
    def count(self) -> int:
        """One for each way of being changed."""
        return len(self.ways)

    @property
    def telling(self) -> int:
        """All of its sizes."""
        return self.count

    @property
    def between(self) -> str:
        """What the element joins."""
        return " and ".join(map(str, self.where)) if len(self.where) > 1 else f"{self.where[0]} and the ground"


@dataclass(frozen=True)
class UnevenElement(WithinElement):
    """An element whose ways of being strained are off each by itself; its sizes are those of ``Z``.

    Attributes
    ----------
    ways
        Changes by sizes of one, as :func:`modalax.diagnose.modal_domain.fitting.throughout.uneven_patterns` makes them,
        shape ``(r (r + 1) / 2, n, n)``.
    """

    def changes(self, u: np.ndarray) -> dict[str, np.ndarray]:
        """Change of the stiffness."""
        return {"K": self.scale * np.tensordot(u, self.ways, 1)}

    def slopes(self, u: np.ndarray) -> list[dict[str, np.ndarray]]:
        """The changes by sizes of one."""
        return [{"K": self.scale * way} for way in self.ways]

    def relative_changes(self, u: np.ndarray) -> np.ndarray:
        """Eigenvalues of ``Z``, rising: by how much each of some ways of being strained is stiffer."""
        return np.linalg.eigvalsh(of_rows(self.scale * u))

    def possible(self, u: np.ndarray) -> bool:
        """No way of being strained has less than no stiffness."""
        return bool(self.relative_changes(u)[0] > -1)

    def size(self, u: np.ndarray) -> float:
        """The largest relative change of any way of being strained."""
        return float(max(self.relative_changes(u), key=abs))

    def told(self, u: np.ndarray, covariance: np.ndarray) -> dict[str, dict[str, Any]]:
        """The mean relative change of all ways, which is linear in the sizes."""
        rank = int(np.sqrt(2 * len(u)))
        own = np.cumsum(np.arange(rank))
        mean = np.zeros(len(u))
        mean[own] = self.scale / rank
        name, unit = UNITS["modal_damping"]
        std = float(np.sqrt(max(mean @ covariance @ mean, 0.0)))
        return {name: {"value": float(mean @ u), "std": std, "unit": unit}}

    def said(self) -> str:
        """What would change an element so."""
        return (
            f"what joins {self.between} is off by unlike amounts in its different motions, which it couples: as where "
            "one of several members in parallel is wrong"
        )


@dataclass(frozen=True)
class OneMember(WithinElement):
    r"""One spring of an element of several is softer or stiffer; its sizes are those of ``a`` in :math:`Z=\pm aa^T`.

    Attributes
    ----------
    ways
        Ways ``f`` in which the element can be strained, the sum of their ``f f'``, shape ``(r, n)``.
    moves
        The same forces over the DoFs of the node that it holds, displacements and rotations, shape ``(r, 6)``.
    stiffer
        Whether the spring is stiffer than in the simulation.
    """

    moves: np.ndarray = field(default_factory=lambda: np.zeros((0, 6)), compare=False)
    stiffer: bool = False

    @property
    def strength(self) -> float:
        """What a product of two sizes changes; all sizes as usual make the usual change."""
        return (1 if self.stiffer else -1) * self.scale / self.count

    def over_dofs(self, u: np.ndarray) -> np.ndarray:
        """Change of the stiffness over DoFs; its factor holds the forces of each way."""
        assert self.factor is not None, "forces of each way are needed"
        force = self.factor @ u
        return self.strength * np.outer(force, force)

    def changes(self, u: np.ndarray) -> dict[str, np.ndarray]:
        """Change of the stiffness."""
        f = u @ self.ways
        return {"K": self.strength * np.outer(f, f)}

    def slopes(self, u: np.ndarray) -> list[dict[str, np.ndarray]]:
        """Derivatives of :meth:`changes` by each size."""
        both = [self.strength * np.outer(way, u @ self.ways) for way in self.ways]
        return [{"K": A + A.T} for A in both]

    def possible(self, u: np.ndarray) -> bool:
        """No spring loses more than it has."""
        return self.size(u) > -1

    def size(self, u: np.ndarray) -> float:
        """Relative change in the one way in which the spring is strained."""
        return self.strength * float(u @ u)

    def told(self, u: np.ndarray, covariance: np.ndarray) -> dict[str, dict[str, Any]]:
        r"""Stiffness along the spring, and by how much its line of action passes the node.

        A force ``n`` at a point ``r`` has the moment :math:`r\times n` about the node; of ``r`` only
        :math:`n\times(r\times n)/|n|^2`, across the line, shows.
        """
        force, across = (self.moves[:, k] for k in (slice(3), slice(3, 6)))
        n, m = u @ force, u @ across
        names = {"stiffness": ("N/m", self.strength * float(n @ n), 2 * self.strength * force @ n)}
        if not n.any():
            names = {"rotational_stiffness": ("N m/rad", self.strength * float(m @ m), 2 * self.strength * across @ m)}
        elif across.any():
            r = np.cross(n, m) / (n @ n)
            slope = (np.cross(force, m) + np.cross(n, across)) / (n @ n) - np.outer(2 * force @ n, r) / (n @ n)
            names |= {f"offset_{x}": ("m", float(r[k]), slope[:, k]) for k, x in enumerate("xyz") if slope[:, k].any()}
        return {
            name: {"value": value, "std": float(np.sqrt(max(by @ covariance @ by, 0.0))), "unit": unit}
            for name, (unit, value, by) in names.items()
        }

    def said(self) -> str:
        """What would change an element so."""
        more = "stiffer" if self.stiffer else "softer"
        only = f"what joins {self.between} is {more} in one direction only"
        return f"{only}, as where one of several springs there is {more}"
