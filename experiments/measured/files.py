"""What an unattended fit says of every measured file: ``MODALAX_DATA=... python experiments/measured/files.py``.

Every universal file that holds FRFs, the steel beam, the aeroplane and the FRFs of the five raw hammer hits, the whole
band, nothing set by hand. Printed are the modes with their grades and flags, what stays unexplained, how much of that
is noise, and what is said of the measurement; for a file without usable FRFs, why. ``--no-refine`` keeps the diagram's
modes.
"""

import argparse
import os
import sys
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

import jax
import numpy as np
from rich.console import Console
from threadpoolctl import threadpool_limits

import modalax
from modalax.cli.tables import mode_table, print_remarks
from modalax.data.frf import FRF
from modalax.data.records import frf_from_blocks
from modalax.identify import fit

jax.config.update("jax_enable_x64", True)
threadpool_limits(1)


def measured(folder: Path) -> Iterator[tuple[str, FRF | str]]:
    """Names of files and their FRFs, or why there are none."""
    for path in [
        *sorted((folder / "uff").glob("*.uff")),
        folder / "steel_beam/frf.npz",
        folder / "uliege_plane/frf.npz",
    ]:
        try:
            found = modalax.load(path)
        except ValueError as error:
            yield path.name, str(error).split(": ", 1)[-1]
            if "form=" in str(error):
                yield f"{path.name} as accelerance", modalax.load(path, form="accelerance").run(0)
            continue
        yield (
            (path.parent.name if path.suffix == ".npz" else path.name),
            (found.run(0) if hasattr(found, "run") else f"holds a {type(found).__name__}, no FRFs"),
        )
    yield "hammer_hits", hammer(folder / "hammer_hits")


def hammer(folder: Path) -> FRF:
    """FRFs of the five hits, their records taken whole; the response is taken for an acceleration."""
    records = np.stack([np.load(folder / f"measurements_{k + 1}.npy") for k in range(5)])
    time_axis, force, response = records[:, 0], records[:, 1], records[:, 2]
    fs = 1 / np.median(np.diff(time_axis[0]))
    return frf_from_blocks(force[:, :, None], response[:, :, None], float(fs), unit="m/s^2", band=(0.0, 5000.0))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--no-refine", action="store_true", help="the diagram's modes")
    parser.add_argument("--only", default="", help="part of the names to take")
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    console = Console(width=140)
    for name, frf in measured(Path(os.environ["MODALAX_DATA"])):
        if args.only not in name:
            continue
        if isinstance(frf, str):
            console.print(f"{name}: {frf[:150]}", highlight=False, markup=False)
            continue
        lines, outputs, inputs = frf.shape
        console.print(
            f"\n{name}: {frf.form}, {outputs} x {inputs} x {lines} lines, {float(frf.freq[0]):g} to "
            f"{float(frf.freq[-1]):g} Hz", highlight=False, markup=False,
        )  # fmt: skip
        began = time.process_time()
        try:
            answer = fit(frf, refine=not args.no_refine).to_dict()
        except ValueError as error:
            console.print(f"no fit: {error}", highlight=False, markup=False)
            continue
        console.print(mode_table(answer["modes"]))
        print_remarks(console, answer)
        print(f"{time.process_time() - began:.0f} CPU s")


if __name__ == "__main__":
    sys.exit(main())
