"""Section 4 of the review, a joint that slips: ``python experiments/paper/section4.py --out out``.

The link between DoFs 3 and 5 becomes an elasto-slip element of the same small-amplitude stiffness. Its two unknowns,
the stiffness that slip takes away and the slip force, come from three published numbers by gradient through the
harmonic balance; then the curves of figures 11 and 13, the diagrams of figures 12 and 14 to 16, tables 3 and 4 by the
forms of FRF and definitions of noise that may be meant, how many harmonics matter, and bandwidth dependence as a test.
"""

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from system import DEFINITIONS, OWN, STRUCTURE, TRUE, ZETA, gaussian, table, uniform_own

from modalax.data.frf import FRF
from modalax.identify import fdpi, lsce, lscf, residues, select, stabilization
from modalax.identify.bandwidth import bandwidth_test
from modalax.identify.tables import PoleTable
from modalax.model.receptance import directions
from modalax.show.stabilization import plot_stabilization
from modalax.simulate import harmonic_balance
from modalax.simulate.joints import ElastoSlip

matplotlib.use("Agg")

PLACE = ["3", "5"]
STEPS, DRAWS, BLOCK = 8, 30, 10  # parts, noise draws, and draws that a function is compiled for
FORCE = 6.0
LINK = float(-STRUCTURE.K[2, 4])
PUBLISHED = np.array([35.0, 35.23, 3.51])  # largest response [Hz]; there frequency [Hz] and damping [%] of mode 2
PRINTED = np.array([0.5, 0.005, 0.005])  # half of the last digit printed
ROUNDING = np.array([0.05, 0.005, 0.005])  # weights of the fit: the first would be read off lines 0.1 Hz apart
NAMES = ("largest response [Hz]", "frequency of mode 2 there [Hz]", "damping of mode 2 there [%]")
# What the review leaves open: whether the linear 2 % is a ratio to the actual frequency or a constant damping; whether
# the largest response is of acceleration or displacement; whether the equivalent damping is taken at the excitation
# frequency or at the actual one; whether the values are read at the peak or at the line of 35.0 Hz.
CHOICES = {
    "constant linear damping": np.array([0, 2, 0, 0]),
    "linear ratio 2 %": np.array([1, 2, 0, 0]),
    "constant linear damping, displacement": np.array([0, 0, 0, 0]),
    "linear ratio 2 %, displacement": np.array([1, 0, 0, 0]),
    "linear ratio 2 %, added at actual frequency": np.array([1, 2, 1, 0]),
    "linear ratio 2 %, read at 35.0 Hz": np.array([1, 2, 0, 1]),
    "linear ratio 2 %, both": np.array([1, 2, 1, 1]),
}
BANDS = ((1.0, 80.0), (20.0, 45.0), (31.0, 45.0), (33.0, 40.0))
TABLE_3 = {
    "LSCF": ((35.34, 3.69), (35.09, 4.06), (34.70, 3.76), (34.21, 3.48)),
    "LSCE": ((34.75, 3.74), (34.54, 4.10), (34.46, 3.55), (34.89, 1.70)),
    "FDPI": (None, (35.29, 4.25), (35.01, 4.56), (34.65, 4.65)),
}
# Orders that an operator would look at. Each is computed for itself, as the review's tools do: in one call all orders
# share the numerators of the largest (of FDPI, its left-hand side too), which bends the damping of what is no pole.
ORDERS = {"LSCF": (lscf, (10, 16, 22, 28, 34)), "LSCE": (lsce, (4, 6, 8, 10, 12)), "FDPI": (fdpi, (2, 3, 4, 5))}
SHOWN = {"LSCF": range(8, 41, 4), "LSCE": range(4, 31, 2), "FDPI": range(2, 11)}


def mode_2() -> tuple[float, float, float]:
    """Frequency [rad/s] and modal mass [kg] of mode 2, and the square of the joint's part in mode 2."""
    model = STRUCTURE.modal()
    shape = np.asarray(model.shapes[1].real)
    b = np.asarray(directions(STRUCTURE, [PLACE])[0])
    return float(jnp.abs(model.poles[1])), float(shape @ np.asarray(STRUCTURE.M) @ shape), float(shape @ b) ** 2


MODE_2 = mode_2()


def joint(unknowns: jax.Array) -> ElastoSlip:
    """The element less the link it replaces: small motions feel no change, slip takes the stiffness ``k`` away."""
    k, slip = jnp.exp(unknowns)
    return ElastoSlip(k, slip, -k)


def actual(law: ElastoSlip, amplitude: jax.Array, freq: jax.Array, choice: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Frequency [Hz] and damping ratio [%] of mode 2 at an amplitude: Rayleigh quotient, and added equivalent damping.

    The review does not say over which frequency the linear part of the damping is a ratio: see ``CHOICES``.
    """
    omega, mass, part = MODE_2
    N = law.describing(amplitude, 2 * jnp.pi * freq)
    own = jnp.sqrt(omega**2 + part * N.real / mass)
    linear = ZETA * jnp.where(choice[0] == 1, 1.0, omega / own)
    over = jnp.where(choice[2] == 1, own, 2 * jnp.pi * freq)
    zeta = linear + part * N.imag / (mass * over) / (2 * own)
    return own / (2 * jnp.pi), 100 * zeta


def three_numbers(unknowns: jax.Array, choice: jax.Array, harmonics: int = 1) -> jax.Array:
    """The three numbers that the review publishes."""
    law, freq = joint(unknowns), jnp.arange(33.5, 36.5, 0.02)
    r = harmonic_balance(STRUCTURE, [law], [PLACE], freq, FORCE, inputs=["1"], outputs=["1"], harmonics=harmonics)
    size, slip = freq ** choice[1] * jnp.abs(r.fundamental[0, :, 0, 0]), jnp.abs(r.q[0, :, 0, r.harmonics.index(1), 0])
    top = jax.lax.stop_gradient(jnp.clip(jnp.argmax(size), 1, len(freq) - 2))
    low, mid, high = (jnp.take(size, top + k) for k in (-1, 0, 1))
    peak = jnp.take(freq, top) + 0.02 * 0.5 * (low - high) / (low - 2 * mid + high)
    # the published frequency and damping are those at the line of the largest response
    read = jnp.where(choice[3] == 1, PUBLISHED[0], peak)
    return jnp.stack([peak, *actual(law, jnp.interp(read, freq, slip), read, choice)])


VALUE, SLOPE = jax.jit(three_numbers), jax.jit(jax.jacrev(three_numbers))


def solve(choice: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unknowns by Gauss-Newton on all three numbers over their rounding; also what they give and the sensitivities."""
    value, slope = partial(VALUE, choice=choice), partial(SLOPE, choice=choice)
    x = np.log([8000.0, 2.0])
    cost = np.inf
    for _ in range(40):
        r = (np.asarray(value(x)) - PUBLISHED) / ROUNDING
        J = np.asarray(slope(x)) / ROUNDING[:, None]
        step = np.linalg.lstsq(J, -r, rcond=None)[0]
        cost, length = float(r @ r), 1.0
        while length > 1e-3:
            tried = x + length * np.clip(step, -0.5, 0.5)
            after = (np.asarray(value(tried)) - PUBLISHED) / ROUNDING
            if float(after @ after) < cost:
                break
            length /= 2
        if length <= 1e-3 or cost - float(after @ after) < 1e-9:
            break
        x = tried
    return x, np.asarray(value(x)), np.asarray(slope(x))


def misfit(got: np.ndarray) -> float:
    """Largest distance from the published numbers, over the weights of the fit."""
    return float(np.max(np.abs(got - PUBLISHED) / ROUNDING))


def report_choices(found: dict[str, tuple]) -> str:
    """What each reading of the review gives."""
    rows = [
        [name, f"{np.exp(x[0]):.1f}", f"{np.exp(x[1]):.4f}", *(f"{g:.3f}" for g in got), f"{misfit(got):.2f}"]
        for name, (x, got, _) in found.items()
    ]
    head = ["reading", "k [N/m]", "slip force [N]", *NAMES, "worst, in half digits (0.05 Hz, 0.005 Hz, 0.005 %)"]
    return "\n## Readings of the three numbers\n\n" + table(head, rows)


def report_joint(x: np.ndarray, got: np.ndarray, slope: np.ndarray, choice: np.ndarray) -> str:
    k, slip = np.exp(x)
    cov = np.linalg.inv((slope / ROUNDING[:, None]).T @ (slope / ROUNDING[:, None]))
    spread = np.sqrt(np.diag(cov))
    more = np.asarray(three_numbers(jnp.asarray(x), jnp.asarray(choice), harmonics=5))
    rows = [
        [n, f"{p:g}", f"{g:.4f}", f"{m:.4f}", "yes" if abs(g - p) <= r else "no"]
        for n, p, g, m, r in zip(NAMES, PUBLISHED, got, more, PRINTED, strict=True)
    ]
    text = "\n## The joint from the three published numbers\n\n"
    text += f"Link 3-5: {LINK:.1f} N/m. Stiffness that slip takes away k = {k:.1f} N/m "
    text += f"(one rounding: {100 * spread[0]:.1f} %), slip force {slip:.4f} N ({100 * spread[1]:.1f} %), "
    text += f"slip displacement {1e6 * slip / k:.2f} um.\n\n"
    text += table(["", "review", "ours", "ours, harmonics 1, 3, 5", "within the digits printed"], rows)
    rows = [[n, *(f"{0.01 * s:+.4f}" for s in row)] for n, row in zip(NAMES, slope, strict=True)]
    return text + "\nChange for one per cent more of each unknown:\n\n" + table(["", "k", "slip force"], rows)


def curves(x: np.ndarray, choice: np.ndarray, out: Path) -> str:
    """Figures 11 and 13."""
    freq = np.arange(200, 701) * 0.1
    law = joint(jnp.asarray(x))
    r = harmonic_balance(STRUCTURE, [law], [PLACE], freq, FORCE, inputs=["1"], outputs=["1"])
    assert bool(r.converged.all())
    bent = FORCE * np.abs(np.asarray(r.frf_values("accelerance")[0, :, 0, 0]))
    straight = FORCE * np.abs(
        np.asarray(STRUCTURE.frf(freq, form="accelerance", outputs=["1"], inputs=["1"]).H[:, 0, 0])
    )
    own, zeta = (np.asarray(v) for v in actual(law, jnp.abs(r.q[0, :, 0, 0, 0]), jnp.asarray(freq), choice))
    figure, axes = plt.subplots(3, 1, figsize=(7, 8), sharex=True, layout="constrained")
    axes[0].semilogy(freq, straight, "0.6", label="linear")
    axes[0].semilogy(freq, bent, "#c0392b", label=f"slipping joint, {FORCE:g} N")
    axes[0].set_ylabel("acceleration at DoF 1 [m/s$^2$]")
    axes[0].legend(frameon=False)
    for axis, values, name in ((axes[1], own, "frequency of mode 2 [Hz]"), (axes[2], zeta, "damping of mode 2 [%]")):
        axis.plot(freq, values, "#2874a6")
        axis.set_ylabel(name)
    axes[2].set_xlabel("excitation frequency [Hz]")
    figure.savefig(out / "section4_curves.png", dpi=150)
    plt.close(figure)
    linear = np.asarray(STRUCTURE.modal().frequency_hz)
    rows = []
    for mode, f in enumerate(linear, start=1):
        near = np.flatnonzero(np.abs(freq - f) < 3.0)
        tops = [near[int(np.argmax(size[near]))] for size in (straight, bent)]
        rows.append(
            [str(mode), *(f"{freq[t]:.1f}" for t in tops), f"{100 * (bent[tops[1]] / straight[tops[0]] - 1):+.1f}"]
        )
    text = "\n## Figures 11 and 13\n\n" + table(
        ["mode", "linear peak [Hz]", "peak at 6 N [Hz]", "change of height [%]"], rows
    )
    lines = [f"{f:.2f}" for f in linear]
    at = [int(np.argmin(np.abs(freq - f))) for f in linear]
    text += "\nMode 2 as the excitation passes each mode:\n\n"
    return text + table(
        ["", *lines],
        [["frequency [Hz]", *(f"{own[a]:.2f}" for a in at)], ["damping [%]", *(f"{zeta[a]:.2f}" for a in at)]],
    )


def orders_for(method: str, band: tuple[float, float]) -> tuple[int, ...]:
    """Orders that a band has lines for, four for each."""
    return tuple(n for n in ORDERS[method][1] if 4 * n < round(10 * (band[1] - band[0])))


@partial(jax.jit, static_argnames=("method", "orders", "band"))
def poles_of(H: jax.Array, method: str, orders: int | tuple[int, ...], band: tuple[float, float]):
    """Poles of many noisy copies in a band, shape ``(draw, order, pole)``, and which of them are poles."""
    first, last = round(10 * band[0]), round(10 * band[1])

    def one(values: jax.Array):
        found = ORDERS[method][0](FRF(jnp.arange(first, last + 1) * 0.1, values), orders)
        return found.poles, found.valid

    return jax.lax.map(one, H[:, first - 1 : last], batch_size=8)


def nearest(poles: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Frequency [Hz] and damping [%] of the stable pole nearest the peak, 35 Hz, within 2 Hz; NaN if there is none."""
    f = np.abs(poles) / (2 * np.pi)
    zeta = -poles.real / np.maximum(np.abs(poles), 1e-9)
    good = valid & (poles.imag > 0) & (zeta > 0) & (zeta < 0.15) & (np.abs(f - PUBLISHED[0]) < 2.0)
    pick = np.argmin(np.where(good, np.abs(f - PUBLISHED[0]), np.inf), axis=-1)[..., None]
    found = np.stack([np.take_along_axis(a, pick, axis=-1)[..., 0] for a in (f, 100 * zeta)], axis=-1)
    return np.where(good.any(axis=-1)[..., None], found, np.nan)


def bent_frf(x: np.ndarray, form: str = "receptance", force: float = FORCE) -> FRF:
    """The first FRF column at a force, 0.1 to 80 Hz."""
    lines = np.arange(1, 801)
    r = harmonic_balance(STRUCTURE, [joint(jnp.asarray(x))], [PLACE], lines * 0.1, force, inputs=["1"])
    assert bool(r.converged.all())
    return r.measurement(form).run(0)


def noisy_copies(frf: FRF, noise: str, draws: int, level: float = 0.15) -> jax.Array:
    """FRFs with noise by one of the definitions, shape ``(draw, f, o, i)``."""
    frf = frf.replace(variance=DEFINITIONS[noise](frf.H) + 1e-24 * jnp.max(jnp.abs(frf.H)) ** 2)
    sampler = uniform_own if noise == OWN else gaussian
    keys = jax.random.split(jax.random.key(4), draws)
    return jax.vmap(lambda key: frf.H + sampler(key, frf, jnp.array(level)))(keys)


def identified(noisy: jax.Array, together: bool = False) -> dict[tuple[str, tuple[float, float]], np.ndarray]:
    """Frequency and damping of mode 2 by method and band, ``(draw, order, 2)``; ``together`` or each order alone."""
    found = {}
    for method in TABLE_3:
        for band in BANDS:
            orders = orders_for(method, band)
            calls = (orders,) if together else orders
            found[method, band] = np.concatenate([
                np.concatenate([nearest(*map(np.asarray, poles_of(part, method, n, band))) for n in calls], axis=1)
                for part in (noisy[k : k + BLOCK] for k in range(0, len(noisy), BLOCK))
            ])  # fmt: skip
    return found


def distances(found: dict) -> tuple[float, float, int]:
    """Root mean square of review minus ours: frequency [Hz], damping [%]; and how many cells nothing was found in."""
    gaps, empty = [], 0
    for method, published in TABLE_3.items():
        for band, theirs in zip(BANDS, published, strict=True):
            values = found[method, band]
            if np.isnan(values[..., 0]).all():
                empty += 1
            elif theirs is not None:
                gaps.append(np.nanmean(values, axis=(0, 1)) - theirs)
    return *np.sqrt(np.mean(np.square(gaps), axis=0)), empty


VARIANTS = [
    (form, noise)
    for form in ("receptance", "mobility", "accelerance")
    for noise in (OWN, list(DEFINITIONS)[0], list(DEFINITIONS)[3])
]


def report_variants(x: np.ndarray, draws: int) -> tuple[str, list[tuple[str, str]]]:
    """Every reading of what was identified, and the two nearest: 0.3 Hz count as much as 0.5 % of damping."""
    rows, score = [], {}
    for form, noise in VARIANTS:
        noisy = noisy_copies(bent_frf(x, form), noise, draws)
        f, z, empty = distances(identified(noisy))
        shared = distances(identified(noisy, together=True))
        score[form, noise] = f / 0.3 + z / 0.5
        rows.append(
            [form, noise, f"{f:.2f}", f"{z:.2f}", str(empty), *(f"{d:.2f}" for d in shared[:2]), str(shared[2])]
        )
    cells = ["frequency: review less ours, rms [Hz]", "damping [%]", "cells without mode 2"]
    head = ["FRF", "noise", *cells, *(f"orders in one call: {c}" for c in ("frequency", "damping", "without"))]
    text = f"\n## Which FRFs and which noise tables 3 and 4 may mean ({draws} draws)\n\n" + table(head, rows)
    return text, sorted(score, key=lambda k: score[k])[:2]


def cell(values: np.ndarray, theirs: float | None, digits: float) -> list[str]:
    """The review's figure, ours with spreads over draws and over orders, and whether the two agree."""
    mean, draws = np.nanmean(values), np.nanmean(np.nanstd(values, axis=0))
    orders = np.nanmean(values, axis=0)
    ours = f"{mean:.2f} ± {draws:.2f}, orders {np.nanmin(orders):.2f}..{np.nanmax(orders):.2f}"
    if theirs is None:
        return ["-", ours, "-"]
    # as far as both spreads, of draws and of orders that could have been chosen, and rounding allow
    away = (theirs - mean) / np.hypot(np.nanstd(values), digits)
    return [f"{theirs:.2f}", ours, f"{'yes' if abs(away) <= 2 else 'no'} ({away:+.1f})"]


def tables_3_and_4(x: np.ndarray, draws: int, form: str, noise: str) -> str:
    """Mode 2 identified from the 6 N FRFs at 15 % noise, in four bands, over many draws."""
    found = identified(noisy_copies(bent_frf(x, form), noise, draws))
    rows3, rows4 = [], []
    for method, published in TABLE_3.items():
        for band, theirs in zip(BANDS, published, strict=True):
            values, name = found[method, band], [method, f"{band[0]:g}-{band[1]:g}"]
            there = f"{100 * np.isfinite(values[..., 0]).mean():.0f}"
            if np.isnan(values[..., 0]).all():
                rows3.append([*name, *(f"{v:.2f}" for v in theirs or ()), "none", there])
                continue
            pair = (None, None) if theirs is None else theirs
            cells = [cell(values[..., k], pair[k], digits) for k, digits in ((0, 0.005), (1, 0.005))]
            rows3.append([*name, *cells[0], *cells[1], there])
            ours4 = off_published(np.nanmean(values, axis=(0, 1)))
            theirs4 = ["-", "-"] if theirs is None else off_published(theirs)
            rows4.append([*name, theirs4[0], ours4[0], theirs4[1], ours4[1]])
    agree = "agree (distance in spreads)"
    head3 = ["", "band [Hz]", "f review", "f ours [Hz]", agree, "damping review", "ours [%]", agree, "found [%]"]
    head4 = ["", "band [Hz]", "frequency review", "ours [%]", "damping review", "ours [%]"]
    text = f"\n## Table 3: mode 2 at 15 % noise, {draws} draws (mean and spread); {form}, {noise}\n\n"
    text += table(head3, rows3)
    return text + "\n## Table 4: deviation from the actual 35.23 Hz and 3.51 %\n\n" + table(head4, rows4)


def one_by_one(method: str, frf: FRF) -> PoleTable:
    """A diagram whose orders are computed each for itself."""
    made = [ORDERS[method][0](frf, n) for n in SHOWN[method]]
    wide = max(t.poles.shape[1] for t in made)
    poles, valid = (
        jnp.concatenate([jnp.pad(a, ((0, 0), (0, wide - a.shape[1]))) for a in parts])
        for parts in ([t.poles for t in made], [t.valid for t in made])
    )
    return PoleTable(poles, valid, None, tuple(SHOWN[method]), method.lower())


def poles_a_peak(data: FRF) -> np.ndarray:
    """Steady LSCF poles within 2.5 Hz of each mode, mean over orders 24 to 40, each computed for itself."""
    found = one_by_one("LSCF", data)
    flags = stabilization(found)
    steady = np.asarray(flags.frequency) & np.asarray(flags.damping) & np.asarray(found.physical(20.0, 70.0, 0.1))
    hertz = np.abs(np.asarray(found.poles)) / (2 * np.pi)
    return np.array([(steady & (np.abs(hertz - f) < 2.5))[4:].sum(1).mean() for f in np.abs(TRUE) / (2 * np.pi)])


def diagrams(x: np.ndarray, form: str, noise: str, out: Path, draws: int = DRAWS) -> str:
    """Figures 12 and 14 to 16: diagrams without and with noise, what they lead to, and poles a peak."""
    clean = bent_frf(x, form).band(20.0, 70.0)
    noisy = noisy_copies(bent_frf(x, form), noise, draws)[:, 199:700]
    loud = clean.replace(H=noisy[0])
    for label, file, data in (
        ("without noise", "fig12_lscf_clean", clean),
        ("with 15 % noise", "fig12_lscf_noisy", loud),
    ):
        found = one_by_one("LSCF", data)
        figure = plot_stabilization(found, stabilization(found), data, title=f"LSCF, {FORCE:g} N, {label}")
        figure.savefig(out / f"{file}.png", dpi=110)
        plt.close(figure)
    many = np.array([poles_a_peak(clean.replace(H=H)) for H in noisy])
    rows = [
        ["without noise", *[f"{c:.2f}" for c in poles_a_peak(clean)]],
        [
            f"with 15 % noise, {draws} draws",
            *[f"{m:.2f} ± {s:.2f}" for m, s in zip(many.mean(0), many.std(0), strict=True)],
        ],
        [
            "draws with more than one at an order",
            *[f"{100 * (many > 1).mean(0)[k]:.0f} %" for k in range(many.shape[1])],
        ],
    ]
    for number, method in zip((14, 15, 16), ORDERS, strict=True):
        _fit_picture(loud.band(20.0, 45.0), clean, method, out / f"fig{number}_{method.lower()}.png")
    head = ["steady poles within 2.5 Hz of", *[f"mode {k}" for k in range(1, 6)]]
    return "\n## Figure 12: poles at a peak, orders 24 to 40 of LSCF, each for itself\n\n" + table(head, rows)


def _fit_picture(data: FRF, clean: FRF, method: str, file: Path) -> None:
    """A diagram of 20 to 45 Hz beside the drive point FRF that follows from the poles selected in it."""
    found = one_by_one(method, data)
    figure = plot_stabilization(found, stabilization(found), data, title=f"{method}, 20-45 Hz, 15 % noise")
    figure.savefig(file, dpi=110)
    plt.close(figure)
    picked = np.asarray(select(found, max_damping=0.15, min_score=0.2, min_orders=3, reach=0.02).poles)
    # as an operator takes them: one a peak, the nearest
    hertz = np.abs(picked) / (2 * np.pi)
    near = [int(np.argmin(np.abs(hertz - f))) for f in (26.0, 35.0) if np.any(np.abs(hertz - f) < 2.0)]
    poles = picked[near]
    figure, axis = plt.subplots(figsize=(7, 4), layout="constrained")
    axis.semilogy(data.freq, np.abs(data.H[:, 0, 0]), ".", ms=3, color="0.5", label="with 15 % noise")
    band = clean.band(20.0, 45.0)
    axis.semilogy(band.freq, np.abs(band.H[:, 0, 0]), "k", lw=0.8, label="without noise")
    if poles.size:
        made = residues(data, poles, weights="unit").frf(data.freq, form=data.form)
        text = ", ".join(f"{abs(p) / 2 / np.pi:.2f} Hz {-100 * p.real / abs(p):.2f} %" for p in poles)
        axis.semilogy(data.freq, np.abs(made.H[:, 0, 0]), "#c0392b", label=f"{method}: {text}")
    axis.set_xlabel("frequency [Hz]")
    axis.set_ylabel(f"drive point {data.form}")
    axis.legend(fontsize=8)
    figure.savefig(file.with_name(file.stem + "_synthesis.png"), dpi=110)
    plt.close(figure)


def off_published(pair: np.ndarray) -> list[str]:
    """How far a frequency and a damping are from the published ones, in per cent."""
    return [f"{100 * (v / p - 1):+.1f}" for v, p in zip(pair, PUBLISHED[1:], strict=True)]


def report_harmonics(x: np.ndarray) -> str:
    """How the FRFs at 6 N change with the number of harmonics."""
    freq = np.arange(100, 351) * 0.2
    law, kept = joint(jnp.asarray(x)), (1, 3, 5, 9, 15)
    run = partial(harmonic_balance, STRUCTURE, [law], [PLACE], freq, FORCE, inputs=["1"], samples=256)
    made = {h: np.asarray(run(harmonics=h).fundamental[0, :, :, 0]) for h in kept}
    best = made[kept[-1]]
    near = np.abs(freq - 35.0) < 3.0
    rows = [
        [str(h), f"{np.abs(X - best).max() / np.abs(best).max():.1e}",
         f"{(np.abs(X - best)[near].max(0) / np.abs(best)[near].max(0)).max():.1e}"]
        for h, X in made.items() if h != kept[-1]
    ]  # fmt: skip
    head = ["highest harmonic", "largest change over the peak", "near mode 2, each output over its own"]
    return f"\n## Harmonics: fundamentals at 6 N against {kept[-1]} harmonics\n\n" + table(head, rows)


def report_bandwidth(x: np.ndarray, draws: int, level: float = 0.05) -> str:
    """Hausman's test of mode 2: how often it rejects a linear structure, at rising force."""
    wide, rows = (20.0, 70.0), []
    for force in (0.1, 1.0, 2.0, 6.0):
        exact = bent_frf(x, "receptance", force).band(*wide)
        power = jnp.abs(exact.H) ** 2
        frf = exact.replace(variance=2 * level**2 * power + 1e-6 * level**2 * jnp.max(power))
        row = [f"{force:g}"]
        for band in BANDS[2:]:
            tests = []
            for key in jax.random.split(jax.random.key(6), draws):
                noisy = frf.replace(H=frf.H + gaussian(key, frf, jnp.array(1.0)))
                tests.append(bandwidth_test(noisy, TRUE, 36.0, band))
            p = np.array([float(t.p_value) for t in tests])
            good = np.array([bool(t.valid) for t in tests])
            row += [f"{100 * (p[good] < 0.05).mean():.0f}", f"{np.median(p[good]):.1e}", f"{good.sum()}"]
        rows.append(row)
    head = ["force [N]", *[f"{lo:g}-{hi:g} Hz: {w}" for lo, hi in BANDS[2:] for w in ("p < 5 % [%]", "median p", "of")]]
    text = (
        f"\n## Bandwidth dependence of mode 2 as a test, {100 * level:g} % noise, against 20-70 Hz, {draws} draws\n\n"
    )
    return text + table(head, rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder of the tables and the pictures")
    parser.add_argument("--draws", type=int, default=DRAWS, help="noise draws of tables 3 and 4 (0: leave them out)")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    study(args.out, args.draws, print)


def study(out: Path, draws: int, tell: Callable[[str], object]) -> str:
    """All parts; each is told as it is made."""
    found = {name: solve(choice) for name, choice in CHOICES.items()}
    best = min(found, key=lambda name: misfit(found[name][1]))
    (x, got, slope), choice = found[best], CHOICES[best]
    text = f"# Section 4 of the review: a joint that slips\n\nReading used: {best}.\n"
    chosen: list[tuple[str, str]] = []

    def variants() -> str:
        made, best = report_variants(x, max(draws // 3, 1))
        chosen.extend(best)
        return made

    parts = [
        lambda: report_choices(found), lambda: report_joint(x, got, slope, choice), lambda: curves(x, choice, out),
        lambda: report_harmonics(x),
    ]  # fmt: skip
    if draws:
        parts += [
            variants, lambda: "".join(tables_3_and_4(x, draws, *reading) for reading in chosen),
            lambda: diagrams(x, *chosen[0], out, draws),
            lambda: report_bandwidth(x, draws),
        ]  # fmt: skip
    for part in parts:
        made = part()
        tell(made)
        text += made
        (out / "section4.md").write_text(text)
    return text


if __name__ == "__main__":
    main()
