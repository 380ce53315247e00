"""Hidden changes of the linear structure, each exactly in its matrices."""

import numpy as np

from .effect import Effect, Setup
from .systems import elastic_frequencies, log_uniform, modal_matrix


def pick_place(setup: Setup, rng, ground: bool = True, spring: bool = False) -> tuple[int, int, float]:
    """A neighbouring pair of the structure, or a DoF and the ground; far pairs now and then."""
    system = setup.system
    pairs = [p for p in system.places if (p[1] >= 0 or ground) and (p[2] > 0 or not spring)]
    if spring and pairs:
        return pairs[int(rng.integers(len(pairs)))]
    inner = [p for p in pairs if p[1] >= 0]
    draw = rng.random()
    if ground and draw < 0.25:
        return int(rng.integers(system.n)), -1, 0.0
    if draw < 0.4 or not inner:
        a, b = rng.choice(system.n, 2, replace=False)
        return int(a), int(b), 0.0
    return inner[int(rng.integers(len(inner)))]


def names(setup: Setup, a: int, b: int = -1) -> list[str]:
    return [setup.system.dofs[k] for k in (a, b) if k >= 0]


def drive_stiffness(setup: Setup, b: np.ndarray) -> float:
    """A stiffness [N/m] that matters in the band: one over the median relative receptance at the place."""
    H = setup.plant.receptance(1j * setup.omega, b[None], b[None])[:, 0, 0]
    return float(1 / np.median(np.abs(H)))


def band_modes(setup: Setup) -> list[int]:
    freq = setup.system.modes()[0] / (2 * np.pi)
    elastic = elastic_frequencies(setup.system)[0]
    inside = (freq >= max(setup.freq[0], 0.99 * elastic)) & (freq <= setup.freq[-1])
    return np.flatnonzero(inside).tolist()


def modal_damping(setup: Setup, rng) -> Effect:
    omega, zeta, shapes = setup.system.modes()
    r = int(rng.choice(band_modes(setup)))
    sign = 1.0 if rng.random() < 0.5 else -1.0
    change = lambda size: zeta[r] * (size if sign > 0 else -size / (1 + size))
    one = np.zeros(len(omega))
    one[r] = 1.0
    C = modal_matrix(setup.system.M, shapes, 2 * omega * one)
    return Effect(
        "modal_damping", [r + 1], 0.01, 30.0,
        lambda size: {
            "relative_change": (change(size) / zeta[r], "-"), "damping_ratio": (zeta[r] + change(size), "-")
        },
        plant=lambda p, size, run: p.add(C=change(size) * C),
    )  # fmt: skip


def structural_damping(setup: Setup, rng) -> Effect:
    omega, zeta, shapes = setup.system.modes()
    hysteretic = 1j * modal_matrix(setup.system.M, shapes, 2 * zeta * omega**2)
    C = setup.system.C
    return Effect(
        "structural_damping", [], 0.01, 1.0, lambda size: {"share": (size, "-")},
        plant=lambda p, size, run: p.add(C=-size * C, K=size * hysteretic),
    )  # fmt: skip


def _between(slug: str, unit: str, matrix: str):
    def draw(setup: Setup, rng) -> Effect:
        a, b, k = pick_place(setup, rng)
        e = setup.system.direction(a, b)
        scale = drive_stiffness(setup, e)
        if matrix == "C":
            scale = scale / float(np.median(setup.omega))
        softer = matrix == "K" and k > 0 and rng.random() < 0.5
        sign, limit = (-1.0, 0.9 * k) if softer else (1.0, 1e3 * scale)
        name = "damping" if matrix == "C" else "stiffness"
        return Effect(
            slug, names(setup, a, b), 1e-4 * scale, limit, lambda size: {name: (sign * size, unit)},
            plant=lambda p, size, run: p.add(**{matrix: sign * size * np.outer(e, e)}),
        )  # fmt: skip

    return draw


local_damper = _between("local_damper", "N s/m", "C")
joint_stiffness = _between("joint_stiffness", "N/m", "K")


def added_mass(setup: Setup, rng) -> Effect:
    a = int(rng.integers(setup.system.n))
    e = setup.system.direction(a, -1)
    own = setup.system.M[a, a]
    return Effect(
        "added_mass", names(setup, a), 1e-4 * own, 30 * own, lambda size: {"mass": (size, "kg")},
        plant=lambda p, size, run: p.add(M=size * np.outer(e, e)),
    )  # fmt: skip


def sensor_mass(setup: Setup, rng) -> Effect:
    """The roving sensor sits at its own output only while that output is measured."""
    o = int(rng.integers(len(setup.outputs)))
    a = setup.outputs[o]
    e = setup.system.direction(a, -1)
    own = setup.system.M[a, a]

    def post(H, setup, size, plants):
        H = H.copy()
        for k, plant in enumerate(plants):
            pad = np.pad(np.outer(e, e), (0, len(plant.M) - len(e)))
            loaded = plant.add(M=size * pad)
            H[k, :, o] = setup.frf(loaded)[:, o]
        return H

    return Effect("sensor_mass", names(setup, a), 1e-4 * own, 30 * own, lambda size: {"mass": (size, "kg")}, post=post)


def tuned_mass(setup: Setup, rng) -> Effect:
    a = int(rng.integers(setup.system.n))
    e = setup.system.direction(a, -1)
    own = setup.system.M[a, a]
    freq = setup.system.modes()[0][band_modes(setup)] / (2 * np.pi)
    tuned = float(rng.choice(freq) * rng.uniform(0.92, 1.08))
    tuned = float(np.clip(tuned, 1.1 * setup.freq[0], 0.9 * setup.freq[-1]))
    zeta, w = float(log_uniform(rng, 0.005, 0.04)), 2 * np.pi * tuned
    return Effect(
        "tuned_mass", names(setup, a), 1e-5 * own, 10 * own,
        lambda m: {"mass": (m, "kg"), "frequency": (tuned, "Hz"), "damping_ratio": (zeta, "-")},
        plant=lambda p, m, run: p.grow(m, np.pad(e, (0, len(p.M) - len(e))), m * w**2, 2 * zeta * w * m),
    )  # fmt: skip


def _mixture(setup: Setup, rng) -> np.ndarray:
    """A shape nobody expected: a random mix of the structure's own, mass-normalised."""
    shapes = setup.system.modes()[2][:, : max(band_modes(setup)) + 2]
    phi = shapes @ rng.normal(size=shapes.shape[1])
    return phi / np.sqrt(phi @ setup.system.M @ phi)


def missing_mode(setup: Setup, rng) -> Effect:
    phi, zeta = _mixture(setup, rng), float(log_uniform(rng, 0.005, 0.03))
    low, high = setup.freq[0], setup.freq[-1]
    f = float(rng.uniform(low + 0.15 * (high - low), high - 0.1 * (high - low)))
    return Effect(
        "missing_mode", [], 1e-3, 10.0,
        lambda size: {"frequency": (f, "Hz"), "damping_ratio": (zeta, "-"), "participation": (size, "kg^-1/2")},
        plant=lambda p, size, run: p.add_mode(size * phi, 2 * np.pi * f, zeta),
    )  # fmt: skip


def out_of_band(setup: Setup, rng) -> Effect:
    """Real modes far above or below the band, not their limits."""
    kind = str(rng.choice(["upper", "lower", "both"]))
    modes = []
    for side in ("upper", "lower"):
        for _ in range(int(rng.integers(1, 4)) if kind in (side, "both") else 0):
            f = setup.freq[-1] * rng.uniform(3, 8) if side == "upper" else setup.freq[0] * rng.uniform(0.02, 0.25)
            # made so that each side matters at its own end of the band
            weight = rng.normal() * (f / setup.freq[-1] if side == "upper" else setup.freq[0] / setup.freq[-1])
            modes.append((weight * _mixture(setup, rng), 2 * np.pi * float(f), 0.01))

    def plant(p, size, run):
        for phi, w, zeta in modes:
            p = p.add_mode(size * phi, w, zeta)
        return p

    return Effect(
        "out_of_band", [], 1e-3, 1e3, lambda size: {"participation": (size, "kg^-1/2")}, plant=plant, variant=kind
    )


def gyroscopic(setup: Setup, rng) -> Effect:
    """A wheel's angular momentum couples two DoFs: G = g (e_a e_b' - e_b e_a')."""
    for _ in range(20):
        a, b, _ = pick_place(setup, rng, ground=False)
        if a in setup.inputs or b in setup.inputs or rng.random() < 0.1:
            break
    G = np.zeros((setup.system.n, setup.system.n))
    G[a, b], G[b, a] = 1.0, -1.0
    scale = drive_stiffness(setup, setup.system.direction(a, b)) / float(np.median(setup.omega))
    sign = 1.0 if rng.random() < 0.5 else -1.0
    return Effect(
        "gyroscopic", names(setup, a, b), 1e-4 * scale, 1e3 * scale, lambda g: {"coupling": (sign * g, "N s/m")},
        plant=lambda p, g, run: p.add(C=sign * g * G),
    )  # fmt: skip


def time_varying(setup: Setup, rng) -> Effect:
    """The stiffness drifts from run to run: all of it, or one spring (warming up, settling bolts)."""
    runs = len(setup.level)
    course = np.linspace(0.0, 1.0, runs) if rng.random() < 0.6 else np.sort(rng.random(runs)) - 0.0
    course = course - course[0]
    sign = 1.0 if rng.random() < 0.3 else -1.0
    springs = [p for p in setup.system.places if p[2] > 0]
    if springs and rng.random() < 0.3:
        a, b, k = springs[int(rng.integers(len(springs)))]
        e = setup.system.direction(a, b)
        K, kind, told = k * np.outer(e, e), "one spring", ("stiffness_drift", k, "N/m")
    else:
        K, kind, told = setup.system.K, "whole structure", ("relative_stiffness_drift", 1.0, "-")
    name, of, unit = told
    return Effect(
        "time_varying", [], 1e-5, 0.9,
        lambda size: {name: (sign * size * course[-1] * of, unit)},  # from the first run to the last
        plant=lambda p, size, run: p.add(K=sign * size * course[run] * K), variant=kind, notes={"per_run": True},
    )  # fmt: skip


LINEAR = {
    "modal_damping": modal_damping,
    "structural_damping": structural_damping,
    "local_damper": local_damper,
    "joint_stiffness": joint_stiffness,
    "added_mass": added_mass,
    "sensor_mass": sensor_mass,
    "tuned_mass": tuned_mass,
    "missing_mode": missing_mode,
    "out_of_band": out_of_band,
    "gyroscopic": gyroscopic,
    "time_varying": time_varying,
}
