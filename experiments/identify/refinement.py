"""Bias, spread and error bars of the refinement over noise draws: ``python experiments/identify/refinement.py``.

The review's five-degree-of-freedom system, first column of the FRF matrix, 20 to 70 Hz in steps of 0.1 Hz, circular
Gaussian noise whose standard deviation is a part of each channel's root mean square. Every draw is refined from poles
that are off by up to half a bandwidth in frequency and by 20 to 50 % in damping. Beside it the Cramer-Rao bound: the
errors that the refinement states on the exact FRF with the same variance.
"""

import argparse
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from modalax.identify import cramer_rao, refine, residues
from modalax.model.examples import five_dof

jax.config.update("jax_enable_x64", True)

LEVELS = (0.01, 0.05, 0.10, 0.25)
FREQ = np.arange(200, 701) * 0.1
TRUE = five_dof().modal()
EXACT = TRUE.normalised("max")
CLEAN = TRUE.frf(FREQ, inputs=["1"])
SHIFT = jnp.array([3e-3, -2e-3, 4e-3, -3e-3, 1e-3])
WIDEN = jnp.array([0.5, -0.4, -0.5, 0.2, 0.3])
START = residues(CLEAN, TRUE.poles * (1 + SHIFT) + TRUE.poles.real * WIDEN)
BATCH = 50
QUANTITIES = ("damping", "frequency", "shape", "modal mass")


@jax.jit
def _draws(keys: jax.Array, level: jax.Array) -> dict[str, tuple[jax.Array, jax.Array]]:
    def one(key: jax.Array) -> dict[str, tuple[jax.Array, jax.Array]]:
        r = refine(CLEAN.add_noise(key, level), START, scale_errors="never")
        return {
            "damping": (r.model.damping_ratio, r.damping_std),
            "frequency": (r.model.frequency_hz, r.frequency_std_hz),
            "shape": (r.model.shapes.real, r.shape_std.real),
            "modal mass": (r.model.modal_mass().real, r.modal_mass_std),
            "success": (r.success, r.steps),
        }

    return jax.vmap(one)(keys)


def draws(level: float, count: int, seed: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Estimates and stated standard deviations of ``count`` draws, arrays ``(draw, mode, ...)``."""
    keys = jax.random.split(jax.random.key(seed), count)
    parts = [jax.tree.map(np.asarray, _draws(keys[k : k + BATCH], level)) for k in range(0, count, BATCH)]
    return {name: tuple(np.concatenate([p[name][j] for p in parts]) for j in (0, 1)) for name in parts[0]}


def bound(level: float) -> np.ndarray:
    """Cramer-Rao bound of each damping ratio."""
    frf = CLEAN.replace(variance=CLEAN.add_noise(jax.random.key(0), level).variance)
    return np.asarray(cramer_rao(EXACT, frf).damping_std)


def truths() -> dict[str, np.ndarray]:
    """What the estimates should be."""
    return {
        "damping": np.asarray(TRUE.damping_ratio),
        "frequency": np.asarray(TRUE.frequency_hz),
        "shape": np.asarray(EXACT.shapes.real),
        "modal mass": np.asarray(EXACT.modal_mass().real),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument("--csv", type=Path, default=Path(__file__).with_name("refinement.csv"))
    args = parser.parse_args()
    truth = truths()
    lines = ["level,mode,quantity,component,bias_over_std,std_over_bound,std_over_stated,coverage_95,failed"]
    for level in LEVELS:
        began = time.perf_counter()
        found, limit = draws(level, args.draws, args.seed), bound(level)
        failed = int((~found["success"][0]).sum())
        print(
            f"\nnoise {100 * level:g} %: {failed} of {args.draws} searches ended without a maximum, "
            f"{np.mean(found['success'][1]):.1f} steps each, {time.perf_counter() - began:.1f} s with compiling"
        )
        print(
            "| mode | damping: bias/std | std/bound | 95 % cover | frequency: bias/std | 95 % cover "
            "| modal mass: std/stated | 95 % cover | shape: std/stated, worst | 95 % cover, worst |\n"
            + "|---" * 10
            + "|"
        )
        ok = found["success"][0]
        for r in range(5):
            cells = {}
            for name in QUANTITIES:
                value, std = (np.atleast_2d(a[ok][:, r].T) for a in found[name])
                exact = np.atleast_1d(truth[name][r])
                rows = []
                for c in range(len(exact)):
                    free = std[c] > 1e-9 * np.median(std[c])  # not what the shape is scaled to in this draw
                    if np.median(std[c]) < 1e-12 or free.mean() < 0.1:
                        continue
                    error, stated = (value[c] - exact[c])[free], std[c][free]
                    bias, z = error.mean() / error.std(ddof=1), error / stated
                    over = error.std(ddof=1) / limit[r] if name == "damping" else np.nan
                    rows.append((bias, over, z.std(ddof=1), np.mean(np.abs(z) < 1.96)))
                    lines.append(
                        f"{level},{r + 1},{name},{c + 1},{rows[-1][0]:.4f},{over:.4f},{rows[-1][2]:.4f},"
                        f"{rows[-1][3]:.4f},{failed}"
                    )
                cells[name] = np.array(rows)
            d, f, m, s = (cells[n] for n in QUANTITIES)
            worst = np.argmax(np.abs(np.log(s[:, 2])))
            print(
                f"| {r + 1} | {d[0, 0]:+.3f} | {d[0, 1]:.3f} | {100 * d[0, 3]:.1f} | {f[0, 0]:+.3f} | "
                f"{100 * f[0, 3]:.1f} | {m[0, 2]:.2f} | {100 * m[0, 3]:.1f} | {s[worst, 2]:.2f} | "
                f"{100 * s[:, 3].min():.1f} |",
                flush=True,
            )
    args.csv.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
