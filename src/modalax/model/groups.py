"""Groups of elements of a structure that share a parameter: a Young's modulus, a density, the rate of some springs."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from modalax._numerics.checks import as_double, require_finite

SYMMETRIC = 1e-6  # greatest difference of a matrix and its transpose, relative to its largest entry


class Groups(eqx.Module):
    r"""What groups of elements contribute to the matrices of a structure.

    A parameter that is wrong by the factor ``f`` changes them by :math:`(f - 1)K_g` or :math:`(f - 1)M_g`. Groups may
    overlap, as all parts of one material and the plates among them do, and need not be all of the structure.

    Attributes
    ----------
    names
        One name for each of ``g`` groups.
    stiffness, mass
        Their shares :math:`K_g` and :math:`M_g` of stiffness and mass, shape ``(g, n, n)``; zero where a group has
        none.
    """

    stiffness: Float[Array, "g n n"]
    mass: Float[Array, "g n n"]
    names: tuple[str, ...] = eqx.field(static=True)

    def __init__(self, names: Sequence[str], stiffness: Any = None, mass: Any = None):
        self.names = tuple(str(name) for name in names)
        if len(set(self.names)) != len(self.names) or not all(self.names):
            raise ValueError(f"groups are named {', '.join(map(repr, self.names))}; each needs a name of its own")
        if stiffness is None and mass is None:
            raise ValueError("groups of elements need their shares of stiffness, of mass, or of both; here is neither")
        empty = np.zeros(np.shape(mass if stiffness is None else stiffness))
        self.stiffness = as_double(empty if stiffness is None else stiffness, "the groups' stiffness")
        self.mass = as_double(empty if mass is None else mass, "the groups' mass")
        if self.stiffness.shape != self.mass.shape or self.mass.shape != (len(self.names), *self.mass.shape[-1:] * 2):
            raise ValueError(
                f"{len(self.names)} groups have stiffness of shape {self.stiffness.shape} and mass of shape "
                f"{self.mass.shape}; both need ({len(self.names)}, n, n)"
            )
        for what, every in (("stiffness", self.stiffness), ("mass", self.mass)):
            require_finite(every, f"the groups' {what}")
            for name, A in zip(self.names, np.asarray(every), strict=True):
                if np.abs(A - A.T).max(initial=0.0) > SYMMETRIC * np.abs(A).max(initial=0.0):
                    raise ValueError(f"the {what} of group {name} is not symmetric")
        for name, K, M in zip(self.names, np.asarray(self.stiffness), np.asarray(self.mass), strict=True):
            if not (K.any() or M.any()):
                raise ValueError(f"group {name} has neither stiffness nor mass")

    def check_of(self, *sizes: int) -> None:
        """Raise ``ValueError`` unless the groups are over one of these numbers of DoFs."""
        if self.mass.shape[1] not in sizes:
            raise ValueError(
                f"the groups are over {self.mass.shape[1]} DoFs, the structure has {' or '.join(map(str, sizes))}"
            )
