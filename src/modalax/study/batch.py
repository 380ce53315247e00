"""Many stabilization diagrams at once: draws of the noise, LSCF and the selection of modes, compiled as one program.

No more is fitted than poles: neither shapes nor standard deviations. The modes are selected near the true ones, as a
user does who knows where they are.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from modalax._numerics.checks import as_array
from modalax._numerics.devices import over_devices
from modalax.identify import lscf, plscf
from modalax.identify.many import LEAST, many_poles
from modalax.identify.tables import PoleTable
from modalax.study.fits import columns, reach
from modalax.study.near import near
from modalax.study.work import Row, Work, chunk_for, draws_of

ORDER = 20  # highest order of the diagrams where none is given
LARGEST = 512  # most diagrams in a chunk, so that progress shows and little is lost
BLOCK = 128  # diagrams computed at once, whose roots fit a processor's cache
COPIES = 8  # arrays of the size of the FRFs, and of the matrices of all orders, that are held at once


@dataclass(frozen=True)
class BatchWork(Work):
    """Diagrams of FRFs with noise, a chunk at a time.

    Attributes
    ----------
    frf
        The FRFs without noise.
    sigma
        Standard deviation of the noise of each sample, shape ``(f, o, i)``.
    poles
        True poles of the modes in the band [rad/s].
    method, order
        Estimator and highest order.
    """

    frf: Any
    sigma: np.ndarray
    poles: np.ndarray
    method: str
    order: int

    @classmethod
    def make(cls, settings: dict[str, Any], frf: Any, poles: np.ndarray, **common: Any) -> "BatchWork":
        """The work of a noise study without refinement; the chunk is sized to the memory."""
        system, fit = settings["system"], settings["fit"]
        method = fit["method"] or ("plscf" if min(frf.shape[1:]) > 1 else "lscf")
        order = fit["order"] or ORDER
        noisy = frf.add_noise(jax.random.key(0), system["noise"], system["noise_reference"])
        size = min(frf.shape[1:]) if method == "plscf" else 1
        each = 16e-6 * COPIES * (frf.H.size + order * ((order + 1) * size) ** 2)
        most = max(1, min(LARGEST, int(settings["memory_mb"] / each)))
        return cls(
            settings["draws"], chunk_for(settings["draws"], settings["chunk"], most), settings["seed"], frf,
            np.sqrt(np.asarray(noisy.variance)), poles, method, order, **common,
        )  # fmt: skip

    @property
    def squared(self) -> bool:
        """Whether the noise is large enough for the moments, which square it."""
        size = np.sqrt(np.mean(np.abs(np.asarray(self.frf.H)) ** 2))
        return self.method == "lscf" and float(np.sqrt(np.mean(self.sigma**2))) > LEAST * float(size)

    def rows(self, k: int) -> list[Row]:
        """The rows of chunk ``k``; its last block is filled up with draws that are left out, to compile nothing new."""
        items = self.items(k)
        block = min(BLOCK, self.chunk)
        starts = range(items.start, items.stop, block)
        found = [self._block(range(start, start + block)) for start in starts]
        poles, score = (np.concatenate(parts) for parts in zip(*found, strict=True))
        size = np.abs(poles)
        told = np.stack([size / (2 * np.pi), -poles.real / size, score], axis=2).reshape(len(poles), -1).tolist()
        modes = np.isfinite(poles).sum(axis=1).tolist()
        names = [n for r in range(1, len(self.poles) + 1) for n in (*columns(r)[:2], f"stability_{r}")]
        return [self._row(i, dict(zip(names, told[j], strict=True)), modes[j]) for j, i in enumerate(items)]

    def _block(self, numbers: range) -> tuple[np.ndarray, np.ndarray]:
        """Poles and scores of some draws."""
        clean = np.asarray(self.frf.H)
        lines = clean.shape[0]
        noise = np.empty((len(numbers), 2, clean[0].size, lines))
        for drawn, number in zip(noise, numbers, strict=True):
            draws_of(self.seed, number).standard_normal(out=drawn)
        noise *= self.sigma.reshape(lines, -1).T / np.sqrt(2.0)
        rows = clean.reshape(lines, -1).T
        noise += np.stack([rows.real, rows.imag])
        modes = as_array(self.poles), as_array(reach(self.poles))
        if self.squared:
            poles, valid = many_poles(np.asarray(self.frf.omega), noise, self.order)
            found = _nearest(poles, as_array(valid), self.frf.added_decay, *modes)
        else:
            found = _diagrams(self.frf, over_devices(noise), *modes, self.method, self.order)
        return np.asarray(found[0]), np.asarray(found[1])

    def _row(self, item: int, told: Row, modes: int) -> Row:
        reason = "" if modes else "no mode lasts over the orders of the diagram"
        return {"item": item, **told, "modes_found": modes, "failed": not modes, "reason": reason}


@jax.jit
def _nearest(found: Array, valid: Array, decay: Array, poles: Array, within: Array) -> tuple[Array, Array]:
    orders = tuple(range(2, found.shape[1] + 2))
    found = jnp.where(valid, found + decay, found)
    return jax.vmap(lambda table: near(PoleTable(table, valid, None, orders, "lscf"), poles, within))(found)


@partial(jax.jit, static_argnums=(4, 5))
def _diagrams(frf: Any, H: Array, poles: Array, within: Array, method: str, order: int) -> tuple[Array, Array]:
    estimate = {"lscf": lscf, "plscf": plscf}[method]

    def one(rows: Array) -> tuple[Array, Array]:
        noisy = frf.replace(H=(rows[0] + 1j * rows[1]).T.reshape(frf.H.shape))
        return near(estimate(noisy, tuple(range(2, order + 1))), poles, within)

    return jax.vmap(one)(H)
