r"""Linear elements in place: what they take from every receptance.

With elements of impedances Z on the directions b, a structure has the receptance
:math:`H - H b\,(I + Z\,b^THb)^{-1} Z\,b^TH` (Sherman, Morrison and Woodbury). What is screened beside elements that
were found is screened on this one: a mass that moved a peak by its width makes another line resonate, and at the lines
of the old peak no further element, and no fault of a channel, would look as it does.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Array

from modalax._numerics.checks import as_array
from modalax.diagnose.causes.base import CouplingCause, LocalCause
from modalax.diagnose.causes.signals import Channels
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.prediction.frf import block_diagonal


@dataclass(frozen=True)
class InPlace:
    """The product that elements take from the receptance between all DoFs, at every line.

    Attributes
    ----------
    left
        Shape ``(f, dof, q)`` for q directions on which elements act.
    right
        Shape ``(f, q, dof)``.
    """

    left: np.ndarray
    right: np.ndarray

    def between(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """From DoFs ``b`` to DoFs ``a``, shape ``(f, a, b)``."""
        return self.left[:, a] @ self.right[:, :, b]

    def on(self, H: np.ndarray, channels: Channels, outputs: np.ndarray, inputs: np.ndarray) -> tuple[Array, Channels]:
        """Receptances ``(run or 1, f, o, i)``, and what a fault of a channel may look at, with the elements."""
        at = lambda dofs: np.einsum("foq,fqo->fo", self.left[:, dofs], self.right[:, :, dofs])
        own, drive = np.asarray(channels.own) - at(outputs), np.asarray(channels.drive) - at(inputs)
        there = Channels(
            channels.s, as_array(own), as_array(drive), channels.level, channels.gains, channels.shapes,
            channels.participation, as_array(self.left[:, outputs]), as_array(self.right),
        )  # fmt: skip
        return as_array(np.asarray(H) - self.between(outputs, inputs)), there


def in_place(
    h: Hypothesis, gains: np.ndarray, shapes: np.ndarray, participation: np.ndarray,
    far: tuple[np.ndarray, np.ndarray] | None, omega: np.ndarray,
) -> InPlace | None:  # fmt: skip
    """The linear elements of a hypothesis, in place; None where it has none.

    Parameters
    ----------
    h
        The hypothesis; joints with a force law, whose stiffness follows the amplitude, are left out.
    gains
        Of the modes and of their conjugates, shape ``(f, m)``.
    shapes, participation
        At every DoF, shape ``(m, dof)``.
    far
        Upper and lower residual terms, shape ``(dof, dof)`` each; None where there are none.
    omega
        Circular frequency of each line [rad/s].
    """
    those = [k for k, c in enumerate(h.causes) if isinstance(c, LocalCause | CouplingCause)]
    if not those:
        return None
    unit = np.eye(shapes.shape[1])
    b = np.concatenate([np.asarray(h.causes[k].ends(unit, h.index[k])) for k in those], axis=-1)
    left = np.einsum("fm,md,mq->fdq", gains, shapes, participation @ b, optimize=True)
    right = np.einsum("fm,mq,md->fqd", gains, shapes @ b, participation, optimize=True)
    if far is not None:
        upper, lower = far
        left = left + upper @ b - lower @ b / omega[:, None, None] ** 2
        right = right + b.T @ upper - b.T @ lower / omega[:, None, None] ** 2
    Z = np.asarray(block_diagonal([h.causes[k].block(1j * as_array(omega), as_array(h.params[k])) for k in those]))
    return InPlace(left, np.linalg.solve(np.eye(Z.shape[1]) + Z @ (right @ b), Z @ right))
