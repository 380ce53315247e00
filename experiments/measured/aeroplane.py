"""The laboratory aeroplane: ``MODALAX_DATA=... python experiments/measured/aeroplane.py --out out/aeroplane``.

From the measured FRFs, with no frequency given by hand, to the modes: beside the published ones with error bars, and
beside the shapes of a finite-element model. Writes the FRFs as ``aeroplane.npz``, so that

    modalax fit out/aeroplane/aeroplane.npz --band 12 180 --out out/aeroplane/pictures

does the same from the command line; ``--command`` runs that in a process of its own, twice with an empty and then a
filled compilation cache, and says how long each took.
"""

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

import jax
import numpy as np
import scipy.optimize
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from modalax.data.datasets import UliegePlane, uliege_plane
from modalax.identify import Fit, fit, residues
from modalax.model.indicators import mac
from modalax.model.modal import poles_from

jax.config.update("jax_enable_x64", True)
threadpool_limits(1)

BAND = (12.0, 180.0)
# Frequency [Hz] and damping [%] by those who made the test, with a PolyMAX of their own.
PUBLISHED = np.array([
    (18.843, 0.354), (40.122, 0.398), (87.852, 0.551), (89.652, 0.366), (97.071, 0.108), (105.200, 0.048),
    (118.013, 0.424), (125.214, 0.396), (125.584, 0.418), (129.952, 0.673), (135.276, 0.880), (143.372, 0.657),
    (166.266, 0.135),
])  # fmt: skip


def pairs(frequency: np.ndarray, reach: float = 0.01) -> dict[int, int]:
    """For each published mode the found one that belongs to it; each found mode is given once."""
    apart = np.abs(frequency[None, :] / PUBLISHED[:, :1] - 1)
    rows, columns = scipy.optimize.linear_sum_assignment(np.where(apart < reach, apart, 1.0))
    return {int(r): int(c) for r, c in zip(rows, columns, strict=True) if apart[r, c] < reach}


def beside_published(found: Fit) -> Table:
    """Frequencies and dampings beside the published ones."""
    assert found.refined is not None
    f, z = np.asarray(found.model.frequency_hz), 100 * np.asarray(found.model.damping_ratio)
    df, dz = np.asarray(found.refined.frequency_std_hz), 100 * np.asarray(found.refined.damping_std)
    table = Table("mode", "published [Hz]", "found [Hz]", "+-", "apart [%]", "published [%]", "found [%]", "+-")
    mine = pairs(f)
    for k, (frequency, damping) in enumerate(PUBLISHED):
        if k not in mine:
            table.add_row(str(k + 1), f"{frequency:.3f}", "not found")
            continue
        r = mine[k]
        table.add_row(
            str(k + 1), f"{frequency:.3f}", f"{f[r]:.3f}", f"{df[r]:.3f}", f"{100 * (f[r] / frequency - 1):+.3f}",
            f"{damping:.3f}", f"{z[r]:.3f}", f"{dz[r]:.3f}",
        )  # fmt: skip
    for r in sorted({*np.flatnonzero(np.asarray(found.inside)).tolist()} - {*mine.values()}):
        table.add_row("-", "none", f"{f[r]:.3f}", f"{df[r]:.3f}", "", "", f"{z[r]:.3f}", f"{dz[r]:.3f}")
    return table


def beside_elements(plane: UliegePlane, found: Fit) -> tuple[Table, np.ndarray]:
    """For each finite-element shape the measured mode most like it, and MACs on wing and tailplane apart from the fin.

    The same once more for shapes fitted at the published poles: what stays poor there is not the fault of our poles.
    """
    given = residues(found.frf, poles_from(PUBLISHED[:, 0], PUBLISHED[:, 1] / 100))
    own, theirs = (np.asarray(m.participation) for m in (found.model, given))
    fin = np.array([name.endswith("X") for name in plane.frf.inputs])
    whole, again = np.asarray(mac(plane.fe_shapes, own)), np.asarray(mac(plane.fe_shapes, theirs))
    table = Table("FE", "like mode [Hz]", "MAC", "next", "without the fin", "at published poles", "in span of 13 FE")
    basis = np.linalg.qr(plane.fe_shapes.T)[0]
    inside = np.linalg.norm(basis.T @ own.T, axis=0) ** 2 / np.linalg.norm(own.T, axis=0) ** 2
    for k, row in enumerate(whole):
        best = int(np.argmax(row))
        part = np.asarray(mac(plane.fe_shapes[k : k + 1, ~fin], own[best : best + 1, ~fin]))[0, 0]
        table.add_row(
            str(k + 1), f"{float(found.model.frequency_hz[best]):.2f}", f"{row[best]:.3f}", f"{np.sort(row)[-2]:.3f}",
            f"{part:.3f}", f"{again[k].max():.3f}", f"{inside[best]:.3f}",
        )  # fmt: skip
    return table, whole


def repeatable(plane: UliegePlane, found: Fit) -> np.ndarray:
    """MAC of each mode's shape from one accelerometer with that from the next: what the measurement itself can tell."""
    shapes = []
    for sensor in plane.frf.outputs:
        model = residues(found.frf.pick(outputs=[sensor]), found.model.poles)
        shapes.append(np.asarray(model.participation))
    alike = [[float(mac(a[r : r + 1], b[r : r + 1])[0, 0]) for r in range(len(a))] for a, b in
             ((shapes[0], shapes[1]), (shapes[0], shapes[2]), (shapes[1], shapes[2]))]  # fmt: skip
    return np.array(alike)


def draw_published(found: Fit, path: Path) -> None:
    """Frequencies and dampings over the published ones, with 95 % intervals."""
    import matplotlib.pyplot as plt

    assert found.refined is not None
    mine = pairs(np.asarray(found.model.frequency_hz))
    rows, columns = np.array(list(mine)), np.array(list(mine.values()))
    own = np.asarray(found.model.frequency_hz)[columns], 100 * np.asarray(found.model.damping_ratio)[columns]
    std = np.asarray(found.refined.frequency_std_hz)[columns], 100 * np.asarray(found.refined.damping_std)[columns]
    fig, axes = plt.subplots(2, 1, figsize=(9, 6), sharex=True, layout="constrained")
    for ax, k, name in zip(axes, (0, 1), ("Frequency", "Damping"), strict=True):
        given = PUBLISHED[rows, k]
        ax.errorbar(rows + 1, 100 * (own[k] / given - 1), 196 * std[k] / given, fmt="o", capsize=3)
        ax.axhline(0, color="0.5", linewidth=1)
        ax.set_ylabel(f"{name}, found over published [%]")
    axes[1].set(xlabel="Published mode", xticks=np.arange(1, 14), xticklabels=[f"{f:.1f} Hz" for f in PUBLISHED[:, 0]])
    axes[1].tick_params(axis="x", rotation=45)
    fig.savefig(path, dpi=150)


def pictures(plane: UliegePlane, found: Fit, table: np.ndarray, folder: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from modalax.show import mode_names, plot_mac, plot_shapes, save_fit_pictures

    folder.mkdir(parents=True, exist_ok=True)
    save_fit_pictures(found, folder)
    draw_published(found, folder / "published.png")
    names = mode_names(found.model.frequency_hz)
    figure = plot_mac(table, columns=names, row_title="Finite-element shape", column_title="Measured mode")
    figure.savefig(folder / "mac_elements.png", dpi=150)
    model = found.model.transpose().normalised("max")
    figure = plot_shapes(plane.geometry, model.outputs, model.shapes, titles=names)
    figure.savefig(folder / "shapes.png", dpi=150)


def command(out: Path) -> None:
    """Seconds from an empty and from a filled compilation cache to the pictures."""
    cache = out / "cache"
    for name in ("cold, compiling", "compiled before"):
        began = time.perf_counter()
        subprocess.run(
            [
                Path(sys.executable).parent / "modalax", "fit", out / "aeroplane.npz", "--band", "12", "180",
                "--out", out / "pictures", "--overwrite",
            ],
            check=True, stdout=subprocess.DEVNULL, env={**os.environ, "JAX_COMPILATION_CACHE_DIR": str(cache)},
        )  # fmt: skip
        print(f"modalax fit, {name}: {time.perf_counter() - began:.0f} s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/aeroplane"))
    parser.add_argument("--command", action="store_true", help="time the command line as well")
    args = parser.parse_args()
    plane = uliege_plane()
    args.out.mkdir(parents=True, exist_ok=True)
    import modalax

    modalax.save(plane.frf, args.out / "aeroplane.npz", overwrite=True)
    began = time.perf_counter()
    found = fit(plane.frf, band=BAND, progress=lambda text: print(f"{time.perf_counter() - began:6.1f} s  {text}"))
    print(f"fit with compiling: {time.perf_counter() - began:.0f} s, load {os.getloadavg()[0]:.1f}")
    console = Console(width=120)
    console.print(beside_published(found))
    print(f"unexplained part of the FRFs' sum of squares: {100 * float(found.unexplained):.2f} %")
    table, alike = beside_elements(plane, found)
    console.print(table)
    lines = zip(found.model.frequency_hz, repeatable(plane, found).T, strict=True)
    print("MAC of the shape from one accelerometer with that from another, for each mode:")
    for f, row in lines:
        print(f"  {float(f):8.3f} Hz  " + "  ".join(f"{v:.3f}" for v in row))
    pictures(plane, found, alike, args.out)
    if args.command:
        command(args.out)


if __name__ == "__main__":
    sys.exit(main())
