"""The one thing that is grossly wrong: what, where, how much; as a change of the structure, a channel or a joint."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from generator import laws
from generator.systems import log_uniform

from .structures import Build
from .world import World


@dataclass(frozen=True)
class Test:
    """The test as planned: lines, form, measured and driven DoFs, force levels."""

    freq: np.ndarray
    form: str
    outputs: list[int]
    inputs: list[int]
    level: np.ndarray

    @property
    def omega(self) -> np.ndarray:
        return 2 * np.pi * self.freq


@dataclass(frozen=True)
class Gross:
    """One gross error by its name in the catalogue.

    ``accepted``: sets of names of which any is the right place; ``element``: the element whose stiffness it is;
    ``size``: its size as the judge counts it; ``M``, ``C``, ``K`` are added to the structure, ``channel`` acts on the
    FRF (run, f, o, i), ``law`` and ``b`` are a joint.
    """

    name: str
    where: list[str]
    parameters: dict[str, tuple[float, str]]
    accepted: list[list[str]] = field(default_factory=list)
    element: int | None = None
    size: float = 1.0
    M: Any = 0.0
    C: Any = 0.0
    K: Any = 0.0
    channel: Callable[[np.ndarray], np.ndarray] | None = None
    law: laws.Law | None = None
    b: np.ndarray | None = None
    family: str = ""

    def described(self) -> dict[str, Any]:
        parameters = {k: {"value": float(v), "unit": u} for k, (v, u) in self.parameters.items()}
        places = self.accepted or [self.where]
        return {"name": self.name, "where": self.where, "accepted": places, "parameters": parameters}


@dataclass(frozen=True)
class Scene:
    """All that a gross error may depend on; ``inside``: the modes in the band.

    ``reference`` holds the lines that sizes refer to, so that they are the same however finely or widely the test
    itself measures.
    """

    build: Build
    world: World
    test: Test
    inside: np.ndarray
    reference: Test

    def names(self, where) -> list[str]:
        return [self.build.dofs[k] for k in where]

    @property
    def total(self) -> float:
        """Mass along the deflections."""
        z = self.build.deflections
        return float(self.world.M[np.ix_(z, z)].sum())

    def added_damping(self, b: np.ndarray) -> float:
        """Largest share that a damper of 1 N s/m adds to the damping ratio of a mode in band."""
        omega = 2 * np.pi * self.world.frequencies[self.inside]
        across = b @ self.world.shapes[:, self.inside]
        return float((across**2 / (2 * omega * self.world.zeta[self.inside])).max())

    def bending(self, b: np.ndarray) -> float:
        """Largest shift of a mode in band by a spring of 1 N/m, in halves of its half-power bandwidth."""
        omega = 2 * np.pi * self.world.frequencies[self.inside]
        across = b @ self.world.shapes[:, self.inside]
        return float((across**2 / (2 * omega**2 * self.world.zeta[self.inside])).max())

    def motion(self, b: np.ndarray) -> float:
        """Largest linear displacement across a place for 1 N at any input."""
        s = 1j * self.reference.omega[:, None, None]
        Z = self.world.K + s * self.world.C + s**2 * self.world.M
        columns = np.eye(self.build.n)[:, self.test.inputs]
        return float(np.abs(b @ np.linalg.solve(Z, np.broadcast_to(columns, (len(s), *columns.shape)))).max())


def signed(rng, low: float, high: float) -> float:
    return float(rng.uniform(low, high) * rng.choice([-1.0, 1.0]))


def spring_stiffness(scene: Scene, rng) -> Gross:
    j = int(rng.choice(scene.build.springs))
    element, a = scene.build.elements[j], signed(rng, 0.05, 0.6)
    b = scene.build.direction(element.where)
    k = element.k[0, 0] * a
    return Gross(
        "joint_stiffness", scene.names(element.where), {"stiffness": (k, "N/m")}, element=j, size=a,
        K=k * np.outer(b, b), family="joint_stiffness",
    )  # fmt: skip


def beam_stiffness(scene: Scene, rng) -> Gross:
    """A beam's whole bending and torsion stiffness: right is any pair of DoFs that spans it; it has no size in N/m."""
    beams = [j for j, e in enumerate(scene.build.elements) if e.kind == "beam" and len(e.where) in (2, 4)]
    if not beams:
        return spring_stiffness(scene, rng)
    j = int(rng.choice(beams))
    element, a = scene.build.elements[j], signed(rng, 0.1, 0.6)
    half = len(element.at) // 2
    ends = [scene.names(element.at[:half]), scene.names(element.at[half:])]
    K = np.zeros_like(scene.world.K)
    K[np.ix_(element.at, element.at)] = a * element.k
    count = len(element.where) // 2
    where = scene.names(element.where[count - 1 :: count])
    return Gross(
        "joint_stiffness", where, {}, [[p, q] for p in ends[0] for q in ends[1]], j, a, K=K, family="beam_stiffness"
    )


def added_mass(scene: Scene, rng) -> Gross:
    at = int(rng.choice(scene.build.deflections))
    share = float(log_uniform(rng, 0.01, 0.10))
    b = scene.build.direction((at,))
    return Gross(
        "added_mass", scene.names((at,)), {"mass": (share * scene.total, "kg")}, size=share,
        M=share * scene.total * np.outer(b, b), family="added_mass",
    )  # fmt: skip


def local_damper(scene: Scene, rng) -> Gross:
    element = scene.build.elements[int(rng.choice(scene.build.springs))]
    b = scene.build.direction(element.where)
    times = float(log_uniform(rng, 0.5, 5.0))
    c = times / scene.added_damping(b)
    return Gross(
        "local_damper", scene.names(element.where), {"damping": (c, "N s/m")}, size=times,
        C=c * np.outer(b, b), family="local_damper",
    )  # fmt: skip


def _channel(scene: Scene, rng, slug: str) -> Gross:
    test = scene.test
    o, i = int(rng.integers(len(test.outputs))), int(rng.integers(len(test.inputs)))
    row, column = scene.build.dofs[test.outputs[o]], scene.build.dofs[test.inputs[i]]
    amount = float(rng.uniform(0.05, 0.5))
    gain = 1 + amount if rng.random() < 0.5 else 1 / (1 + amount)

    def rows(factor, at):
        def act(H):
            H = H.copy()
            H[:, :, at] *= factor
            return H

        return act

    if slug == "channel_gain":
        return Gross(slug, [row], {"gain": (gain, "-")}, size=gain - 1, channel=rows(gain, o), family="channel_gain")
    if slug == "channel_sign":
        return Gross(slug, [row], {}, channel=rows(-1.0, o), family=slug)
    if slug == "channel_swap":
        p = int(rng.choice([k for k in range(len(test.outputs)) if k != o]))
        order = np.arange(len(test.outputs))
        order[[o, p]] = p, o
        both = [row, scene.build.dofs[test.outputs[p]]]
        return Gross(slug, both, {}, channel=lambda H: H[:, :, order], family=slug)
    if slug == "time_delay":
        delay = signed(rng, 0.1, 1.0) / scene.reference.omega[-1]
        lag = np.exp(-1j * test.omega * delay)[:, None]
        return Gross(
            slug, [row], {"delay": (delay, "s")}, size=delay * test.omega[-1], channel=rows(lag, o), family=slug
        )
    if slug == "units":
        power = int(rng.choice([-1, 1]))
        factor = (1j * test.omega[:, None, None]) ** power
        return Gross(slug, [], {"derivatives": (power, "-")}, channel=lambda H: H * factor, family=slug)

    def force(H):
        H = H.copy()
        H[..., i] *= gain
        return H

    return Gross("force_gain", [column], {"gain": (gain, "-")}, size=gain - 1, channel=force, family="force_gain")


def joint(scene: Scene, rng, slug: str) -> Gross:
    """A law on one of the springs; thresholds and sizes in proportion to the motion there at the highest level."""
    element = scene.build.elements[int(rng.choice(scene.build.springs))]
    b, k = scene.build.direction(element.where), float(element.k[0, 0])
    amplitude = scene.motion(b) * float(np.max(scene.test.level))
    onset = float(rng.uniform(0.1, 0.5)) * amplitude
    shift = float(rng.uniform(0.3, 1.2)) / scene.bending(b)  # a spring that moves a peak by so many half-widths
    if slug == "elasto_slip":
        law: laws.Law = laws.Jenkins(slug, k, k * onset, k)
        parameters = {"stiffness": (k, "N/m"), "slip_force": (k * onset, "N")}
    elif slug == "cubic_stiffness":
        law = laws.Cubic(slug, shift / (0.75 * amplitude**2))
        parameters = {"cubic_stiffness": (law.k3, "N/m^3")}
    elif slug == "gap":
        law = laws.Gap(slug, shift, onset)
        parameters = {"stiffness": (shift, "N/m"), "gap": (onset, "m")}
    else:
        times, omega = float(log_uniform(rng, 0.3, 3.0)), float(np.median(scene.reference.omega))
        law = laws.QuadraticDamper(slug, times / scene.added_damping(b) / (0.85 * omega * amplitude))
        parameters = {"coefficient": (law.c, "N s^2/m^2")}
    return Gross(slug, scene.names(element.where), parameters, law=law, b=b, family=slug)


JOINTS = ("elasto_slip", "cubic_stiffness", "quadratic_damping", "gap")
STRUCTURE = {
    "joint_stiffness": spring_stiffness,
    "beam_stiffness": beam_stiffness,
    "added_mass": added_mass,
    "local_damper": local_damper,
}
CHANNELS = ("channel_gain", "channel_sign", "channel_swap", "time_delay", "units", "force_gain")
CAUSES = ("none", *STRUCTURE, *CHANNELS, *JOINTS)


def draw_gross(scene: Scene, rng: np.random.Generator, cause: str) -> Gross | None:
    """A gross error of one kind at a random place.

    Raises
    ------
    ValueError
        If the kind is not known.
    """
    if cause == "none":
        return None
    if cause in STRUCTURE:
        return STRUCTURE[cause](scene, rng)
    if cause in CHANNELS:
        return _channel(scene, rng, cause)
    if cause in JOINTS:
        return joint(scene, rng, cause)
    raise ValueError(f"cause is {cause!r}; it must be one of {', '.join(CAUSES)}")
