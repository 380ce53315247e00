"""A whole case: a structure, what its simulation gets wrong, a test with noise, and the files that say no more."""

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from generator.noise import add_noise, stated_variance
from generator.plant import DERIVATIVES, Plant
from generator.systems import log_uniform

from .balance import joint_change
from .gross import CAUSES, CHANNELS, JOINTS, Gross, Scene, Test, draw_gross
from .judge import Verdict, judge
from .structures import KINDS, SMALL, Build, draw_build
from .world import Off, Spread, World, draw_off, modal_inaccuracy, nominal, realised

SPREADS = (0.0, 0.003, 0.01, 0.03)
CLAIMS = {"none": 0.0, "right": 1.0, "half": 0.5, "double": 2.0}
VARIANCES = ("exact", "6", "missing")
WEIGHTS = {"none": 4, "joint_stiffness": 4, "beam_stiffness": 1, "added_mass": 4, "local_damper": 2}
MOST_LINES = 1500


@dataclass(frozen=True)
class Case:
    """Arrays of both files as they are written, and the truth that only the scoring opens."""

    measurement: dict[str, np.ndarray]
    simulation: dict[str, np.ndarray]
    truth: dict[str, Any]
    H_true: np.ndarray = field(repr=False)
    sigma: np.ndarray = field(repr=False)
    build: Build = field(repr=False)
    design: World = field(repr=False)
    world: World = field(repr=False)
    test: Test = field(repr=False)

    def save(self, folder: Path | str, truth: Path | str) -> None:
        """``measurement.npz`` and ``simulation.npz`` into ``folder``, the truth into the file ``truth``."""
        folder, truth = Path(folder), Path(truth)
        folder.mkdir(parents=True, exist_ok=True)
        truth.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(folder / "measurement.npz", **self.measurement)
        np.savez_compressed(folder / "simulation.npz", **self.simulation)
        truth.write_text(json.dumps(self.truth, indent=1))


@dataclass(frozen=True)
class Plan:
    """What is decided before anything is built; every entry can be given to :func:`draw_case`."""

    cause: str
    kind: str
    spread: float
    claim: str
    claimed: str
    variance: str
    noise: float
    lines: float
    widen: float


def _plan(rng: np.random.Generator, given: dict[str, Any]) -> Plan:
    pick = lambda values: values[int(rng.integers(len(values)))]
    names = [c for c in CAUSES]
    weights = np.array([WEIGHTS.get(c, 1) for c in names], float)
    drawn = {
        "cause": names[int(rng.choice(len(names), p=weights / weights.sum()))],
        "kind": pick(KINDS),
        "spread": pick(SPREADS),
        "claim": pick(("none", "none", "right", "right", "half", "double")),
        "claimed": pick(("matrices", "modes")),
        "variance": pick(("exact", "exact", "6", "6", "missing")),
        "noise": float(log_uniform(rng, 0.005, 0.02)),
        "lines": float(log_uniform(rng, 2.0, 20.0)),
        "widen": float(rng.choice([1.0, 1.0, 1.25, 1.5, 2.0])),
    }
    plan = Plan(**{**drawn, **{k: v for k, v in given.items() if v is not None}})
    for name, allowed in (("cause", CAUSES), ("kind", (*KINDS, SMALL)), ("claim", CLAIMS), ("variance", VARIANCES)):
        if getattr(plan, name) not in allowed:
            raise ValueError(f"{name} is {getattr(plan, name)!r}; it must be one of {', '.join(allowed)}")
    if plan.cause in JOINTS:
        plan = replace(plan, lines=min(plan.lines, 8.0))
    return plan


def base_band(build: Build, design: World, rng: np.random.Generator) -> tuple[float, float]:
    """From half the first elastic frequency to between two modes, some 4 to 10 modes up."""
    elastic = design.frequencies[build.rigid :]
    count = int(rng.integers(4, 11))
    wide = int(np.sum(elastic < 12 * elastic[0]))
    count = max(3, min(count, wide, len(elastic) - 2))
    low = float(rng.uniform(0.5, 0.75)) * elastic[0]
    return low, float(min(0.5 * (elastic[count - 1] + elastic[count]), 1.15 * elastic[count - 1]))


def draw_lines(world: World, band: tuple[float, float], lines: float) -> np.ndarray:
    """Equispaced lines, ``lines`` to a half-power bandwidth of the median mode.

    Where these were more than can be carried they gather at the peaks, as in a stepped sine test: so many to every
    mode's bandwidth within two to four bandwidths, over a coarse grid.
    """
    low, high = band
    freq = world.frequencies
    at = (freq > low) & (freq < high)
    width = 2 * world.zeta[at] * freq[at]
    step = float(np.median(width)) / lines
    count = int((high - low) / step) + 1
    if count <= MOST_LINES:
        return (np.ceil(low / step) + np.arange(max(count, 60))) * step
    reach = float(np.clip(MOST_LINES / (2 * lines * at.sum()), 1.5, 4.0))
    near = [f + np.arange(-reach * lines, reach * lines + 1) * w / lines for f, w in zip(freq[at], width, strict=True)]
    every = np.unique(np.round(np.concatenate([np.linspace(low, high, 200), *near]), 6))
    return every[(every >= low) & (every <= high)]


def _channels(build: Build, design: World, rng, inside: np.ndarray) -> tuple[list[int], list[int]]:
    places = np.array(build.deflections)
    lively = np.sqrt((design.shapes[places][:, inside] ** 2 / (design.shapes[:, inside] ** 2).max(axis=0)).sum(axis=1))
    inputs = rng.choice(places, int(rng.integers(1, 4)), replace=False, p=lively / lively.sum()).tolist()
    count = int(rng.integers(6, min(20, len(places)) + 1))
    outputs = rng.choice(places, count, replace=False).tolist()
    if rng.random() < 0.85:
        outputs = [*inputs, *(o for o in outputs if o not in inputs)][:count]
    return sorted(int(o) for o in outputs), [int(i) for i in inputs]


def linear_frf(world: World, test: Test) -> np.ndarray:
    """FRF (f, o, i) in the test's form, solved line by line."""
    eye = np.eye(len(world.M))
    H = Plant(world.M, world.C, world.K).receptance(1j * test.omega, eye[test.outputs], eye[test.inputs])
    return H * (1j * test.omega[:, None, None]) ** DERIVATIVES[test.form]


def answer(world: World, test: Test, gross: Gross | None) -> tuple[np.ndarray, float]:
    """FRF (run, f, o, i) without noise, and the share of lines on which a joint has not settled."""
    H, lost = np.repeat(linear_frf(world, test)[None], len(test.level), axis=0), 0.0
    if gross is not None and gross.law is not None:
        change, lost = joint_change(
            Plant(world.M, world.C, world.K), gross.b, gross.law, test.freq, test.outputs, test.inputs, test.level
        )
        H = H + change * (1j * test.omega[:, None, None]) ** DERIVATIVES[test.form]
    if gross is not None and gross.channel is not None:
        H = gross.channel(H)
    return H, lost


def noise_floor(H: np.ndarray, level: float, rng: np.random.Generator) -> np.ndarray:
    """Standard deviation of every sample: a share of the channel's rms, or of its magnitude with a floor."""
    rms = np.sqrt((np.abs(H) ** 2).mean(axis=(0, 1), keepdims=True))
    rms = np.sqrt(rms**2 + 0.02**2 * (rms**2).mean())
    if rng.random() < 0.5:
        return np.broadcast_to(level * rms, H.shape).copy()
    return level * np.sqrt(np.abs(H) ** 2 + (0.05 * rms) ** 2)


def simulation_file(build: Build, design: World, plan: Plan, spread: Spread, inaccuracy, rng) -> dict[str, np.ndarray]:
    """The nominal matrices with what their author claims, and where elements may sit in half of the files."""
    arrays = {"M": design.M, "C": design.C, "K": design.K, "dofs": np.array(build.dofs)}
    claimed = spread.scaled(CLAIMS[plan.claim])
    if claimed.stiffness and plan.claimed == "matrices":
        arrays |= {"stiffness_std": np.array(claimed.stiffness), "mass_std": np.array(claimed.mass)}
    if claimed.stiffness and plan.claimed == "modes":
        expected = np.hypot(inaccuracy["stiffness"]["expected"], inaccuracy["mass"]["expected"]) / 2
        arrays["frequency_std"] = np.array(CLAIMS[plan.claim] * expected)
    if claimed.damping:
        arrays["damping_std"] = np.array(claimed.damping)
    if rng.random() < 0.5 or build.kind == "plate":
        pairs = {e.where for e in build.elements if e.kind == "spring" and len(e.where) == 2}
        for e in build.elements:
            if e.kind == "beam" and len(e.where) in (2, 4):
                half = len(e.where) // 2
                pairs |= set(zip(e.where[:half], e.where[half:], strict=True))
        arrays["pairs"] = np.array([[build.dofs[a], build.dofs[b]] for a, b in sorted(pairs)])
    return arrays


def draw_case(
    seed: int,
    cause: str | None = None,
    *,
    kind: str | None = None,
    structure: int | None = None,
    spread: float | None = None,
    claim: str | None = None,
    claimed: str | None = None,
    variance: str | None = None,
    noise: float | None = None,
    lines: float | None = None,
    widen: float | None = None,
    damping_follows: bool = False,
) -> Case:
    """A case by seed; what is not given is drawn.

    ``cause``: one of :data:`CAUSES`; ``kind``: frame, plate or shaft; ``structure``: a seed of its own for the
    structure; ``spread``: relative standard deviation of every element's stiffness; ``claim``: none, right, half,
    double, by ``claimed`` matrices or modes; ``variance``: exact, 6 (repeats) or missing; ``noise``: share of the
    signal; ``lines``: to a half-power bandwidth; ``widen``: how many times the identified band is measured;
    ``damping_follows``: modes keep their damping ratios where stiffness or mass is grossly wrong, so that the damping
    matrix changes with it. The same seed with other ``lines`` and ``widen`` is the same structure, error and sensors,
    measured otherwise.

    Raises
    ------
    ValueError
        If a name is not known.
    """
    streams = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(7)]
    ask, wrong, bulk, where, floor, error, told = streams
    asked = {
        "cause": cause, "kind": kind, "spread": spread, "claim": claim, "claimed": claimed, "variance": variance,
        "noise": noise, "lines": lines, "widen": widen,
    }  # fmt: skip
    plan = _plan(ask, asked)
    shape = np.random.default_rng([seed if structure is None else structure, 41])
    build = draw_build(shape, plan.kind)
    design = nominal(build, shape)
    damping = float(bulk.uniform(0.1, 0.4))
    spread_of = Spread(plan.spread, plan.spread / 3, damping if plan.spread else 0.0)
    off = draw_off(build, bulk, spread_of)
    low, high = base_band(build, design, where)
    inside = (design.frequencies > low) & (design.frequencies < high)
    outputs, inputs = _channels(build, design, where, inside)
    form = str(where.choice(["accelerance", "accelerance", "mobility", "receptance"]))
    runs = 3 if plan.cause in JOINTS else int(where.choice([1, 1, 3]))
    level = 2.0 * 2.5 ** np.arange(runs) if runs > 1 or where.random() < 0.5 else np.array([np.nan])
    freq = draw_lines(realised(build, design, off), (low, high * plan.widen), plan.lines)
    test = Test(freq, form, outputs, inputs, level)
    same = replace(test, freq=draw_lines(realised(build, design, off), (low, high), 6.0))
    general = build, design, off
    gross, world, general, H, lost = _with_gross(*general, test, same, inside, plan.cause, wrong, damping_follows)
    sigma = noise_floor(H, plan.noise, floor)
    values, averages = stated_variance(floor, sigma, plan.variance)
    names = np.array(build.dofs)
    measurement = {
        "freq": freq, "H": add_noise(error, H, sigma), "level": level, "outputs": names[outputs],
        "inputs": names[inputs], "form": np.array(form),
    }  # fmt: skip
    measurement |= {} if values is None else {"variance": values}
    measurement |= {} if averages is None else {"averages": np.array(averages)}
    inaccuracy = modal_inaccuracy(build, design, general, spread_of, inside)
    said: Verdict = judge(build, world, general, test, sigma, spread_of, gross, H)
    truth = {
        "seed": seed, "structure": structure, **vars(plan), "variant": build.variant, "dofs": build.n,
        "causes": [] if gross is None else [gross.described()], "inaccuracy": inaccuracy,
        "modes_inside": int(inside.sum()), "band": [low, high], "shape": list(H.shape), "form": form,
        "unsettled": lost, **said.described(),
    }  # fmt: skip
    truth |= {"damping_follows": True} if damping_follows else {}
    simulation = simulation_file(build, design, plan, spread_of, inaccuracy, told)
    return Case(measurement, simulation, truth, H, sigma, build, design, world, test)


def _with_gross(build: Build, design: World, off: Off, test: Test, same: Test, inside, cause: str, rng, follows: bool):
    """The gross error, the structure with and without it, and its FRF; another place where a joint has no one answer.

    The element that is grossly wrong is off by the gross error alone.
    """
    general = realised(build, design, off)
    for _ in range(20):
        gross = draw_gross(Scene(build, general, test, inside, same), rng, cause)
        bare = general
        if gross is not None and gross.element is not None:
            kept = off.stiffness.copy()
            kept[gross.element] = 0.0
            bare = realised(build, design, replace(off, stiffness=kept))
        world = bare if gross is None else bare.changed(gross.M, gross.C, gross.K)
        undamped = gross is not None and not np.any(gross.C) and (np.any(gross.M) or np.any(gross.K))
        if undamped and follows:
            world = bare.at_equal_ratios(gross.M, gross.K)
        H, lost = answer(world, test, gross)
        if lost == 0:
            return gross, world, bare, H, lost
    raise ValueError(f"no place found where {cause} has one answer at every line")


__all__ = ["CAUSES", "CHANNELS", "Case", "draw_case"]
