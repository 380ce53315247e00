"""An F-16's wing and payload at four levels: ``MODALAX_DATA=... python experiments/measured/f16.py [--out out/f16]``.

Records of a multisine at levels 1, 3, 5 and 7 (12 to 98 N rms) to FRFs, modes of each level, their softening and
damping over the level with a band, and the FRFs of a level that was held out, from the others. Then the modes of level
1 are diagnosed as a simulation of the higher levels: is it a place between the accelerometers? 1 is at the excitation
(wing tip), 2 on the wing's side and 3 on the payload's side of the interface. Nothing is set by hand.
"""

import argparse
import os
import time
import warnings
from pathlib import Path

import jax
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

import modalax
from modalax.data import FRF, Measurement
from modalax.data.reduction import common_lines, frf_from_recording
from modalax.files import load_records
from modalax.identify import OverAmplitude, over_amplitude

matplotlib.use("Agg")
jax.config.update("jax_enable_x64", True)
threadpool_limits(1)

LEVELS = (1, 3, 5, 7)
DOFS = ("1:+Z", "2:+Z", "3:+Z")
HELD_OUT = (3, 2, 1)  # which run is left out, in turn: the highest is extrapolated


def levels(folder: Path) -> list[FRF]:
    """FRFs of each level with the root mean square of its force [N]."""
    found = []
    for n in LEVELS:
        recording = load_records([folder / f"F16Data_FullMSine_Level{n}.mat"])
        force = recording.data[..., recording.index("Force")]
        frf = frf_from_recording(recording, inputs=DOFS[:1], outputs=DOFS)
        found.append(frf.replace(level=float(np.sqrt(np.mean(force**2)))))
    return common_lines(found)


def norm(H: np.ndarray) -> float:
    return float(np.linalg.norm(H))


def linear(found: OverAmplitude) -> np.ndarray:
    """FRFs of the modes fitted at the lowest level."""
    frf = found.measured[0]
    return np.asarray(found.models[0].frf(frf.freq, form=frf.form).H)


def tell_modes(console: Console, found: OverAmplitude) -> None:
    """Frequency and damping of each mode at each level, with the band of the smooth function."""
    rows = Table("mode", *(f"{x:.1f} N" for x in found.level), "from first to last")
    f, df, z, dz = found.band(found.level)
    for k in range(f.shape[1]):
        told = [
            f"{found.frequency_hz[r, k]:.3f} ({f[r, k]:.3f} ± {2 * df[r, k]:.3f}) Hz\n"
            f"{100 * found.damping_ratio[r, k]:.2f} ({100 * z[r, k]:.2f} ± {200 * dz[r, k]:.2f}) %"
            for r in range(len(found.level))
        ]
        change = 100 * (found.frequency_hz[-1, k] / found.frequency_hz[0, k] - 1)
        rows.add_row(
            str(k + 1), *told, f"{change:+.1f} %\nx {found.damping_ratio[-1, k] / found.damping_ratio[0, k]:.1f}"
        )
    console.print("Each fit, and in brackets the smooth function of the level with its 95 % band:")
    console.print(rows)


def hold_out(frfs: list[FRF], which: int) -> tuple[OverAmplitude, dict[str, float], FRF]:
    """Predict one level from the others; norms of errors over that of the linear modes of the lowest level."""
    rest = over_amplitude(Measurement.from_frfs([frf for k, frf in enumerate(frfs) if k != which]))
    true, level = np.asarray(frfs[which].H), float(frfs[which].level)
    whole, modes = rest.frf(level), rest.frf(level, rest=False)
    near = int(np.argmin(np.abs(np.log(rest.level / level))))
    base = norm(linear(rest) - true)
    error = np.asarray(whole.H) - true
    return rest, {
        "linear": base / norm(true), "modes": norm(np.asarray(modes.H) - true) / base, "whole": norm(error) / base,
        "nearest": norm(np.asarray(rest.measured[near].H) - true) / base,
        "stated": float(np.sqrt(np.sum(np.asarray(whole.variance)))) / base,
    }, whole  # fmt: skip


def place(console: Console, found: OverAmplitude) -> None:
    """What changes the modes of level 1 into those of a higher one, as the diagnosis says."""
    for k in range(1, len(LEVELS)):
        began = time.process_time()
        told = modalax.diagnose(Measurement.from_frfs([found.measured[k]]), found.models[0], time=60)
        causes = ", ".join(f"{c['name']} at {'-'.join(map(str, c['where']))}" for c in told.causes) or "no cause"
        console.print(
            f"level {LEVELS[k]} against the modes of level 1: {told.verdict}; {causes}; "
            f"{time.process_time() - began:.0f} CPU s"
        )


def draw(out: Path, found: OverAmplitude, frfs: list[FRF], predicted: FRF, which: int) -> None:
    """Frequency and damping over the level; the held-out level measured, linear and predicted."""
    out.mkdir(parents=True, exist_ok=True)
    x = np.geomspace(0.5 * found.level[0], 1.5 * found.level[-1], 80)
    f, df, z, dz = found.band(x)
    fig, axes = plt.subplots(2, f.shape[1], figsize=(3 * f.shape[1], 5.5), sharex=True, layout="constrained")
    for k in range(f.shape[1]):
        for ax, y, dy, seen in (
            (axes[0, k], f, df, found.frequency_hz), (axes[1, k], 100 * z, 100 * dz, 100 * found.damping_ratio)
        ):  # fmt: skip
            ax.fill_between(x, y[:, k] - 2 * dy[:, k], y[:, k] + 2 * dy[:, k], alpha=0.3)
            ax.plot(x, y[:, k])
            ax.plot(found.level, seen[:, k], "ko", markersize=4)
        axes[0, k].set_title(f"Mode {k + 1}")
        axes[1, k].set(xlabel="Force [N rms]", xscale="log")
    axes[0, 0].set_ylabel("Frequency [Hz]")
    axes[1, 0].set_ylabel("Damping [%]")
    fig.savefig(out / "modes.png")
    fig, axes = plt.subplots(3, 1, figsize=(9, 9), sharex=True, layout="constrained")
    freq = np.asarray(frfs[which].freq)
    for o, ax in enumerate(axes):
        ax.semilogy(freq, np.abs(np.asarray(frfs[which].H)[:, o, 0]), "k.", markersize=4, label="measured")
        ax.semilogy(freq, np.abs(linear(found)[:, o, 0]), "C3-", linewidth=1, label="linear modes of level 1")
        ax.semilogy(freq, np.abs(np.asarray(predicted.H)[:, o, 0]), "C0-", linewidth=1, label="predicted")
        ax.set_ylabel(f"Accelerance at {DOFS[o]} [1/kg]")
    axes[0].legend()
    axes[0].set_title(f"Level {LEVELS[which]}, held out")
    axes[-1].set_xlabel("Frequency [Hz]")
    fig.savefig(out / "held_out.png")


def main() -> None:
    """Fit, hold out, diagnose, draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="folder for the pictures")
    parser.add_argument("--no-place", action="store_true", help="leave the diagnosis by place out")
    parser.add_argument(
        "--predict", type=float, nargs="*", default=[], metavar="N",
        help="levels [N rms] whose FRFs are predicted from all four and written to the folder as predicted_N.npz",
    )  # fmt: skip
    options = parser.parse_args()
    if options.predict and not options.out:
        parser.error("--predict needs a folder to write to: --out")
    console = Console(width=150)
    began, cpu = time.time(), time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        frfs = levels(Path(os.environ["MODALAX_DATA"]) / "f16")
    found = over_amplitude(Measurement.from_frfs(frfs))
    tell_modes(console, found)
    console.print("What the modes fitted to each level leave of its FRFs: " + ", ".join(
        f"{100 * norm(np.asarray(frf.H) - np.asarray(m.frf(frf.freq, form=frf.form).H)) / norm(np.asarray(frf.H)):.1f}"
        for frf, m in zip(found.measured, found.models, strict=True)) + " %")  # fmt: skip
    rows = Table(
        "held out", "linear modes miss", "predicted, of that error", "by the modes alone", "stated", "nearest level"
    )
    for which in HELD_OUT:
        rest, e, whole = hold_out(frfs, which)
        rows.add_row(
            f"level {LEVELS[which]}",
            *(f"{100 * e[k]:.1f} %" for k in ("linear", "whole", "modes", "stated", "nearest")),
        )
        if options.out and which == HELD_OUT[0]:
            draw(options.out, found, frfs, whole, which)
    console.print(rows)
    for level in options.predict:
        options.out.mkdir(parents=True, exist_ok=True)
        path = options.out / f"predicted_{level:g}.npz"
        modalax.save(Measurement.from_frfs([found.frf(level)]), path, overwrite=True)
        console.print(f"{path} written")
    if not options.no_place:
        place(console, found)
    console.print(f"{time.process_time() - cpu:.0f} CPU s, {time.time() - began:.0f} s")


if __name__ == "__main__":
    main()
