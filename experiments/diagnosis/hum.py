"""Power at which hum of one source can be told by its rank: ``python experiments/diagnosis/hum.py``.

Hum on one line of all channels, of unknown gains and phases, in noise of known variance: the largest singular value of
the channels is all that is left to look at. The level is what a chance of 0.001, the share of hum among the alarms,
leaves each of so many independent tries.
"""

import argparse

import numpy as np
import scipy.stats

from modalax.diagnose.causes.hum_pickup import largest
from modalax.diagnose.thresholds import THRESHOLDS

TONES = 8  # what two mains frequencies, two ways of looking and the forms of a line, much alike, cost together


def draw(rng: np.random.Generator, count: int, outputs: int, columns: int, d: float) -> np.ndarray:
    """Noise of unit variance in both parts, and hum at distance ``d``, shape ``(count, outputs, columns)``."""
    noise = rng.normal(size=(2, count, outputs, columns))
    gains = np.exp(rng.uniform(np.log(0.3), np.log(1.5), (count, outputs))) * rng.choice([-1, 1], (count, outputs))
    hum = gains[:, :, None] * np.exp(2j * np.pi * rng.random((count, 1, columns)))
    return noise[0] + 1j * noise[1] + d * hum / np.linalg.norm(hum, axis=(1, 2), keepdims=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--outputs", type=int, default=6)
    parser.add_argument("--columns", type=int, default=6, help="inputs times runs")
    parser.add_argument("--draws", type=int, default=20_000)
    args = parser.parse_args()
    rng, shape = np.random.default_rng(0), (args.outputs, args.columns)
    level = THRESHOLDS.alarm * THRESHOLDS.share_of_hum / TONES
    null = largest(draw(rng, 10 * args.draws, *shape, 0.0))
    least = float(np.quantile(null, 1 - level))
    print(f"{shape[0]} outputs, {shape[1]} columns: hum counts from a squared singular value of {least:.1f}")
    for d in (6.5, 8.0, 10.0):
        power = (largest(draw(rng, args.draws, *shape, d)) > least).mean()
        known = scipy.stats.norm.sf(scipy.stats.norm.isf(level / 2) - d)
        print(f"d = {d:g}: power {power:.2f}; {known:.2f} if gains and phases were known")


if __name__ == "__main__":
    main()
