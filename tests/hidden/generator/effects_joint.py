"""Hidden non-linear joints: where, which law, and thresholds in proportion to the motion at the place."""

import numpy as np

from . import laws
from .effect import Effect, Setup
from .effects_linear import drive_stiffness, names, pick_place
from .march import Joint

SLIDERS = 6  # that stand for an Iwan joint


def place_with_motion(setup: Setup, rng, spring: bool = False):
    a, b, k = pick_place(setup, rng, spring=spring)
    e = setup.system.direction(a, b)
    levels = np.sort(setup.level)
    middle = float(levels[len(levels) // 2])
    amplitude = float(np.abs(setup.motion(e)).max()) * middle
    return e, names(setup, a, b), k, amplitude, float(np.median(setup.omega))


def elasto_slip(setup: Setup, rng) -> Effect:
    """Spring and slider in parallel to what is there, or in place of a part of an existing spring."""
    replaced = rng.random() < 0.5 and any(p[2] > 0 for p in setup.system.places)
    e, where, k, amplitude, _ = place_with_motion(setup, rng, spring=replaced)
    onset = float(rng.uniform(0.08, 0.6)) * amplitude
    scale = drive_stiffness(setup, e)
    return Effect(
        "elasto_slip", where, 1e-4 * (k if replaced else scale), k if replaced else 50 * scale,
        lambda s: {"stiffness": (s, "N/m"), "slip_force": (s * onset, "N")},
        joint=lambda s: Joint(laws.Jenkins("elasto_slip", s, s * onset, s if replaced else 0.0), e),
        variant="replaced" if replaced else "added",
    )  # fmt: skip


def coulomb_friction(setup: Setup, rng) -> Effect:
    e, where, _, amplitude, _ = place_with_motion(setup, rng)
    scale = drive_stiffness(setup, e) * amplitude
    return Effect(
        "coulomb_friction", where, 1e-5 * scale, 10 * scale, lambda s: {"slip_force": (s, "N")},
        joint=lambda s: Joint(laws.Coulomb("coulomb_friction", s), e),
    )  # fmt: skip


def cubic_stiffness(setup: Setup, rng) -> Effect:
    e, where, _, amplitude, _ = place_with_motion(setup, rng)
    scale = drive_stiffness(setup, e) / amplitude**2
    return Effect(
        "cubic_stiffness", where, 1e-3 * scale, 1e3 * scale, lambda s: {"cubic_stiffness": (s, "N/m^3")},
        joint=lambda s: Joint(laws.Cubic("cubic_stiffness", s), e),
    )  # fmt: skip


def gap(setup: Setup, rng) -> Effect:
    e, where, _, amplitude, _ = place_with_motion(setup, rng)
    clearance = float(rng.uniform(0.1, 0.7)) * amplitude
    scale = drive_stiffness(setup, e)
    return Effect(
        "gap", where, 1e-3 * scale, 50 * scale, lambda s: {"stiffness": (s, "N/m"), "gap": (clearance, "m")},
        joint=lambda s: Joint(laws.Gap("gap", s, clearance), e),
    )  # fmt: skip


def quadratic_damping(setup: Setup, rng) -> Effect:
    e, where, _, amplitude, omega = place_with_motion(setup, rng)
    scale = drive_stiffness(setup, e) / (omega**2 * amplitude)
    return Effect(
        "quadratic_damping", where, 1e-4 * scale, 1e3 * scale, lambda s: {"coefficient": (s, "N s^2/m^2")},
        joint=lambda s: Joint(laws.QuadraticDamper("quadratic_damping", s), e),
    )  # fmt: skip


def bilinear_stiffness(setup: Setup, rng) -> Effect:
    e, where, _, _, _ = place_with_motion(setup, rng)
    ratio = float(rng.choice([0.0, rng.uniform(-0.3, 0.7)]))
    scale = drive_stiffness(setup, e)
    first = rng.random() < 0.5
    law = lambda s: laws.Bilinear("bilinear_stiffness", *((s, ratio * s) if first else (ratio * s, s)))
    return Effect(
        "bilinear_stiffness", where, 1e-4 * scale, 20 * scale,
        lambda s: {"stiffness_positive": (law(s).tension, "N/m"), "stiffness_negative": (law(s).pressure, "N/m")},
        joint=lambda s: Joint(law(s), e),
    )  # fmt: skip


def iwan_joint(setup: Setup, rng) -> Effect:
    """Sliders side by side, as stiff as each other, whose slip displacements follow a power law up to a largest one."""
    e, where, _, amplitude, _ = place_with_motion(setup, rng)
    largest, n = float(rng.uniform(0.3, 2.0)) * amplitude, float(rng.uniform(0.4, 1.0))
    slips = largest * ((np.arange(SLIDERS) + 0.5) / SLIDERS) ** (1 / n)
    scale = drive_stiffness(setup, e)
    return Effect(
        "iwan_joint", where, 1e-4 * scale, 50 * scale,
        lambda s: {"stiffness": (s, "N/m"), "slip_force": (s * largest * n / (n + 1), "N"), "exponent": (n, "-")},
        joint=lambda s: [Joint(laws.Jenkins("iwan_joint", s / SLIDERS, s / SLIDERS * x), e) for x in slips],
    )  # fmt: skip


JOINTS = {
    "coulomb_friction": coulomb_friction,
    "elasto_slip": elasto_slip,
    "cubic_stiffness": cubic_stiffness,
    "gap": gap,
    "quadratic_damping": quadratic_damping,
    "bilinear_stiffness": bilinear_stiffness,
    "iwan_joint": iwan_joint,
}
