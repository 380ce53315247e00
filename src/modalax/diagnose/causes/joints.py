"""Non-linear joints between two DoFs or to ground, by the laws of :mod:`modalax.simulate`.

Thresholds are screened at fractions of the amplitude that the undisturbed structure has across the place.
"""

from typing import Any

import numpy as np
from jaxtyping import Array, Complex

from modalax.diagnose.causes.base import Cause, JointCause
from modalax.diagnose.causes.local import JointStiffness
from modalax.diagnose.causes.parameter import Parameter, strengths
from modalax.diagnose.causes.scene import Place, Scene
from modalax.simulate import joints
from modalax.simulate.joints.friction import jenkins_describing

FRACTIONS = (0.03, 0.1, 0.2, 0.35, 0.6)  # thresholds over the largest amplitude
SIZES = (1e-4, 0.05, 0.4)  # strengths that are screened, relative to the stiffness seen at the place


class CoulombFriction(JointCause):
    r"""Dry friction, :math:`4jF/(\pi A)`."""

    slug = "coulomb_friction"
    summary = "dry friction"
    rigid = True
    fidelity = 0.01
    parameters = (Parameter("slip_force", "N", 0.0),)

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Around what brings the usual motion to rest."""
        typical = float(np.median(np.abs(scene.motion(place)))) * float(scene.levels.max())
        return strengths(scene.stiffness_scale(place) * typical, ((),), (1e-4, 0.03, 0.2, 1.0), both=False)

    def law(self, p: Array) -> Any:
        """Friction force."""
        return joints.CoulombFriction(p[0])

    def impedance_in_series(self, A: Array, omega: Array, p: Array, compliance: Array) -> Complex[Array, "..."]:
        """The describing function of a spring in series with a slider."""
        return jenkins_describing(1 / compliance, p[0] * compliance, A)


class ElastoSlip(JointCause):
    r"""A spring in series with a slider; ``replaced`` where the spring was already in the simulation."""

    slug = "elasto_slip"
    has_threshold = True
    fidelity = 0.01
    prior = 0.5  # each of its two forms
    parameters = (Parameter("stiffness", "N/m", 0.0), Parameter("slip_displacement", "m", 1e-15, log=True))

    def __init__(self, replaced: bool):
        self.replaced = replaced
        self.summary = "a spring of the simulation that slips" if replaced else "an additional spring that slips"

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Slip at fractions of the amplitude."""
        shapes = [(x,) for x in scene.amplitudes(place, FRACTIONS)]
        return strengths(scene.stiffness_scale(place), shapes, SIZES, both=False)

    def law(self, p: Array) -> Any:
        """Stiffness, slip force and, where a spring is replaced, its absence."""
        return joints.ElastoSlip(p[0], p[0] * p[1], -p[0] if self.replaced else 0.0)

    def simpler(self, p: np.ndarray) -> tuple[JointCause, np.ndarray] | None:
        """An additional spring of any great stiffness that slips is dry friction."""
        return None if self.replaced else (CoulombFriction(), np.array([p[0] * p[1]]))

    def report(self, p: np.ndarray, place: Place) -> dict[str, tuple[Any, str]]:
        """The slip force rather than the slip displacement."""
        return {"stiffness": (p[0], "N/m"), "slip_force": (p[0] * p[1], "N")}


class CubicStiffness(JointCause):
    r"""A cubic spring, :math:`\frac34 k_3 A^2`."""

    slug = "cubic_stiffness"
    summary = "a cubic spring"
    fidelity = 0.01
    parameters = (Parameter("cubic_stiffness", "N/m^3"),)

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Around the stiffness that matters at the largest amplitude."""
        return strengths(
            scene.stiffness_scale(place) / scene.amplitudes(place, (1.0,))[0] ** 2, ((),), (1e-4, 0.05, 0.4, 2.0)
        )

    def law(self, p: Array) -> Any:
        """Coefficient of the cube."""
        return joints.CubicSpring(p[0])


class GapContact(JointCause):
    """Stops on both sides of a free way."""

    slug = "gap"
    has_threshold = True
    summary = "clearance between stops"
    fidelity = 0.01
    parameters = (Parameter("stiffness", "N/m", 0.0), Parameter("gap", "m", 1e-15, log=True))

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Gaps at fractions of the amplitude."""
        shapes = [(x,) for x in scene.amplitudes(place, FRACTIONS)]
        return strengths(scene.stiffness_scale(place), shapes, SIZES, both=False)

    def law(self, p: Array) -> Any:
        """Stiffness of the stops and free way."""
        return joints.Gap(p[0], p[1])


class QuadraticDamping(JointCause):
    r"""Drag, :math:`j\frac{8}{3\pi}c\,\omega^2 A`."""

    slug = "quadratic_damping"
    summary = "damping that grows with the square of the velocity"
    fidelity = 0.01
    parameters = (Parameter("coefficient", "N s^2/m^2", 0.0),)

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Around what matters at the largest amplitude."""
        scale = scene.stiffness_scale(place) / (np.median(scene.omega) ** 2 * scene.amplitudes(place, (1.0,))[0])
        return strengths(float(scale), ((),), (1e-4, 0.05, 0.4, 2.0), both=False)

    def law(self, p: Array) -> Any:
        """Coefficient of the square."""
        return joints.QuadraticDamping(p[0])


class BilinearStiffness(JointCause):
    r"""One stiffness in push, another in pull; to first order a spring of their mean.

    Its FRFs do not depend on the level; only the mean displacement and the even harmonics tell it from a spring.
    """

    slug = "bilinear_stiffness"
    advice = "record the mean displacement and the even harmonics"
    summary = "a spring that differs in push and pull"
    fidelity = 0.01
    prior = 0.02  # its fundamental FRF is a spring's: the spring is named, and the reasons say so
    told_by_levels = False
    unseen = 1
    parameters = (Parameter("mean_stiffness", "N/m"), Parameter("asymmetry", "-", 0.0, 3.0))
    asymmetries = (0.3, 1.0)
    stiffer = (1.0, 1.2, 1.5, 2.0)  # mean stiffness over that of a spring with the same FRF, at any asymmetry

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Around the stiffness that matters."""
        return strengths(scene.stiffness_scale(place), [(a,) for a in self.asymmetries], (1e-4, 0.03, 0.2, 1.0))

    def alike(self, other: Cause, p: np.ndarray) -> np.ndarray | None:
        """A spring of its mean stiffness, to first order."""
        return np.array([p[0], self.asymmetries[0]]) if isinstance(other, JointStiffness) else None

    def law(self, p: Array) -> Any:
        """Stiffness in push and in pull."""
        return joints.BilinearSpring(p[0] * (1 + p[1]), p[0] * (1 - p[1]))

    def untold(self, p: np.ndarray) -> list[np.ndarray]:
        """Any asymmetry; the motion leans to the softer side, and so the mean is stiffer than the spring it seems."""
        return [np.array([[p[0] * s, a] for s in self.stiffer]) for a in self.asymmetries]

    def report(self, p: np.ndarray, place: Place) -> dict[str, tuple[Any, str]]:
        """The two stiffnesses; which of them is in push, the fundamental does not tell."""
        sides = p[0] * (1 + p[1]), p[0] * (1 - p[1])
        return {"stiffness_stiffer_side": (max(sides), "N/m"), "stiffness_softer_side": (min(sides), "N/m")}


JOINTS: tuple[Any, ...] = (
    CoulombFriction(), ElastoSlip(False), ElastoSlip(True), CubicStiffness(), GapContact(), QuadraticDamping(),
    BilinearStiffness(),
)  # fmt: skip
