"""Five hammer hits on one structure: ``MODALAX_DATA=... python experiments/measured/hammer.py [--out out/hammer]``.

Records to FRFs, to what the check finds, to modes over the whole band, with nothing set by hand. The units of the
records are not known; the response is taken for an acceleration.
"""

import argparse
import time
from pathlib import Path

import jax
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from rich.console import Console
from threadpoolctl import threadpool_limits

from modalax.check import check
from modalax.cli.tables import mode_table
from modalax.data.datasets import Records, hammer_hits
from modalax.data.frf import FRF
from modalax.data.records import frf_from_blocks
from modalax.identify import Fit, fit

matplotlib.use("Agg")
jax.config.update("jax_enable_x64", True)
threadpool_limits(1)

SURE = 0.9  # grade from which a mode is told as one


def draw(records: Records, frf: FRF, found: Fit, sure: list[dict], folder: Path) -> None:
    """The hits, and the FRF with its coherence and the modes."""
    folder.mkdir(parents=True, exist_ok=True)
    fig, axes = plt.subplots(1, 2, figsize=(11, 3.5), layout="constrained")
    start = int(np.argmax(np.abs(records.input[0])))
    for force, response in zip(records.input, records.output, strict=True):
        hit = slice(max(start - 60, 0), start + 140)
        axes[0].plot(1e3 * records.time[hit], np.roll(force, start - np.argmax(np.abs(force)))[hit])
        axes[1].plot(records.time, response, linewidth=0.3)
    axes[0].set(xlabel="Time [ms]", ylabel="Force [as recorded]", title="Five hits, moved over each other")
    axes[1].set(xlabel="Time [s]", ylabel="Response [as recorded]", title="Their responses have died away")
    fig.savefig(folder / "hits.png", dpi=150)
    freq, H = np.asarray(frf.freq), np.asarray(frf.H)[:, 0, 0]
    fig, axes = plt.subplots(2, 1, figsize=(11, 6), sharex=True, height_ratios=(3, 1), layout="constrained")
    axes[0].semilogy(freq, np.abs(H), "k", linewidth=0.8, label="measured")
    model = np.asarray(found.model.frf(frf.freq, form=frf.form).H)[:, 0, 0]
    axes[0].semilogy(freq, np.abs(model), "C1", linewidth=0.8, label="synthesised")
    for mode in sure:
        axes[0].axvline(mode["frequency_hz"], color="C0", linewidth=0.5, linestyle=":")
    axes[0].set_ylabel("|FRF| [as recorded]")
    axes[0].legend()
    axes[1].plot(freq, np.asarray(frf.coherence)[:, 0, 0], linewidth=0.8)
    axes[1].set(xlabel="Frequency [Hz]", ylabel="Coherence [-]", ylim=(0, 1.02))
    fig.savefig(folder / "frf.png", dpi=150)


def main() -> None:
    """Read, check, fit, tell, draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="folder for the pictures")
    options = parser.parse_args()
    console, began = Console(width=110), time.process_time()
    records = hammer_hits()
    frf = frf_from_blocks(
        records.input[:, :, None], records.output[:, :, None], records.sample_rate, unit="m/s^2", band=(0.0, 5000.0)
    )
    console.print(f"median coherence {float(np.median(np.asarray(frf.coherence))):.4f}")
    findings = check(frf)
    console.print("check: " + ("; ".join(f"{f.what} at {f.place}" for f in findings) or "nothing wrong was found"))
    found = fit(frf)
    answer = found.to_dict()
    console.print(mode_table(answer["modes"]))
    sure = [mode for mode in answer["modes"] if mode["grade"] >= SURE]
    told = ", ".join(f"{m['frequency_hz']:.2f}" for m in sure)
    console.print(f"{len(sure)} of {len(answer['modes'])} with a grade of {SURE} and more: {told} Hz")
    noise = answer.get("unexplained_noise")
    part = "" if noise is None else f", {100 * noise:.2f} % noise"
    console.print(f"unexplained: {100 * answer['unexplained']:.2f} % of the sum of squares{part}")
    if options.out:
        draw(records, frf, found, sure, options.out)
    console.print(f"{time.process_time() - began:.0f} CPU s")


if __name__ == "__main__":
    main()
