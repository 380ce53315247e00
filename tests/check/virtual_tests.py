"""Virtual modal tests in NumPy alone: structures, sound measurements of them, and faults put into these.

Nothing here is shared with what is tested. A structure is a set of matrices; a test is what a laboratory would hand
over: FRFs with noise (stepped sine), FRFs from hammer hits or from random blocks made of time records, or the records.
"""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy.linalg
import scipy.signal

STEPS = {"receptance": 0, "mobility": 1, "accelerance": 2}


def log_uniform(rng, low, high, size=None):
    return np.exp(rng.uniform(np.log(low), np.log(high), size))


@dataclass(frozen=True)
class Plant:
    """Poles with Im > 0 and residues (n, dof, dof) of the receptance, rigid-body receptance B/s^2, names of DoFs."""

    poles: np.ndarray
    residues: np.ndarray
    rigid: np.ndarray
    names: tuple[str, ...]

    def receptance(self, s: np.ndarray, o: list[int], i: list[int]) -> np.ndarray:
        A = self.residues[:, o][:, :, i]
        terms = np.tensordot(1 / (s[:, None] - self.poles), A, 1)
        mirror = np.tensordot(1 / (s[:, None] - self.poles.conj()), A.conj(), 1)
        return terms + mirror + self.rigid[np.ix_(o, i)] / s[:, None, None] ** 2


def chain(rng, n: int, free: bool) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    m = log_uniform(rng, 0.5, 2.0, n)
    k = log_uniform(rng, 0.5, 2.0, n + 1) * 1e5
    if free:
        k[0] = k[-1] = 0
    elif rng.random() < 0.5:
        k[-1] = 0
    K = np.diag(k[:-1] + k[1:]) - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)
    for _ in range(int(rng.integers(0, 3))):
        a, b = rng.choice(n, 2, replace=False)
        extra = 1e5 * log_uniform(rng, 0.05, 0.5)
        K[np.ix_([a, b], [a, b])] += extra * np.array([[1, -1], [-1, 1]])
    style = rng.integers(3)
    names = tuple((f"m{j + 1}", f"{j + 1}:+X", f"x{j + 1}")[style] for j in range(n))
    return np.diag(m), K, names


def beam(rng, n: int, free: bool) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Euler-Bernoulli beam of n elements with translations and rotations; free, clamped, pinned or on springs."""
    L = 1.0 / n
    EI, mass = 100.0 * log_uniform(rng, 0.5, 2), 1.0 * log_uniform(rng, 0.5, 2)
    k = EI / L**3 * np.array([[12, 6 * L, -12, 6 * L], [6 * L, 4 * L**2, -6 * L, 2 * L**2],
                              [-12, -6 * L, 12, -6 * L], [6 * L, 2 * L**2, -6 * L, 4 * L**2]])  # fmt: skip
    m = mass * L / 420 * np.array([[156, 22 * L, 54, -13 * L], [22 * L, 4 * L**2, 13 * L, -3 * L**2],
                                   [54, 13 * L, 156, -22 * L], [-13 * L, -3 * L**2, -22 * L, 4 * L**2]])  # fmt: skip
    M, K = np.zeros((2 * n + 2, 2 * n + 2)), np.zeros((2 * n + 2, 2 * n + 2))
    for e in range(n):
        at = slice(2 * e, 2 * e + 4)
        stiff = log_uniform(rng, 0.8, 1.25)
        M[at, at] += m
        K[at, at] += stiff * k
    for j in rng.choice(n + 1, 2, replace=False):
        M[2 * j, 2 * j] += mass * rng.uniform(0, 0.2)
    keep = list(range(2 * n + 2))
    if not free:
        kind = rng.integers(3)
        if kind == 0:
            keep = keep[2:]
        elif kind == 1:
            keep = [d for d in keep if d not in (0, 2 * n)]
        else:
            for j in (0, n):
                K[2 * j, 2 * j] += EI * log_uniform(rng, 10, 1000)
    names = [f"{d // 2 + 1}:+{'Z' if d % 2 == 0 else 'RY'}" for d in keep]
    return M[np.ix_(keep, keep)], K[np.ix_(keep, keep)], tuple(names)


def plate(rng, n: int, free: bool) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Masses on a nearly regular net of strings and bending springs: close modes in pairs."""
    side = max(3, int(np.sqrt(n)))
    other = side if rng.random() < 0.6 else side + 1
    D = []
    at = lambda a, b: a * other + b
    for a in range(side):
        for b in range(other):
            for da, db in ((1, 0), (0, 1)):
                if a + da < side and b + db < other:
                    row = np.zeros(side * other)
                    row[at(a, b)], row[at(a + da, b + db)] = 1, -1
                    D.append(row * np.sqrt(log_uniform(rng, 0.9, 1.1)))
    K = 1e5 * np.array(D).T @ np.array(D)
    if not free:
        for a in range(side):
            for b in range(other):
                if a in (0, side - 1) or b in (0, other - 1):
                    K[at(a, b), at(a, b)] += 1e5 * log_uniform(rng, 0.3, 3)
    M = np.diag(log_uniform(rng, 0.9, 1.1, side * other))
    return M, K, tuple(f"{j + 1}:+Z" for j in range(side * other))


def draw_plant(rng, kind: str | None = None) -> Plant:
    kind = kind or str(rng.choice(["chain", "chain", "beam", "beam", "plate"]))
    free = bool(rng.random() < 0.3)
    make, sizes = {"chain": (chain, (3, 13)), "beam": (beam, (3, 10)), "plate": (plate, (9, 21))}[kind]
    M, K, names = make(rng, int(rng.integers(*sizes)), free)
    w2, phi = scipy.linalg.eigh(K, M)
    rigid = w2 < 1e-8 * w2[-1]
    w = np.sqrt(np.where(rigid, 1.0, w2))
    zeta = np.clip(log_uniform(rng, 0.0015, 0.03) * log_uniform(rng, 0.5, 2.0, len(w)), 0.0008, 0.05)
    dampers = int(rng.integers(1, 3)) if rng.random() < 0.35 else 0
    elastic = ~rigid
    Cm = np.diag(np.where(elastic, 2 * zeta * w, 0.0))
    for _ in range(dampers):
        a, b = rng.choice(len(w), 2, replace=False)
        e = np.zeros(len(w))
        e[a], e[b] = 1, -1 if rng.random() < 0.7 else 0
        c = (phi.T @ e) * elastic
        share = (
            log_uniform(rng, 0.3, 2.0) * np.median(2 * zeta[elastic] * w[elastic]) / np.median(c[elastic] ** 2 + 1e-12)
        )
        share = min(share, 0.1 * np.min(w[elastic] / np.maximum(c[elastic] ** 2, 1e-12)))
        Cm += share * np.outer(c, c)
    keep = np.flatnonzero(elastic)
    n = len(keep)
    Cm, W2 = Cm[np.ix_(keep, keep)], np.diag(w[keep] ** 2)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-W2, -Cm]])
    lam, right = scipy.linalg.eig(A)
    up = np.flatnonzero(lam.imag > 0)
    up = up[np.argsort(lam[up].imag)]
    q = right[:n, up]
    lam = lam[up]
    norm = np.einsum("ij,ij->j", q, (2 * lam * q + Cm @ q))
    shapes = phi[:, keep] @ q
    residues = np.einsum("or,ir,r->roi", shapes, shapes, 1 / norm)
    B = phi[:, rigid] @ phi[:, rigid].T
    scale = log_uniform(rng, 5, 500) * 2 * np.pi / abs(lam[0])
    # Time is stretched so that the first mode lies at 5 to 500 Hz; the receptance keeps its masses.
    return Plant(lam * scale, residues / scale, B, names)


@dataclass(frozen=True)
class Test:
    """A measurement, the keyword arguments of ``Measurement``, and what was put into it."""

    arrays: dict[str, Any]
    records: dict[str, Any] = field(default_factory=dict)
    truth: dict[str, Any] = field(default_factory=dict)
    plant: Plant | None = None
    __test__ = False

    def with_arrays(self, **changes) -> "Test":
        return replace(self, arrays={**self.arrays, **changes})


LAYOUTS = ("column", "column", "no drive", "references", "references", "roving", "square", "mixed")


def draw_layout(rng, plant: Plant, layout: str) -> tuple[list[int], list[int]]:
    """Outputs and inputs: one column, none driven, several references, roving hammer, all by all, one of two driven."""
    n = len(plant.names)
    loud = [d for d in range(n) if "+R" not in plant.names[d]] or list(range(n))
    rotations = rng.random() < 0.3
    pool = list(range(n)) if rotations else loud
    many = sorted(int(d) for d in rng.choice(pool, min(len(pool), int(rng.integers(3, 11))), replace=False))
    pick = lambda count, among: [int(d) for d in rng.choice(among, min(count, len(among)), replace=False)]
    if layout == "column":
        i = pick(1, loud)
        return sorted({*many, *i}), i
    if layout == "no drive":
        i = pick(1, loud)
        rest = [d for d in many if d not in i]
        return (rest if len(rest) > 1 else [d for d in range(n) if d not in i]), i
    if layout == "references":
        i = pick(int(rng.integers(2, 4)), loud)
        return sorted({*many, *i}), i
    if layout == "roving":
        o = pick(int(rng.integers(1, 4)), loud)
        return o, sorted({*many, *o})
    if layout == "square":
        both = sorted(pick(int(rng.integers(2, 6)), loud))
        return both, list(both)
    i = pick(2, loud)
    return sorted({*many, i[0]} - {i[1]}), i


def draw_axis(rng, plant: Plant, per_width: float | None = None) -> np.ndarray:
    """Lines over some of the first modes, so many a half-power bandwidth of the narrowest mode."""
    f, width = np.abs(plant.poles) / 2 / np.pi, -plant.poles.real / np.pi
    count = min(int(rng.integers(2, 9)), len(f))
    while count > 1 and 1.3 * f[count - 1] / np.min(width[:count]) > 600:
        count -= 1
    top = f[count - 1]
    high = min(1.3 * top, (top + f[count]) / 2) if count < len(f) else 1.3 * top
    per_width = per_width or float(log_uniform(rng, 2.5, 20))
    step = max(np.min(width[:count]) / per_width, high / 1600)
    step = min(step, high / 120)
    low = step if rng.random() < 0.35 else float(rng.uniform(0.2, 0.8)) * f[0]
    first = max(1, round(low / step))
    return step * np.arange(first, max(int(high / step), first + 60) + 1)


def noise_of(rng, test: Test) -> np.ndarray:
    """Standard deviation of each sample (run, f, o, i); the rms of an FRF counts from half of the first mode on."""
    H, kind, level = test.arrays["H"], test.truth["noise"], test.truth["level"]
    first = np.abs(test.plant.poles[0]) / (2 * np.pi)
    power = np.abs(H[:, test.arrays["freq"] > 0.5 * first]) ** 2
    rms = np.sqrt(np.mean(power, axis=(0, 1), keepdims=True))
    if kind == "channel":
        sigma = level * rms * np.ones_like(np.abs(H))
    elif kind == "overall":
        sigma = level * np.sqrt(np.mean(rms**2)) * np.ones_like(np.abs(H))
    else:
        sigma = level * np.abs(H) + 0.003 * level * rms
    return sigma


def softened(rng, plant: Plant, level: float) -> Plant:
    """The plant at a force: one mode or two a little lower and more damped, as a weak joint makes it."""
    poles = plant.poles.copy()
    for r in np.random.default_rng(7).choice(len(poles), min(2, len(poles)), replace=False):
        sigma = -poles[r].real
        poles[r] += -0.25j * sigma * level - 0.1 * sigma * level
    return replace(plant, poles=poles)


def draw_frf_test(rng, kind=None, layout=None, runs=None, per_width=None, level=None, conditions=None) -> Test:
    """FRFs of stepped sine or multisine: exact lines with noise."""
    plant = draw_plant(rng, kind)
    layout = layout or str(rng.choice(LAYOUTS))
    o, i = draw_layout(rng, plant, layout)
    freq = draw_axis(rng, plant, per_width)
    form = str(rng.choice(list(STEPS)))
    runs = runs or int(rng.choice([1, 1, 1, 2, 3]))
    force = np.full(runs, np.nan)
    s = 2j * np.pi * freq
    nonlinear = runs > 1 and rng.random() < 0.3
    if runs > 1 and (nonlinear or rng.random() < 0.5):
        force = 2.0 ** np.arange(runs) * log_uniform(rng, 0.5, 10)
    at = lambda k: softened(rng, plant, k / max(runs - 1, 1)) if nonlinear else plant
    H = np.stack([at(k).receptance(s, o, i) * s[:, None, None] ** STEPS[form] for k in range(runs)])
    noise = str(rng.choice(["channel", "overall", "relative"]))
    level = level or float(log_uniform(rng, 0.001, 0.1))
    truth = {"layout": layout, "noise": noise, "level": level, "form": form, "nonlinear": nonlinear}
    arrays = {
        "freq": freq, "H": H, "form": form, "level": force,
        "outputs": [plant.names[d] for d in o], "inputs": [plant.names[d] for d in i],
    }  # fmt: skip
    return Test(arrays, truth={**truth, "o": o, "i": i}, plant=plant)


def with_noise(rng, test: Test, sigma: np.ndarray | None = None) -> Test:
    """Noise, and what the laboratory says of it: nothing, its variance, or an estimate from repeats."""
    H = test.arrays["H"]
    if sigma is None:
        sigma = noise_of(rng, test) * test.truth.get("times", 1.0)
    e = (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)) / np.sqrt(2)
    arrays = {**test.arrays, "H": H + sigma * e}
    told = rng.random()
    if told < 0.35:
        arrays["variance"] = sigma**2
    elif told < 0.7:
        repeats = int(rng.choice([3, 5, 8, 16]))
        arrays["variance"] = sigma**2 * rng.chisquare(2 * (repeats - 1), H.shape) / (2 * (repeats - 1))
        arrays["averages"] = repeats
    return replace(test, arrays=arrays)


# Faults of FRFs: each takes a test without noise and gives a test, or None where the layout cannot have it.


def _driven(test: Test) -> list[tuple[int, int]]:
    o, i = test.truth["o"], test.truth["i"]
    return [(a, b) for a, x in enumerate(o) for b, y in enumerate(i) if x == y]


def _marked(test: Test, what: str, where, **changes) -> Test:
    test = test.with_arrays(**changes)
    return replace(test, truth={**test.truth, "what": what, "where": list(where)})


def _peak_share(test: Test, row: int) -> float:
    size = np.abs(test.arrays["H"]).max(axis=(0, 1, 3))
    return size[row] / size.max()


def put_reversed(rng, test: Test) -> Test | None:
    pairs = _driven(test)
    if not pairs:
        return None
    o, i = pairs[int(rng.integers(len(pairs)))]
    H = test.arrays["H"].copy()
    if rng.random() < 0.6 or len(pairs) < 2:
        H[:, :, o] *= -1
        return _marked(test, "reversed", [test.arrays["outputs"][o]], H=H)
    H[..., i] *= -1
    return _marked(test, "reversed", [test.arrays["inputs"][i]], H=H)


def put_swapped(rng, test: Test) -> Test | None:
    """Two outputs exchanged, one of them driven, whose mode shapes do differ."""
    pairs = _driven(test)
    H = test.arrays["H"].copy()
    if not pairs or H.shape[2] < 2:
        return None
    a = pairs[int(rng.integers(len(pairs)))][0]
    b = int(rng.choice([k for k in range(H.shape[2]) if k != a]))
    column = [i for o, i in pairs if o == a][0]
    inside = _inside(test)
    shape = test.plant.residues[inside][:, [test.truth["o"][b]], test.truth["i"][column]].imag[:, 0]
    own = -test.plant.residues[inside][:, test.truth["o"][a], test.truth["i"][column]].imag
    loud = np.abs(shape) > 0.1 * np.abs(own).max()
    if not (loud & (shape > 0)).any() and len(pairs) < 2:
        return None  # In phase in every mode of the band: nothing can tell.
    H[:, :, [a, b]] = H[:, :, [b, a]]
    return _marked(test, "swapped", [test.arrays["outputs"][k] for k in (a, b)], H=H)


def _inside(test: Test) -> np.ndarray:
    f = np.abs(test.plant.poles) / 2 / np.pi
    return np.flatnonzero((f > test.arrays["freq"][0]) & (f < test.arrays["freq"][-1]))


def put_dead(rng, test: Test) -> Test | None:
    H = test.arrays["H"].copy()
    if H.shape[2] < 2:
        return None
    o = int(rng.integers(H.shape[2]))
    rms = np.sqrt(np.mean(np.abs(np.delete(H, o, axis=2)) ** 2))
    shape = H[:, :, o].shape
    H[:, :, o] = rng.choice([0.0, 1e-4, 0.02]) * rms * (rng.normal(size=shape) + 1j * rng.normal(size=shape))
    return _marked(test, "dead", [test.arrays["outputs"][o]], H=H)


def put_duplicated(rng, test: Test) -> Test | None:
    """After the noise: one channel holds another's data."""
    H = test.arrays["H"].copy()
    axis = 2 if H.shape[2] > 1 and (rng.random() < 0.6 or H.shape[3] < 2) else 3
    if H.shape[axis] < 2:
        return None
    a, b = (int(k) for k in rng.choice(H.shape[axis], 2, replace=False))
    view = np.moveaxis(H, axis, 0)
    view[b] = view[a]
    names = test.arrays["outputs" if axis == 2 else "inputs"]
    return _marked(test, "duplicated", [names[a], names[b]], H=H)


def put_hum(rng, test: Test) -> Test | None:
    freq, H = test.arrays["freq"], test.arrays["H"].copy()
    step, sigma = freq[1] - freq[0], noise_of(rng, test)
    mains = float(rng.choice([50.0, 60.0]))
    lines = [m for m in mains * np.arange(1, 8) if freq[0] + 20 * step < m < freq[-1] - 20 * step]
    if not lines or step > 3:
        return None
    wide = rng.random() < 0.5
    mains_now = 1 + 3e-4 * rng.normal()
    for k, m in enumerate(lines):
        at = (freq - m * mains_now) / step
        box = lambda u: np.sinc(u) * np.exp(-1j * np.pi * u)
        shape = box(at) - 0.5 * (box(at - 1) + box(at + 1)) if wide else (np.abs(at) <= 0.5).astype(complex)
        local = np.abs(H[:, np.abs(at) < 15]).mean(axis=1, keepdims=True) + 4 * sigma[:, :1]
        phase = np.exp(2j * np.pi * rng.random(H[:, :1].shape))
        H += local * log_uniform(rng, 0.5, 2.0) / (1 + k) * phase * shape[None, :, None, None]
    return _marked(test, "hum", [], H=H)


def put_conjugated(rng, test: Test) -> Test:
    return _marked(test, "conjugated", [], H=test.arrays["H"].conj())


def put_wrong_form(rng, test: Test) -> Test | None:
    true = test.arrays["form"]
    wrong = str(rng.choice([f for f in STEPS if f != true]))
    freq = test.arrays["freq"]
    if abs(STEPS[wrong] - STEPS[true]) == 2:
        first = np.abs(test.plant.poles[0]) / 2 / np.pi
        if not _driven(test) or freq[0] > 0.25 * first:
            return None  # Two derivatives are a sign, in a narrow band.
    return _marked(test, "wrong_form", [], form=wrong)


def put_delay(rng, test: Test) -> Test | None:
    freq, H = test.arrays["freq"], test.arrays["H"].copy()
    if len(_inside(test)) < 4:
        return None
    tau = np.radians(log_uniform(rng, 25, 120)) / (2 * np.pi * freq[-1]) * (1 if rng.random() < 0.7 else -1)
    turn = np.exp(-2j * np.pi * freq * tau)[None, :, None]
    if rng.random() < 0.3 or H.shape[2] < 3:
        return _marked(test, "delay", [], H=H * turn[..., None])
    o = int(rng.integers(H.shape[2]))
    H[:, :, o] *= turn
    return _marked(test, "delay", [test.arrays["outputs"][o]], H=H)


def put_calibration(rng, test: Test) -> Test | None:
    pairs = _driven(test)
    if len(pairs) < 2:
        return None
    o, i = pairs[int(rng.integers(len(pairs)))]
    gain = log_uniform(rng, 1.1, 2.0) ** (1 if rng.random() < 0.5 else -1)
    H = test.arrays["H"].copy()
    if rng.random() < 0.6:
        H[:, :, o] *= gain
    else:
        H[..., i] *= gain
    return _marked(test, "calibration", [test.arrays["outputs"][o]], H=H)


def put_not_reciprocal(rng, test: Test) -> Test | None:
    """Rotating parts: a skew-symmetric coupling of the modes."""
    pairs = _driven(test)
    if len(pairs) < 2:
        return None
    H, freq = test.arrays["H"].copy(), test.arrays["freq"]
    (a, i), (b, j) = (pairs[k] for k in rng.choice(len(pairs), 2, replace=False))
    s = 2j * np.pi * freq
    other = test.plant.residues.copy()
    inside = _inside(test)
    if len(inside) < 2:
        return None
    turn = log_uniform(rng, 0.2, 0.6)
    signs = rng.choice([-1.0, 1.0], len(other))
    here = np.abs(other[inside, test.truth["o"][a], test.truth["i"][j]]) / -test.plant.poles[inside].real
    first, second = inside[np.argsort(-here)[:2]]
    signs[first], signs[second] = 1, -1
    if np.sort(here)[-2] < 0.2 * here.max():
        return None
    other *= 1 + turn * signs[:, None, None]
    changed = replace(test.plant, residues=other).receptance(s, test.truth["o"], test.truth["i"])
    changed = changed * s[:, None, None] ** STEPS[test.arrays["form"]]
    H[:, :, a, j] = changed[None, :, a, j]
    return _marked(test, "not_reciprocal", [test.arrays["outputs"][k] for k in (a, b)], H=H)


def put_frequency_shift(rng, test: Test) -> Test | None:
    """The structure changes between columns or between runs: a sensor's mass, a temperature."""
    H, freq = test.arrays["H"].copy(), test.arrays["freq"]
    runs, _, _, ins = H.shape
    if test.truth["nonlinear"] or (runs < 2 and ins < 2):
        return None
    s = 2j * np.pi * freq
    inside = _inside(test)
    if not len(inside):
        return None
    half = np.median(-test.plant.poles[inside].real / np.abs(test.plant.poles[inside]))
    shift = log_uniform(rng, 0.3, 2.0) * half
    moved = replace(test.plant, poles=test.plant.poles * (1 - shift))
    M = moved.receptance(s, test.truth["o"], test.truth["i"]) * s[:, None, None] ** STEPS[test.arrays["form"]]
    if runs > 1 and (ins < 2 or rng.random() < 0.5):
        H[int(rng.integers(runs))] = M
        level = np.full(runs, 1.0)
        return _marked(test, "frequency_shift", [], H=H, level=level)
    i = int(rng.integers(ins))
    H[..., i] = M[None, ..., i]
    return _marked(test, "frequency_shift", [test.arrays["inputs"][i]], H=H)


def put_too_few_lines(rng, test: Test) -> Test | None:
    freq = test.arrays["freq"]
    inside = _inside(test)
    if not len(inside):
        return None
    width = np.median(-test.plant.poles[inside].real / np.pi)
    every = int(np.ceil(width / (freq[1] - freq[0]) / log_uniform(rng, 0.3, 0.8)))
    if len(freq) // every < 60:
        return None
    keep = slice(int(rng.integers(every)), None, every)
    return _marked(test, "too_few_lines", [], freq=freq[keep], H=test.arrays["H"][:, keep])


def put_double_hit(rng, test: Test) -> Test | None:
    """Noise of the responses over the force of a double hit."""
    freq = test.arrays["freq"]
    if len(freq) < 150:
        return None
    ripples = rng.uniform(6, min(60, len(freq) / 8))
    tau = ripples / (freq[-1] - freq[0])
    force = np.abs(1 + rng.uniform(0.3, 0.9) * np.exp(-2j * np.pi * freq * tau))
    i = int(rng.integers(test.arrays["H"].shape[3]))
    return _louder(test, 1 / force, i, "double_hit")


def put_force_rolloff(rng, test: Test) -> Test | None:
    freq = test.arrays["freq"]
    if len(freq) < 150:
        return None
    x = (freq - freq[0]) / (freq[-1] - freq[0])
    end = rng.uniform(0.6, 0.85)
    fall = 10 ** (-rng.uniform(35, 60) / 20 * np.clip((x - end + 0.25) / (1.25 - end), 0, None))
    i = int(rng.integers(test.arrays["H"].shape[3]))
    return _louder(test, 1 / fall, i, "force_rolloff")


def _louder(test: Test, factor: np.ndarray, i: int, what: str) -> Test:
    times = np.ones(test.arrays["H"].shape)
    times[..., i] *= factor[None, :, None]
    test = _marked(test, what, [test.arrays["inputs"][i]])
    return replace(test, truth={**test.truth, "times": times})


def put_record_too_short(rng, test: Test) -> Test | None:
    """Blocks as long as the lines are apart, cut off or under a window, from the impulse responses."""
    freq, inside = test.arrays["freq"], _inside(test)
    if not len(inside) or test.truth["nonlinear"]:
        return None
    decay = np.median(-test.plant.poles[inside].real)
    remain = rng.uniform(0.15, 0.6)
    T = -np.log(remain) / decay
    step = 1 / T
    count = int(freq[-1] / step)
    first = max(1, int(np.ceil(freq[0] / step)))
    if count - first < 60 or freq[0] > 0.7 * np.abs(test.plant.poles[0]) / 2 / np.pi:
        return None
    new = step * np.arange(first, count + 1)
    s = 2j * np.pi * new
    kind = str(rng.choice(["hit", "Hann", "Hann", "boxcar"]))
    o, i = test.truth["o"], test.truth["i"]
    H = np.zeros((len(new), len(o), len(i)), complex)
    for sign in (1, -1):
        poles = test.plant.poles if sign > 0 else test.plant.poles.conj()
        A = test.plant.residues if sign > 0 else test.plant.residues.conj()
        A = A[:, o][:, :, i] * poles[:, None, None] ** STEPS[test.arrays["form"]]
        H += np.tensordot(_weighted((s[:, None] - poles) * T, kind) * T, A, 1)
    if np.any(test.plant.rigid) and STEPS[test.arrays["form"]] < 2:
        return None
    far = test.plant.receptance(s, o, i) * s[:, None, None] ** STEPS[test.arrays["form"]]
    for sign in (1, -1):
        poles = test.plant.poles if sign > 0 else test.plant.poles.conj()
        A = test.plant.residues if sign > 0 else test.plant.residues.conj()
        A = A[:, o][:, :, i] * poles[:, None, None] ** STEPS[test.arrays["form"]]
        far = far - np.tensordot(1 / (s[:, None] - poles), A, 1)
    test = replace(test, truth={**test.truth, "window": kind})
    H = np.broadcast_to(H + far, (len(test.arrays["H"]), *H.shape)).copy()
    return _marked(test, "record_too_short", [], freq=new, H=H)


def _weighted(x: np.ndarray, kind: str) -> np.ndarray:
    """Integral of w(t) exp(-x t) over 0..1, by Gauss-Legendre."""
    t, w = np.polynomial.legendre.leggauss(60)
    pieces = max(2, int(np.abs(x).max() / 40) + 1)
    total = np.zeros(x.shape, complex)
    for k in range(pieces):
        time = (k + 0.5 * (t + 1)) / pieces
        if kind == "hit":
            window = np.ones_like(time)
        elif kind == "boxcar":
            window = 1 - time
        else:
            window = (1 - time) * (2 + np.cos(2 * np.pi * time)) / 3 + np.sin(2 * np.pi * time) / (2 * np.pi)
        for tt, ww in zip(time, 0.5 * w * window / pieces, strict=True):
            total += ww * np.exp(-x * tt)
    return total


def put_clipped(rng, test: Test) -> Test | None:
    """A sensor that saturates: the fundamental of a cut-off sine, at two or three levels."""
    H = test.arrays["H"].copy()
    if len(H) < 2 or H.shape[2] < 2 or not np.isfinite(test.arrays["level"]).all():
        return None
    o = int(rng.integers(H.shape[2]))
    level = test.arrays["level"]
    size = np.abs(H[:, :, o]) * level[:, None, None]
    limit = rng.uniform(0.35, 0.8) * size[-1].max()
    over = np.maximum(size / limit, 1.0)
    gain = 2 / np.pi * (np.arcsin(1 / over) + np.sqrt(np.maximum(1 - 1 / over**2, 0)) / over)
    H[:, :, o] *= gain
    return _marked(test, "clipped", [test.arrays["outputs"][o]], H=H)


def put_drift(rng, test: Test) -> Test | None:
    """A sensor whose accelerance rises towards 0 Hz: f^-1 to f^-2, of random phase or smooth."""
    freq, H = test.arrays["freq"], test.arrays["H"].copy()
    first = np.abs(test.plant.poles[0]) / 2 / np.pi
    if freq[0] > 0.08 * first or freq[0] > 1.5 * (freq[1] - freq[0]) or len(freq[freq < 0.5 * first]) < 24:
        return None
    o = int(rng.integers(H.shape[2]))
    top = np.abs(H[:, :, o, :]).max()
    power = rng.uniform(1.0, 2.0) + 2 - STEPS[test.arrays["form"]]
    random = rng.normal(size=H[:, :, o].shape) + 1j * rng.normal(size=H[:, :, o].shape)
    phase = random / np.sqrt(2) if rng.random() < 0.5 else np.exp(2j * np.pi * rng.random())
    H[:, :, o] += log_uniform(rng, 0.5, 5) * top * (freq[0] / freq)[None, :, None] ** power * phase
    return _marked(test, "drift", [test.arrays["outputs"][o]], H=H)


FAULTS = {
    "reversed": put_reversed, "swapped": put_swapped, "dead": put_dead, "duplicated": put_duplicated, "hum": put_hum,
    "conjugated": put_conjugated, "wrong_form": put_wrong_form, "delay": put_delay, "calibration": put_calibration,
    "not_reciprocal": put_not_reciprocal, "frequency_shift": put_frequency_shift,
    "too_few_lines": put_too_few_lines, "double_hit": put_double_hit, "force_rolloff": put_force_rolloff,
    "record_too_short": put_record_too_short, "clipped": put_clipped, "drift": put_drift,
}  # fmt: skip
AFTER_NOISE = ("duplicated", "dead")


def draw_test(seed: int, fault: str | None = None) -> Test:
    """A sound test, or one with a fault, by seed."""
    for attempt in range(200):
        rng = np.random.default_rng([seed, attempt, *(fault or "").encode()])
        test = draw_frf_test(rng)
        if fault is None:
            return with_noise(rng, test)
        sigma = noise_of(rng, test)
        if fault in AFTER_NOISE:
            faulty = FAULTS[fault](rng, with_noise(rng, test, sigma))
        else:
            faulty = FAULTS[fault](rng, test)
            if faulty is not None:
                faulty = with_noise(rng, faulty)
        if faulty is not None:
            return faulty
    raise RuntimeError(f"no test can have {fault}")
