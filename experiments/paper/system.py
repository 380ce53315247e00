"""The review's five-degree-of-freedom system, its noise, and draws of it."""

from collections.abc import Callable
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from modalax.data.frf import FRF
from modalax.identify.tables import PoleTable
from modalax.model.examples import five_dof

jax.config.update("jax_enable_x64", True)

LEVELS = (0.01, 0.025, 0.05, 0.10, 0.15, 0.25)
BAND = (20.0, 70.0)
STRUCTURE = five_dof()
MODES = STRUCTURE.modal()
TRUE = np.asarray(MODES.poles)
ZETA = 0.02


def clean(form: str = "receptance") -> FRF:
    """The first column of the FRF matrix, 0 to 80 Hz in steps of 0.1 Hz."""
    return STRUCTURE.frf(np.arange(801) * 0.1, inputs=["1"], form=form)


def _channel(power: Callable) -> Callable:
    return lambda H: jnp.broadcast_to(power(jnp.abs(H)), H.shape)


# Variance of the complex sample over the squared noise level, from the FRF over 0 to 80 Hz.
DEFINITIONS: dict[str, Callable] = {
    "Gaussian, std of each part = level x channel rms": _channel(lambda a: 2 * jnp.mean(a**2, 0, keepdims=True)),
    "Gaussian, level x channel peak": _channel(lambda a: 2 * jnp.max(a, 0, keepdims=True) ** 2),
    "Gaussian, level x rms of all channels": _channel(lambda a: 2 * jnp.mean(a**2, keepdims=True)),
    "Gaussian, level x magnitude of the sample": lambda H: 2 * jnp.abs(H) ** 2,
    "Gaussian, level x the part's own value": lambda H: jnp.abs(H) ** 2,
    "uniform, +-level x channel rms": _channel(lambda a: 2 / 3 * jnp.mean(a**2, 0, keepdims=True)),
    "uniform, +-level x the part's own value": lambda H: jnp.abs(H) ** 2 / 3,
    "uniform, +-level x the sample, one factor for both parts": lambda H: jnp.abs(H) ** 2 / 3,
    "uniform, +-level x magnitude of the sample": lambda H: 2 * jnp.abs(H) ** 2 / 3,
}
OWN, FACTOR, MAGNITUDE = list(DEFINITIONS)[-3:]


def noisy_case(name: str, form: str = "receptance") -> FRF:
    """The clean FRF in the band, with the variance of noise level 1 by this definition."""
    full = clean(form)
    floor = 1e-24 * jnp.max(jnp.abs(full.H)) ** 2  # a variance of zero has no weight
    return full.replace(variance=DEFINITIONS[name](full.H) + floor).band(*BAND)


def uniform_own(key: jax.Array, frf: FRF, level: jax.Array) -> jax.Array:
    """Each part times 1 + level U(-1, 1)."""
    a, b = jax.random.uniform(key, (2, *frf.H.shape), minval=-1.0, maxval=1.0)
    return level * (frf.H.real * a + 1j * frf.H.imag * b)


def uniform_factor(key: jax.Array, frf: FRF, level: jax.Array) -> jax.Array:
    """Each sample times 1 + level U(-1, 1)."""
    return level * frf.H * jax.random.uniform(key, frf.H.shape, minval=-1.0, maxval=1.0)


def uniform_magnitude(key: jax.Array, frf: FRF, level: jax.Array) -> jax.Array:
    """Each part plus level U(-1, 1) times the magnitude of its sample."""
    a, b = jax.random.uniform(key, (2, *frf.H.shape), minval=-1.0, maxval=1.0)
    return level * jnp.abs(frf.H) * (a + 1j * b)


def gaussian(key: jax.Array, frf: FRF, level: jax.Array) -> jax.Array:
    """Circular Gaussian noise of the variance that ``frf`` holds for level 1."""
    assert frf.variance is not None
    a, b = jax.random.normal(key, (2, *frf.H.shape))
    return level * (a + 1j * b) * jnp.sqrt(frf.variance / 2)


SAMPLERS: dict[str, Callable] = {OWN: uniform_own, FACTOR: uniform_factor, MAGNITUDE: uniform_magnitude}


def with_noise(frf: FRF, noise: jax.Array, level: jax.Array) -> FRF:
    """The FRF with this noise and the variance that belongs to the level."""
    return eqx.tree_at(lambda f: (f.H, f.variance), frf, (frf.H + noise, frf.variance * level**2))


@partial(jax.jit, static_argnames=("estimator", "sampler", "count"))
def draw_poles(
    frf: FRF, level: jax.Array, seed: int, *, estimator: Callable[[FRF], PoleTable], sampler: Callable, count: int
) -> tuple[jax.Array, jax.Array]:
    """Poles of ``count`` noisy copies in one vmap, shape ``(draw, pole)``, and which of them are poles."""

    def one(key: jax.Array) -> tuple[jax.Array, jax.Array]:
        table = estimator(with_noise(frf, sampler(key, frf, level), level))
        return table.poles[0], table.valid[0]

    keys = jax.random.split(jax.random.key(seed), count)
    return jax.vmap(one)(keys)


def pick(poles: np.ndarray, valid: np.ndarray, stable: bool = True, within: float = 0.03) -> np.ndarray:
    """The pole next to each true one, shape ``(draw, mode)``; NaN where none lies within 3 % of its frequency."""
    good = valid & (poles.real < 0) if stable else valid
    distance = np.where(good[:, :, None], np.abs(poles[:, :, None] - TRUE), np.inf)
    near = np.argmin(distance, axis=1)
    found = np.take_along_axis(poles, near, axis=1)
    there = np.take_along_axis(np.broadcast_to(good[:, :, None], distance.shape), near[:, None], axis=1)[:, 0]
    close = np.abs(np.abs(found) / np.abs(TRUE) - 1) < within
    return np.where(there & close, found, np.nan)


def nearest_stable(found: PoleTable) -> jax.Array:
    """The stable pole next to each true one, shape ``(mode,)`` [rad/s], however far; also under a transformation."""
    poles = found.poles[0]
    good = found.valid[0] & (poles.real < 0)
    distance = jnp.where(good[:, None], jnp.abs(poles[:, None] - TRUE), jnp.inf)
    return poles[jnp.argmin(distance, axis=0)]


def errors(found: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Relative errors of frequency and damping, per cent."""
    size = np.abs(found)
    return 100 * (size / np.abs(TRUE) - 1), 100 * (-found.real / size / ZETA - 1)


def statistics(found: np.ndarray, mode: int) -> tuple[float, float, float, float, int]:
    """Mean and deviation of the errors of frequency and damping of a mode [%], and how many draws have lost it."""
    df, dz = errors(found)
    kept = np.isfinite(dz[:, mode])
    if not kept.any():
        return (float("nan"),) * 4 + (len(kept),)
    f, z = df[kept, mode], dz[kept, mode]
    return float(f.mean()), float(f.std()), float(z.mean()), float(z.std()), int((~kept).sum())


def table(header: list[str], rows: list[list[str]]) -> str:
    """A markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"
