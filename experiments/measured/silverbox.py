"""An electronic Duffing oscillator: ``MODALAX_DATA=... python experiments/measured/silverbox.py [--out out/box]``.

Records to one linear mode, to the law of its spring with an interval, to a simulation of records it was not shown.
The split is the benchmark's own: what is fitted are the ten random multisines, what is predicted is the noise of
growing amplitude before them, and the error is the root mean square of the simulated response (from rest, under the
measured force alone) over that of the measured one. Which law is taken is decided within the multisines: the last two
are held out, and predicted. Nothing is set by hand but the unit and the two parts of the records.
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

from modalax.data.recording import Recording
from modalax.data.reduction import frf_from_recording
from modalax.diagnose.record_laws import FittedLaws, fit_laws
from modalax.files import load_records
from modalax.identify import fit
from modalax.model import ModalModel
from modalax.simulate.joints import Joint, PolynomialStiffness, QuadraticDamping

matplotlib.use("Agg")
jax.config.update("jax_enable_x64", True)
threadpool_limits(1)

RATE = 1e7 / 2**14  # Hz
BAND = (2.0, 200.0)  # Hz, what was excited
GROWING = slice(0, 40_500)  # the benchmark's test
EVERY = slice(40_500, 127_470)  # ten multisines with a pause after each
FITTED, CHECKED = slice(40_500, 110_076), slice(110_076, 127_470)  # eight of them and two
LENGTH = 8697  # samples of a multisine and its pause
PUBLISHED = {"linear": 13.2, "better": 1.1, "best": 0.44}  # % of the response, as published for the benchmark


def records() -> Recording:
    """Force and displacement about their means over the multisines."""
    path = Path(os.environ["MODALAX_DATA"]) / "silverbox" / "SNLS80mV.mat"
    found = load_records([path], fs=RATE)
    u, y = (found.data[0, :, found.index(name)] for name in ("V1", "V2"))
    both = np.stack([u - u[EVERY].mean(), y - y[EVERY].mean()], axis=1)
    return Recording(both[None], RATE, ("force", "motion"), ("N", "m"), (1, 2))


def one_mode(recording: Recording) -> ModalModel:
    """The linear mode of the multisines."""
    frf = frf_from_recording(
        Recording(recording.data[:, FITTED], RATE, recording.channels, recording.units, recording.numbers),
        kind="random", inputs=["1"], outputs=["1"],
    )  # fmt: skip
    return fit(frf, band=BAND).model


def laws(mode: ModalModel, motion: np.ndarray) -> dict[str, list[Joint]]:
    """Sets of laws with start values: a hundredth of the force of the mode's own stiffness at the usual motion."""
    residue = complex(mode.shapes[0, 0] * mode.participation[0, 0])
    omega, usual = 2 * np.pi * float(mode.frequency_hz[0]), float(motion.std())
    stiffness = omega / (2 * abs(residue))
    k2, k3 = 0.01 * stiffness / usual, 0.01 * stiffness / usual**2
    cubic, both = PolynomialStiffness((k3,), (3,)), PolynomialStiffness((k2, k3), (2, 3))
    drag = QuadraticDamping(0.01 * stiffness / usual / omega**2)
    return {
        "linear": [], "quadratic damping": [drag], "cubic stiffness": [cubic],
        "quadratic and cubic stiffness": [both], "cubic stiffness and quadratic damping": [cubic, drag],
        "all three": [both, drag],
    }  # fmt: skip


def missed(found: FittedLaws, recording: Recording, part: slice) -> tuple[float, np.ndarray]:
    """Root mean square error of the simulated response over that of the measured one, and the error."""
    u, y = recording.data[0, part].T
    error = found.simulate(u, RATE)[:, 0] - y
    return float(np.sqrt(np.mean(error**2) / np.mean(y**2))), error


def fitted(recording: Recording, part: slice, mode: ModalModel, joints: list[Joint]) -> FittedLaws:
    """Laws fitted to multisines, each a run of its own."""
    u, y = recording.data[0, part].reshape(-1, LENGTH, 2).transpose(2, 0, 1)
    return fit_laws(u, y[:, :, None], RATE, mode, joints, ["1"], band=BAND)


def tell(console: Console, found: FittedLaws) -> None:
    """The mode and the laws with 95 % intervals."""
    m = found.model
    console.print(f"mode: {float(m.frequency_hz[0]):.3f} Hz, damping {100 * float(m.damping_ratio[0]):.3f} %")
    for joint, spread in zip(found.joints, found.std, strict=True):
        for name, value in joint.parameters.items():
            told = zip(np.atleast_1d(np.asarray(value)), np.atleast_1d(spread[name]), strict=True)
            console.print(f"{joint.slug} {name}: " + ", ".join(f"{v:.5g} ± {2 * s:.2g}" for v, s in told))


def main() -> None:
    """Fit each set, decide by the multisines held out, predict the growing noise."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="folder for the picture")
    options = parser.parse_args()
    console = Console(width=130)
    began, cpu = time.time(), time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        recording = records()
        mode = one_mode(recording)
    sets = laws(mode, recording.data[0, FITTED, 1])
    rows, held = Table("laws", "left of the spectra fitted", "error on the two multisines held out"), {}
    for name, joints in sets.items():
        found = fitted(recording, FITTED, mode, joints)
        held[name] = missed(found, recording, CHECKED)[0]
        rows.add_row(name, f"{100 * found.unexplained:.2f} %", f"{100 * held[name]:.2f} %")
    console.print(rows)
    best = min(held, key=lambda name: held[name])
    console.print(f"taken: {best}")
    end = Table("predicted: the noise of growing amplitude", "error, of the response's root mean square")
    errors, base = {}, 0.0
    for name in dict.fromkeys(("linear", "cubic stiffness", best)):
        found = fitted(recording, EVERY, mode, sets[name])
        size, errors[name] = missed(found, recording, GROWING)
        base = base or size
        end.add_row(name, f"{100 * size:.2f} %: {base / size:.1f} times below the linear mode")
        if name == best:
            tell(console, found)
    console.print(end)
    console.print("published: " + ", ".join(f"{size:g} % ({name})" for name, size in PUBLISHED.items()))
    console.print(f"{time.process_time() - cpu:.0f} CPU s, {time.time() - began:.0f} s")
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        t = np.arange(GROWING.stop) / RATE
        fig, ax = plt.subplots(figsize=(9, 4), layout="constrained")
        ax.plot(t, recording.data[0, GROWING, 1], "0.7", linewidth=0.4, label="measured")
        for name, error in errors.items():
            ax.plot(t, error, linewidth=0.4, label=f"error, {name}")
        ax.set(xlabel="Time [s]", ylabel="Response [V]")
        ax.legend()
        fig.savefig(options.out / "growing.png")


if __name__ == "__main__":
    main()
