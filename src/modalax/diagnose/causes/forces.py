"""Faults of the force and of what one channel hears of another."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex

from modalax.diagnose.causes.base import RARE, ChannelCause
from modalax.diagnose.causes.channels import one_row
from modalax.diagnose.causes.parameter import Parameter
from modalax.diagnose.causes.scene import Place, Scene
from modalax.diagnose.causes.signals import Channels


class ForceGain(ChannelCause):
    r"""Calibration of the force of one input or of all, columns times :math:`1 + g`."""

    slug = "force_gain"
    summary = "calibration of the force"
    advice = "calibrate the force sensor: weigh a suspended block of known mass by its accelerance"
    prior = 0.5  # one column by itself, or all of them
    parameters = (Parameter("gain", "-", -0.999),)

    def places(self, scene: Scene) -> list[Place]:
        """Every input, and all together where there are several."""
        each = [Place((name,), (k, -1, 0)) for k, name in enumerate(scene.inputs)]
        return each + ([Place((), (-1, -1, 0))] if len(each) > 1 else [])

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Linear in the gain, so one size does."""
        return np.array([[1e-3]])

    def channels(self, H: Array, at: Channels, where: Array, extra: Any, p: Array) -> Complex[Array, "run f o i"]:
        """Scale columns."""
        which = jnp.where(where[0] < 0, 1.0, (jnp.arange(H.shape[3]) == where[0]).astype(float))
        return H * (1 + p[0] * which)


class ForceSwap(ChannelCause):
    """Two inputs exchanged: hits written down at each other's points, or the cables of two load cells."""

    slug = "channel_swap"
    shortlist_by = "exchange of inputs"
    summary = "two inputs exchanged"
    prior = 0.5  # as of what else is wrong of a single input
    advice = "hit, or drive, each of the two points again and check which FRFs come back"

    def places(self, scene: Scene) -> list[Place]:
        """Every pair of inputs."""
        names, count = scene.inputs, len(scene.inputs)
        return [Place((names[a], names[b]), (a, b, 0)) for a in range(count) for b in range(a + 1, count)]

    def channels(self, H: Array, at: Channels, where: Array, extra: Any, p: Array) -> Complex[Array, "run f o i"]:
        """Exchange two columns."""
        k = jnp.arange(H.shape[3])
        return jnp.take(H, jnp.where(k == where[0], where[1], jnp.where(k == where[1], where[0], k)), axis=3)


class Crosstalk(ChannelCause):
    """A share of one channel leaks into another."""

    slug = "crosstalk"
    summary = "one channel leaks into another"
    advice = "short-circuit one sensor's input and look for the signal of the others in it"
    prior = 0.2  # channels of analysers are 60 dB apart and more: only damaged or long shared cables do worse
    parameters = (Parameter("share", "-"),)
    most = 24  # outputs beyond which there are too many pairs

    def places(self, scene: Scene) -> list[Place]:
        """Every ordered pair of outputs; the first hears the second."""
        names, count = scene.outputs, len(scene.outputs)
        if count > self.most:
            return []
        return [Place((names[a], names[b]), (a, b, 0)) for a in range(count) for b in range(count) if a != b]

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Linear in the share, so one size does."""
        return np.array([[1e-3]])

    def channels(self, H: Array, at: Channels, where: Array, extra: Any, p: Array) -> Complex[Array, "run f o i"]:
        """Add to one row."""
        return H + p[0] * jnp.take(H, where[1], axis=2)[:, :, None] * one_row(H, where[0])


class StrayForce(ChannelCause):
    r"""A share of the force of one input also acts on another DoF, as in an oblique hit: :math:`H_{oi} + g H_{oj}`."""

    slug = "stray_force"
    summary = "a share of the force acts elsewhere"
    named = False
    prior = RARE
    parameters = (Parameter("share", "-"),)
    most = 60  # DoFs beyond which there are too many places

    def places(self, scene: Scene) -> list[Place]:
        """Every input with every other DoF."""
        names = scene.dofs if scene.scaled and len(scene.dofs) <= self.most else ()
        return [
            Place((name, dof), (i, k, 0)) for i, name in enumerate(scene.inputs) for k, dof in enumerate(names)
            if dof != name
        ]  # fmt: skip

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Linear in the share, so one size does."""
        return np.array([[1e-3]])

    def channels(self, H: Array, at: Channels, where: Array, extra: Any, p: Array) -> Complex[Array, "run f o i"]:
        """Add to one column."""
        which = (jnp.arange(H.shape[3]) == where[0]).astype(float)
        return H + p[0] * at.column(where[1])[None, :, :, None] * which


FORCES: tuple[Any, ...] = (ForceGain(), ForceSwap(), Crosstalk(), StrayForce())
