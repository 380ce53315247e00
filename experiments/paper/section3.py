"""Section 3 of the review: the influence of noise on three methods, and on ours."""

from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from system import (
    BAND,
    DEFINITIONS,
    LEVELS,
    OWN,
    SAMPLERS,
    TRUE,
    clean,
    draw_poles,
    errors,
    gaussian,
    nearest_stable,
    noisy_case,
    pick,
    statistics,
    table,
    uniform_own,
    with_noise,
)

from modalax.data.frf import FRF
from modalax.identify import fdpi, lsce, lscf, plscf, predicted_damping_bias, refine, residues, stabilization
from modalax.identify.consistent import compensated, subspace
from modalax.identify.tables import PoleTable
from modalax.show.stabilization import plot_stabilization

DRAWS = 200
ORDER = 32  # of LSCF and LSCE: about three times what ten poles need
FDPI_ORDER = 8
COLOURS = {
    "LSCF": "#c0392b",
    "LSCE": "#2874a6",
    "FDPI": "#1e8449",
    "subspace": "#7d3c98",
    "compensated": "#d68910",
    "maximum likelihood": "#222222",
}


def fdpi_split(frf: FRF) -> PoleTable:
    """FDPI as the review used it: 20 to 45 and 45 to 70 Hz apart."""
    parts = [fdpi(frf.lines(slice(0, 251)), FDPI_ORDER), fdpi(frf.lines(slice(250, 501)), FDPI_ORDER)]
    edge = 2 * np.pi * 45.0
    valid = [parts[0].valid & (jnp.abs(parts[0].poles) < edge), parts[1].valid & (jnp.abs(parts[1].poles) >= edge)]
    poles = jnp.concatenate([p.poles for p in parts], axis=1)
    return PoleTable(poles, jnp.concatenate(valid, axis=1), None, (FDPI_ORDER,), "fdpi")


def likelihood(frf: FRF) -> PoleTable:
    """Maximum likelihood from the poles of the signal subspace."""
    start = nearest_stable(subspace(frf, 10, weights="variance"))
    poles = refine(frf, residues(frf, start)).model.poles
    return PoleTable(poles[None], jnp.isfinite(poles)[None], None, (len(poles),), "maximum likelihood")


METHODS: dict[str, Callable[[FRF], PoleTable]] = {
    "LSCF": lambda f: lscf(f, ORDER),
    "LSCE": lambda f: lsce(f, ORDER),
    "FDPI": fdpi_split,
    "subspace": lambda f: subspace(f, 10, weights="variance"),
    "compensated": lambda f: compensated(f, 20, weights="variance"),
    "maximum likelihood": likelihood,
}


def noise_free() -> str:
    """Errors of every method without noise."""
    frf = clean().band(*BAND)
    full = clean().lines(slice(1, None))
    runs: dict[str, PoleTable] = {
        f"LSCF, order {ORDER}": lscf(frf, ORDER),
        f"pLSCF, order {ORDER}": plscf(frf, ORDER),
        "FDPI, order 5, 20-70 Hz": fdpi(frf, 5, residual=0),
        f"LSCE, order {ORDER}, 20-70 Hz": lsce(frf, ORDER),
        f"LSCE real, order {2 * ORDER}, 0.1-80 Hz": lsce(full, 2 * ORDER, real=True),
        "subspace, 10 poles": subspace(frf, 10),
    }
    rows = []
    for name, found in runs.items():
        df, dz = errors(pick(np.asarray(found.poles), np.asarray(found.valid)))
        rows.append([name, f"{np.nanmax(np.abs(df)):.1e}", f"{np.nanmax(np.abs(dz)):.1e}", "0.01"])
    best = lscf(frf, ORDER)
    poles = pick(np.asarray(best.poles), np.asarray(best.valid))[0]
    found = refine(frf, residues(frf, poles * (1 + 1e-4j))).model.poles
    df, dz = errors(np.asarray(found)[None])
    rows.append(["maximum likelihood", f"{np.abs(df).max():.1e}", f"{np.abs(dz).max():.1e}", "-"])
    return table(["method", "largest frequency error [%]", "largest damping error [%]", "review [%]"], rows)


def definitions() -> str:
    """Mode 3 at 25 % noise by every definition, form and option, predicted without a draw; and drawn where it lasts."""
    rows, level = [], LEVELS[-1]
    options = {"arc 0.8, n = 32": dict(orders=ORDER), "circle, n = 20": dict(orders=20, arc=1.0)}
    cases = [(form, option) for form in ("receptance", "accelerance") for option in options]
    for name in DEFINITIONS:
        row = [name]
        for form, option in cases:
            frf = noisy_case(name, form)
            bias = predicted_damping_bias(frf, TRUE, variance=frf.variance * level**2, **options[option])
            value = 100 * float(bias.relative_damping[2])
            row.append(f"{value:.1f}" + (" (unstable: lost)" if value <= -100 else ""))
        if "lost" not in row[1]:
            drawn = draw_poles(
                noisy_case(name), jnp.asarray(level), 11, estimator=METHODS["LSCF"], sampler=SAMPLERS[name], count=DRAWS
            )
            _, _, mean, std, lost = statistics(pick(*map(np.asarray, drawn)), 2)
            row[1] += f" (drawn {mean:.1f} ± {std:.1f}, {lost} lost)"
        rows.append(row)
    head = [f"{form}, {option}" for form, option in cases]
    return table(["noise [%: damping of mode 3, review -83]", *head], rows)


def diagrams(out: Path) -> str:
    """Figures 1 and 4 to 6: stabilization diagrams at 15 % noise, and how many stable poles are no modes."""
    base = noisy_case(OWN)
    key = jax.random.key(3)
    frf = with_noise(base, uniform_own(key, base, jnp.asarray(0.15)), jnp.asarray(0.15))
    low, high = frf.lines(slice(0, 251)), frf.lines(slice(250, 501))
    orders = range(4, 41)
    runs = {
        "fig1_6_lscf_a0": ("LSCF, a0 = 1", frf, lscf(frf, orders)),
        "fig1_lscf_aN": ("LSCF, aN = 1", frf, lscf(frf, orders, constraint="aN")),
        "fig5_lsce": ("LSCE", frf, lsce(frf, orders)),
        "fig4_fdpi": ("FDPI, 20-70 Hz", frf, fdpi(frf, range(2, 15))),
        "fig4_fdpi_low": ("FDPI, 20-45 Hz", low, fdpi(low, range(2, 15))),
        "fig4_fdpi_high": ("FDPI, 45-70 Hz", high, fdpi(high, range(2, 15))),
        "compensated": ("compensated", frf, compensated(frf, orders, weights="variance")),
        "subspace": ("subspace", frf, subspace(frf, range(4, 21), weights="variance")),
    }
    rows = []
    for file, (name, data, found) in runs.items():
        flags = stabilization(found)
        figure = plot_stabilization(found, flags, data, title=f"{name}, 15 % noise")
        figure.savefig(out / f"{file}.png", dpi=110)
        plt.close(figure)
        inside = np.asarray(found.physical(float(data.freq[0]), float(data.freq[-1]), 0.1))
        poles = np.asarray(found.poles)
        near = np.min(np.abs(np.abs(poles)[..., None] / np.abs(TRUE) - 1), axis=-1) < 0.02
        steady = inside & np.asarray(flags.frequency) & np.asarray(flags.damping)
        half = len(found.orders) // 2
        modes = [
            np.sum((np.abs(np.abs(poles[half:]) / abs(t) - 1) < 0.02) & steady[half:], axis=1).astype(bool).mean()
            for t in TRUE
        ]
        rows.append([
            name, f"{(inside & ~near).sum(1).mean():.2f}", f"{(steady & ~near).sum(1).mean():.2f}",
            " ".join(f"{100 * m:.0f}" for m in modes),
        ])  # fmt: skip
    return table(
        ["method", "stable poles away from modes, per order", "of them steady from order to order",
         "modes 1-5: steady in % of the upper half of the orders"], rows,
    )  # fmt: skip


def error_curves(out: Path, advance: Callable[[], None]) -> tuple[str, str, str]:
    """Figures 7 and 8: errors over noise level for three methods and ours, with the prediction for LSCF."""
    base = noisy_case(OWN)
    results = {}
    for name, estimator in METHODS.items():
        for level in LEVELS:
            found = draw_poles(base, jnp.asarray(level), 11, estimator=estimator, sampler=uniform_own, count=DRAWS)
            results[name, level] = pick(*map(np.asarray, found))
            advance()
    predicted = {
        level: predicted_damping_bias(base, TRUE, ORDER, variance=base.variance * level**2) for level in LEVELS
    }
    _draw_curves(out, results, predicted)
    return _error_table(results), _single_draws(results), _prediction_table(results, predicted)


def _draw_curves(out: Path, results: dict, predicted: dict) -> None:
    fig, axes = plt.subplots(2, 5, figsize=(17, 7), sharex=True)
    for mode in range(5):
        for name in METHODS:
            stats = [statistics(results[name, level], mode) for level in LEVELS]
            for row, part in ((0, 0), (1, 2)):
                axes[row, mode].errorbar(
                    100 * np.array(LEVELS), [s[part] for s in stats], [s[part + 1] for s in stats], marker="o", ms=3,
                    capsize=2, lw=1, label=name, color=COLOURS[name],
                )  # fmt: skip
        axes[1, mode].plot(
            100 * np.array(LEVELS), [100 * float(predicted[v].relative_damping[mode]) for v in LEVELS], "k--", lw=1.2,
            label="LSCF predicted",
        )  # fmt: skip
        axes[0, mode].set_title(f"mode {mode + 1}, {abs(TRUE[mode]) / 2 / np.pi:.2f} Hz")
        axes[1, mode].set_xlabel("noise [%]")
    for ax in axes.flat:
        ax.grid(alpha=0.3)
    axes[0, 0].set_ylabel("frequency error [%]")
    axes[1, 0].set_ylabel("damping error [%]")
    axes[1, 2].legend(fontsize=8, loc="lower left")
    fig.suptitle(f"Mean and standard deviation over {DRAWS} draws; noise {OWN}")
    fig.tight_layout()
    fig.savefig(out / "fig7_8_errors.png", dpi=110)
    plt.close(fig)


def _error_table(results: dict) -> str:
    rows = []
    for name in METHODS:
        for mode in range(3):
            cells = []
            for level in LEVELS:
                f, _, z, sz, lost = statistics(results[name, level], mode)
                cells.append(f"{f:+.2f} / {z:+.1f} ± {sz:.1f}" + (f" ({lost} lost)" if lost else ""))
            rows.append([name, str(mode + 1), *cells])
    return table(["method", "mode", *[f"{100 * v:g} %: frequency / damping error [%]" for v in LEVELS]], rows)


def _single_draws(results: dict) -> str:
    """How many single draws have a frequency off by more than the review's 0.4 %, and which mode is worst."""
    rows = []
    for name in METHODS:
        cells = []
        for level in LEVELS:
            off = np.abs(errors(results[name, level])[0])
            share = 100 * np.nanmean(off > 0.4, axis=0)
            worst = int(np.nanargmax(np.nanmax(off, axis=0)))
            shares = " ".join(f"{s:.0f}" for s in share)
            cells.append(f"{shares} (mode {worst + 1}: {np.nanmax(off):.2f})")
        rows.append([name, *cells])
    return table(["method", *[f"{100 * v:g} %" for v in LEVELS]], rows)


def _prediction_table(results: dict, predicted: dict) -> str:
    rows = []
    for mode in range(5):
        cells = []
        for level in LEVELS:
            _, _, z, sz, lost = statistics(results["LSCF", level], mode)
            p = 100 * float(predicted[level].relative_damping[mode])
            flag = "" if bool(predicted[level].valid[mode]) else " flagged"
            cells.append(f"{p:+.2f} against {z:+.2f} ± {sz / np.sqrt(DRAWS - lost):.2f}{flag}")
        rows.append([str(mode + 1), *cells])
    return table(["mode", *[f"{100 * v:g} %" for v in LEVELS]], rows)


def noisy_picture(out: Path) -> None:
    """Figure 3: the drive point FRF with 10 and 25 % noise."""
    base = noisy_case(OWN)
    fig, axes = plt.subplots(1, 2, figsize=(13, 4))
    for ax, level in zip(axes, (0.1, 0.25), strict=True):
        for name, colour in ((OWN, "#2874a6"), ("Gaussian, std of each part = level x channel rms", "#bbbbbb")):
            case = noisy_case(name)
            sampler = uniform_own if name == OWN else gaussian
            H = case.H + sampler(jax.random.key(1), case, jnp.asarray(level))
            ax.semilogy(case.freq, np.abs(H[:, 0, 0]), color=colour, lw=0.9, label=name, zorder=2 if name == OWN else 1)
        ax.semilogy(base.freq, np.abs(base.H[:, 0, 0]), "k", lw=1.0, label="noise-free", zorder=3)
        ax.set_title(f"{100 * level:g} % noise")
        ax.set_xlabel("frequency [Hz]")
        ax.grid(alpha=0.3)
    axes[0].set_ylabel("drive point receptance [m/N]")
    axes[0].legend(fontsize=8)
    fig.tight_layout()
    fig.savefig(out / "fig3_noise.png", dpi=110)
    plt.close(fig)
