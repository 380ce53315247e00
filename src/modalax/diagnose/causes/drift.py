"""Stiffness of the whole structure, or of one joint, that is off or changes from run to run."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from modalax.diagnose.causes.base import RARE, JointCause, ModesCause
from modalax.diagnose.causes.parameter import Parameter, strengths
from modalax.diagnose.causes.scene import Place, Scene
from modalax.diagnose.causes.signals import ModalTerms


class TimeVarying(ModesCause):
    r"""All stiffness drifts from run to run, :math:`K(1 + \delta\,n/(N-1))` in run n = 0 ... N-1."""

    slug = "time_varying"
    advice = "repeat the first run at the end"
    per_run = True
    each_run = True
    summary = "the structure drifts from run to run"
    prior = 0.4  # of the three forms of a drift
    parameters = (Parameter("relative_stiffness_drift", "-", -0.95),)

    def places(self, scene: Scene) -> list[Place]:
        """Nowhere in particular, if there are several runs."""
        return [Place(())] if len(scene.levels) > 1 else []

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Small drifts both ways."""
        return strengths(1.0, ((),), (1e-6, 1e-3, 1e-2, 5e-2))

    def modes(self, modes: ModalTerms, where: Array, p: Array, runs: int) -> ModalTerms:
        """Scale the stiffness of each run."""
        course = jnp.linspace(0.0, 1.0, runs)[:, None] if runs > 1 else jnp.zeros((1, 1))
        return ModalTerms(modes.k * (1 + p[0] * course), modes.c + 0 * course, modes.h + 0 * course)


class TimeVaryingSteps(ModesCause):
    r"""Each run after the first has a stiffness of its own, :math:`K(1 + \delta_n)`."""

    slug = "time_varying"
    advice = "repeat the first run at the end"
    per_run = True
    each_run = True
    summary = "the structure changes between runs"
    prior = 0.3

    def __init__(self, runs: int):
        self.runs = runs
        self.parameters = tuple(Parameter(f"relative_stiffness_run_{n + 1}", "-", -0.95) for n in range(1, runs))

    def places(self, scene: Scene) -> list[Place]:
        """Nowhere in particular, if there are three runs or more."""
        return [Place(())] if len(scene.levels) == self.runs and self.runs > 2 else []

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Drifts both ways, early and late."""
        late = np.linspace(0.0, 1.0, self.runs)[1:]
        early = np.sqrt(late)
        return np.array([size * way for size in (1e-6, 3e-3, -3e-3) for way in (early, late**3)])

    def modes(self, modes: ModalTerms, where: Array, p: Array, runs: int) -> ModalTerms:
        """Scale the stiffness of each run."""
        factor = jnp.concatenate([jnp.ones(1), 1 + p[: runs - 1]])[:, None]
        return ModalTerms(modes.k * factor, modes.c * jnp.ones_like(factor), modes.h * jnp.ones_like(factor))


class DriftingSpring(JointCause):
    r"""One spring that drifts from run to run, by :math:`\delta\,n/(N-1)` in run n = 0 ... N-1."""

    slug = "time_varying"
    told_by_levels = False
    drifts = True
    advice = "repeat the first run at the end"
    summary = "one joint drifts from run to run"
    each_run = True
    prior = 0.3
    parameters = (Parameter("stiffness_drift", "N/m"),)

    def places(self, scene: Scene) -> list[Place]:
        """Anywhere, if there are several runs; the answer tells no place."""
        if len(scene.levels) < 2:
            return []
        if "drifting" not in scene.cache:
            scene.cache["drifting"] = [Place((), p.index) for p in scene.pairs()]
        return scene.cache["drifting"]

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Softer and stiffer, around one over the receptance."""
        return strengths(scene.stiffness_scale(place))

    def impedance(self, A: Array, omega: Array, p: Array) -> Array:
        """The stiffness gained up to each run, the first axis of ``A``."""
        course = jnp.linspace(0.0, 1.0, A.shape[0]) if A.shape[0] > 1 else jnp.zeros(1)
        return p[0] * course[:, None, None] + 0j * A

    def report(self, p: np.ndarray, place: Place) -> dict[str, tuple[Any, str]]:
        """The drift from the first run to the last."""
        return {"stiffness_drift": (p[0], "N/m")}


class AllStiffness(ModesCause):
    """All natural frequencies off by one share: Young's modulus, or the clock of the analyser."""

    slug = "all_stiffness"
    summary = "all natural frequencies off by the same factor"
    named = False
    prior = RARE
    parameters = (Parameter("relative_stiffness", "-", -0.9),)

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Small changes both ways."""
        return strengths(1.0, ((),), (1e-6, 1e-3, 1e-2, 5e-2))

    def modes(self, modes: ModalTerms, where: Array, p: Array, runs: int) -> ModalTerms:
        """Scale the stiffness."""
        return ModalTerms(modes.k * (1 + p[0]), modes.c, modes.h)


DRIFTS: tuple[Any, ...] = (TimeVarying(), AllStiffness())
