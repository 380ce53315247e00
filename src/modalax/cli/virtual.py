"""A virtual test for the demo: the five-degree-of-freedom system with an effect hidden in it, at three force levels."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from modalax.data import Measurement
from modalax.model import Structure
from modalax.model.examples import five_dof
from modalax.simulate.harmonic import simulate
from modalax.simulate.joints import ElastoSlip

LEVELS = (1.0, 3.0, 6.0)
FREQ = np.arange(200, 701) / 10
JOINT = ("3", "5")
SLIP = 4.0
NOISE = 0.02


@dataclass(frozen=True)
class Hidden:
    """An effect that the structure has and its simulation lacks.

    ``matrices`` changes M, C and K; ``channels`` changes the measured FRFs ``(f, o, i)``.
    """

    name: str
    where: tuple[str, ...]
    size: float
    unit: str
    matrices: Callable[[Any, Any, Any], tuple[Any, Any, Any]] = lambda M, C, K: (M, C, K)
    channels: Callable[[Any], Any] = lambda H: H

    def __str__(self) -> str:
        """Name, size and place in words."""
        return f"{self.name} of {f'{self.size:.3g} {self.unit}'.strip()} at {' - '.join(self.where) or 'all channels'}"


def random_effect(seed: int, dofs: tuple[str, ...]) -> Hidden:
    """Draw an effect by chance: a mass, a damper, the gain or the sign of a sensor, or a delay."""
    rng = np.random.default_rng(seed)
    k = int(rng.integers(len(dofs)))
    e = np.eye(len(dofs))[k]
    size = float(rng.uniform(1, 2))
    kind = int(rng.integers(5))
    if kind == 0:
        m = 0.03 * size
        return Hidden("added_mass", (dofs[k],), m, "kg", lambda M, C, K: (M + m * np.outer(e, e), C, K))
    if kind == 1:
        c = 3.0 * size
        return Hidden("local_damper", (dofs[k],), c, "N s/m", lambda M, C, K: (M, C + c * np.outer(e, e), K))
    if kind == 2:
        return Hidden(
            "channel_gain", (dofs[k],), 0.05 * size, "", channels=lambda H: H * (1 + 0.05 * size * e[:, None])
        )
    if kind == 3:
        return Hidden("channel_sign", (dofs[k],), -1.0, "", channels=lambda H: H * (1 - 2 * e[:, None]))
    delay = 1e-4 * size
    turn = np.exp(-2j * np.pi * FREQ * delay)[:, None, None]
    return Hidden("time_delay", (), delay, "s", channels=lambda H: H * turn)


def hidden_joint() -> tuple[Hidden, ElastoSlip]:
    """The spring between DoFs 3 and 5 slips at ``SLIP`` [N]; below that force it is the spring of the simulation."""
    structure = five_dof()
    a, b = (structure.index(name) for name in JOINT)
    k = float(-structure.K[a, b])
    direction = np.eye(5)[a] - np.eye(5)[b]
    hidden = Hidden("elasto_slip", JOINT, SLIP, "N", lambda M, C, K: (M, C, K - k * np.outer(direction, direction)))
    return hidden, ElastoSlip(k=jnp.asarray(k), slip_force=jnp.asarray(SLIP))


def virtual_test(effect: Hidden, seed: int, joint: ElastoSlip | None = None) -> Measurement:
    """Noisy FRFs of a structure with an effect, at three force levels; the noise is 2 % of each channel's rms."""
    structure = five_dof()
    M, C, K = effect.matrices(np.asarray(structure.M), np.asarray(structure.C), np.asarray(structure.K))
    actual = Structure(M, C, K, structure.dofs)
    joints, places = ([], []) if joint is None else ([joint], [JOINT])
    options: dict[str, Any] = {} if joint is None else {"harmonics": 9}
    clean = simulate(actual, joints, places, FREQ, np.array(LEVELS), inputs=["1"], **options)
    keys = jax.random.split(jax.random.key(seed), clean.runs)
    runs = [clean.run(r) for r in range(clean.runs)]
    return Measurement.from_frfs(
        [
            frf.replace(H=jnp.asarray(effect.channels(frf.H))).add_noise(key, NOISE)
            for frf, key in zip(runs, keys, strict=True)
        ]
    )
