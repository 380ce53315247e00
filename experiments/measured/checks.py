"""What ``modalax check`` says of every measured file: ``MODALAX_DATA=... python experiments/measured/checks.py``.

Universal files, the steel beam, the aeroplane, the raw hammer hits and the records of the F-16, nothing set by hand;
for a file without FRFs or time records, why.
"""

import argparse
import os
import sys
import time
import warnings
from pathlib import Path

import jax
from threadpoolctl import threadpool_limits

from modalax.check import check

jax.config.update("jax_enable_x64", True)
threadpool_limits(1)
FOLDERS = ("uff/*.uff", "steel_beam/*.npz", "uliege_plane/frf.npz", "hammer_hits/*.npy", "f16/*.mat")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="part of the names to take")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    root = Path(os.environ["MODALAX_DATA"])
    for path in [p for pattern in FOLDERS for p in sorted(root.glob(pattern))]:
        name = str(path.relative_to(root))
        if given.only not in name:
            continue
        began = time.process_time()
        try:
            found = check(path)
        except ValueError as error:
            print(f"{name}: {str(error).removeprefix(str(path)).lstrip(': ')[:110]}")
            continue
        print(f"{name}: {len(found)} findings, {time.process_time() - began:.1f} CPU s")
        for f in found:
            print(f"    {f.what} ({f.place}) {f.measure}, sure {f.sure:.2f}: {f.evidence}")


if __name__ == "__main__":
    sys.exit(main())
