"""Seconds a diagnosis: ``python experiments/benchmarks/diagnosis.py [--cases 5 100 458]``.

A joint that slips is hidden in the paper's five-DoF system at three levels, and in nets of 100 and 458 masses on
springs, all of them measured (458 DoFs have 105,111 places for a joint), so strong that the place can be told: a free
force at any other place leaves a part of the effect. Each is diagnosed twice in one process, with
other noise the second time: the first time compiles (unless the compilation cache has it, which is said), the second
is warm. Apart from that: the screening alone of every joint at every place. ``--off-everywhere``: simulations whose
every element is off instead, in CPU seconds.
"""

import argparse
import itertools
import os
import tempfile
import time

os.environ.setdefault("OMP_NUM_THREADS", "2")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "2")
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

import jax
import numpy as np
from common import forget_peak, machine, peak

from modalax import Measurement, Structure
from modalax.diagnose import diagnose
from modalax.diagnose.causes import catalogue
from modalax.diagnose.causes.base import ElementCause
from modalax.diagnose.comparison import make_comparison
from modalax.diagnose.fitting.gauss_newton import ROUNDS
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.screening.every_cause import screen_all
from modalax.diagnose.screening.score_state import score_state_of
from modalax.model.examples import five_dof
from modalax.simulate import harmonic_balance
from modalax.simulate.joints import ElastoSlip

LEVELS = (1.0, 3.0, 9.0)
HARMONICS = (1, 3, 5, 7, 9)  # of the motion across the joint
DISTANCE = 30.0  # between the lowest and the highest level, in standard deviations
EVERY = 5  # of so many lines one is taken for the next number
LEAD = 300.0  # chi-square that a free force at any other place leaves of the noise-free effect


def net(count: int) -> Structure:
    """Masses at random points, each on springs to its nearest neighbours and softly to the ground."""
    rng = np.random.default_rng(count)
    points = rng.uniform(size=(count, 2))
    K = np.diag(rng.uniform(2e3, 4e3, count))
    for a in range(count):
        near = np.argsort(((points - points[a]) ** 2).sum(axis=1))[1:5]
        for b in near:
            k = rng.uniform(0.5e6, 2e6)
            K[[a, b, a, b], [a, b, b, a]] += [k, k, -k, -k]
    M = np.diag(rng.uniform(0.5, 1.5, count))
    return Structure(M, 1e-4 * K + 0.2 * M, K)


def case(count: int) -> tuple[Structure, list[str], np.ndarray, np.ndarray]:
    """The simulation, where a spring that slips is hidden, the lines, and the FRFs of the three levels."""
    simulation = five_dof() if count == 5 else net(count)
    modes, names = simulation.modal(), simulation.dofs
    hz = np.sort(np.abs(np.asarray(modes.poles))) / (2 * np.pi)
    freq = np.linspace(20.0, 70.0, 501) if count == 5 else np.linspace(0.8 * hz[0], 1.03 * hz[29], 500)
    place = [names[2], names[4]] if count == 5 else [names[0], names[neighbour(simulation)]]
    quiet = np.asarray(modes.frf(freq, outputs=place, inputs=[names[0]]).H)[:, :, 0]
    motion = np.abs(quiet[:, 0] - quiet[:, 1])
    columns = np.asarray(modes.frf(freq[::EVERY], outputs=list(names), inputs=list(names)).H)
    spring, across = 1e-6 / float(np.median(motion)), float(motion.max()) * LEVELS[0]
    for _ in range(40):
        joint = ElastoSlip(spring, 0.3 * across * spring, 0.0)
        response = harmonic_balance(
            modes, [joint], [place], freq, np.array(LEVELS), inputs=[names[0]], outputs=list(names), harmonics=HARMONICS
        )
        H = np.asarray(response.frf_values())
        distance = np.sqrt(2) * np.linalg.norm((H[0] - H[-1]) / spread_of(H)[0])
        led = EVERY * lead(columns, H[:, ::EVERY], place, names) if distance > DISTANCE else 0.0
        if led > LEAD:
            return simulation, place, freq, H
        spring *= 1.5 if distance > DISTANCE else min(10.0, 1.2 * DISTANCE / distance)
    raise ValueError(f"no spring at {' and '.join(place)} shows in {count} DoFs")


def neighbour(simulation: Structure) -> int:
    """The first mass that a spring joins to mass 0."""
    return int(np.flatnonzero(np.asarray(simulation.K)[0, 1:])[0]) + 1


def lead(columns: np.ndarray, H: np.ndarray, place: list[str], names: tuple[str, ...]) -> float:
    """Chi-square that a free force at the best other place, at every line and level, leaves of the noise-free effect.

    Where it is small, no method can tell the place.

    Parameters
    ----------
    columns
        Receptances between all DoFs without the joint, shape ``(f, o, dof)``.
    H
        With the joint, shape ``(level, f, o, 1)``.
    """
    sigma = spread_of(H)
    effect = (np.sqrt(2) * (H - columns[None, :, :, :1]) / sigma)[..., 0]
    left = np.full((len(names), len(names)), (np.abs(effect) ** 2).sum())  # the diagonal: to ground
    for run, f in itertools.product(range(len(H)), range(len(columns))):
        g = columns[f] / sigma[run, f]
        gram, toward = g.conj().T @ g, g.conj().T @ effect[run, f]
        own = np.real(np.diagonal(gram))
        length = own[:, None] + own[None] - 2 * np.real(gram)
        np.fill_diagonal(length, own)
        product = toward[:, None] - toward[None]
        np.fill_diagonal(product, toward)
        left -= np.abs(product) ** 2 / np.maximum(length, 1e-9 * own[:, None])
    a, b = sorted(names.index(p) for p in place)
    left[[a, b], [b, a]] = np.inf
    return float(left.min())


def spread_of(H: np.ndarray) -> np.ndarray:
    """Standard deviation of the noise, 2 % of each channel's root mean square."""
    return 0.02 * np.sqrt((np.abs(H) ** 2).mean(axis=1, keepdims=True)) * np.ones(H.shape)


def noisy(simulation: Structure, freq: np.ndarray, H: np.ndarray, seed: int) -> Measurement:
    """What a noisy test gives."""
    rng, sigma = np.random.default_rng(seed), spread_of(H)
    e = (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)) / np.sqrt(2)
    return Measurement(
        freq, H + sigma * e, outputs=simulation.dofs, inputs=simulation.dofs[:1], level=np.array(LEVELS),
        variance=sigma**2,
    )  # fmt: skip


def off_everywhere(count: int, outputs: int, inputs: int, lines: int, seed: int) -> tuple[Measurement, Structure]:
    """A net whose every spring is 3 % off and every mass 1 %, one spring besides by half; three levels alike."""
    rng = np.random.default_rng(seed)
    plain = net(count)
    C = 3.0 * np.asarray(plain.M) + 2e-5 * np.asarray(plain.K)  # a few lines to every bandwidth
    simulation = plain.replace(C=C)
    M, K = (np.array(a) for a in (simulation.M, simulation.K))
    for a in range(count):
        for b in range(a):
            change = K[a, b] * (0.03 * rng.standard_normal() + (0.5 if (b, a) == softened(simulation) else 0.0))
            K[[a, b], [b, a]] += change
            K[[a, b], [a, b]] -= change
    M *= 1 + 0.01 * rng.standard_normal(count)
    true = Structure(M, np.asarray(simulation.C), K)
    hz = np.sort(np.abs(np.asarray(simulation.modal().poles))) / (2 * np.pi)
    freq = np.linspace(0.8 * hz[0], 1.02 * hz[min(9, count - 1)], lines)
    names = simulation.dofs
    H = np.asarray(true.frf(freq, form="accelerance", outputs=names[:outputs], inputs=names[:inputs]).H)
    sigma = 0.01 * np.sqrt((np.abs(H) ** 2).mean(axis=0)) * np.ones((len(LEVELS), *H.shape))
    e = (rng.normal(size=sigma.shape) + 1j * rng.normal(size=sigma.shape)) / np.sqrt(2)
    measurement = Measurement(
        freq, H + sigma * e, form="accelerance", outputs=names[:outputs], inputs=names[:inputs],
        level=np.array(LEVELS), variance=sigma**2,
    )  # fmt: skip
    return measurement, simulation


def softened(simulation: Structure) -> tuple[int, int]:
    """The first spring between two masses."""
    K = np.asarray(simulation.K)
    return next((b, a) for a in range(len(K)) for b in range(a) if K[a, b] != 0)


def time_off_everywhere() -> None:
    """CPU seconds of the first and of a second diagnosis of simulations that are off everywhere."""
    print("| DoFs x outputs x inputs x levels x lines | first, CPU | warm, CPU | answer | memory |")
    print("|---|---|---|---|---|")
    for count, outputs, inputs, lines in ((10, 10, 1, 400), (27, 13, 2, 580)):
        took, told = [], ""
        for seed in range(2):
            measurement, simulation = off_everywhere(count, outputs, inputs, lines, seed)
            start = time.process_time()
            said = diagnose(measurement, simulation)
            took.append(time.process_time() - start)
            told = f"{said.verdict}: " + ", ".join(f"{c['name']} {'-'.join(c['where'])}" for c in said.causes)
        hidden = "-".join(simulation.dofs[k] for k in softened(simulation))
        memory = peak() / 1024
        print(
            f"| {count} x {outputs} x {inputs} x {len(LEVELS)} x {lines} | {took[0]:.1f} s | {took[1]:.1f} s | {told} "
            f"(hidden: joint_stiffness {hidden}) | {memory:.1f} GiB |",
            flush=True,
        )


def screened(measurement: Measurement, simulation: Structure) -> tuple[float, int, int]:
    """Seconds that the screening of every element at every place takes, and the numbers of causes and places."""
    comparison = make_comparison(measurement, simulation)
    count = comparison.problem.modal_form.stiffness.shape[0]
    null = comparison.fit([Hypothesis(theta=np.zeros((2, count)))], ROUNDS)[0]
    causes = [c for c in catalogue() if isinstance(c, ElementCause)]
    places = len(comparison.scene.pairs())
    took = []
    for _ in range(2):
        start = time.perf_counter()
        screen_all(score_state_of(comparison, null), causes)
        took.append(time.perf_counter() - start)
    return took[-1], len(causes), places


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, nargs="*", default=[5, 100, 458])
    parser.add_argument("--screen-only", action="store_true", help="only the screening of elements")
    parser.add_argument("--off-everywhere", action="store_true", help="only simulations whose every element is off")
    parser.add_argument("--cache", help="folder of the compilation cache; a new and empty one by default")
    args = parser.parse_args()
    print(machine() + "\n")
    jax.config.update("jax_enable_x64", True)
    with tempfile.TemporaryDirectory() as folder:
        jax.config.update("jax_compilation_cache_dir", args.cache or folder)
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
        if args.off_everywhere:
            time_off_everywhere()
            return
        print("| DoFs, all measured | lines x levels | first | warm | answer | elements screened | memory |")
        print("|---|---|---|---|---|---|---|")
        for count in args.cases:
            simulation, place, freq, H = case(count)
            took, said = [], None
            forget_peak()
            for seed in range(0 if args.screen_only else 2):
                start = time.perf_counter(), time.process_time()
                said = diagnose(noisy(simulation, freq, H, seed), simulation)
                took.append((time.perf_counter() - start[0], time.process_time() - start[1]))
            memory = peak() / 1024
            seconds, causes, places = screened(noisy(simulation, freq, H, 2), simulation)
            names = [] if said is None else [f"{c['name']} {'-'.join(c['where'])}" for c in said.causes]
            told = ", ".join(names) or "nothing"
            first, warm = (f"{wall:.1f} s, CPU {cpu:.1f} s" for wall, cpu in took) if took else ("", "")
            verdict = "" if said is None else f"{said.verdict}: "
            print(
                f"| {count} | {len(freq)} x {len(LEVELS)} | {first} | {warm} | {verdict}{told} "
                f"(hidden: elasto_slip {'-'.join(place)}) | {causes} kinds at {places} places: {seconds:.1f} s | "
                f"{memory:.1f} GiB |",
                flush=True,
            )


if __name__ == "__main__":
    main()
