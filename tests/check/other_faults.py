"""Faults of known size for ``other_tests``: each takes a test without noise; None where it cannot have the fault."""

from dataclasses import replace

import numpy as np
from other_structures import draw_structure, log_uniform
from other_tests import STEPS, Made, draw_made, finished


def reversed_(rng, made: Made):
    if not made.driven:
        return None
    o, i = made.driven[int(rng.integers(len(made.driven)))]
    H = made.H.copy()
    if len(made.driven) > 1 and rng.random() < 0.3:
        H[..., i] *= -1
        return made.having("reversed", [made.inputs[i]], -1.0, H=H)
    H[:, :, o] *= -1
    return made.having("reversed", [made.outputs[o]], -1.0, H=H)


def swapped(rng, made: Made):
    if not made.driven or len(made.o) < 2:
        return None
    a, column = made.driven[int(rng.integers(len(made.driven)))]
    b = int(rng.choice([k for k in range(len(made.o)) if k != a]))
    A = made.structure.residues(made.o, made.i)[made.inside]
    peak = np.abs(A[:, [a, b]][:, :, column]) / -made.structure.poles[made.inside].real[:, None]
    against = (1j * A[:, b, column]).real < 0
    if not np.any(against & (peak[:, 1] > 0.2 * peak[:, 0].max())):
        return None  # In phase in every mode of the band: nothing can tell.
    H = made.H.copy()
    H[:, :, [a, b]] = H[:, :, [b, a]]
    return made.having("swapped", [made.outputs[a], made.outputs[b]], H=H)


def dead(rng, made: Made):
    if len(made.o) < 2:
        return None
    o = int(rng.integers(len(made.o)))
    H, sigma = made.H.copy(), made.sigma.copy()
    H[:, :, o] = 0
    sigma[:, :, o] *= 0 if rng.random() < 0.4 else 1
    return made.having("dead", [made.outputs[o]], H=H, sigma=sigma)


def conjugated(rng, made: Made):
    return made.having("conjugated", H=made.H.conj())


def wrong_form(rng, made: Made):
    wrong = str(rng.choice([f for f in STEPS if f != made.form]))
    steps = STEPS[made.form] - STEPS[wrong]
    if abs(steps) == 2 and (not made.driven or made.freq[0] > 0.4 * np.abs(made.structure.poles).min() / 2 / np.pi):
        return None
    return made.having("wrong_form", [], float(steps), form=wrong)


def delay(rng, made: Made):
    if len(made.inside) < 4:
        return None
    angle = np.radians(log_uniform(rng, 3, 90))
    tau = angle / (2 * np.pi * made.freq[-1]) * rng.choice([-1, 1])
    turn = np.exp(-2j * np.pi * made.freq * tau)[:, None, None]
    H = made.H.copy()
    if rng.random() < 0.3 or len(made.o) < 3:
        return made.having("delay", [], tau, H=H * turn)
    o = int(rng.integers(len(made.o)))
    H[:, :, o : o + 1] *= turn
    return made.having("delay", [made.outputs[o]], tau, H=H)


def calibration(rng, made: Made):
    if len(made.driven) < 2:
        return None
    o, i = made.driven[int(rng.integers(len(made.driven)))]
    gain = log_uniform(rng, 1.05, 2.0) ** rng.choice([-1, 1])
    H = made.H.copy()
    if rng.random() < 0.5:
        H[:, :, o] *= gain
        size = gain
    else:
        H[..., i] *= gain
        size = 1 / gain
    return made.having("calibration", [made.outputs[o]], float(size), H=H)


def not_reciprocal(rng, made: Made):
    if len(made.driven) < 2 or len(made.inside) < 2:
        return None
    (a, i), (b, j) = (made.driven[k] for k in rng.choice(len(made.driven), 2, replace=False))
    peak = np.abs(made.structure.residues(made.o, made.i)[:, a, j]) / -made.structure.poles.real
    first, second = made.inside[np.argsort(-peak[made.inside])[:2]]
    if peak[second] < 0.3 * peak[first]:
        return None
    times = np.ones(len(peak))
    times[first], times[second] = 1 + (turn := log_uniform(rng, 0.1, 0.5)), 1 - turn
    shapes = made.structure.shapes * np.sqrt(times)[:, None]
    other = replace(made.structure, shapes=shapes).receptance(made.freq, made.o, made.i)
    H = made.H.copy()
    H[:, :, a, j] = made.as_form(other)[None, :, a, j]
    return made.having("not_reciprocal", [made.outputs[a], made.outputs[b]], H=H)


def frequency_shift(rng, made: Made):
    """A column, a run: all modes lower, or each a little differently."""
    runs, ins = len(made.H), len(made.i)
    if not len(made.inside) or (runs < 2 and ins < 2):
        return None
    size = log_uniform(rng, 3e-4, 1e-2)
    each = (
        np.full(len(made.structure.poles), 1.0)
        if rng.random() < 0.5
        else rng.uniform(0.3, 1.0, len(made.structure.poles))
    )
    poles = made.structure.poles * (1 - size * each)
    moved = made.as_form(made.structure.changed(poles).receptance(made.freq, made.o, made.i))
    H, where = made.H.copy(), []
    if runs > 1 and (ins < 2 or rng.random() < 0.5):
        H[int(rng.integers(runs))] = moved
    else:
        i = int(rng.integers(ins))
        H[..., i] = moved[None, ..., i]
        where = [made.inputs[i]]
    made = made.having("frequency_shift", where, size, H=H)
    made.truth["sizes"] = (size * each)[made.inside].tolist()
    return made


def hum(rng, made: Made):
    mains = float(rng.choice([50.0, 60.0]))
    step = np.median(np.diff(made.freq))
    lines = [m for m in mains * np.arange(1, 6) if made.freq[0] + 15 * step < m < made.freq[-1] - 15 * step]
    if not lines or step > 3 or np.ptp(np.diff(made.freq)) > 1e-6 * step:
        return None
    H = made.H.copy()
    for k, m in enumerate(lines):
        at = int(np.argmin(np.abs(made.freq - m * (1 + 2e-4 * rng.normal()))))
        local = np.abs(H[:, max(0, at - 10) : at + 11]).mean(axis=1)
        phase = np.exp(2j * np.pi * rng.random(local.shape))
        size = np.maximum(log_uniform(rng, 0.1, 2.0) / (1 + k) * local, 3 * made.sigma[:, at])
        H[:, at] += size * phase
    return made.having("hum", H=H)


def too_few_lines(rng, made: Made):
    f = np.abs(made.structure.poles[made.inside]) / 2 / np.pi
    if not len(f):
        return None
    width = np.median(-made.structure.poles[made.inside].real / np.pi)
    lines = log_uniform(rng, 0.3, 0.8)
    freq = np.arange(made.freq[0], made.freq[-1], width / lines)
    if len(freq) < 40:
        return None
    H = made.structure.receptance(freq, made.o, made.i)
    H = H * (2j * np.pi * freq[:, None, None]) ** STEPS[made.form]
    nearest = np.searchsorted(made.freq, freq).clip(0, len(made.freq) - 1)
    return made.having(
        "too_few_lines", [], lines, freq=freq, H=np.broadcast_to(H, (len(made.H), *H.shape)).copy(),
        sigma=made.sigma[:, nearest],
    )  # fmt: skip


def _louder(made: Made, times: np.ndarray, i: int, what: str, size: float):
    sigma = made.sigma.copy()
    sigma[..., i] *= times[None, :, None]
    return made.having(what, [made.inputs[i]], size, sigma=sigma)


def double_hit(rng, made: Made):
    freq, i = made.freq, int(rng.integers(len(made.i)))
    if len(freq) < 200 or made.told == "nothing" or np.ptp(np.diff(freq)) > 1e-6 * freq[0]:
        return None
    tau = rng.uniform(6, min(50, len(freq) / 10)) / (freq[-1] - freq[0])
    force = np.abs(1 + rng.uniform(0.25, 0.9) * np.exp(-2j * np.pi * freq * tau))
    return _louder(made, 1 / force, i, "double_hit", tau)


def force_rolloff(rng, made: Made):
    freq, i = made.freq, int(rng.integers(len(made.i)))
    if len(freq) < 200:
        return None
    x = (freq - freq[0]) / (freq[-1] - freq[0])
    begin = rng.uniform(0.3, 0.6)
    fall = 10 ** (rng.uniform(50, 90) / 20 * np.clip((x - begin) / (1 - begin), 0, None))
    return _louder(made, fall, i, "force_rolloff", float(freq[0] + begin * (freq[-1] - freq[0])))


def drift(rng, made: Made):
    freq, H = made.freq, made.H.copy()
    f = np.abs(made.structure.poles).min() / 2 / np.pi
    if np.sum(freq < 0.5 * f) < 20 or freq[0] > 0.05 * f:
        return None
    o = int(rng.integers(len(made.o)))
    shape = (6 * freq[0] / freq) ** (rng.uniform(1, 2) + 2 - STEPS[made.form])
    at = int(np.searchsorted(freq, 6 * freq[0]))
    size = log_uniform(rng, 1, 10) * np.maximum(np.abs(H[:, at, o]), 3 * made.sigma[:, at, o])
    phase = np.exp(2j * np.pi * rng.random(H[:, :, o].shape if rng.random() < 0.5 else (1, 1, 1)))
    H[:, :, o] += size[:, None] * shape[None, :, None] * phase
    return made.having("drift", [made.outputs[o]], H=H)


def clipped(rng, made: Made):
    runs = max(2, len(made.H))
    if len(made.o) < 2:
        return None
    level = 2.0 ** np.arange(runs) * log_uniform(rng, 0.5, 10)
    H = np.broadcast_to(made.H[0], (runs, *made.H.shape[1:])).copy()
    sigma = np.broadcast_to(made.sigma[0], H.shape).copy()
    o = int(rng.integers(len(made.o)))
    size = np.abs(H[:, :, o]) * level[:, None, None]
    over = np.maximum(size / (rng.uniform(0.4, 0.8) * size[-1].max()), 1.0)
    gain = 2 / np.pi * (np.arcsin(1 / over) + np.sqrt(np.maximum(1 - 1 / over**2, 0)) / over)
    H[:, :, o] *= gain
    return made.having("clipped", [made.outputs[o]], float(1 - gain[-1].min()), H=H, sigma=sigma, level=level)


def duplicated(rng, made: Made):
    return made.having("duplicated") if len(made.o) > 1 else None


FAULTS = {
    "reversed": reversed_, "swapped": swapped, "dead": dead, "duplicated": duplicated, "conjugated": conjugated,
    "wrong_form": wrong_form, "delay": delay, "calibration": calibration, "not_reciprocal": not_reciprocal,
    "frequency_shift": frequency_shift, "hum": hum, "too_few_lines": too_few_lines, "double_hit": double_hit,
    "force_rolloff": force_rolloff, "drift": drift, "clipped": clipped,
}  # fmt: skip


def draw_other(seed: int, fault: str | None = None, structure=None) -> tuple[dict, dict, Made]:
    """Arrays of a file, the truth, and the test without noise; of structures that a function may draw."""
    for attempt in range(300):
        rng = np.random.default_rng([seed, attempt, *(fault or "").encode()])
        made = draw_made(rng, True if fault in ("hum", "double_hit") else None, structure or draw_structure)
        made = made if fault is None else FAULTS[fault](rng, made)
        if made is None:
            continue
        arrays = finished(rng, made)
        truth = dict(made.truth)
        if fault == "duplicated":
            a, b = (int(k) for k in rng.choice(len(made.o), 2, replace=False))
            arrays["H"][:, :, b] = arrays["H"][:, :, a] * (gain := rng.choice([1.0, -1.0, 0.5]))
            truth.update(where=[made.outputs[a], made.outputs[b]], size=float(gain))
        return arrays, truth, made
    raise RuntimeError(f"no test can have {fault}")
