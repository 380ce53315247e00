"""The same modes out of any band, without noise: ``python experiments/identify/bands.py``.

Forty modes between 8 and 160 Hz, 0.3 to 2 % damping, seen at five outputs; thirty bands of 25 to 110 Hz drawn at
random, six of them from 0 Hz, each at 500 lines. Errors are those of modes inside by more than three half-bandwidths,
at the order that :func:`modalax.identify.best_order` chooses and at every higher one of the diagram.
"""

import sys

import jax
import numpy as np
from threadpoolctl import threadpool_limits

from modalax.data.frf import FRF
from modalax.identify import PoleTable, best_order, fdpi, lsce, lscf, plscf, select
from modalax.model.modal import ModalModel

jax.config.update("jax_enable_x64", True)
threadpool_limits(1)

LINES, STEP = 500, 0.05  # lines of a band, and spacing of the lines that it takes every so many of [Hz]
LIMITS = {"chosen": (1e-6, 1e-4), "higher": (1e-5, 1e-3)}
CASES = (
    (lscf, "a", range(20, 101, 4), {}),
    (lscf, "a", range(20, 101, 4), {"solver": "moments"}),
    (plscf, "ac", range(10, 51, 2), {}),
    (plscf, "ac", range(10, 51, 2), {"solver": "moments"}),
    (lsce, "a", range(20, 101, 4), {}),
    (lsce, "ac", range(10, 51, 2), {}),
    (fdpi, "ac", range(20, 51, 3), {}),
    (fdpi, "ac", range(40, 71, 6), {}),
)


def structure() -> ModalModel:
    rng = np.random.default_rng(3)
    frequency = 8 + np.cumsum(rng.uniform(1.5, 6.0, 40))
    return ModalModel.from_real_modes(
        frequency, rng.uniform(0.003, 0.02, 40), rng.normal(size=(40, 5)), rng.uniform(0.5, 2, 40), list("abcde")
    )


def bands(whole: FRF) -> list[FRF]:
    rng = np.random.default_rng(30)
    parts = []
    for k in range(30):
        width = rng.uniform(25, 110)
        lower = 0.0 if k % 5 == 0 else rng.uniform(0, 150 - width)
        every, first = max(1, int(width / STEP) // LINES), int(round(lower / STEP))
        parts.append(whole.lines(slice(first, first + LINES * every, every)))
    return parts


def worst(table: PoleTable, row: int, true: np.ndarray) -> np.ndarray:
    """Largest relative error in frequency and in damping of the poles of one order nearest the true ones."""
    poles = np.asarray(table.poles[row])[np.asarray(table.valid[row])]
    near = poles[np.abs(poles - true[:, None]).argmin(axis=1)]
    zeta, exact = -near.real / np.abs(near), -true.real / np.abs(true)
    return np.max(np.abs([np.abs(near) / np.abs(true) - 1, zeta / exact - 1]), axis=1)


def main() -> None:
    model = structure()
    true, f, zeta = (np.asarray(a) for a in (model.poles, model.frequency_hz, model.damping_ratio))
    print("| estimator, inputs, orders | chosen: frequency, damping | higher: frequency, damping | beyond the limits |")
    print("|---|---|---|---|")
    for estimator, inputs, orders, options in CASES:
        errors, beyond = {"chosen": np.zeros(2), "higher": np.zeros(2)}, 0
        for frf in bands(model.frf(np.arange(3500) * STEP, inputs=list(inputs))):
            lower, upper = float(frf.freq[0]), float(frf.freq[-1])
            inside = (f - 3 * zeta * f > lower) & (f + 3 * zeta * f < upper)
            table = estimator(frf, orders, **options)
            chosen = best_order(table, select(table, band=(lower, upper), max_damping=0.1))
            found = [
                ("chosen" if n == chosen else "higher", worst(table, row, true[inside]))
                for row, n in enumerate(table.orders)
                if n >= chosen
            ]
            for kind, error in found:
                errors[kind] = np.maximum(errors[kind], error)
            beyond += any((error > LIMITS[kind]).any() for kind, error in found)
        words = ", ".join(f"{k} {v}" for k, v in options.items())
        name = f"{estimator.__name__} {words}, {len(inputs)}, {orders[0]} to {orders[-1]}".replace(" ,", ",")
        row = " | ".join(f"{e[0]:.0e}, {e[1]:.0e}" for e in errors.values())
        print(f"| {name} | {row} | {beyond} of 30 |", flush=True)


if __name__ == "__main__":
    sys.exit(main())
