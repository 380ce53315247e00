r"""`modalax.identify.fit` on systems drawn at random: ``python experiments/identify/random_systems.py``.

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
(at least a quarter of a line) and four stated deviations of it (where hits differ, within 0.3 % more) and makes its
response: of those, one for one, the ones whose responses :math:`h` are most like the true :math:`t`,
:math:`2\,\mathrm{Re}\langle t,h\rangle/(|t|^2+|h|^2)` of at least a tenth, which broad background has not.
Other modes in the band are false. Coverage is that of the 95 % intervals of the true ones found; where hits differ, of
the mean over the hits. The grade is judged by the area under its curve: the chance that a true mode has a higher one
than a false one. As next to no false modes are found, ``--candidates`` puts some in beside those found.
"""

import argparse
import json
import os
import sys
import time
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
import scipy.optimize
import scipy.stats
from threadpoolctl import threadpool_limits

from modalax.data.frf import DERIVATIVES, FRF
from modalax.identify import Fit, fit
from modalax.identify.band import usable_lines
from modalax.identify.chosen import fit_chosen
from modalax.identify.diagram import diagram
from modalax.identify.fit import summed_up
from modalax.identify.noise import smooth_variance
from modalax.identify.record_window import record_kernel
from modalax.model.modal import ModalModel

jax.config.update("jax_enable_x64", True)
threadpool_limits(1)

STEP = 0.5
PLAIN = 100.0
TEMPTING = 3
LEAST = 0.1  # likeness of responses from which on a found mode may be a true one
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
    alike = likeness(model, found)[:, inside]
    close = (apart < 1) & (alike > LEAST)
    rows, columns = scipy.optimize.linear_sum_assignment(np.where(close, 1 - alike, 10.0))
    pairs = {int(r): int(inside[c]) for r, c in zip(rows, columns, strict=True) if close[r, c]}
    return pairs, [int(k) for k in inside if k not in pairs.values()]


def likeness(model: ModalModel, found: Fit) -> np.ndarray:
    """How much of the response of each true mode each found one makes, 1 where the two are equal, shape ``(t, n)``."""
    frf = found.frf
    s = 2j * np.pi * np.asarray(frf.freq)[np.asarray(frf.freq) > 0]
    kernel, residue = [], []
    for m in (model, found.model):
        o, i = [m.outputs.index(n) for n in frf.outputs], [m.inputs.index(n) for n in frf.inputs]
        kernel.append(s ** DERIVATIVES[frf.form] / (s - np.asarray(m.poles)[:, None]))
        residue.append(np.asarray(m.residues)[:, o][:, :, i].reshape(len(m.poles), -1))
    inner = (kernel[0].conj() @ kernel[1].T) * (residue[0].conj() @ residue[1].T)
    size = [
        np.sum(np.abs(k) ** 2, axis=1) * np.sum(np.abs(r) ** 2, axis=1) for k, r in zip(kernel, residue, strict=True)
    ]
    return 2 * inner.real / (size[0][:, None] + size[1])


class Outcome(NamedTuple):
    """What came of one system: modes plain to see, found of them, false ones, intervals, and grades."""

    seed: int
    kind: str
    plain: int
    found: int
    false: int
    z: list[tuple[float, float]]
    true_grades: list[tuple[float, float]]
    false_grades: list[tuple[float, float]]


def row(kind: str, some: list[Outcome]) -> str:
    """One line of the table."""
    z = np.array([pair for o in some for pair in o.z]).reshape(-1, 2)
    hold = [f"{100 * np.mean(np.abs(c) < 1.96):.1f} %" if len(z) else "-" for c in z.T]
    plain, found, false = (sum(getattr(o, name) for o in some) for name in ("plain", "found", "false"))
    return f"| {kind} | {len(some)} | {found} of {plain} | {false} | {hold[0]} | {hold[1]} of {len(z)} |"


def area(true: list[float], false: list[float]) -> float:
    """Chance that a true mode has a higher grade than a false one: the area under the curve."""
    if not true or not false:
        return float("nan")
    return float(scipy.stats.mannwhitneyu(true, false).statistic / (len(true) * len(false)))


def table(outcomes: list[Outcome]) -> None:
    """Print what came of all systems, by kind."""
    print("| kind | systems | plain modes found | false modes | 95 % intervals hold: frequency | damping |")
    print("|---" * 6 + "|")
    for kind in KINDS:
        some = [o for o in outcomes if o.kind == kind]
        if some:
            print(row(kind, some))
    print(row("all", outcomes))
    for k, name in enumerate(("grade", "score")):
        true, false = ([g[k] for o in outcomes for g in getattr(o, n)] for n in ("true_grades", "false_grades"))
        ends = [f"{np.quantile(v, q):.2f}" if v else "-" for v, q in ((true, 0.1), (false, 0.9))]
        print(
            f"{name}: area under the curve {area(true, false):.4f} of {len(true)} true and {len(false)} false modes; "
            f"a tenth of the true below {ends[0]}, of the false above {ends[1]}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--kind", choices=KINDS, help="systems of this kind only")
    parser.add_argument("--detail", action="store_true", help="name the missed, false and badly covered modes")
    parser.add_argument("--seconds", type=float, default=np.inf, help="of CPU time after which no system is begun")
    parser.add_argument("--no-refine", action="store_true", help="the diagram's modes, without intervals")
    parser.add_argument("--candidates", action="store_true", help="grade false modes too, put in beside those found")
    parser.add_argument("--keep", type=Path, help="file of outcomes: systems in it are not fitted again")
    args = parser.parse_args()
    outcomes: list[Outcome] = []
    if args.keep and args.keep.exists():
        outcomes = [Outcome(**json.loads(line)) for line in args.keep.read_text().splitlines()]
    have = {o.seed for o in outcomes}
    began = time.process_time()
    for seed in range(args.first, args.first + args.count):
        if seed in have or (args.kind and KINDS[seed % len(KINDS)] != args.kind):
            continue
        if time.process_time() - began > args.seconds:
            print(f"stopped before system {seed}")
            break
        outcomes.append(one(seed, not args.no_refine, args.detail, args.candidates))
        if len(outcomes) % 25 == 0:
            jax.clear_caches()  # programs of every size that was drawn would fill the memory
        if args.keep:
            with args.keep.open("a") as file:
                print(json.dumps(outcomes[-1]._asdict()), file=file)
    table(outcomes)
    print(f"{time.process_time() - began:.0f} CPU s, load {os.getloadavg()[0]:.1f}")


def one(seed: int, refine: bool, tell: bool, candidates: bool) -> Outcome:
    """Draw, fit and count one system."""
    kind, model, frf, variance = draw(seed)
    noise = kind == "noise"
    plain = strength(model, frf, variance) > PLAIN if not noise else np.zeros(len(model.poles), bool)
    start, spread = time.process_time(), 3e-3 if kind == "hits differ" else 0.0

    def graded(found: Fit) -> tuple[dict[int, int], list[int], list[list[tuple[float, float]]]]:
        """True and false modes and the grades of both."""
        pairs, false = match(model, found, spread)
        pairs, false = ({}, [*pairs.values(), *false]) if noise else (pairs, false)
        grade, score = np.asarray(found.grade), np.asarray(found.score)
        return pairs, false, [[(float(grade[k]), float(score[k])) for k in s] for s in (pairs.values(), false)]

    found, pairs, false, grades = None, {}, [], [[], []]
    try:
        found = fit(frf, refine=refine)
        pairs, false, grades = graded(found)
    except ValueError as error:
        if plain.any() or tell:
            print(f"{seed}, {kind}: {error}", flush=True)
    if candidates:
        more = with_candidates(frf, found, np.random.default_rng(seed), refine)
        grades = grades if more is None else graded(more)[2]
    z = deviations(model, found, pairs) if found else []
    missed = plain & ~np.isin(np.arange(len(plain)), list(pairs))
    if tell and found:
        detail(seed, kind, model, found, missed, false, pairs, z, time.process_time() - start)
    return Outcome(seed, kind, int(plain.sum()), int((plain & ~missed).sum()), len(false), z, *grades)


def with_candidates(frf: FRF, found: Fit | None, rng: np.random.Generator, refine: bool) -> Fit | None:
    """The modes found and further ones that data of this kind tempt to take, all fitted together.

    Up to ``TEMPTING`` of them are poles that the higher orders of the diagram show and the search did not take, drawn
    at random; one, in every third system, stands 0.3 lines beside a mode that was found. None without any.
    """
    frf = usable_lines(frf, choose=True)[0] if found is None else found.frf
    name = "plscf" if min(frf.shape[1:]) > 1 else "lscf"
    diagrams, selection = diagram(frf.transpose() if frf.shape[2] > frf.shape[1] else frf, name, None)
    own = np.zeros(0, complex) if found is None else np.asarray(found.model.poles)
    late = slice(len(diagrams.orders) // 2, None)
    there = np.asarray(diagrams.physical(float(frf.freq[0]), float(frf.freq[-1])))[late]
    poles = list(own)
    for pole in rng.permutation(np.asarray(diagrams.poles)[late][there]):
        apart = np.abs(np.array(poles) - pole)
        if len(poles) < len(own) + TEMPTING and (apart > np.maximum(-pole.real, 2 * np.pi * STEP)).all():
            poles.append(pole)
    inside = own[np.asarray(found.inside)] if found else own
    if len(inside) and rng.random() < 1 / 3:
        poles.append(rng.choice(inside) + 0.3j * 2 * np.pi * STEP)
    if not poles or not selection.poles.size:
        return None
    poles = np.array(poles)[np.argsort(np.abs(poles))]
    weighted = smooth_variance(frf)
    model, refined = fit_chosen(weighted, poles, lambda text: None, refine)
    return summed_up(frf, weighted, model, refined, diagrams, selection, frf.shape[2] > frf.shape[1], [])


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
