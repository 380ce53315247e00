"""Hidden faults of the measurement: sensors, windows, records, sweeps, hum and force.

Gain, sign, swap, delay and integration act on a channel's spectrum as exact factors, so the time records are not made.
The exponential window is the exact shift s -> s + sigma of the whole transfer function (the force of an impact falls
at t = 0, where the window is 1). Finite records and sweeps use the exact mean of the estimator, derived from the
weight that the processing puts on the impulse response (``plant.py``); the tests compare it with time records.
"""

import numpy as np

from .effect import Effect, Setup
from .plant import boxcar_kernel, hann_kernel, sweep_kernel, truncated_kernel
from .systems import log_uniform


def _output(setup: Setup, rng) -> tuple[int, str]:
    o = int(rng.integers(len(setup.outputs)))
    return o, setup.system.dofs[setup.outputs[o]]


def scale_rows(which, factor):
    """A post hook that multiplies output rows by ``factor(setup, size)``, shape () or (f,)."""

    def post(H, setup, size, plants):
        H = H.copy()
        value = np.asarray(factor(setup, size))
        H[:, :, which] *= value[..., None, None] if value.ndim else value
        return H

    return post


def channel_gain(setup: Setup, rng) -> Effect:
    o, name = _output(setup, rng)
    sign = 1.0 if rng.random() < 0.5 else -1.0
    change = lambda s: s if sign > 0 else -s / (1 + s)
    return Effect(
        "channel_gain", [name], 1e-4, 10.0, lambda s: {"gain": (change(s), "-")},
        post=scale_rows([o], lambda setup, s: 1 + change(s)),
    )  # fmt: skip


def channel_sign(setup: Setup, rng) -> Effect:
    o, name = _output(setup, rng)
    return Effect("channel_sign", [name], 1, 1, lambda s: {}, post=scale_rows([o], lambda u, s: -1.0), natural=1.0)


def channel_swap(setup: Setup, rng) -> Effect:
    a, b = sorted(rng.choice(len(setup.outputs), 2, replace=False).tolist())

    def post(H, setup, size, plants):
        H = H.copy()
        H[:, :, [a, b]] = H[:, :, [b, a]]
        return H

    where = [setup.system.dofs[setup.outputs[k]] for k in (a, b)]
    return Effect("channel_swap", where, 1, 1, lambda s: {}, post=post, natural=1.0)


def time_delay(setup: Setup, rng) -> Effect:
    o, name = _output(setup, rng)
    everywhere = rng.random() < 0.35
    which = list(range(len(setup.outputs))) if everywhere else [o]
    sign = 1.0 if rng.random() < 0.8 else -1.0
    unit = 1 / (2 * np.pi * setup.freq[-1])
    return Effect(
        "time_delay", [] if everywhere else [name], 1e-5 * unit, unit, lambda s: {"delay": (sign * s, "s")},
        post=scale_rows(which, lambda setup, s: np.exp(-1j * setup.omega * sign * s)),
        variant="all" if everywhere else "one",
    )  # fmt: skip


def units(setup: Setup, rng) -> Effect:
    power = {"receptance": 1, "accelerance": -1}.get(setup.form, int(rng.choice([-1, 1])))
    return Effect(
        "units", [], 1, 1, lambda s: {"derivatives": (float(power), "-")},
        post=lambda H, setup, s, plants: H * (1j * setup.omega[:, None, None]) ** power, natural=1.0,
    )  # fmt: skip


def exponential_window(setup: Setup, rng) -> Effect:
    """Every mode seems to decay faster by ``size`` [1/s]."""
    return Effect(
        "exponential_window", [], 1e-4, 2 * np.pi * setup.freq[-1], lambda s: {"decay": (s, "1/s")}, shift=lambda s: s
    )


def leakage(setup: Setup, rng) -> Effect:
    """Records of finite length 1/size [s]: Hann or boxcar windows on random force, or an impact cut off."""
    kind = str(rng.choice(["hann", "hann", "hann", "boxcar", "cut impact"]))
    kernel = {"hann": hann_kernel, "boxcar": boxcar_kernel, "cut impact": truncated_kernel}[kind]
    return Effect(
        "leakage", [], 1e-3 * setup.freq[0], 2 * setup.freq[-1], lambda s: {"inverse_record_length": (s, "Hz")},
        kernel=lambda s: lambda x: kernel(x, 1 / s), variant=kind,
    )  # fmt: skip


def fast_sweep(setup: Setup, rng) -> Effect:
    """Linear sweep, up or down, at ``size`` Hz/s, demodulated at its instant frequency."""
    sign = 1.0 if rng.random() < 0.6 else -1.0
    return Effect(
        "fast_sweep", [], 1e-3, 1e4, lambda s: {"sweep_rate": (sign * s, "Hz/s")},
        kernel=lambda s: lambda x: sweep_kernel(x, sign * 2 * np.pi * s), variant="up" if sign > 0 else "down",
    )  # fmt: skip


def hann_line(x: np.ndarray) -> np.ndarray:
    """Line of the DFT of a Hann-windowed unit complex exponential, for a line ``x`` above the tone (1 at x = 0)."""
    box = lambda u: np.sinc(u) * np.exp(-1j * np.pi * u)
    return box(x) - 0.5 * (box(x - 1) + box(x + 1))


def mains_hum(setup: Setup, rng) -> Effect:
    """Pick-up at the mains frequency and its multiples, through a Hann window; random phase in each run and input."""
    df = float(setup.freq[1] - setup.freq[0])
    inside = [m for m in (50.0, 60.0) if setup.freq[0] < m < setup.freq[-1]]
    base = float(rng.choice(inside)) if inside else 50.0
    mains = base * (1 + rng.normal() * 2e-4)
    count = max(1, int(setup.freq[-1] / base))
    weights = np.array([1.0, *(log_uniform(rng, 0.05, 0.6, count - 1) if count > 1 else [])])
    gains = log_uniform(rng, 0.3, 1.5, len(setup.outputs)) * rng.choice([-1, 1], len(setup.outputs))
    shape = (len(setup.level), len(setup.inputs), count)
    phase = rng.uniform(0, 2 * np.pi, shape)
    spread = np.sqrt(np.mean(np.abs(setup.frf(setup.plant)) ** 2))
    reference = np.nanmax(setup.level) if np.isfinite(setup.level).any() else 1.0
    force = np.where(np.isfinite(setup.level), setup.level, reference) / reference

    def post(H, setup, size, plants):
        lines = np.stack([w * hann_line((setup.freq - mains * (k + 1)) / df) for k, w in enumerate(weights)])
        hum = np.einsum("kf,rik->rfi", lines, np.exp(1j * phase)) / force[:, None, None]
        return H + size * spread * gains[None, None, :, None] * hum[:, :, None, :]

    return Effect("mains_hum", [], 1e-4, 1e3, lambda s: {"frequency": (mains, "Hz")}, post=post)


def force_dropout(setup: Setup, rng) -> Effect:
    """A shaker's force falls where the drive point moves easily; noise on its signal then biases H1 low."""
    stinger = float(log_uniform(rng, 3, 30))
    drive = [setup.system.direction(i, -1)[None] for i in setup.inputs]

    def post(H, setup, size, plants):
        H = H.copy()
        for k, plant in enumerate(plants):  # of the structure as it is, whatever else is hidden in it
            for i, e in enumerate(drive):
                mobility = plant.receptance(1j * setup.omega, e, e)[:, 0, 0] * 1j * setup.omega
                lost = np.abs(1 + stinger * mobility / np.abs(mobility).max()) ** 2
                H[k, :, :, i] /= (1 + size * lost)[:, None]
        return H

    return Effect("force_dropout", [], 1e-5, 1e2, lambda s: {"noise_to_force": (s, "-")}, post=post)


def crosstalk(setup: Setup, rng) -> Effect:
    """A share of one channel leaks into another."""
    o, p = (int(k) for k in rng.choice(len(setup.outputs), 2, replace=False))

    def post(H, setup, size, plants):
        H = H.copy()
        H[:, :, o] += size * H[:, :, p]
        return H

    where = [setup.system.dofs[setup.outputs[k]] for k in (o, p)]
    return Effect("crosstalk", where, 1e-4, 10.0, lambda s: {"share": (s, "-")}, post=post)


def force_gain(setup: Setup, rng) -> Effect:
    """A hammer or load cell whose calibration is off, so that one column is scaled."""
    i = int(rng.integers(len(setup.inputs)))
    column = np.where(np.arange(len(setup.inputs)) == i, 1.0, 0.0)
    return Effect(
        "force_gain", [setup.system.dofs[setup.inputs[i]]], 1e-4, 10.0, lambda s: {"gain": (s, "-")},
        post=lambda H, setup, s, plants: H * (1 + s * column),
    )  # fmt: skip


def sensor_filter(setup: Setup, rng) -> Effect:
    """A sensor that rolls off: above the band (first or second order), or below it (a coupling capacitor)."""
    o, name = _output(setup, rng)
    kind = str(rng.choice(["low", "butterworth", "high"]))
    low, high = setup.freq[0], setup.freq[-1]
    x = 1j * setup.freq / high
    gain = {
        "low": lambda z: 1 / (1 + z * x),
        "butterworth": lambda z: 1 / (1 + np.sqrt(2) * z * x + (z * x) ** 2),
        "high": lambda z: 1 / (1 - 1j * z * low / setup.freq),
    }[kind]
    told = {"high": lambda z: {"high_pass_corner": (z * low, "Hz")}}.get(
        kind, lambda z: {"low_pass_corner": (high / z, "Hz")}
    )
    return Effect(
        "sensor_filter", [name], 1e-4, 10.0, told, post=scale_rows([o], lambda setup, z: gain(z)), variant=kind
    )  # fmt: skip


def sensor_clipping(setup: Setup, rng) -> Effect:
    """One sensor clips: the fundamental of a clipped sine, by the response amplitude at each force level."""
    o, name = _output(setup, rng)
    peak = float((np.abs(setup.frf(setup.plant)[:, o]).max() * setup.level).max())

    def post(H, setup, size, plants):
        H = H.copy()
        response = np.abs(H[:, :, o]) * setup.level[:, None, None]
        rho = np.minimum(peak / (1 + size) / np.maximum(response, 1e-300), 1.0)
        H[:, :, o] *= 2 / np.pi * (np.arcsin(rho) + rho * np.sqrt(1 - rho**2))
        return H

    unit = {"receptance": "m", "mobility": "m/s", "accelerance": "m/s^2"}[setup.form]
    return Effect("sensor_clipping", [name], 1e-3, 1e3, lambda z: {"ceiling": (peak / (1 + z), unit)}, post=post)


CHANNEL = {
    "channel_gain": channel_gain,
    "channel_sign": channel_sign,
    "channel_swap": channel_swap,
    "time_delay": time_delay,
    "units": units,
    "exponential_window": exponential_window,
    "leakage": leakage,
    "fast_sweep": fast_sweep,
    "mains_hum": mains_hum,
    "force_dropout": force_dropout,
    "crosstalk": crosstalk,
    "force_gain": force_gain,
    "sensor_filter": sensor_filter,
    "sensor_clipping": sensor_clipping,
}
