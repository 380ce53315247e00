"""What is hidden: one effect with its place, its size and the stage of the measurement at which it acts."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .march import Joint, march
from .plant import DERIVATIVES, Plant, through_kernel
from .systems import System


@dataclass(frozen=True)
class Setup:
    """The test as planned: structure, lines, channels and levels, before any effect or noise."""

    system: System
    freq: np.ndarray
    form: str
    outputs: list[int]
    inputs: list[int]
    level: np.ndarray
    equispaced: bool

    @property
    def omega(self) -> np.ndarray:
        return 2 * np.pi * self.freq

    @property
    def rows(self) -> np.ndarray:
        return np.eye(self.system.n)[self.outputs]

    @property
    def columns(self) -> np.ndarray:
        return np.eye(self.system.n)[self.inputs]

    @property
    def factor(self) -> np.ndarray:
        """(j omega)^n of the form, shape (f, 1, 1)."""
        return (1j * self.omega[:, None, None]) ** DERIVATIVES[self.form]

    @property
    def plant(self) -> Plant:
        return Plant(self.system.M, self.system.C, self.system.K)

    def frf(self, plant: Plant) -> np.ndarray:
        return plant.receptance(1j * self.omega, self.rows, self.columns) * self.factor

    def motion(self, b: np.ndarray) -> np.ndarray:
        """Linear relative displacement a unit force, shape (f, i), across the direction ``b``."""
        return self.plant.receptance(1j * self.omega, b[None], self.columns)[:, 0]


@dataclass
class Effect:
    """A cause: its name, its place, and one or more of the hooks below, each a function of the size.

    ``plant(plant, size, run)`` changes the structure, ``joint(size)`` adds one non-linear element or several that are
    marched in time, ``harmonic(H, setup, size, plant, run)`` is a describing-function correction, ``kernel(size)``
    weights the impulse response, ``shift(size)`` moves s to the right, ``post(H, setup, size, plants)`` acts on the
    channels.
    """

    slug: str
    where: list[Any]
    start: float
    limit: float
    params: Callable[[float], dict[str, tuple[float, str]]]
    plant: Callable[[Plant, float, int], Plant] | None = None
    joint: Callable[[float], Joint | list[Joint]] | None = None
    harmonic: Callable[..., np.ndarray] | None = None
    kernel: Callable[[float], Callable[[np.ndarray], np.ndarray]] | None = None
    shift: Callable[[float], float] | None = None
    post: Callable[..., np.ndarray] | None = None
    natural: float | None = None
    variant: str = ""
    notes: dict[str, Any] = field(default_factory=dict)

    @property
    def marched(self) -> bool:
        return self.joint is not None


def evaluate(setup: Setup, effects: list[tuple[Effect, float]], steps: int = 256) -> tuple[np.ndarray, dict]:
    """The FRF (run, f, o, i) that a noise-free test would give, and remarks on how it was reached."""
    plants = []
    for run in range(len(setup.level)):
        plant = setup.plant
        for effect, size in effects:
            if effect.plant is not None:
                plant = effect.plant(plant, size, run)
        plants.append(plant)
    per_run = any(e.plant is not None and e.notes.get("per_run") for e, _ in effects)
    kernels = [(e, s) for e, s in effects if e.kernel is not None]
    shift = sum(e.shift(s) for e, s in effects if e.shift is not None)
    kinds = plants if per_run else plants[:1]
    if kernels:
        (effect, size) = kernels[0]
        H = np.stack(
            [
                through_kernel(
                    *p.residues(setup.rows, setup.columns), setup.omega, DERIVATIVES[setup.form], effect.kernel(size)
                )
                for p in kinds
            ]
        )
    else:
        s = 1j * setup.omega + shift
        H = np.stack([p.receptance(s, setup.rows, setup.columns) for p in kinds])
        H = H * s[:, None, None] ** DERIVATIVES[setup.form]
    H = np.array(np.broadcast_to(H, (len(setup.level), *H.shape[1:])))
    remarks: dict[str, Any] = {}
    added = [e.joint(s) for e, s in effects if e.joint is not None]
    joints = [j for some in added for j in (some if isinstance(some, list) else [some])]
    if joints:
        # without a kernel or shift the march is exact; with one, the joint's share passes through unchanged
        change, remarks = march(plants[0], setup, joints, steps)
        H = H + change * setup.factor
    for effect, size in effects:
        if effect.harmonic is not None:
            H = np.stack([effect.harmonic(H[k], setup, size, plants[k], k) for k in range(len(H))])
    for effect, size in effects:
        if effect.post is not None:
            H = effect.post(H, setup, size, plants)
    return H, remarks
