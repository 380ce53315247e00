"""`modalax.fit` on systems drawn at random: ``python experiments/identify/random_systems.py``.

Systems of 1 to 6 modes between 25 and 185 Hz, at lines 0.5 Hz apart, with 0.5 to 20 lines in the half-power bandwidth
of each mode (evenly in its logarithm; damping at most 8 %), real shapes drawn from a normal distribution, 1 to 4
outputs and 1 or 2 inputs (3 where hits differ), as receptance, mobility or accelerance; circular noise of 0.3 to 10 %
(again in its logarithm) of each channel's root mean square. Frequencies are drawn evenly and may come close to each
other. System ``k`` is of kind ``k`` modulo the number of kinds:

- ``plain``: noise of known variance. ``no coherence``: the same, and nothing is known of the noise.
- ``0 Hz``: from 0 Hz on, the line there an offset of the size of the largest peak, below a suspension's mass line.
- ``drift``: accelerance from 0 Hz on, 50 to 95 % of the sum of squares drift that falls with the square of frequency.
- ``hits differ``: three inputs, for each of which all frequencies are 0.01 to 0.2 % off, drawn anew.
- ``cut short``: blocks of continuous random excitation with Hann's taper, as long as the lines are apart.
- ``hits cut short``: rectangular blocks of hammer hits, as long as the lines are apart.
- ``noise``: nothing but noise; every mode found is a false one.

The variance is known for the first kind only. A mode counts as *plain to see* if the power of its response is 100
times the noise's a line and channel, summed over all. A found mode is a true one if it lies within a half-bandwidth
(at least a quarter of a line) and four stated deviations of it, one for one; where hits differ, within 0.3 % more.
Other modes in the band are false. Coverage is that of the 95 % intervals of the true ones found; where hits differ, of
the mean over the hits. The grade is judged by the area under its curve: the chance that a true mode has a higher one
than a false one.
"""

import argparse
import os
import sys
import time

import jax
import numpy as np
import scipy.optimize
import scipy.stats
from threadpoolctl import threadpool_limits

from modalax.data.frf import DERIVATIVES, FRF
from modalax.identify import Fit, fit
from modalax.identify.record_window import record_kernel
from modalax.model.modal import ModalModel

jax.config.update("jax_enable_x64", True)
threadpool_limits(1)

STEP = 0.5
PLAIN = 100.0
KINDS = ("plain", "no coherence", "0 Hz", "drift", "hits differ", "cut short", "hits cut short", "noise")


def draw(seed: int) -> tuple[str, ModalModel, FRF, np.ndarray]:
    """A kind, a system, its FRFs, and the noise's variance of each sample."""
    rng = np.random.default_rng(seed)
    kind = KINDS[seed % len(KINDS)]
    modes, outputs, inputs = int(rng.integers(1, 7)), int(rng.integers(1, 5)), int(rng.integers(1, 3))
    inputs = 3 if kind == "hits differ" else inputs
    names = [str(k + 1) for k in range(max(outputs, inputs))]
    frequency = np.sort(rng.uniform(25, 185, modes))
    lines = np.exp(rng.uniform(np.log(0.5), np.log(20), modes))
    model = ModalModel.from_real_modes(
        frequency, np.minimum(lines * STEP / 2 / frequency, 0.08), rng.normal(size=(modes, len(names))),
        rng.uniform(0.5, 2, modes), names,
    )  # fmt: skip
    form = "accelerance" if kind == "drift" else str(rng.choice(list(DERIVATIVES)))
    freq = STEP * np.arange(0 if kind in ("0 Hz", "drift") else 1, 381)
    H = response(model, kind, freq, form, names[:outputs], names[:inputs], rng)
    rms = np.sqrt(np.mean(np.abs(H[freq >= 10]) ** 2, axis=0, keepdims=True))
    level = float(np.exp(rng.uniform(np.log(0.003), np.log(0.1))))
    sigma = np.broadcast_to(level * rms, H.shape)
    if kind == "noise":
        H, sigma = np.zeros_like(H), np.broadcast_to(rms, H.shape)
    H = H + sigma * circular(rng, H.shape)
    if kind == "0 Hz":
        H[0] = np.abs(H[freq >= 10]).max() * circular(rng, H.shape[1:])
    if kind == "drift":
        drift = np.maximum(freq, STEP)[:, None, None] ** -2.0 * circular(rng, H.shape)
        part = rng.uniform(0.5, 0.95)
        H += drift * np.sqrt(part / (1 - part) * np.sum(np.abs(H) ** 2) / np.sum(np.abs(drift) ** 2))
    variance = sigma**2 if kind == "plain" else None
    return (
        kind,
        model,
        FRF(freq, H, form=form, variance=variance, outputs=names[:outputs], inputs=names[:inputs]),
        (sigma**2),
    )


def circular(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Complex noise of unit variance."""
    return (rng.normal(size=shape) + 1j * rng.normal(size=shape)) / np.sqrt(2)


def response(
    model: ModalModel, kind: str, freq: np.ndarray, form: str, outputs: list[str], inputs: list[str],
    rng: np.random.Generator,
) -> np.ndarray:  # fmt: skip
    """FRFs of a kind without noise, shape ``(f, o, i)``."""
    if kind == "hits differ":
        size = np.exp(rng.uniform(np.log(1e-4), np.log(2e-3)))
        shift = rng.normal(size=len(inputs))
        columns = []
        for name, part in zip(inputs, size * (shift - shift.mean()), strict=True):
            hit = model.replace(poles=model.poles * (1 + part))
            columns.append(hit.frf(freq, form=form, outputs=outputs, inputs=[name]).H)
        return np.concatenate([np.asarray(c) for c in columns], axis=2)
    if kind == "cut short":
        s = 2j * np.pi * freq
        own = model.replace(upper=None, lower=None)
        residues = np.asarray(own.frf(freq[:1], outputs=outputs, inputs=inputs).H) * 0
        H = np.zeros((len(freq), *residues.shape[1:]), complex)
        power = DERIVATIVES[form]
        o, i = [model.outputs.index(n) for n in outputs], [model.inputs.index(n) for n in inputs]
        for pole, R in zip(np.asarray(model.poles), np.asarray(model.residues), strict=True):
            for p, r in ((pole, R[np.ix_(o, i)]), (pole.conj(), R[np.ix_(o, i)].conj())):
                # The derivatives of the impulse response: what they add at its start is a smooth function of s.
                start = sum(s[:, None, None] ** (power - 1 - k) * p**k * r for k in range(power))
                H += record_kernel(s, p, 1 / STEP, "hann")[:, None, None] * p**power * r + start
        return H
    if kind == "hits cut short":
        # A rectangular block scales each residue by what the mode has lost at its end.
        poles = np.asarray(model.poles)
        model = model.replace(participation=model.participation * (1 - np.exp(poles / STEP))[:, None])
        psi = np.asarray(model.shapes)
        full = ModalModel(poles, psi, model.participation, outputs=model.outputs, inputs=model.inputs)
        return np.asarray(full.frf(freq, form=form, outputs=outputs, inputs=inputs).H)
    if kind == "0 Hz":
        model = model.replace(lower=rng.normal(size=model.upper.shape) * 0.1)
    return np.array(model.frf(freq, form=form, outputs=outputs, inputs=inputs).H)


def strength(model: ModalModel, frf: FRF, variance: np.ndarray) -> np.ndarray:
    """For each mode the sum over lines and channels of the power of its response over the noise's."""
    own = []
    freq = np.maximum(np.asarray(frf.freq), STEP / 2)
    for r in range(len(model.poles)):
        one = model.replace(
            poles=model.poles[r : r + 1], shapes=model.shapes[r : r + 1], participation=model.participation[r : r + 1],
            frequency_std=0.0, damping_std=0.0, lower=None,
        )  # fmt: skip
        own.append(np.asarray(one.frf(freq, form=frf.form, outputs=frf.outputs, inputs=frf.inputs).H))
    return np.array([np.sum(np.abs(h) ** 2 / variance) for h in own])


def match(model: ModalModel, found: Fit, spread: float) -> tuple[dict[int, int], list[int]]:
    """For each true mode the found one that belongs to it, and the false ones; frequencies may spread by a part."""
    f, zeta = np.asarray(model.frequency_hz), np.asarray(model.damping_ratio)
    inside = np.flatnonzero(np.asarray(found.inside))
    own = np.asarray(found.model.frequency_hz)[inside]
    std = np.zeros(len(own)) if found.refined is None else np.asarray(found.refined.frequency_std_hz)[inside]
    reach = (np.maximum(zeta * f, 0.25 * STEP) + spread * f)[:, None] + 4 * np.nan_to_num(std, nan=0.0)[None, :]
    apart = np.abs(own[None, :] - f[:, None]) / reach
    rows, columns = scipy.optimize.linear_sum_assignment(np.where(apart < 1, apart, 10.0))
    pairs = {int(r): int(inside[c]) for r, c in zip(rows, columns, strict=True) if apart[r, c] < 1}
    return pairs, [int(k) for k in inside if k not in pairs.values()]


class Tally:
    """Counts of one kind: modes plain to see, found of them, false, systems, and intervals."""

    def __init__(self) -> None:
        self.plain = self.found = self.false = self.systems = 0
        self.z: list[tuple[float, float]] = []

    def row(self, kind: str) -> str:
        """One line of the table."""
        z = np.array(self.z).reshape(-1, 2)
        hold = [f"{100 * np.mean(np.abs(c) < 1.96):.1f} %" if len(z) else "-" for c in z.T]
        return (
            f"| {kind} | {self.systems} | {self.found} of {self.plain} | {self.false} | {hold[0]} | {hold[1]} of "
            f"{len(z)} |"
        )


def area(true: list[float], false: list[float]) -> float:
    """Chance that a true mode has a higher grade than a false one: the area under the curve."""
    if not true or not false:
        return float("nan")
    return float(scipy.stats.mannwhitneyu(true, false).statistic / (len(true) * len(false)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--detail", action="store_true", help="name the missed, false and badly covered modes")
    parser.add_argument("--seconds", type=float, default=np.inf, help="of wall time after which no system is begun")
    parser.add_argument("--no-refine", action="store_true", help="the diagram's modes, without intervals")
    args = parser.parse_args()
    tallies = {kind: Tally() for kind in (*KINDS, "all")}
    grades: tuple[list[float], list[float]] = [], []
    began, until = time.process_time(), time.perf_counter() + args.seconds
    for seed in range(args.first, args.first + args.count):
        if time.perf_counter() > until:
            print(f"stopped before system {seed}")
            break
        one(seed, tallies, grades, not args.no_refine, args.detail)
    print("| kind | systems | plain modes found | false modes | 95 % intervals hold: frequency | damping |")
    print("|---" * 6 + "|")
    for kind, tally in tallies.items():
        if tally.systems:
            print(tally.row(kind))
    print(
        f"grade: area under the curve {area(*grades):.4f} of {len(grades[0])} true and {len(grades[1])} false modes; "
        f"median grade {np.median(grades[0]) if grades[0] else np.nan:.2f} and "
        f"{np.median(grades[1]) if grades[1] else np.nan:.2f}"
    )
    print(f"{time.process_time() - began:.0f} CPU s, load {os.getloadavg()[0]:.1f}")


def one(
    seed: int, tallies: dict[str, Tally], grades: tuple[list[float], list[float]], refine: bool, tell: bool
) -> None:  # fmt: skip
    """Draw, fit and count one system."""
    kind, model, frf, variance = draw(seed)
    plain = strength(model, frf, variance) > PLAIN if kind != "noise" else np.zeros(len(model.poles), bool)
    told = [tallies[kind], tallies["all"]]
    for tally in told:
        tally.systems += 1
        tally.plain += int(plain.sum())
    start = time.process_time()
    try:
        found = fit(frf, refine=refine)
    except ValueError as error:
        if plain.any() or tell:
            print(f"{seed}, {kind}: {error}", flush=True)
        return
    pairs, false = match(model, found, 3e-3 if kind == "hits differ" else 0.0)
    pairs, false = ({}, [*pairs.values(), *false]) if kind == "noise" else (pairs, false)
    z = deviations(model, found, pairs)
    have = np.isin(np.arange(len(plain)), list(pairs))
    for tally in told:
        tally.found += int((have & plain).sum())
        tally.false += len(false)
        tally.z += z
    grade = np.asarray(found.grade)
    grades[0].extend(grade[list(pairs.values())].tolist())
    grades[1].extend(grade[false].tolist())
    if tell:
        detail(seed, kind, model, found, plain & ~have, false, pairs, z, time.process_time() - start)


def deviations(model: ModalModel, found: Fit, pairs: dict[int, int]) -> list[tuple[float, float]]:
    """Errors of frequency and damping of the true modes over their standard deviations."""
    if found.refined is None:
        return []
    f, zeta = np.asarray(model.frequency_hz), np.asarray(model.damping_ratio)
    own, refined = found.model, found.refined
    return [
        (
            (float(own.frequency_hz[k]) - f[r]) / float(refined.frequency_std_hz[k]),
            (float(own.damping_ratio[k]) - zeta[r]) / float(refined.damping_std[k]),
        )
        for r, k in pairs.items()
    ]


def detail(
    seed: int, kind: str, model: ModalModel, found: Fit, missed: np.ndarray, false: list[int], pairs: dict[int, int],
    z: list[tuple[float, float]], seconds: float,
) -> None:  # fmt: skip
    """Name what went wrong with one system."""
    f, zeta = np.asarray(model.frequency_hz), np.asarray(model.damping_ratio)
    own = found.model
    print(f"{seed}, {kind}, {found.frf.shape}, {len(f)} modes, {seconds:.1f} s", flush=True)
    for r in np.flatnonzero(missed):
        print(f"    missed {f[r]:.3f} Hz, {100 * zeta[r]:.3f} %; others at {np.round(np.delete(f, r), 2)}")
    for k in false:
        print(
            f"    false {float(own.frequency_hz[k]):.3f} Hz, {100 * float(own.damping_ratio[k]):.3f} %, grade "
            f"{float(found.grade[k]):.2f}, {list(found.flags[k])}; true at {np.round(f, 2)}"
        )
    for (r, k), (of_f, of_zeta) in zip(pairs.items(), z, strict=False):
        if max(abs(of_f), abs(of_zeta)) > 2.5:
            print(
                f"    z {of_f:+.1f}, {of_zeta:+.1f} at {f[r]:.3f} Hz, {100 * zeta[r]:.3f} % (found "
                f"{100 * float(own.damping_ratio[k]):.3f}), grade {float(found.grade[k]):.2f}, {list(found.flags[k])}"
            )


if __name__ == "__main__":
    sys.exit(main())
