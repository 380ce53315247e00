"""`modalax.fit` on systems drawn at random: ``python experiments/identify/random_systems.py``.

Systems of 3 to 12 modes between 20 and 180 Hz, 0.1 to 5 % damping (evenly in its logarithm), real shapes drawn from a
normal distribution, 1 to 4 outputs and 1 or 2 inputs, as receptance, mobility or accelerance at 1,801 lines from 10 to
190 Hz; circular noise of 1 to 25 % (again in its logarithm) of each channel's root mean square. Frequencies are drawn
evenly and may come close to each other. Every set is fitted twice, with the variance and without.

A mode counts as *above the noise* if its own response exceeds the noise's standard deviation at some line of some
channel, and as *plain* if the power of its response is 100 times the noise's a line and channel, summed over all. A
found mode is a true one if it lies within a half-bandwidth and four stated deviations of it, one for one; found modes
in the band that are no true one are spurious. Coverage is that of the 95 % intervals of the true ones found.
"""

import argparse
import os
import sys
import time

import jax
import numpy as np
import scipy.optimize
from threadpoolctl import threadpool_limits

from modalax.data.frf import DERIVATIVES, FRF
from modalax.identify import Fit, fit
from modalax.model.modal import ModalModel

jax.config.update("jax_enable_x64", True)
threadpool_limits(1)

FREQ = np.linspace(10.0, 190.0, 1801)
PLAIN = 100.0


def draw(seed: int) -> tuple[ModalModel, FRF, float]:
    """A system, its FRFs with noise and variance, and the noise level."""
    rng = np.random.default_rng(seed)
    modes, outputs, inputs = int(rng.integers(3, 13)), int(rng.integers(1, 5)), int(rng.integers(1, 3))
    names = [str(k + 1) for k in range(max(outputs, inputs))]
    model = ModalModel.from_real_modes(
        np.sort(rng.uniform(20, 180, modes)), np.exp(rng.uniform(np.log(0.001), np.log(0.05), modes)),
        rng.normal(size=(modes, len(names))), rng.uniform(0.5, 2, modes), names,
    )  # fmt: skip
    level = float(np.exp(rng.uniform(np.log(0.01), np.log(0.25))))
    clean = model.frf(FREQ, form=str(rng.choice(list(DERIVATIVES))), outputs=names[:outputs], inputs=names[:inputs])
    return model, clean.add_noise(jax.random.key(seed), level), level


def strength(model: ModalModel, frf: FRF) -> tuple[np.ndarray, np.ndarray]:
    """For each mode its response over the noise: the largest at any line and channel, and the sum of squares."""
    assert frf.variance is not None
    own = []
    for r in range(len(model.poles)):
        one = model.replace(
            poles=model.poles[r : r + 1], shapes=model.shapes[r : r + 1], participation=model.participation[r : r + 1],
            frequency_std=0.0, damping_std=0.0,
        )  # fmt: skip
        own.append(one.frf(frf.freq, form=frf.form, outputs=frf.outputs, inputs=frf.inputs).H)
    ratio = np.array([np.abs(np.asarray(h)) ** 2 / np.asarray(frf.variance) for h in own])
    return np.sqrt(ratio.max(axis=(1, 2, 3))), ratio.sum(axis=(1, 2, 3))


def match(model: ModalModel, found: Fit) -> tuple[dict[int, int], list[int]]:
    """For each true mode the found one that belongs to it, and the spurious ones."""
    assert found.refined is not None
    f, zeta = np.asarray(model.frequency_hz), np.asarray(model.damping_ratio)
    inside = np.flatnonzero(np.asarray(found.inside))
    own, std = (np.asarray(a)[inside] for a in (found.model.frequency_hz, found.refined.frequency_std_hz))
    apart = np.abs(own[None, :] - f[:, None]) / ((zeta * f)[:, None] + 4 * np.nan_to_num(std, nan=0.0)[None, :])
    rows, columns = scipy.optimize.linear_sum_assignment(np.where(apart < 1, apart, 10.0))
    pairs = {int(r): int(inside[c]) for r, c in zip(rows, columns, strict=True) if apart[r, c] < 1}
    return pairs, [int(k) for k in inside if k not in pairs.values()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--detail", action="store_true", help="name the missed, spurious and badly covered modes")
    args = parser.parse_args()
    print("| seed | modes o x i, form | noise | variance | above noise | plain | spurious | z > 1.96 | s |")
    print("|---" * 9 + "|")
    total = {known: np.zeros(8) for known in (True, False)}
    for seed in range(args.first, args.first + args.count):
        model, frf, level = draw(seed)
        peak, power = strength(model, frf)
        f, zeta = np.asarray(model.frequency_hz), np.asarray(model.damping_ratio)
        for known in (True, False):
            began = time.perf_counter()
            try:
                found = fit(frf if known else frf.replace(variance=None))
            except ValueError as error:
                print(f"| {seed} | {error} |")
                continue
            pairs, spurious = match(model, found)
            assert found.refined is not None
            own = found.model
            z = np.array([
                ((float(own.frequency_hz[k]) - f[r]) / float(found.refined.frequency_std_hz[k]),
                 (float(own.damping_ratio[k]) - zeta[r]) / float(found.refined.damping_std[k]))
                for r, k in pairs.items()
            ]).reshape(-1, 2)  # fmt: skip
            have = np.isin(np.arange(len(f)), list(pairs))
            above, plain, out = peak > 1, power > PLAIN, np.abs(z) > 1.96
            print(
                f"| {seed} | {len(f)}, {frf.shape[1]} x {frf.shape[2]}, {frf.form} | {100 * level:.1f} % | "
                f"{'known' if known else 'unknown'} | {(have & above).sum()} of {above.sum()} | "
                f"{(have & plain).sum()} of {plain.sum()} | {len(spurious)} | {out[:, 0].sum()} + {out[:, 1].sum()} of "
                f"{len(z)} | {time.perf_counter() - began:.0f} |",
                flush=True,
            )
            total[known] += [
                above.sum(), (have & above).sum(), plain.sum(), (have & plain).sum(), len(spurious), len(z),
                out[:, 0].sum(), out[:, 1].sum(),
            ]  # fmt: skip
            if args.detail:
                for r in np.flatnonzero(above & ~have):
                    print(f"    missed {f[r]:.3f} Hz, {100 * zeta[r]:.3f} %, peak {peak[r]:.2f}, power {power[r]:.0f}")
                for k in spurious:
                    damping, evidence = 100 * float(own.damping_ratio[k]), float(found.refined.evidence[k])
                    print(f"    spurious {float(own.frequency_hz[k]):.3f} Hz, {damping:.3f} %, evidence {evidence:.0f}")
                for (r, k), (of_f, of_zeta) in zip(pairs.items(), z, strict=True):
                    if max(abs(of_f), abs(of_zeta)) > 2.5:
                        damping = 100 * float(own.damping_ratio[k])
                        print(
                            f"    z {of_f:+.1f}, {of_zeta:+.1f} at {f[r]:.3f} Hz, {100 * zeta[r]:.3f} % "
                            f"(found {damping:.3f}), power {power[r]:.0f}; {found.refined.reason}"
                        )
    print(f"load {os.getloadavg()[0]:.1f}")
    for known, t in total.items():
        print(
            f"variance {'known' if known else 'unknown'}: {t[1]:.0f} of {t[0]:.0f} modes above the noise found, "
            f"{t[3]:.0f} of {t[2]:.0f} plain ones, {t[4]:.0f} spurious; 95 % intervals hold "
            f"{100 * (1 - t[6] / t[5]):.1f} % of {t[5]:.0f} frequencies, {100 * (1 - t[7] / t[5]):.1f} % of dampings"
        )


if __name__ == "__main__":
    sys.exit(main())
