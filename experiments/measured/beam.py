"""A bolted beam at four force levels: ``MODALAX_DATA=... python experiments/measured/beam.py --out out/beam``.

The simulation is one linear mode fitted at the lowest level. ``diagnose`` is asked about all levels; it fits joints
together with the mode by all of them but the highest, which it predicts.
"""

import argparse
from pathlib import Path
from time import process_time

import jax
import jax.numpy as jnp
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from modalax.data import Measurement
from modalax.data.datasets import brake_reuss_beam
from modalax.diagnose import diagnose
from modalax.diagnose.joint_laws import Explained, compare_laws, modes_at
from modalax.diagnose.jointed.answer import JointDiagnosis
from modalax.identify import refine, residues
from modalax.model import ModalModel
from modalax.model.modal import poles_from

matplotlib.use("Agg")
jax.config.update("jax_enable_x64", True)
threadpool_limits(1)

KNOTS = 9


def levels(measurement: Measurement, which: list[int]) -> Measurement:
    """Some of the runs."""
    k = jnp.array(which)
    return measurement.replace(H=measurement.H[k], level=measurement.level[k], force=measurement.force[k])


def linear_mode(measurement: Measurement, run: int) -> ModalModel:
    """One mode fitted to one run by maximum likelihood, from the peak."""
    frf = measurement.run(run)
    peak = float(frf.freq[int(np.argmax(np.abs(np.asarray(frf.H)[:, 0, 0])))])
    return refine(frf, residues(frf, poles_from([peak], [0.002]), residuals="none"), residuals="none").model


def any_law(measurement: Measurement) -> np.ndarray:
    """Relative error of each sample under the best law of any form: stiffness and damping free over the amplitude.

    One mode whose frequency and damping are piecewise linear in the measured amplitude, and a constant. What is left is
    no function of the amplitude alone: drift between runs, the exciter, more than one mode.
    """
    freq = np.asarray(measurement.freq)
    H = np.asarray(measurement.H)[:, :, 0, 0] / -((2 * np.pi * freq) ** 2)
    A = np.asarray(measurement.force) * np.abs(H)
    knots = np.linspace(0.0, A.max(), KNOTS)
    unit, centre = np.abs(H).mean(), freq.mean()

    def error(x: np.ndarray) -> np.ndarray:
        f = centre + np.interp(A, knots, x[4 : 4 + KNOTS])
        zeta = 1e-3 * np.interp(A, knots, x[4 + KNOTS :])
        model = unit * ((x[0] + 1j * x[1]) / (f**2 - freq**2 + 2j * zeta * f**2) + x[2] + 1j * x[3])
        return model / H - 1

    start = np.r_[centre, 0, 0, 0, np.zeros(KNOTS), np.linspace(1, 5, KNOTS)]
    fit = least_squares(lambda x: np.stack([error(x).real, error(x).imag]).ravel(), start, x_scale="jac")
    return error(fit.x)


def missed(explained: Explained | ModalModel, measurement: Measurement) -> np.ndarray:
    """Norm of what a model misses over the norm of the FRF, one number a run."""
    H = np.asarray(measurement.H)
    out = []
    for k in range(measurement.runs):
        if isinstance(explained, ModalModel):
            P = explained.frf(measurement.freq, form=measurement.form)
        else:
            P = explained.extended.predict(measurement.force[k], measurement.freq, form=measurement.form)
        out.append(np.linalg.norm(np.asarray(P.H) - H[k]) / np.linalg.norm(H[k]))
    return np.array(out)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/beam"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    console = Console(width=140)
    everything = brake_reuss_beam(drive_point=True)
    lower, top = levels(everything, [0, 1, 2]), everything.runs - 1

    each = [linear_mode(everything, k) for k in range(everything.runs)]
    mode = each[0]
    linear = Table(title="One linear mode at each level", title_justify="left")
    for name in ("force [N]", "frequency [Hz]", "damping [%]", "missed by its own fit [%]", "by that of 0.19 N [%]"):
        linear.add_column(name, justify="right")
    for k, m in enumerate(each):
        own, first = missed(m, levels(everything, [k]))[0], missed(mode, levels(everything, [k]))[0]
        linear.add_row(
            f"{float(everything.level[k]):.2f}", f"{float(m.frequency_hz[0]):.3f}",
            f"{100 * float(m.damping_ratio[0]):.3f}", f"{100 * own:.1f}", f"{100 * first:.1f}",
        )  # fmt: skip
    console.print(linear)

    floor = any_law(lower)
    repeat = float(np.sqrt(np.mean(np.abs(floor) ** 2)))
    console.print(
        f"no law of the amplitude alone leaves less than {100 * repeat:.1f} % (levels 1 to 3, root mean square)"
    )
    sigma = repeat * np.abs(np.asarray(lower.H))

    began = process_time()
    found = diagnose(everything, mode)
    console.print(str(found))
    console.print(f"{process_time() - began:.0f} CPU s, whole catalogue, default time")
    if not isinstance(found, JointDiagnosis):
        console.print("no joint was fitted together with the mode, so there is nothing more to show")
        return
    table = Table(title="Joints fitted together with the mode, levels 1 to 3", title_justify="left")
    for name in ("joint", "probability", "missed at 0.19, 0.49, 0.97 N [%]", "held-out 1.46 N [%]", "gain"):
        table.add_column(name, justify="left" if name == "joint" else "right")
    reference = missed(mode, everything)[top]
    for e in found.candidates:
        m, law = missed(e.explained, everything), e.explained.extended.causes[0]
        knots = f" of {law.count} values" if e.explained.slugs == ("free_law",) else ""
        table.add_row(
            " + ".join(e.explained.slugs) + knots, f"{e.probability:.3f}",
            ", ".join(f"{100 * v:.1f}" for v in m[:top]), f"{100 * m[top]:.1f}", f"{reference / m[top]:.1f}",
        )  # fmt: skip
    console.print(table)
    best = found.chosen.explained
    for cause, p, s in zip(best.extended.causes, best.extended.params, best.extended.spread, strict=True):
        for q, value, std in zip(cause.parameters, np.asarray(p), np.asarray(s), strict=True):
            console.print(f"  {cause.slug} {q.name}: {value:.4g} +- {1.96 * std:.2g} {q.unit}")

    (held,) = compare_laws(lower.replace(force=None), mode, [best.extended.causes], place="beam", sigma=sigma)
    mean = everything.replace(force=np.asarray(everything.level)[:, None] * np.ones(everything.force.shape))
    console.print(
        "  with the mean force of each run instead of that of each line, missed at the four levels [%]: "
        + ", ".join(f"{100 * v:.1f}" for v in missed(held, mean))
    )

    amplitude = np.linspace(1e-5, 2.9e-4, 57)
    value, std = modes_at(best, amplitude)
    for k in range(2, len(amplitude), 9):
        console.print(
            f"  at {1e6 * amplitude[k]:5.0f} um: {value[0, 0, k]:.3f} +- {1.96 * std[0, 0, k]:.3f} Hz, "
            f"{100 * value[1, 0, k]:.3f} +- {196 * std[1, 0, k]:.3f} %"
        )
    pictures(args.out, everything, mode, best, amplitude, value, std)
    console.print(f"pictures: {args.out}/levels.png, {args.out}/amplitude.png")


def pictures(
    out: Path, data: Measurement, mode: ModalModel, best: Explained, amplitude: np.ndarray, value: np.ndarray,
    std: np.ndarray,
) -> None:  # fmt: skip
    """The FRF at every level, and frequency and damping over the amplitude."""
    freq = np.asarray(data.freq)
    fig, axes = plt.subplots(1, data.runs, figsize=(13, 3.4), sharey=True, layout="constrained")
    for k, ax in enumerate(axes):
        ax.semilogy(freq, np.abs(np.asarray(data.H)[k, :, 0, 0]), "k.", ms=4, label="measured")
        ax.semilogy(
            freq,
            np.abs(np.asarray(mode.frf(data.freq, form=data.form).H)[:, 0, 0]),
            "C0--",
            label="linear mode of 0.19 N",
        )
        P = best.extended.predict(data.force[k], data.freq, form=data.form).H
        ax.semilogy(freq, np.abs(np.asarray(P)[:, 0, 0]), "C1", label=" + ".join(best.slugs))
        held = ", held out" if k == data.runs - 1 else ""
        ax.set(title=f"{float(data.level[k]):.2f} N{held}", xlabel="frequency [Hz]")
        ax.grid(alpha=0.3)
    axes[0].set_ylabel("|accelerance| [(m/s²)/N]")
    axes[0].legend(fontsize=8)
    fig.savefig(out / "levels.png", dpi=130)
    fig, axes = plt.subplots(1, 2, figsize=(11, 3.8), layout="constrained")
    for ax, scale, row, label in zip(axes, (1, 100), (0, 1), ("frequency [Hz]", "damping ratio [%]"), strict=True):
        mid, half = scale * value[row, 0], scale * 1.96 * std[row, 0]
        ax.fill_between(1e6 * amplitude, mid - half, mid + half, alpha=0.3, color="C1", label="95 % interval")
        ax.plot(1e6 * amplitude, mid, "C1", label=" + ".join(best.slugs))
        ax.set(xlabel="amplitude of the response [µm]", ylabel=label)
        ax.grid(alpha=0.3)
    points = direct(data, best)
    for k in range(data.runs):
        for ax, y in zip(axes, points[1:], strict=True):
            ax.plot(
                1e6 * points[0][k],
                y[k],
                ".",
                ms=4,
                color=f"C{[0, 2, 4, 3][k]}",
                label=f"{float(data.level[k]):.2f} N, line by line",
            )
    axes[0].legend(fontsize=8)
    fig.savefig(out / "amplitude.png", dpi=130)


def direct(data: Measurement, best: Explained) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Amplitude [m], frequency [Hz] and damping [%] read from every line of every run, the mode's size as fitted."""
    base = best.extended.base
    freq = np.asarray(data.freq)
    omega = 2 * np.pi * freq
    H = np.asarray(data.H)[:, :, 0, 0] / -(omega**2)
    R = complex(np.asarray(base.residues)[0, 0, 0])
    pole = complex(np.asarray(base.poles)[0])
    size = (R + R.conjugate()).real * 1j * omega - 2 * (R * pole.conjugate()).real
    Z = size / (H - complex(np.asarray(base.upper)[0, 0])) + omega**2
    f = np.sqrt(Z.real) / (2 * np.pi)
    return np.asarray(data.force) * np.abs(H), f, 100 * Z.imag / (2 * Z.real)


if __name__ == "__main__":
    main()
