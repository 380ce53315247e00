"""Section 5 of the review: a large aircraft, simulated, so that the truth is known.

458 sensors, 4 exciters, 112 modes to 30 Hz, sensor noise, and ten control-surface modes that soften and gain damping
with amplitude, each exciter driving them to another one.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from meter import Meter
from scipy.optimize import linear_sum_assignment
from system import table

from modalax.data.frf import FRF
from modalax.identify import fdpi, lsce, plscf, refine, residues
from modalax.identify.consistent import subspace
from modalax.identify.tables import PoleTable

SENSORS, MODES, BANDS, STEPS = {"wing": 240, "fuselage": 90, "tailplane": 60, "fin": 28, "engine": 40}, 112, 12, 13
EDGES = np.linspace(1.0, 30.0, BANDS + 1)
MARGIN = 0.35  # [Hz] kept on either side of a band
STEP = 0.0125  # [Hz]


class Aircraft(NamedTuple):
    """Frequency axis, accelerance, its variance, and the truth."""

    freq: np.ndarray
    H: np.ndarray
    variance: np.ndarray
    poles: np.ndarray
    shapes: np.ndarray
    soft: np.ndarray


def aircraft(seed: int = 380) -> Aircraft:
    """Modes with wave-like shapes on five components, symmetric or antisymmetric, and local control-surface modes."""
    rng = np.random.default_rng(seed)
    hertz = 1.1 + 28.6 * ((np.arange(MODES) + rng.uniform(0, 0.9, MODES)) / MODES) ** 0.85
    zeta = np.exp(rng.normal(np.log(0.015), 0.4, MODES))
    shapes = np.concatenate([_component(rng, n, hertz) for n in SENSORS.values()], axis=1)
    soft = np.zeros(MODES, bool)
    soft[rng.choice(np.arange(15, MODES), 10, replace=False)] = True
    for r in np.flatnonzero(soft):
        where = rng.integers(0, 230)
        shapes[r] *= 0.15
        shapes[r, where : where + 8] += rng.uniform(0.6, 1.0)
    shapes /= np.abs(shapes).max(axis=1, keepdims=True)
    mass = np.exp(rng.normal(np.log(500.0), 0.6, MODES))
    inputs = np.array([2, 118, 355, 448])
    freq = np.arange(round(0.6 / STEP), round(30.5 / STEP) + 1) * STEP
    H = _accelerance(freq, hertz, zeta, shapes, mass, inputs, soft)
    size = np.abs(H)
    variance = 2 * (0.03 * size) ** 2 + 2 * (0.02 * np.sqrt(np.mean(size**2, axis=0, keepdims=True))) ** 2
    noise = rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)
    omega = 2 * np.pi * hertz
    poles = -zeta * omega + 1j * omega * np.sqrt(1 - zeta**2)
    return Aircraft(freq, H + noise * np.sqrt(variance / 2), variance, poles, shapes, soft)


def _component(rng: np.random.Generator, count: int, hertz: np.ndarray) -> np.ndarray:
    """Waves along both halves of a component, the second half the mirror image with its sign."""
    x = np.linspace(0, 1, count // 2)
    parity = rng.choice([-1.0, 1.0], len(hertz))[:, None]
    waves = np.zeros((len(hertz), len(x)))
    for k in range(1, 9):
        weight = np.exp(-0.5 * ((k - 1 - hertz / 5) / 1.5) ** 2) * rng.normal(size=len(hertz))
        waves += weight[:, None] * np.cos(np.pi * k * x[None] + rng.uniform(0, 2 * np.pi, (len(hertz), 1)))
    size = np.exp(rng.normal(0, 0.8, (len(hertz), 1)))
    return size * np.concatenate([waves, parity * waves], axis=1)


def _accelerance(
    freq: np.ndarray, hertz: np.ndarray, zeta: np.ndarray, shapes: np.ndarray, mass: np.ndarray, inputs: np.ndarray,
    soft: np.ndarray,
) -> np.ndarray:  # fmt: skip
    omega = 2 * np.pi * freq[:, None]
    w = 2 * np.pi * hertz
    Q = 1 / (mass * (w**2 - omega**2 + 2j * zeta * w * omega))
    force = shapes[:, inputs].T
    H = np.empty((len(freq), shapes.shape[1], len(inputs)), complex)
    for i in range(len(inputs)):
        column = Q.copy()
        for r in np.flatnonzero(soft):
            column[:, r] = _softened(omega[:, 0], w[r], zeta[r], mass[r], abs(force[i, r]))
        H[:, :, i] = (-(omega**2) * column * force[i]) @ shapes
    return H


def _softened(omega: np.ndarray, w: float, zeta: float, mass: float, force: float) -> np.ndarray:
    """One mode whose frequency falls by up to 5 % and whose damping doubles with its own amplitude."""
    linear = 1 / (mass * 2 * zeta * w**2)
    q = np.zeros(len(omega), complex)
    for _ in range(200):
        part = np.abs(q) * force / linear
        part = part / (0.5 + part)
        we, ze = w * (1 - 0.05 * part), zeta * (1 + part)
        q = 0.8 * q + 0.2 / (mass * (we**2 - omega**2 + 2j * ze * w * omega))
    return q


def study(out: Path, advance: Callable[[], None]) -> list[str]:
    """Every method on every band; counts as in the review, but against the truth."""
    began = time.perf_counter()
    plane = aircraft()
    advance()
    found: dict[str, np.ndarray] = {name: np.full(MODES, np.nan, complex) for name in (*ESTIMATORS, LIKELIHOOD)}
    meter = Meter()
    truth = np.abs(plane.poles) / (2 * np.pi)
    width = round((EDGES[1] - EDGES[0] + 2 * MARGIN) / STEP)  # one number of lines, so one compilation
    for low, high in zip(EDGES[:-1], EDGES[1:], strict=True):
        start = min(max(np.searchsorted(plane.freq, low - MARGIN), 0), len(plane.freq) - width)
        part = slice(int(start), int(start) + width)
        frf = FRF(plane.freq[part], plane.H[part], form="accelerance", variance=plane.variance[part])
        here = np.flatnonzero((truth >= low) & (truth < high))
        around = np.flatnonzero((truth >= low - MARGIN) & (truth < high + MARGIN))
        matched = {}
        for name, estimator in ESTIMATORS.items():
            with meter.running(name):
                matched[name] = _matched(plane, frf, estimator(frf), around)
            found[name][here] = matched[name][np.isin(around, here)]
        # a mode that is left out bends its neighbours, so each starts from the first method that has it
        start = np.full(len(around), np.nan, complex)
        for name in START:
            start = np.where(np.isfinite(start), start, matched[name])
        with meter.running(LIKELIHOOD):
            refined = _matched(plane, frf, _likelihood(frf, start), around)
        found[LIKELIHOOD][here] = refined[np.isin(around, here)]
        advance()
    _draw(out, plane, found)
    (out / "section5_modes.md").write_text(_mode_by_mode(plane, found))
    head = (
        f"{sum(SENSORS.values())} sensors, 4 exciters, {MODES} modes, {len(plane.freq)} lines: "
        f"{plane.H.nbytes / 1e6:.0f} MB of FRFs, {time.perf_counter() - began:.0f} s in all.\n"
    )
    return [head, _counts(plane, found, meter), _against_fdpi(found)]


def _matched(plane: Aircraft, frf: FRF, result: PoleTable, around: np.ndarray) -> np.ndarray:
    """The stable pole that an operator would take for each true mode: near in frequency and alike in shape."""
    poles, valid = np.asarray(result.poles[0]), np.asarray(result.valid[0])
    zeta = -poles.real / np.maximum(np.abs(poles), 1e-12)
    freq = np.abs(poles) / (2 * np.pi)
    poles = poles[valid & (zeta > 0) & (zeta < 0.15) & (freq > frf.freq[0]) & (freq < frf.freq[-1])]
    shapes = _shapes(frf, poles)
    true = plane.poles[around]
    power = np.abs(np.einsum("no,mio->nmi", plane.shapes[around], shapes)) ** 2
    mac = (power / np.sum(plane.shapes[around] ** 2, 1)[:, None, None] / np.sum(np.abs(shapes) ** 2, 2)).max(2)
    away = 100 * np.abs(np.abs(poles)[None] / np.abs(true)[:, None] - 1)
    cost = away / 2 + (1 - mac)
    rows, columns = linear_sum_assignment(np.minimum(cost, 3.0))
    answer = np.full(len(around), np.nan, complex)
    for row, column in zip(rows, columns, strict=True):
        if cost[row, column] < 3.0:
            answer[row] = poles[column]
    return answer


def _shapes(frf: FRF, poles: np.ndarray) -> np.ndarray:
    """Residues by plain least squares, shape ``(pole, i, o)``."""
    s = 2j * np.pi * np.asarray(frf.freq)[:, None]
    near, far = 1 / (s - poles), 1 / (s - poles.conj())
    columns = np.concatenate([s**2 * near, s**2 * far, np.ones_like(s), s**2], axis=1)
    scale = np.linalg.norm(columns, axis=0)
    H = np.asarray(frf.H)
    fitted = np.linalg.lstsq(columns / scale, H.reshape(len(H), -1), rcond=1e-10)[0] / scale[:, None]
    return np.swapaxes(fitted[: len(poles)].reshape(len(poles), *H.shape[1:]), 1, 2)


def compressed(frf: FRF, count: int = 24) -> FRF:
    """The first principal responses of the whitened sensors: the same poles, the noise still white, far less to do."""
    variance = jnp.asarray(frf.variance)
    sigma = jnp.sqrt(jnp.mean(variance, axis=(0, 2)))[None, :, None]
    white = frf.H / sigma
    rows = jnp.swapaxes(white, 1, 2).reshape(-1, white.shape[1])
    V = jnp.linalg.eigh((rows.conj().T @ rows).real)[1][:, -count:]
    small = jnp.einsum("foi,oc->fci", white, V)
    return FRF(frf.freq, small, form=frf.form, variance=jnp.einsum("foi,oc->fci", variance / sigma**2, V**2))


LIKELIHOOD = "maximum likelihood"
COLOURS = {"LSCF": "#c0392b", "LSCE": "#2874a6", "FDPI": "#1e8449", "subspace": "#7d3c98", LIKELIHOOD: "#222222"}
START = ("FDPI", "subspace", "LSCE", "LSCF")
SLOTS = 24  # modes a band is compiled for


def _likelihood(frf: FRF, start: np.ndarray) -> PoleTable:
    """Maximum likelihood on the principal responses, from the poles found."""
    data, poles = compressed(frf), start[np.isfinite(start)]
    refined = refine(data, residues(data, poles), slots=max(SLOTS, len(poles))).model.poles
    return PoleTable(refined[None], jnp.isfinite(refined)[None], None, (len(poles),), LIKELIHOOD)


ESTIMATORS: dict[str, Callable[[FRF], PoleTable]] = {
    "LSCF": lambda f: plscf(f, 16),
    "LSCE": lambda f: lsce(f, 16),
    "FDPI": lambda f: fdpi(f, 24),
    "subspace": lambda f: subspace(compressed(f), 40),
}


def _counts(plane: Aircraft, found: dict[str, np.ndarray], meter: Meter) -> str:
    rows = []
    for name, poles in found.items():
        df = 100 * (np.abs(poles) / np.abs(plane.poles) - 1)
        true = -plane.poles.real / np.abs(plane.poles)
        dz = 100 * (-poles.real / np.abs(poles) / true - 1)
        there = np.isfinite(df)
        linear = there & ~plane.soft
        rows.append([
            name, str(there.sum()), f"{(abs(df[there]) > 1).sum()} / {(abs(df[linear]) > 1).sum()}",
            f"{(abs(dz[there]) > 50).sum()} / {(abs(dz[linear]) > 50).sum()}", f"{(dz[there] < 0).sum()}",
            f"{np.median(dz[linear]):+.1f}", f"{np.median(abs(dz[linear])):.1f}", f"{meter.seconds[name]:.0f}",
            f"{meter.megabytes[name]:.0f}",
        ])  # fmt: skip
    return table(
        ["method", "modes found", "frequency off by more than 1 %: all / linear", "damping off by more than 50 %",
         "damping underestimated", "median damping error, linear [%]", "median size of it [%]", "seconds",
         "peak memory above what was held before [MB]"], rows,
    )  # fmt: skip


def _mode_by_mode(plane: Aircraft, found: dict[str, np.ndarray]) -> str:
    """Deviation of every mode from the truth by every method."""
    true, rows = -plane.poles.real / np.abs(plane.poles), []
    for r, pole in enumerate(plane.poles):
        row = [
            f"{r + 1}{' (non-linear)' if plane.soft[r] else ''}",
            f"{abs(pole) / 2 / np.pi:.3f}",
            f"{100 * true[r]:.2f}",
        ]
        for poles in found.values():
            f, z = 100 * (abs(poles[r]) / abs(pole) - 1), 100 * (-poles[r].real / abs(poles[r]) / true[r] - 1)
            row.append(f"{f:+.2f} / {z:+.1f}" if np.isfinite(f) else "-")
        rows.append(row)
    return table(["mode", "f [Hz]", "damping [%]", *[f"{n}: f / damping [%]" for n in found]], rows)


def _against_fdpi(found: dict[str, np.ndarray]) -> str:
    """The review's own counts: FDPI taken as the reference."""
    rows = [["review", "LSCF", "21", "27", "74"], ["review", "LSCE", "21", "18", "-"]]
    zeta = {name: -p.real / np.abs(p) for name, p in found.items()}
    for name in ("LSCF", "LSCE", "subspace", LIKELIHOOD):
        df = 100 * (np.abs(found[name]) / np.abs(found["FDPI"]) - 1)
        dz = 100 * (zeta[name] / zeta["FDPI"] - 1)
        there = np.isfinite(df)
        below = str((dz[there] < 0).sum())
        rows.append(["ours", name, str((abs(df[there]) > 1).sum()), str((abs(dz[there]) > 50).sum()), below])
    return table(["", "against FDPI", "frequency by more than 1 %", "damping by more than 50 %", "damping lower"], rows)


def _draw(out: Path, plane: Aircraft, found: dict[str, np.ndarray]) -> None:
    """Figures 19 and 20, against the truth."""
    true = -plane.poles.real / np.abs(plane.poles)
    number = np.arange(1, MODES + 1)
    for file, label, limit, of in (
        ("fig19_frequency", "frequency deviation [%]", 1, lambda p: 100 * (np.abs(p) / np.abs(plane.poles) - 1)),
        ("fig20_damping", "damping deviation [%]", 50, lambda p: 100 * (-p.real / np.abs(p) / true - 1)),
    ):
        fig, ax = plt.subplots(figsize=(14, 4.5))
        for r in np.flatnonzero(plane.soft):
            ax.axvspan(r + 0.5, r + 1.5, color="#eeeeee")
        for name, poles in found.items():
            ax.plot(number, np.clip(of(poles), -3 * limit, 3 * limit), "o", ms=3.5, color=COLOURS[name], label=name)
        for edge in (-limit, limit):
            ax.axhline(edge, color="#888888", lw=0.8)
        ax.set_xlabel("mode number (grey: control surfaces, non-linear)")
        ax.set_ylabel(label)
        ax.set_ylim(-3.1 * limit, 3.1 * limit)
        ax.legend(ncol=5, fontsize=8)
        ax.grid(alpha=0.3)
        fig.tight_layout()
        fig.savefig(out / f"{file}.png", dpi=110)
        plt.close(fig)
