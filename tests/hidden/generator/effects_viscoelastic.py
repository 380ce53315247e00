"""Elements at one place whose force follows frequency in other ways than a spring and a damper; exact matrices."""

import numpy as np

from .effect import Effect, Setup
from .effects_linear import drive_stiffness, names, pick_place


def dynamic(slug: str, setup: Setup, rng, law, told) -> Effect:
    """A complex stiffness ``size * law(s)`` across a place; ``law`` is about 1 in size mid-band."""
    a, b, _ = pick_place(setup, rng)
    e = setup.system.direction(a, b)
    scale = drive_stiffness(setup, e)
    return Effect(
        slug, names(setup, a, b), 1e-4 * scale, 1e3 * scale, told,
        plant=lambda p, z, run: p.add_dynamic(e, e, lambda s: z * law(s)),
    )  # fmt: skip


def fractional_joint(setup: Setup, rng) -> Effect:
    alpha, w = float(rng.uniform(0.3, 0.7)), float(np.median(setup.omega))
    law = lambda s: (s / w) ** alpha
    told = lambda z: {"coefficient": (z / w**alpha, "N s^a/m"), "order": (alpha, "-")}
    return dynamic("fractional_joint", setup, rng, law, told)


def hysteretic_joint(setup: Setup, rng) -> Effect:
    told = lambda z: {"loss_stiffness": (z, "N/m")}
    return dynamic("hysteretic_joint", setup, rng, lambda s: 1j + 0 * s, told)


VISCOELASTIC = {"fractional_joint": fractional_joint, "hysteretic_joint": hysteretic_joint}
