"""Write one case: ``python -m generator --seed 1 --out DIR [--cause SLUG] [--d D] [--family F]``."""

import argparse
import sys

from . import CATALOGUE, FAMILIES, OUTSIDE_CATALOGUE, draw_case
from .noise import KINDS, VARIANCES


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m generator", description=__doc__)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--out", required=True)
    parser.add_argument("--cause", help=f"clean, {', '.join((*CATALOGUE, *OUTSIDE_CATALOGUE))}, or several with +")
    parser.add_argument("--d", type=float, help="distance in standard deviations")
    parser.add_argument("--family", choices=FAMILIES)
    parser.add_argument("--noise", choices=KINDS)
    parser.add_argument("--noise-level", type=float)
    parser.add_argument("--variance", choices=VARIANCES)
    parser.add_argument("--spread", action=argparse.BooleanOptionalAction, default=None)
    parser.add_argument("--form", choices=("receptance", "mobility", "accelerance"))
    parser.add_argument("--inputs", type=int)
    parser.add_argument("--runs", type=int)
    parser.add_argument("--structure", type=int, help="a seed of its own for the structure and its test")
    given = vars(parser.parse_args())
    out, seed = given.pop("out"), given.pop("seed")
    try:
        draw_case(seed, **given).save(out)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
