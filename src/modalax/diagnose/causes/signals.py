r"""Arguments of the maps of causes: terms of the modes, receptances at the channels, and lines of hum."""

from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float


class ModalTerms(eqx.Module):
    r"""Coefficients of :math:`D_r = s^2 + c_r s + k_r + j h_r`, shape ``(run or 1, n)``."""

    k: Float[Array, "run n"]
    c: Float[Array, "run n"]
    h: Float[Array, "run n"]


class Channels(eqx.Module):
    """Arguments of a map on the channels: receptances of the simulation at the sensors and at the drive points.

    Attributes
    ----------
    s
        Laplace variable of each line, shape ``(f,)`` [rad/s].
    own
        Receptance of each output's DoF at itself, shape ``(f, o)`` [m/N], with linear elements in place.
    drive
        The same of each input's DoF, shape ``(f, i)`` [m/N].
    level
        Force amplitudes of each run and line [N].
    gains, shapes, participation
        Of the modes and their conjugates, shapes ``(f, m)``, ``(m, o)`` at the outputs and ``(m, dof)``.
    taken, reach
        Linear elements on q directions: what they take from the outputs by a unit of free motion along these, shape
        ``(f, o, q)``, and that motion by a unit of force at any DoF, ``(f, q, dof)``.
    """

    s: Complex[Array, " f"]
    own: Complex[Array, "f o"]
    drive: Complex[Array, "f i"]
    level: Float[Array, "run f"]
    gains: Complex[Array, "f m"]
    shapes: Complex[Array, "m o"]
    participation: Complex[Array, "m dof"]
    taken: Complex[Array, "f o q"]
    reach: Complex[Array, "f q dof"]

    def column(self, dof: Array) -> Complex[Array, "f o"]:
        """Receptance from any DoF to the outputs [m/N]."""
        free = (self.gains * jnp.take(self.participation, dof, axis=1)) @ self.shapes
        return free - jnp.einsum("foq,fq->fo", self.taken, jnp.take(self.reach, dof, axis=2))

    def at(self, outputs: Array) -> "Channels":
        """Those of some outputs."""
        of = lambda c: (c.own, c.shapes, c.taken)
        return eqx.tree_at(of, self, (self.own[:, outputs], self.shapes[:, outputs], self.taken[:, outputs]))


@dataclass(frozen=True)
class HumLines:
    """Lines that hum reaches and what it explains.

    Attributes
    ----------
    lines
        Mask over the lines, shape ``(f,)``.
    chi2
        Minus twice the log likelihood of these lines with hum of unknown size and phase, less the constant of the
        noise alone.
    freedom
        Unknown sizes, one a harmonic.
    amplitude
        Spread of the hum over that of the noise at the strongest harmonic.
    frequency
        Fundamental [Hz].
    p_value
        Chance of so much at such lines under noise alone.
    """

    lines: np.ndarray
    chi2: float
    freedom: float
    amplitude: float
    frequency: float
    p_value: float


def gather(columns: Array, index: Array) -> Array:
    """Column of a direction: that of the first DoF less that of the second, where there is one."""
    second = jnp.take(columns, jnp.maximum(index[1], 0), axis=-1)
    return jnp.take(columns, index[0], axis=-1) - jnp.where(index[1] >= 0, 1.0, 0.0) * second
