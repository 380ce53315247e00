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

from modalax.identify import lscf, plscf
from modalax.study.fits import columns, reach
from modalax.study.near import near
from modalax.study.work import Row, Work, chunk_for

ORDER = 20  # highest order of the diagrams where none is given
LARGEST = 512  # most diagrams in a chunk, so that progress shows and little is lost
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

    def rows(self, k: int) -> list[Row]:
        """The rows of chunk ``k``; the last chunk is filled up with draws that are left out, to compile nothing new."""
        items = self.items(k)
        numbers = jnp.arange(k * self.chunk, (k + 1) * self.chunk)
        found = _diagrams(
            self.frf, jnp.asarray(self.sigma), jnp.asarray(self.poles), jnp.asarray(reach(self.poles)), numbers,
            jax.random.key(self.seed), self.method, self.order,
        )  # fmt: skip
        poles, score = (np.asarray(a)[: len(items)] for a in found)
        return [self._row(i, poles[j], score[j]) for j, i in enumerate(items)]

    def _row(self, item: int, poles: np.ndarray, score: np.ndarray) -> Row:
        row: Row = {"item": item}
        for r, pole in enumerate(poles, 1):
            f, z, *_ = columns(r)
            row |= {f: abs(pole) / (2 * np.pi), z: -pole.real / abs(pole), f"stability_{r}": score[r - 1]}
        lost = not np.isfinite(poles).any()
        return row | {
            "modes_found": int(np.isfinite(poles).sum()), "failed": lost,
            "reason": "no mode lasts over the orders of the diagram" if lost else "",
        }  # fmt: skip


@partial(jax.jit, static_argnums=(6, 7))
def _diagrams(
    frf: Any, sigma: Array, poles: Array, within: Array, numbers: Array, key: Any, method: str, order: int
) -> tuple[Array, Array]:
    estimate = {"lscf": lscf, "plscf": plscf}[method]

    def one(number: Array) -> tuple[Array, Array]:
        real, imag = jax.random.normal(jax.random.fold_in(key, number), (2, *frf.H.shape))
        noisy = frf.replace(H=frf.H + sigma * (real + 1j * imag) / jnp.sqrt(2.0))
        return near(estimate(noisy, tuple(range(2, order + 1))), poles, within)

    return jax.vmap(one)(numbers)
