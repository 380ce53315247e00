"""A flying wing: eight measured modes at 30 sensors beside those of its finite-element model.

``MODALAX_DATA=... python experiments/measured/wing.py [--out out/wing]``. The sensors' plane coordinates are turned
into the model's axes, matched to the nearest nodes of the model, and the modes are paired by MAC. Nothing else is set.
"""

import argparse
import os
import warnings
from pathlib import Path

import jax
import matplotlib
import numpy as np
import scipy.io
from rich.console import Console
from rich.table import Table

from modalax.data import Geometry
from modalax.files.finite_elements import import_finite_elements
from modalax.model.correlation import Correlation, correlate
from modalax.model.matching import Matched, match
from modalax.model.mode_table import ModeTable
from modalax.show import mode_names, plot_mac
from modalax.show.shape_pairs import plot_shape_pairs

matplotlib.use("Agg")
jax.config.update("jax_enable_x64", True)

# The test counts span and chord from the nose, the model from elsewhere, along y (to the other side) and x.
ORIGIN = np.array([1.2923, 0.0, 1.3369])  # the test's origin in the model [m]
AXES = np.array([[0.0, 1.0], [-1.0, 0.0], [0.0, 0.0]])
PANELS = [(1, 2, 4, 3), (3, 4, 6, 5), (5, 6, 8, 7), (7, 8, 10, 9), (9, 10, 12, 11), (13, 14, 16, 15), (15, 16, 18, 17),
          (17, 18, 20, 19), (19, 20, 22, 21), (21, 22, 24, 23), (1, 2, 30, 29), (29, 30, 26, 25), (25, 26, 28, 27),
          (27, 28, 14, 13)]  # fmt: skip
FARTHEST = 0.05  # m
APART = 3.0  # times the usual deviation of frequencies, from which one stands out


def measured(folder: Path) -> tuple[ModeTable, Geometry]:
    """Modes of the ground vibration test, and the places of its sensors in the model's axes."""
    found = scipy.io.loadmat(folder / "Modes_GVT_huggin_v3.mat", squeeze_me=True)
    names = [str(k + 1) for k in range(30)]
    places = ORIGIN + found["full_gvt_accelerpos"] @ AXES.T
    lines = [[str(n) for n in (*panel, panel[0])] for panel in PANELS]
    return ModeTable.of(found["Freqs"], np.nan, found["ModeShapes"].T, [f"{n}:+Z" for n in names]), Geometry(
        names, places, lines
    )


def compare(folder: Path) -> tuple[ModeTable, Geometry, Matched, np.ndarray, np.ndarray, Correlation]:
    """Match and pair."""
    table, places = measured(folder)
    deck = folder / "mAEWing2_Full_GVT_accelero_v2.dat"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        model = import_finite_elements(next(folder.glob("*.pch")), grids=deck, units="in-lbf")
    assert model.geometry is not None
    matched = match(table.dofs, model.simulation.outputs, places=places, model_places=model.geometry, farthest=FARTHEST)
    frequency, shapes = np.asarray(model.simulation.frequency_hz), np.real(model.simulation.shapes)
    return table, places, matched, frequency, shapes, correlate(table, frequency, matched.seen(shapes))


def tell(console: Console, table: ModeTable, matched: Matched, found: Correlation) -> None:
    """Print what matched, the pairs, the general inaccuracy, and what stands out."""
    console.print(
        f"{len(matched.dofs)} sensors matched to nodes, {1e3 * np.nanmedian(matched.distance):.1f} mm away in the "
        f"median, {1e3 * np.nanmax(matched.distance):.1f} mm at most "
        f"({matched.dofs[int(np.nanargmax(matched.distance))]})"
    )
    rows = Table("mode", "measured [Hz]", "model [Hz]", "apart [%]", "MAC")
    for k, f in enumerate(found.frequency_hz):
        if found.pairs[k] < 0:
            rows.add_row(str(k + 1), f"{f:.2f}", "none alike", "", f"{found.mac[k].max():.2f} at best")
        else:
            model = found.model_frequency_hz[k]
            rows.add_row(
                str(k + 1), f"{f:.2f}", f"{model:.2f}", f"{100 * found.change[k]:+.1f}", f"{found.pair_mac[k]:.3f}"
            )
    console.print(rows)
    change = found.change[found.pairs >= 0]
    usual = 1.4826 * np.median(np.abs(change))
    console.print(
        f"general inaccuracy of the frequencies: {100 * usual:.1f} % (robust standard deviation about no error)"
    )
    far = [k for k in np.flatnonzero(found.pairs >= 0) if abs(found.change[k]) > APART * usual]
    console.print("frequencies beyond three times that: " + (", ".join(
        f"{found.frequency_hz[k]:.2f} Hz ({100 * found.change[k]:+.1f} %)" for k in far) or "none"))  # fmt: skip
    order = np.argsort(found.comac)[:5]
    console.print("sensors that agree least (CoMAC): " + ", ".join(
        f"{table.dofs[k]} {found.comac[k]:.2f}" for k in order))  # fmt: skip


def main() -> None:
    """Compare, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="folder for the pictures")
    options = parser.parse_args()
    folder = Path(os.environ["MODALAX_DATA"]) / "nastran" / "mAEWing2_gvt"
    table, places, matched, frequency, shapes, found = compare(folder)
    tell(Console(width=110), table, matched, found)
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        paired = np.flatnonzero(found.pairs >= 0)
        model = matched.seen(shapes)[found.pairs[paired]]
        titles = [f"{found.frequency_hz[k]:.2f} Hz, model {found.model_frequency_hz[k]:.2f} Hz" for k in paired]
        plot_shape_pairs(places, table.dofs, table.shapes[paired], model, titles=titles).savefig(
            options.out / "shapes.png"
        )
        names = mode_names(found.frequency_hz), mode_names(frequency)
        plot_mac(found.mac, rows=names[0], columns=names[1], row_title="Measured", column_title="Model").savefig(
            options.out / "mac.png"
        )


if __name__ == "__main__":
    main()
