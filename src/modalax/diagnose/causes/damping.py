"""Damping other than the simulation has it: of one mode, or hysteretic instead of viscous."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from modalax.diagnose.causes.base import HystereticCause, UndampedCause
from modalax.diagnose.causes.parameter import Parameter
from modalax.diagnose.causes.scene import Place, Scene
from modalax.diagnose.causes.signals import ModalTerms


class ModalDamping(UndampedCause):
    r"""The damping ratio of one mode changed by a part, :math:`c_r (1 + \delta)`."""

    slug = "modal_damping"
    advice = "check the settings of window and record length, or repeat without a window"
    summary = "damping ratio of one mode"
    parameters = (Parameter("relative_change", "-", -0.999, relative=True),)

    def places(self, scene: Scene) -> list[Place]:
        """Every mode in or near the band."""
        low, high = 0.9 * scene.freq[0], 1.1 * scene.freq[-1]
        inside = np.flatnonzero((scene.frequency_hz >= low) & (scene.frequency_hz <= high))
        return [Place((int(r) + 1,), (int(r), -1, 0)) for r in inside]

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Half to five times."""
        return np.array([[1e-4], [0.3], [-0.3], [1.0], [-0.6], [3.0]])

    def undamped(self, theta: Array, where: Array, p: Array) -> Array:
        """Change of the logarithms of frequencies and damping ratios of the undamped modes, shape ``(2, n)``.

        Where dampers couple these, the complex modes follow (:mod:`modalax.diagnose.setup.complex_modes`).
        """
        return jnp.zeros_like(theta).at[1, where[0]].set(jnp.log1p(p[0]))


class StructuralDamping(HystereticCause):
    r"""Hysteretic instead of viscous damping, :math:`2 j\zeta\omega_r\omega \to 2 j\zeta\omega_r^2` in a share.

    What couples the modes in the viscous damping goes with that share.
    """

    slug = "structural_damping"
    advice = "calibrate the delay between the channels, and widen the band"
    summary = "hysteretic instead of viscous damping"
    prior = 0.5  # each of its two forms

    parameters = (Parameter("share", "-", 0.0, 2.0, ends=True),)

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """From a little to all."""
        return np.array([[1e-3], [0.3], [1.0]])

    def viscous(self, p: Array) -> Array:
        """Share of the viscous damping that stays, coupling of the modes included."""
        return 1 - p[0]

    def modes(self, modes: ModalTerms, where: Array, p: Array, runs: int) -> ModalTerms:
        """Move a share of each damping term."""
        return ModalTerms(modes.k, modes.c * (1 - p[0]), modes.h + p[0] * modes.c * jnp.sqrt(modes.k))


class LossFactor(HystereticCause):
    r"""Hysteretic damping with one loss factor for all modes, :math:`2 j\zeta\omega_r\omega \to j\eta\omega_r^2`."""

    slug = "structural_damping"
    advice = "calibrate the delay between the channels, and widen the band"
    summary = "one loss factor instead of viscous damping"
    prior = 0.5
    parameters = (Parameter("loss_factor", "-", 1e-5, 1.0, log=True, ends=True),)

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Around twice the damping ratios."""
        eta = 2 * float(np.median(scene.damping_ratio))
        return np.array([[eta * x] for x in (0.5, 1.0, 2.0)])

    def viscous(self, p: Array) -> float:
        """Share of the viscous damping that stays."""
        return 0.0

    def modes(self, modes: ModalTerms, where: Array, p: Array, runs: int) -> ModalTerms:
        """Viscous terms out, one loss factor in."""
        return ModalTerms(modes.k, 0.0 * modes.c, modes.h + p[0] * modes.k)


DAMPING: tuple[Any, ...] = (ModalDamping(), StructuralDamping(), LossFactor())
