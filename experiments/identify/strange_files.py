"""Files of kinds that laboratories hand over and nobody tunes for: ``python experiments/identify/strange_files.py``.

Every kind is a measurement file made here from a modal model that is known: records with leakage, windows left
uncorrected, very low and very high damping, sixty modes, double poles, uneven and coarse lines, bands far from 0 Hz,
wrong forms, conjugation, dead channels, NaN lines, loud noise, and so on. Each is written, loaded, fitted and checked
unattended. Printed are the modes in band found, missed and false, deviations in stated standard deviations, flags of
modes that are off, remarks, and the findings of the check, to be looked at and judged.
"""

import argparse
import sys
import tempfile
import time
import zlib
from pathlib import Path
from typing import Any

import jax
import numpy as np
import scipy.optimize
import strange_records  # noqa: F401, its kinds are put among KINDS
import strange_structures  # noqa: F401
from strange_base import KINDS
from threadpoolctl import threadpool_limits

import modalax
from modalax.identify import Fit, fit, residues
from modalax.identify.noise import smooth_variance
from modalax.identify.quality import gains_of

jax.config.update("jax_enable_x64", True)
threadpool_limits(1)


def judge(found: Fit, poles: np.ndarray) -> str:
    """Modes in band that are found, missed and false, and the largest deviations in stated ones.

    Of a missed mode stands by how much it would have raised twice the log-likelihood, and what chance gives.
    """
    freq = np.asarray(found.frf.freq)
    f, zeta = np.abs(poles) / (2 * np.pi), -poles.real / np.abs(poles)
    true = np.flatnonzero((f >= freq[0]) & (f <= freq[-1]))
    inside = np.flatnonzero(np.asarray(found.inside))
    own, own_zeta = (np.asarray(a)[inside] for a in (found.model.frequency_hz, found.model.damping_ratio))
    std = np.stack([np.asarray(a)[inside] for a in (found.refined.frequency_std_hz, found.refined.damping_std)], 1)
    reach = np.maximum(zeta * f, 0.5 * np.median(np.diff(freq)))[true]
    apart = np.abs(own[None] - f[true][:, None]) / reach[:, None]
    rows, columns = scipy.optimize.linear_sum_assignment(np.minimum(apart, 5.0)) if apart.size else ([], [])
    pairs = [(r, c) for r, c in zip(rows, columns, strict=True) if apart[r, c] < 2]
    told = [f"{len(pairs)} of {len(true)} modes"]
    missed = np.delete(np.arange(len(true)), [r for r, _ in pairs])
    gain, chance = gains_of(smooth_variance(found.frf), residues(found.frf, poles))
    told += [f"missed {f[true][r]:.5g} Hz, gain {gain[true[r]]:.0f} ({chance[true[r]]:.0f} by chance)" for r in missed]
    for c in np.delete(np.arange(len(inside)), [c for _, c in pairs]):
        told.append(
            f"FALSE {own[c]:.5g} Hz {100 * own_zeta[c]:.3g} % grade {float(found.grade[inside[c]]):.2f} "
            f"{'; '.join(found.flags[inside[c]])}"
        )
    for r, c in pairs:
        error = np.array([own[c] - f[true][r], own_zeta[c] - zeta[true][r]])
        z = error / np.maximum(std[c], 1e-300)
        if np.abs(z).max() > 3 or not np.isfinite(z).all():
            told.append(
                f"{f[true][r]:.5g} Hz off by {error[0]:+.2g} Hz ({z[0]:+.1f} std), damping {100 * own_zeta[c]:.3g} for "
                f"{100 * zeta[true][r]:.3g} % ({z[1]:+.1f} std), grade {float(found.grade[inside[c]]):.2f} "
                f"{'; '.join(found.flags[inside[c]])}"
            )
    return "\n    ".join(told)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="part of the names of the kinds to take")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--no-fit", action="store_true", help="only the check")
    parser.add_argument("--no-check", action="store_true", help="only the fit")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for name, make in KINDS.items():
            if args.only in name:  # the draw of a kind does not depend on the others
                rng = np.random.default_rng([args.seed, zlib.crc32(name.encode())])
                one(name, make(rng), Path(folder) / f"{name.replace(' ', '_')}.npz", args)


def one(name: str, made: tuple[dict[str, Any], np.ndarray], path: Path, args: argparse.Namespace) -> None:
    """Write, load, fit and check one file."""
    arrays, poles = made
    np.savez(path, **arrays)
    print(f"\n== {name}: {' x '.join(map(str, arrays['H'].shape[1:]))}", flush=True)
    began = time.process_time()
    try:
        measured = modalax.load(path)
        if not args.no_fit:
            found = fit(measured)
            answer = found.to_dict()
            print(f"  fit: {judge(found, poles)}")
            noise = float(found.noise)
            print(f"  unexplained {100 * answer['unexplained']:.3g} %, noise {100 * noise:.3g} %")
            for note in found.notes:
                print(f"  note: {note}")
            print(f"  {time.process_time() - began:.1f} CPU s")
    except ValueError as error:
        print(f"  fit: ValueError: {error}")
    if args.no_check:
        return
    began = time.process_time()
    try:
        for f in modalax.check(modalax.load(path)):
            print(f"  check: {f.what} {f.where} {f.size} {f.unit} sure {f.sure:.2f}: {f.evidence}")
        print(f"  {time.process_time() - began:.1f} CPU s")
    except ValueError as error:
        print(f"  check: ValueError: {error}")


if __name__ == "__main__":
    sys.exit(main())
