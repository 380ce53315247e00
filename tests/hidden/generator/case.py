"""A whole case: a structure, a test, a hidden effect of a given size, noise, and the files that say no more."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .effect import Effect, Setup, evaluate
from .effects_channel import CHANNEL
from .effects_joint import JOINTS
from .effects_linear import LINEAR
from .effects_outside import OUTSIDE
from .effects_viscoelastic import VISCOELASTIC
from .noise import KINDS, VARIANCES, Yardstick, add_noise, draw_sigma, stated_variance
from .rivals import confusion, shares
from .systems import System, draw_system, elastic_frequencies, log_uniform, modal_matrix

EFFECTS = {**LINEAR, **CHANNEL, **JOINTS, **VISCOELASTIC, **OUTSIDE}
CATALOGUE = (*LINEAR, *CHANNEL, *JOINTS, *VISCOELASTIC)
OUTSIDE_CATALOGUE = tuple(OUTSIDE)
SIZES = (0.0, 3.0, 5.0, 8.0, 12.0, 20.0, 30.0, 50.0)
NEEDS_LEVELS = (
    *JOINTS,
    "sensor_clipping",
    "outside:sloshing_mass",
    "outside:geometric_stiffening",
    "outside:cubic_damping",
)
NEEDS_EVEN_LINES = ("leakage", "mains_hum")
NEEDS_REAL_POLES = ("leakage", "fast_sweep")


@dataclass(frozen=True)
class Case:
    """Arrays of both files as they are written, and the truth that only the scoring opens."""

    measurement: dict[str, np.ndarray]
    simulation: dict[str, np.ndarray]
    truth: dict[str, Any]
    H_true: np.ndarray = field(repr=False)
    sigma: np.ndarray = field(repr=False)
    setup: Setup = field(repr=False)

    def save(self, folder: Path | str, truth: Path | str | None = None) -> Path:
        """``measurement.npz`` and ``simulation.npz`` into ``folder``; ``truth.json`` there or into ``truth``."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(folder / "measurement.npz", **self.measurement)
        np.savez_compressed(folder / "simulation.npz", **self.simulation)
        secret = Path(truth) if truth is not None else folder / "truth.json"
        secret.parent.mkdir(parents=True, exist_ok=True)
        secret.write_text(json.dumps(self.truth, indent=1))
        np.savez_compressed(secret.with_suffix(".npz"), H_true=self.H_true, sigma=self.sigma)
        return folder


def _choose(rng, weights: dict):
    keys = list(weights)
    p = np.array([weights[k] for k in keys], float)
    return keys[int(rng.choice(len(keys), p=p / p.sum()))]


def _lines(rng, system: System, causes: tuple[str, ...]) -> tuple[np.ndarray, bool]:
    """A band that holds some modes, with a few lines over each half-power width where their number allows."""
    elastic = elastic_frequencies(system)
    count = int(rng.integers(3, 9))
    top = elastic[min(count, len(elastic)) - 1]
    top = max(top, elastic[min(1, len(elastic) - 1)])
    if top > 10 * elastic[0]:
        top = elastic[elastic <= 10 * elastic[0]][-1]
    above = elastic[elastic > 1.02 * top]
    high = min(1.3 * top, 0.5 * (top + above[0])) if len(above) else 1.25 * top
    low = float(rng.uniform(0.4, 0.8)) * elastic[0]
    zeta = np.clip(np.median(system.modes()[1][: count + 2]), 0.003, 0.05)
    most = 220 if any(c in JOINTS for c in causes) else 400
    lines = int(np.clip((high - low) / (zeta * 0.5 * (low + high) / 1.5), 120, most))
    if not any(c in NEEDS_EVEN_LINES for c in causes) and rng.random() < 0.25:
        freq = system.modes()[0] / (2 * np.pi)
        inside = freq[(freq > low) & (freq < high)]
        near = [f * (1 + zeta * np.linspace(-4, 4, 15)) for f in inside]
        freq = np.unique(np.round(np.concatenate([np.linspace(low, high, lines // 2), *near]), 6))
        return freq[(freq >= low) & (freq <= high)], False
    step = (high - low) / (lines - 1)
    start = np.ceil(low / step)
    return (start + np.arange(lines)) * step, True


def _levels(rng, causes: tuple[str, ...], runs: int | None) -> np.ndarray:
    force = float(log_uniform(rng, 0.5, 20.0))
    if "time_varying" in causes:
        runs = max(runs or int(rng.integers(3, 6)), 2)
        if rng.random() < 0.6:
            return np.full(runs, force)
        return np.append(force * np.array([1.0, 2.0, 4.0, 8.0])[: runs - 1], force)
    if any(c in NEEDS_LEVELS for c in causes):
        runs = runs or _choose(rng, {1: 10, 2: 15, 3: 55, 4: 20})
    else:
        runs = runs or _choose(rng, {1: 40, 2: 20, 3: 40})
        if runs == 1 and rng.random() < 0.4:
            return np.array([np.nan])
    return force * float(rng.uniform(1.6, 3.0)) ** np.arange(runs)


def draw_setup(rng, family: str, causes: tuple[str, ...], *, form=None, inputs=None, runs=None) -> Setup:
    system = draw_system(rng, family)
    freq, equispaced = _lines(rng, system, causes)
    if "mains_hum" in causes:  # a mains frequency has to lie well within the band
        inside = freq[0] + rng.uniform(0.25, 0.85) * (freq[-1] - freq[0])
        factor = float(rng.choice([50.0, 60.0])) / inside
        system, freq = system.scaled(factor), freq * factor
    form = form or str(rng.choice(["receptance", "mobility", "accelerance"]))
    most = min(3, system.n // 2)
    weights = {1: 10, 2: 50, 3: 40} if "gyroscopic" in causes else {1: 40, 2: 35, 3: 25}
    count = min(inputs or _choose(rng, weights), most)
    deflections = [k for k, name in enumerate(system.dofs) if ":+R" not in name]
    # a place near a node of most modes is a poor drive point: prefer the lively ones
    shapes = system.modes()[2][:, : max(len(elastic_frequencies(system)), 1)]
    lively = np.sqrt((shapes[deflections] ** 2).sum(axis=1))
    chosen = rng.choice(deflections, count, replace=False, p=lively / lively.sum()).tolist()
    if len(deflections) <= 10 and rng.random() < 0.6:
        outputs = list(deflections)
    else:
        size = int(rng.integers(min(3, len(deflections)), min(len(deflections), 14) + 1))
        outputs = rng.choice(deflections, size, replace=False).tolist()
        if rng.random() < 0.85:
            outputs = sorted({*outputs, *chosen})
        outputs = sorted(outputs)
    return Setup(
        system, freq, form, [int(o) for o in outputs], [int(i) for i in chosen], _levels(rng, causes, runs), equispaced
    )


def solve_size(distance, target: float, start: float, limit: float, accuracy: float) -> float | None:
    """A size whose distance is ``target``, by secants in logarithms from below; None if it is out of reach."""
    low: tuple[float, float] | None = None
    high: tuple[float, float] | None = None
    size, slope, last = start, 1.0, None
    for _ in range(40):
        value = distance(size)
        if abs(value - target) <= accuracy * target:
            return size
        if value < target:
            if size >= limit:
                return None
            low = (size, value) if low is None or size > low[0] else low
        else:
            high = (size, value) if high is None or size < high[0] else high
        if last is not None and value > 0 and last[1] > 0 and abs(np.log(size / last[0])) > 1e-6:
            slope = float(np.clip(np.log(value / last[1]) / np.log(size / last[0]), 0.3, 3.0))
        last = (size, value)
        step = np.log(target / value) / slope if value > 0 else np.log(10.0)
        new = size * np.exp(np.clip(step, -6.0, 8.0 if value > 1e-6 * target else np.log(100.0)))
        if low is not None and high is not None and not low[0] * 1.02 < new < high[0] / 1.02:
            new = np.sqrt(low[0] * high[0])
        size = float(min(new, limit))
        if low is not None and high is not None and high[0] / low[0] < 1 + 1e-9:
            return None
    return None


def _size_of(setup, base, yard, effect: Effect, target: float) -> tuple[float | None, float, tuple]:
    """Size that stands ``target`` out of the noise, the distance that it really has, and what it evaluates to."""
    steps = 96 if effect.marched else 256
    if effect.natural is not None:
        reached = evaluate(setup, [(effect, effect.natural)])
        return effect.natural, yard.distance(reached[0] - base), reached
    distance = lambda s: yard.distance(evaluate(setup, [(effect, s)], steps)[0] - base)
    size = solve_size(distance, target, effect.start, effect.limit, 0.01 if effect.marched else 1e-4)
    if size is None and effect.slug == "structural_damping":
        size = effect.limit
    if size is None:
        return None, 0.0, ()
    reached = evaluate(setup, [(effect, size)])
    return size, yard.distance(reached[0] - base), reached


def simulated(setup: Setup, rng, frequency_std: float, damping_std: float) -> dict[str, np.ndarray]:
    """The simulation's file: the structure without the effect, its modes off by what its author admits."""
    system = setup.system
    omega, zeta, shapes = system.modes()
    off_f, off_z = rng.normal(size=system.n) * frequency_std, np.exp(rng.normal(size=system.n) * damping_std)
    new_omega, new_zeta = omega * (1 + off_f), zeta * off_z
    K = system.K + modal_matrix(system.M, shapes, new_omega**2 - omega**2)
    C = system.C + modal_matrix(system.M, shapes, 2 * (new_zeta * new_omega - zeta * omega))
    arrays = {"M": system.M, "C": (C + C.T) / 2, "K": (K + K.T) / 2, "dofs": np.array(system.dofs)}
    if frequency_std or damping_std:
        arrays |= {"frequency_std": np.array(frequency_std), "damping_std": np.array(damping_std)}
    return arrays


def draw_case(
    seed: int,
    cause: str | None = None,
    d: float | None = None,
    family: str | None = None,
    *,
    noise: str | None = None,
    noise_level: float | None = None,
    variance: str | None = None,
    spread: bool | None = None,
    form: str | None = None,
    inputs: int | None = None,
    runs: int | None = None,
    structure: int | None = None,
    rivals: bool = False,
) -> Case:
    """A case by seed; what is not given is drawn.

    ``cause``: a slug of the catalogue, ``clean``, ``outside:NAME``, or several joined by ``+``; ``d``: distance of
    each in standard deviations; ``family``: ``masses``, ``frame``, or ``third`` (never drawn unasked); ``noise``:
    absolute, relative or coloured; ``noise_level``: its size (0.01 to 0.1 unasked); ``variance``: exact, 6, 8, 16,
    30 (repeats) or missing; ``spread``: whether the simulation is off and says so; ``structure``: a seed of its own
    for the structure and the test on it, so that many cases can share them; ``rivals``: also say in the truth how much
    of the effect each other name could explain, and how surely a perfect namer could tell them apart.

    Raises
    ------
    ValueError
        If a name is not known.
    """
    streams = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(6)]
    plan, place, build, floor, error, model = streams
    if structure is not None:
        build = np.random.default_rng([structure, 20])
    cause = cause or _choose(plan, {"clean": 3, **dict.fromkeys(CATALOGUE, 1)})
    target = float(plan.choice(SIZES)) if d is None else float(d)
    family = family or str(plan.choice(["masses", "frame"]))
    noise = noise or str(plan.choice(KINDS))
    level = float(noise_level or log_uniform(plan, 0.01, 0.10))
    variance = str(variance) if variance else _choose(plan, dict(zip(VARIANCES, (4, 2, 1, 1, 1, 1), strict=True)))
    spread = bool(plan.random() < 0.4) if spread is None else spread
    claims = (float(plan.uniform(0.0005, 0.004)), float(plan.uniform(0.03, 0.2))) if spread else (0.0, 0.0)
    for name, allowed in ((noise, KINDS), (variance, VARIANCES)):
        if name not in allowed:
            raise ValueError(f"{name!r} is unknown; it must be one of {', '.join(allowed)}")
    causes = tuple(c for c in cause.split("+") if c != "clean")
    unknown = [c for c in causes if c not in EFFECTS]
    if unknown:
        raise ValueError(f"cause {unknown[0]!r} is unknown; there are clean, {', '.join(EFFECTS)}")
    if target == 0:
        causes = ()
    setup, effects, sigma, yard, base, alone, level = _reachable(
        (place, build, floor), family, causes, target, noise, level, claims, form, inputs, runs
    )
    H, remarks = evaluate(setup, [(e, s) for e, s, _ in effects]) if len(effects) > 1 else alone
    values, averages = stated_variance(floor, sigma, variance)
    names = np.array(setup.system.dofs)
    measurement = {
        "freq": setup.freq,
        "H": add_noise(error, H, sigma),
        "level": setup.level,
        "outputs": names[setup.outputs],
        "inputs": names[setup.inputs],
        "form": np.array(setup.form),
    }
    if values is not None:
        measurement["variance"] = values
    if averages is not None:
        measurement["averages"] = np.array(averages)
    truth = {
        "seed": seed,
        "cause": "+".join(e.slug for e, _, _ in effects) or "clean",
        "causes": [_described(setup, base, yard, e, s, got) for e, s, got in effects],
        "d_asked": target,
        "d": yard.distance(H - base),
        "d_plain": yard.plain(H - base),
        "family": family,
        "kind": setup.system.kind,
        "dofs": setup.system.n,
        "shape": list(H.shape),
        "form": setup.form,
        "level": [None if np.isnan(v) else float(v) for v in setup.level],
        "noise": {"kind": noise, "level": level, "variance": variance},
        "frequency_std": claims[0],
        "damping_std": claims[1],
        "separable": _separable(setup, causes),
        "remarks": remarks,
    }
    if rivals and len(effects) == 1:
        truth |= _naming(setup, yard, H - base, truth)
    return Case(measurement, simulated(setup, model, *claims), truth, H, sigma, setup)


def _described(setup, base, yard, effect: Effect, size: float, got: float) -> dict[str, Any]:
    parameters = {k: {"value": float(v), "unit": u} for k, (v, u) in effect.params(size).items()}
    return {"name": effect.slug, "where": effect.where, "parameters": parameters, "d": got, "variant": effect.variant}


def _naming(setup, yard, change, truth) -> dict[str, Any]:
    """The five strongest look-alikes of other names, and the chance that a perfect namer is right."""
    own = {truth["cause"], "channel_gain" if truth["cause"] == "channel_sign" else ""}
    others = {slug: share for slug, share in shares(setup, yard, change).items() if slug not in own}
    leading = dict(sorted(others.items(), key=lambda item: -item[1])[:5])
    return {"rivals": leading, "namable": 1 - confusion(truth["d"], max(leading.values()))}


def _separable(setup: Setup, causes: tuple[str, ...]) -> bool:
    """Whether the data that tells the causes from their look-alikes is there at all: levels, columns, repeats."""
    levels = len(np.unique(setup.level))
    for cause in causes:
        if cause in NEEDS_LEVELS and levels < 3:
            return False
        if cause == "gyroscopic" and len(setup.inputs) < 2:
            return False
        if cause == "time_varying" and levels == len(setup.level) > 1:
            return False
        if cause == "bilinear_stiffness":
            return False
    return True


def _reachable(streams, family, causes, target, noise, level, claims, form, inputs, runs):
    """Draw places (then quieter noise, then another structure) until every effect can reach its size."""
    place, build, floor = streams
    for _ in range(6):
        setup = draw_setup(build, family, causes, form=form, inputs=inputs, runs=runs)
        base = evaluate(setup, [])[0]
        unit = draw_sigma(setup, floor, noise, 1.0)
        for quiet in (1.0, 1.0, 1.0, 0.5, 0.25, 0.1):
            sigma = np.maximum(unit * level * quiet, 1e-300)
            yard = Yardstick.of(setup, sigma, *claims)
            effects, alone = [], (base, {})
            for cause in causes:
                effect = EFFECTS[cause](setup, place)
                size, got, alone = _size_of(setup, base, yard, effect, target)
                if size is None:
                    break
                effects.append((effect, size, got))
            if len(effects) == len(causes) and _compatible(effects):
                return setup, effects, sigma, yard, base, alone, level * quiet
    raise ValueError(f"no structure found on which {'+'.join(causes)} reaches d = {target:g}")


def _compatible(effects) -> bool:
    slugs = [e.slug for e, _, _ in effects]
    kernels = [e for e, _, _ in effects if e.kernel is not None]
    dynamic = any(e.marched or e.slug == "structural_damping" or e.slug.startswith("outside:") for e, _, _ in effects)
    moving = any(e.notes.get("per_run") for e, _, _ in effects) and any(e.marched for e, _, _ in effects)
    shifted = any(e.shift is not None for e, _, _ in effects) and (kernels or dynamic)
    same = len({(e.slug, tuple(e.where)) for e, _, _ in effects}) < len(slugs)
    if (len(kernels) > 1) or (kernels and dynamic) or moving or shifted:
        raise ValueError(f"{' and '.join(slugs)} cannot be combined exactly in one test; choose other pairs")
    return not same
