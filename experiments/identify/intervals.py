"""Do intervals hold whose noise is read off the residual? ``python experiments/identify/intervals.py --count 300``.

Two to five modes apart from each other, half a line to twenty in their half-power bandwidths, one to a few channels,
even noise of 0.3 % that is not told. The modes are refined from their true poles, so that nothing but the noise decides
how often 95 % intervals hold, with weights of both kinds: noise alone, and noise beside a part in proportion to the
FRF, which a fit ends with. Modes whose damping is known to less than 15 % are left out.
"""

import argparse
import sys
import time

import jax
import numpy as np
from random_systems import circular
from threadpoolctl import threadpool_limits

from modalax.data.frf import FRF
from modalax.identify.host import refine_on_host
from modalax.identify.noise import residual_sigma
from modalax.identify.residues import residues
from modalax.model.modal import ModalModel

jax.config.update("jax_enable_x64", True)
threadpool_limits(1)
STEP, NOISE, KNOWN = 0.5, 0.003, 0.15


def draw(seed: int, outputs: int, inputs: int) -> tuple[ModalModel, FRF]:
    """A system and its FRFs with noise."""
    rng = np.random.default_rng(seed)
    n, names = int(rng.integers(2, 6)), [str(k) for k in range(max(outputs, inputs))]
    edges = np.linspace(25, 185, n + 1)
    f = edges[:-1] + rng.uniform(0.2, 0.8, n) * np.diff(edges)
    lines = np.exp(rng.uniform(np.log(0.5), np.log(20), n))
    shapes = rng.normal(size=(n, len(names))) + 0.5
    model = ModalModel.from_real_modes(f, np.minimum(lines * STEP / 2 / f, 0.08), shapes, np.ones(n), names)
    clean = model.frf(STEP * np.arange(1, 381), form="accelerance", outputs=names[:outputs], inputs=names[:inputs])
    H = np.asarray(clean.H)
    sigma = NOISE * np.sqrt(np.mean(np.abs(H) ** 2, axis=0, keepdims=True))
    return model, clean.replace(H=H + sigma * circular(rng, H.shape))


def deviations(model: ModalModel, frf: FRF, proportional: bool) -> np.ndarray:
    """Errors of frequency and damping over their standard deviations, shape ``(n, 2)``."""
    found = refine_on_host(frf, residues(frf, model.poles), covariance="robust")
    sigma = "auto"
    for _ in range(2):
        sigma = residual_sigma(frf, found, sigma, proportional)
        found = refine_on_host(frf, found.model, weights=sigma, covariance="robust")
    zeta, std = np.asarray(found.model.damping_ratio), np.asarray(found.damping_std)
    known = std < KNOWN * zeta
    known &= std > 0
    off = np.asarray(found.model.frequency_hz - model.frequency_hz)[known] / np.asarray(found.frequency_std_hz)[known]
    return np.stack([off, (zeta - np.asarray(model.damping_ratio))[known] / std[known]], axis=1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=300, help="systems of each number of channels")
    parser.add_argument("--channels", nargs="*", default=["1x1", "2x2"], help="outputs x inputs")
    given = parser.parse_args()
    print("| channels | weights | modes | 95 % intervals hold: frequency | damping |\n|---|---|---|---|---|")
    for word in given.channels:
        outputs, inputs = map(int, word.split("x"))
        for proportional in (False, True):
            z = np.concatenate([deviations(*draw(seed, outputs, inputs), proportional) for seed in range(given.count)])
            hold = 100 * np.mean(np.abs(z) < 1.96, axis=0)
            kind = "and in proportion" if proportional else "noise alone"
            print(f"| {word} | {kind} | {len(z)} | {hold[0]:.1f} % | {hold[1]:.1f} % |", flush=True)
    print(f"{time.process_time():.0f} CPU s")


if __name__ == "__main__":
    sys.exit(main())
