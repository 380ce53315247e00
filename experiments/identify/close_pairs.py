"""Two modes closer than their bandwidth: ``python experiments/identify/close_pairs.py [--count N] [--detail]``.

Tests drawn at random hold two modes 0.05 to 1 of a half-power bandwidth apart (the sum of their half-bandwidths)
between two others, with 3 to 30 lines in the bandwidth, 1 to 8 outputs and 1 to 3 inputs, receptance, mobility or
accelerance, and 0.1 to 10 % noise. What the data can tell is the rise of twice the log-likelihood from the best single
mode to the true pair, the others known; a likelihood ratio test at one in a million asks for some 40 to 100, by the
channels. Counted are tests by that rise and by what was said: two modes; one that carries a flag of not being resolved;
one without a word; more than two. ``--single`` draws the same tests with one mode in the place of the pair: all that is
said of two there is a false alarm.
"""

import argparse
import sys
import time
from collections import Counter

import jax
import numpy as np
import scipy.optimize
from threadpoolctl import threadpool_limits

from modalax.data.frf import DERIVATIVES, FRF
from modalax.identify import fit
from modalax.model.modal import ModalModel

jax.config.update("jax_enable_x64", True)
threadpool_limits(1)
STEPS = (0, 30, 100, 300, 1000, 1e4, np.inf)
ANSWERS = ("two", "flagged", "silent", "more")


def draw(seed: int, single: bool) -> tuple[ModalModel, FRF, np.ndarray, float]:
    """A model, its FRFs with noise, the noise's standard deviation, and the distance in half-power bandwidths."""
    rng = np.random.default_rng([7, seed])
    outputs, inputs = int(rng.integers(1, 9)), int(rng.integers(1, 4))
    names = [str(k + 1) for k in range(max(outputs, inputs))]
    step = 0.25
    wide = np.exp(rng.uniform(np.log(3), np.log(30))) * step  # of one mode, in Hz
    ratio = np.exp(rng.uniform(-0.7, 0.7))
    width = np.array([wide / (1 + ratio), wide * ratio / (1 + ratio)])  # half-bandwidths
    d = float(np.exp(rng.uniform(np.log(0.05), 0.0)))
    f = np.array([60.0, 100.0, 100.0 + d * width.sum(), 150.0])
    zeta = np.array([0.01, width[0] / 100, width[1] / 100, 0.01])
    shapes = rng.normal(size=(4, len(names)))
    if single:
        f, zeta, shapes = f[[0, 1, 3]], zeta[[0, 1, 3]], shapes[[0, 1, 3]]
    model = ModalModel.from_real_modes(f, zeta, shapes, np.ones(len(f)), names)
    freq, form = np.arange(30, 180, step), str(rng.choice(list(DERIVATIVES)))
    H = np.array(model.frf(freq, form=form, outputs=names[:outputs], inputs=names[:inputs]).H)
    level = float(np.exp(rng.uniform(np.log(0.001), np.log(0.1))))
    sigma = level * np.sqrt(np.mean(np.abs(H) ** 2, axis=0, keepdims=True)) * np.ones(H.shape)
    H = H + sigma * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)) / np.sqrt(2)
    known = rng.random() < 0.5
    frf = FRF(
        freq, H, form=form, variance=sigma**2 if known else None, outputs=names[:outputs], inputs=names[:inputs]
    )  # fmt: skip
    return model, frf, sigma, d


def told(model: ModalModel, frf: FRF, sigma: np.ndarray) -> float:
    """Rise of twice the log-likelihood from the best single mode to the true pair."""
    s = 1j * np.asarray(frf.omega)
    power = DERIVATIVES[frf.form]
    weight = 1 / sigma.reshape(len(s), -1)[0]
    data = np.asarray(frf.H).reshape(len(s), -1) * weight

    def left(poles: np.ndarray) -> float:
        own = np.asarray([*poles, *np.asarray(model.poles)[[0, 3]]])
        K = np.concatenate([1 / (s[:, None] - own), 1 / (s[:, None] - own.conj())], axis=1) * s[:, None] ** power
        n = len(own)
        A = np.concatenate([K[:, :n] + K[:, n:], 1j * (K[:, :n] - K[:, n:])], axis=1)
        A, y = (np.concatenate([a.real, a.imag]) for a in (A, data))
        Q = np.linalg.qr(A)[0]
        return float(2 * np.sum((y - Q @ (Q.T @ y)) ** 2))

    pair = np.asarray(model.poles)[1:3]
    pole = lambda x: np.array([-np.exp(x[1]) + 1j * x[0]])
    starts = [[p.imag, np.log(-p.real)] for p in (*pair, pair.mean())]
    best = min(
        scipy.optimize.minimize(lambda x: left(pole(x)), x0, method="Nelder-Mead", options={"maxiter": 200}).fun
        for x0 in starts
    )
    return best - left(pair)


def answer(model: ModalModel, frf: FRF) -> tuple[str, str]:
    """What was said of the pair, and details."""
    found = fit(frf)
    f, width = np.asarray(found.model.frequency_hz), -np.asarray(found.model.poles.real) / (2 * np.pi)
    true = np.asarray(model.frequency_hz)[1:-1]
    reach = 2 * (-np.asarray(model.poles.real)[1:-1] / (2 * np.pi)).sum()
    near = np.flatnonzero((f > true.min() - reach) & (f < true.max() + reach) & np.asarray(found.inside))
    said = "; ".join(f"{f[k]:.3f} Hz {100 * width[k] / f[k]:.2f} %: {', '.join(found.flags[k])}" for k in near)
    flagged = any("unresolved" in word for k in near for word in found.flags[k])
    word = "more" if len(near) > 2 else "two" if len(near) == 2 else "flagged" if flagged else "silent"
    return word, said


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--single", action="store_true", help="one mode in the place of the pair")
    parser.add_argument("--detail", action="store_true", help="one line for each test")
    args = parser.parse_args()
    counts: dict[int, Counter] = {k: Counter() for k in range(len(STEPS))}
    began = time.process_time()
    for seed in range(args.first, args.first + args.count):
        model, frf, sigma, d = draw(seed, args.single)
        rise = 0.0 if args.single else told(model, frf, sigma)
        try:
            word, said = answer(model, frf)
        except ValueError as error:
            word, said = "silent", str(error)
        counts[int(np.searchsorted(STEPS, rise, side="right"))][word] += 1
        if args.detail:
            true = ", ".join(f"{x:.3f}" for x in np.asarray(model.frequency_hz)[1:-1])
            print(
                f"{seed} {frf.shape} {'known' if frf.variance is not None else ''} d {d:.2f} rise {rise:.0f} true "
                f"{true} {word} | {said}", flush=True,
            )  # fmt: skip
    print("| rise of twice the log-likelihood | " + " | ".join(ANSWERS) + " |")
    print("|---" * (1 + len(ANSWERS)) + "|")
    for k in range(1, len(STEPS)):
        if counts[k]:
            print(f"| {STEPS[k - 1]:g} to {STEPS[k]:g} | " + " | ".join(str(counts[k][w]) for w in ANSWERS) + " |")
    print(f"{time.process_time() - began:.0f} CPU s")


if __name__ == "__main__":
    sys.exit(main())
