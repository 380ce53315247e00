"""Causes that no catalogue holds: an honest answer to them is "unknown", or a set, but no confident name.

The linear ones are exact. The two that depend on the amplitude of the whole response (sloshing, geometric stiffening)
use one harmonic; the damper of third degree is marched in time like the catalogue's joints.
"""

import numpy as np

from . import laws
from .effect import Effect, Setup
from .effects_channel import scale_rows
from .effects_joint import place_with_motion
from .effects_linear import drive_stiffness, names, pick_place
from .effects_viscoelastic import dynamic
from .march import Joint
from .plant import DERIVATIVES
from .systems import log_uniform


def maxwell(setup: Setup, rng) -> Effect:
    tau = float(log_uniform(rng, 0.3, 3.0)) / float(np.median(setup.omega))
    law = lambda s: s * tau / (1 + s * tau)
    told = lambda z: {"size": (z, "N/m"), "time_constant": (tau, "s")}
    return dynamic("outside:maxwell", setup, rng, law, told)


def _one_way(slug: str, matrix: str, skew: bool):
    def draw(setup: Setup, rng) -> Effect:
        a, b, _ = pick_place(setup, rng, ground=False)
        scale = drive_stiffness(setup, setup.system.direction(a, b))
        scale = scale / float(np.median(setup.omega)) if matrix == "C" else scale
        A = np.zeros((setup.system.n, setup.system.n))
        A[a, b] = 1.0
        A[b, a] = -1.0 if skew else 0.0
        return Effect(
            slug, names(setup, a, b), 1e-4 * scale, 3 * scale, lambda z: {"size": (z, "SI")},
            plant=lambda p, z, run: p.add(**{matrix: z * A}),
        )  # fmt: skip

    return draw


def _sensor(slug: str, start: float, limit: float, response):
    def draw(setup: Setup, rng) -> Effect:
        o = int(rng.integers(len(setup.outputs)))
        at = response(setup, rng)
        where = [setup.system.dofs[setup.outputs[o]]]
        return Effect(
            slug, where, start, limit, lambda s: {"size": (s, "-")}, post=scale_rows([o], lambda setup, s: at(s))
        )

    return draw


def _cable(setup: Setup, rng):
    """A resonance of cable or bracket within the band, coupled by ``size``."""
    f0 = float(rng.uniform(setup.freq[0], setup.freq[-1]))
    zeta, x = float(log_uniform(rng, 0.01, 0.05)), setup.freq / f0
    return lambda size: 1 + size * x**2 / (1 - x**2 + 2j * zeta * x)


def phase_jitter(setup: Setup, rng) -> Effect:
    """The trigger wanders: a random phase at each line, run and input, the same for all outputs."""
    wander = rng.normal(size=(len(setup.level), len(setup.freq), 1, len(setup.inputs)))
    return Effect(
        "outside:phase_jitter", [], 1e-5, 1.0, lambda s: {"phase_std": (s, "rad")},
        post=lambda H, setup, s, plants: H * np.exp(1j * s * wander),
    )  # fmt: skip


def clock_error(setup: Setup, rng) -> Effect:
    """The analyser's clock is off: every line lies a little beside where it says."""
    return Effect(
        "outside:clock_error", [], 1e-6, 0.2, lambda s: {"relative": (s, "-")},
        post=lambda H, setup, s, plants: np.stack(
            [
                p.receptance(1j * setup.omega * (1 + s), setup.rows, setup.columns)
                * (1j * setup.omega[:, None, None] * (1 + s)) ** DERIVATIVES[setup.form]
                for p in plants
            ]
        ),
    )  # fmt: skip


def stray_force(setup: Setup, rng) -> Effect:
    """The shaker's stinger also pushes another point, by a share of the measured force."""
    i = int(rng.integers(len(setup.inputs)))
    stray = int(rng.choice([k for k in range(setup.system.n) if k != setup.inputs[i]]))
    e = setup.system.direction(stray, -1)

    def post(H, setup, size, plants):
        H = H.copy()
        for k, plant in enumerate(plants):
            H[k, :, :, i] += size * (plant.receptance(1j * setup.omega, setup.rows, e[None]) * setup.factor)[..., 0]
        return H

    where = [setup.system.dofs[setup.inputs[i]], setup.system.dofs[stray]]
    return Effect("outside:stray_force", where, 1e-5, 3.0, lambda s: {"share": (s, "-")}, post=post)


def _warming(setup: Setup, rng):
    """A sensor whose gain wanders while it warms up, in step with the lines."""
    along = (setup.freq - setup.freq[0]) / (setup.freq[-1] - setup.freq[0]) - 0.5
    return lambda size: 1 + size * along + 0j


def drifting_sweep(setup: Setup, rng) -> Effect:
    """The structure softens from line to line of each run, as one does that warms up during a slow sweep."""
    along = (setup.freq - setup.freq[0]) / (setup.freq[-1] - setup.freq[0])

    def post(H, setup, size, plants):
        s = 1j * setup.omega[:, None, None]
        softer = [
            np.linalg.inv(p.M * s**2 + p.C * s + p.K * (1 - size * along)[:, None, None])[:, setup.outputs][
                :, :, setup.inputs
            ]
            for p in plants
        ]
        return np.stack(softer) * setup.factor

    return Effect("outside:drifting_sweep", [], 1e-6, 0.3, lambda z: {"softening": (z, "-")}, post=post)


def relaxing_mass(setup: Setup, rng) -> Effect:
    """Fluid that is carried along at low frequencies only: a mass behind a relaxation."""
    tau = float(log_uniform(rng, 0.3, 3.0)) / float(np.median(setup.omega))
    law = lambda s: s**2 * tau**2 / (1 + s * tau)
    told = lambda z: {"size": (z, "N/m"), "time_constant": (tau, "s")}
    return dynamic("outside:relaxing_mass", setup, rng, law, told)


def sloshing_mass(setup: Setup, rng) -> Effect:
    """A tank whose contents move along less and less as the motion grows: m(A) = size / (1 + (A/A0)^2)."""
    a = int(rng.integers(setup.system.n))
    e = setup.system.direction(a, -1)
    own = float(setup.system.M[a, a])
    A0 = float(rng.uniform(0.15, 0.6)) * float(np.abs(setup.motion(e)).max() * np.median(setup.level))

    def harmonic(H, setup, size, plant, run):
        s = 1j * setup.omega
        own_path = plant.receptance(s, e[None], e[None])[:, 0, 0]
        free = plant.receptance(s, e[None], setup.columns)[:, 0] * setup.level[run]
        mass = np.zeros_like(free, dtype=float)
        for _ in range(200):
            x = free / (1 - setup.omega[:, None] ** 2 * mass * own_path[:, None])
            mass = 0.5 * mass + 0.5 * size / (1 + (np.abs(x) / A0) ** 2)
        force = setup.omega[:, None] ** 2 * mass * x / setup.level[run]
        path = plant.receptance(s, setup.rows, e[None])
        return H + path * force[:, None, :] * setup.factor

    return Effect(
        "outside:sloshing_mass", names(setup, a), 1e-4 * own, 3 * own,
        lambda m: {"mass": (m, "kg"), "amplitude": (A0, "m")}, harmonic=harmonic,
    )  # fmt: skip


def geometric_stiffening(setup: Setup, rng) -> Effect:
    """Large motion stiffens the whole structure: K (1 + size * strain energy / its linear peak), one harmonic."""
    omega, zeta, shapes = setup.system.modes()
    s = 1j * setup.omega[:, None, None]
    push = shapes[setup.inputs][None]  # (1, i, r)

    def energy(stiffer):
        eta = push / (omega**2 * (1 + stiffer[..., None]) + 2 * zeta * omega * s + s**2)
        return eta, (omega**2 * np.abs(eta) ** 2).sum(axis=-1)

    still = np.zeros((len(setup.freq), len(setup.inputs)))
    linear, at_rest = energy(still)
    reference = at_rest.max() * float(np.nanmax(setup.level)) ** 2

    def harmonic(H, setup, size, plant, run):
        stiffer = still
        for _ in range(200):
            eta, now = energy(stiffer)
            stiffer = 0.7 * stiffer + 0.3 * size * now * setup.level[run] ** 2 / reference
        return H + np.einsum("or,fir->foi", shapes[setup.outputs], eta - linear) * setup.factor

    limit = 3 * float(np.median(zeta))
    return Effect("outside:geometric_stiffening", [], 1e-5, limit, lambda z: {"size": (z, "-")}, harmonic=harmonic)


def cubic_damping(setup: Setup, rng) -> Effect:
    e, where, _, amplitude, omega = place_with_motion(setup, rng)
    scale = drive_stiffness(setup, e) / (omega**3 * amplitude**2)
    return Effect(
        "outside:cubic_damping", where, 1e-4 * scale, 1e4 * scale, lambda c: {"coefficient": (c, "N s^3/m^3")},
        joint=lambda c: Joint(laws.CubicDamper("cubic_damping", c), e),
    )  # fmt: skip


OUTSIDE = {
    "outside:maxwell": maxwell,
    "outside:one_way_damping": _one_way("outside:one_way_damping", "C", False),
    "outside:follower_stiffness": _one_way("outside:follower_stiffness", "K", True),
    "outside:warming_sensor": _sensor("outside:warming_sensor", 1e-4, 1.5, _warming),
    "outside:cable_resonance": _sensor("outside:cable_resonance", 1e-5, 1.0, _cable),
    "outside:phase_jitter": phase_jitter,
    "outside:clock_error": clock_error,
    "outside:stray_force": stray_force,
    "outside:drifting_sweep": drifting_sweep,
    "outside:relaxing_mass": relaxing_mass,
    "outside:sloshing_mass": sloshing_mass,
    "outside:geometric_stiffening": geometric_stiffening,
    "outside:cubic_damping": cubic_damping,
}
