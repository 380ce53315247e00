"""Virtual tests of ``other_structures`` with faults of known size, the smallest just large enough to matter."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from other_structures import Modal, draw_structure, log_uniform

STEPS = {"receptance": 0, "mobility": 1, "accelerance": 2}
MOST = 2000  # lines


@dataclass(frozen=True)
class Made:
    """FRFs without noise, their noise, and what is said of them; ``truth`` holds word, place and size."""

    freq: np.ndarray
    H: np.ndarray
    sigma: np.ndarray
    form: str
    level: np.ndarray
    structure: Modal
    o: list[int]
    i: list[int]
    told: str
    truth: dict[str, Any] = field(default_factory=dict)

    @property
    def outputs(self) -> list[str]:
        return [self.structure.names[d] for d in self.o]

    @property
    def inputs(self) -> list[str]:
        return [self.structure.names[d] for d in self.i]

    @property
    def driven(self) -> list[tuple[int, int]]:
        return [(a, b) for a, x in enumerate(self.o) for b, y in enumerate(self.i) if x == y]

    @property
    def inside(self) -> np.ndarray:
        f = np.abs(self.structure.poles) / 2 / np.pi
        return np.flatnonzero((f > self.freq[0]) & (f < self.freq[-1]))

    def as_form(self, H: np.ndarray) -> np.ndarray:
        return H * (2j * np.pi * self.freq[:, None, None]) ** STEPS[self.form]

    def having(self, what: str, where=(), size=None, **changes) -> "Made":
        return replace(self, truth={"what": what, "where": list(where), "size": size}, **changes)


def layout_of(rng, count: int) -> tuple[list[int], list[int]]:
    kind = rng.integers(6)
    every = list(range(count))
    if kind == 0:  # a shaker
        return every, [int(rng.integers(count))]
    if kind == 1:  # a shaker at a place of its own
        i = int(rng.integers(count))
        return [d for d in every if d != i], [i]
    if kind == 2:  # a roving hammer
        return sorted(rng.choice(count, min(count, int(rng.integers(1, 4))), replace=False).tolist()), every
    if kind == 3:
        return every, sorted(rng.choice(count, min(count, int(rng.integers(2, 4))), replace=False).tolist())
    if kind == 4:
        few = every[: int(rng.integers(2, 6))]
        return few, list(few)
    i = rng.choice(count, 2, replace=False).tolist()
    return [d for d in every if d != i[1]], i


def axis_of(rng, structure: Modal, even: bool | None = None) -> np.ndarray:
    """Lines: evenly spaced from near 0 Hz or from within, closer at the resonances, or in proportion to frequency."""
    f, width = np.abs(structure.poles) / 2 / np.pi, -structure.poles.real / np.pi
    order = np.argsort(f)
    f, width = f[order], width[order]
    lowest = int(rng.integers(0, 3)) if rng.random() < 0.3 and len(f) > 6 else 0
    top = min(lowest + int(rng.integers(2, 8)), len(f) - 1)
    low = f[lowest] * rng.uniform(0.3, 0.9) if lowest == 0 else 0.5 * (f[lowest - 1] + f[lowest])
    # Not so far up that more lines than MOST would be needed.
    while top > lowest + 1 and f[top] > MOST / 5 * np.min(width[lowest:top]):
        top -= 1
    high = min(0.5 * (f[top] + f[top - 1]), 1.4 * f[top - 1]) if top > lowest + 1 else 1.2 * f[lowest]
    narrow = np.min(width[lowest:top])
    per = log_uniform(rng, 4, 15)
    style = 0 if even else rng.integers(4)
    if style < 2:
        step = min(max(narrow / per, high / MOST), (high - low) / 150)
        first = 1 if rng.random() < 0.4 and lowest == 0 else max(1, int(low / step))
        return step * np.arange(first, int(high / step) + 1)
    count = per * np.log(high / low) * np.max(f[lowest:top] / width[lowest:top])
    if style == 2 and count < MOST:
        return np.geomspace(low, high, int(max(200, count)))
    coarse = np.linspace(low, high, 200)
    fine = [fr + w * np.linspace(-4, 4, int(8 * per)) for fr, w in zip(f[lowest:top], width[lowest:top], strict=True)]
    every = np.unique(np.concatenate([coarse, *fine]))
    every = every[(every > low) & (every < high)]
    return every[np.concatenate([[True], np.diff(every) > 1e-4 * narrow])]


def draw_made(rng, even: bool | None = None, draw=draw_structure) -> Made:
    structure = draw(rng, int(rng.integers(2, 12)))
    count = len(structure.names)
    freq = axis_of(rng, structure, even)
    o, i = layout_of(rng, count)
    form = str(rng.choice(list(STEPS)))
    runs = int(rng.choice([1, 1, 1, 2, 4]))
    H = structure.receptance(freq, o, i) * (2j * np.pi * freq[:, None, None]) ** STEPS[form]
    H = np.broadcast_to(H, (runs, *H.shape)).copy()
    level = log_uniform(rng, 0.001, 0.05)
    accelerance = np.abs(H) * (2 * np.pi * freq[:, None, None]) ** (2 - STEPS[form])
    kind = rng.integers(3)
    if kind == 0:  # an accelerometer's floor
        floor = level * np.sqrt(np.mean(accelerance**2, axis=(0, 1)))
        sigma = floor * (2 * np.pi * freq[:, None, None]) ** (STEPS[form] - 2) * np.ones(H.shape)
    elif kind == 1:
        sigma = level * np.sqrt(np.mean(np.abs(H) ** 2)) * np.ones(H.shape)
    else:
        sigma = level * np.abs(H) + 0.02 * level * np.sqrt(np.mean(np.abs(H) ** 2))
    force = np.full(runs, np.nan) if rng.random() < 0.6 else np.full(runs, log_uniform(rng, 0.5, 50))
    told = str(rng.choice(["nothing", "nothing", "exact", "repeats"]))
    return Made(freq, H, sigma, form, force, structure, o, i, told)


def finished(rng, made: Made) -> dict[str, Any]:
    """Noise on top, and the arrays of the file."""
    H, sigma = made.H, made.sigma
    e = (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)) / np.sqrt(2)
    arrays = {
        "freq": made.freq, "H": H + sigma * e, "form": made.form, "level": made.level,
        "outputs": made.outputs, "inputs": made.inputs,
    }  # fmt: skip
    if made.told == "exact":
        arrays["variance"] = sigma**2
    elif made.told == "repeats":
        n = int(rng.choice([3, 5, 10]))
        arrays["variance"] = sigma**2 * rng.chisquare(2 * (n - 1), H.shape) / (2 * (n - 1))
        arrays["averages"] = n
    return arrays
