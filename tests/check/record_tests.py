"""Time records of hammer hits on ``other_structures``, sound or with one fault of known size."""

import numpy as np
from other_structures import draw_structure, log_uniform

FAULTS = (
    "double_hit", "short_pulse", "record_too_short", "clipped", "dead", "duplicated", "drift", "hum", "frequency_shift",
    "delay",
)  # fmt: skip


def swing(structure, time: np.ndarray, o: list[int], i: int) -> np.ndarray:
    """Acceleration ``(o, t)`` times seconds after an impulse of 1 N s, without the jump of the impulse itself."""
    A = structure.residues(o, [i])[:, :, 0] * structure.poles[:, None] ** 2
    return 2 * np.real(np.einsum("rt,ro->ot", np.exp(structure.poles[:, None] * time), A))


def draw_hits(seed: int, fault: str | None = None, draw=draw_structure) -> tuple[dict, dict]:
    """Arguments of ``Records`` and the truth."""
    rng = np.random.default_rng([seed, *(fault or "").encode()])
    structure = draw(rng, int(rng.integers(3, 8)))
    f, decay = np.abs(structure.poles) / 2 / np.pi, -structure.poles.real
    top = np.sort(f)[min(5, len(f) - 1)]
    keep = f < 1.2 * top
    structure = type(structure)(structure.poles[keep], structure.shapes[:][keep], structure.rigid, structure.names)
    fs = float(2.56 * 1.3 * top)
    slowest = float(np.min(decay[keep]))
    left = rng.uniform(0.15, 0.5) if fault == "record_too_short" else rng.uniform(1e-4, 5e-3)
    samples = int(np.clip(-np.log(left) / slowest * fs, 512, 16384))
    if samples == 16384 and fault is None or fault == "record_too_short" and samples == 512:
        return draw_hits(seed + 10**7, fault, draw)
    o, i = list(range(len(structure.names))), int(rng.integers(len(structure.names)))
    count, before, pulse = int(rng.integers(3, 7)), int(0.01 * samples) + 20, 1 if fault == "short_pulse" else 4
    time = np.arange(samples) / fs
    force = np.zeros((count, samples))
    height = rng.uniform(50, 150, (count, 1))
    force[:, before : before + pulse] = height * np.sin(np.pi * np.arange(1, pulse + 1) / (pulse + 1))
    size = None
    if fault == "double_hit":
        gap, size = int(rng.integers(25, 90)), log_uniform(rng, 0.08, 0.7)
        force[int(rng.integers(count)), before + gap : before + gap + pulse] = size * height.max() * 0.6
        size = gap / fs
    shapes = np.real(structure.shapes)
    jump = np.einsum("ro,r->o", shapes, shapes[:, i])
    H = np.fft.rfft(swing(structure, time, o, i) / fs, 2 * samples) + jump[:, None]
    spectrum = np.fft.rfft(force, 2 * samples)
    x = np.fft.irfft(spectrum[:, None] * H[None])[..., :samples].transpose(0, 2, 1)
    if fault == "frequency_shift":
        size = log_uniform(rng, 1e-3, 1e-2)
        moved = swing(structure.changed(structure.poles * (1 - size)), time, o, i) / fs
        k = int(rng.integers(count))
        other = np.fft.irfft(spectrum[k] * (np.fft.rfft(moved, 2 * samples) + jump[:, None]))[:, :samples]
        x[k] = other.T
        size = 100 * size
    x = x + log_uniform(rng, 0.001, 0.02) * x.std(axis=(0, 1)) * rng.normal(size=x.shape)
    force = force + 1e-3 * force.max() * rng.normal(size=force.shape)
    where, k = [], int(rng.integers(len(o)))
    own = x[:, :, k].copy()
    if fault in ("clipped", "dead", "duplicated", "drift", "hum", "delay"):
        where = [structure.names[k]]
        other = x[:, :, (k + 1) % len(o)]
        tone = np.sin(2 * np.pi * 50 * (time + rng.random((count, 1))))
        x[:, :, k] = {
            "clipped": np.clip(own, -0.6 * np.abs(own).max(), 0.6 * np.abs(own).max()), "dead": 0 * own,
            "duplicated": other, "hum": own + log_uniform(rng, 0.1, 1.0) * own.std() * tone,
            "drift": own + rng.uniform(0.5, 2) * own.std() * np.linspace(-1, 1, samples),
            "delay": np.roll(own, 1, axis=1),
        }[fault]  # fmt: skip
        size = 1 / fs if fault == "delay" else None
    elif fault in ("double_hit", "short_pulse"):
        where = [structure.names[i]]
    arguments = dict(force=force, response=x, fs=fs, outputs=structure.names, input=structure.names[i])
    return arguments, {"what": fault, "where": where, "size": size}
