"""Section 3 of the review: the influence of noise on three methods, and on ours."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from system import (
    BAND,
    DEFINITIONS,
    LEVELS,
    MODES,
    OWN,
    TRUE,
    ZETA,
    clean,
    draw_poles,
    errors,
    gaussian,
    noisy_case,
    pick,
    table,
    uniform_own,
    with_noise,
)

from modalax.data.frf import FRF
from modalax.identify import fdpi, lsce, lscf, plscf, predicted_damping_bias, refine, residues, stabilization
from modalax.identify.consistent import compensated, gtls, subspace
from modalax.identify.expected import expected_fdpi_bias, expected_lsce_bias
from modalax.identify.reweighted import reweighted
from modalax.identify.spread import second_order
from modalax.identify.tables import PoleTable
from modalax.model.indicators import mac
from modalax.show.stabilization import plot_stabilization

DRAWS = 200
ORDER = 32  # of LSCF and LSCE: about three times what ten poles need
FDPI_ORDER = 8
COLOURS = {"LSCF": "#c0392b", "LSCE": "#2874a6", "FDPI": "#1e8449", "subspace": "#7d3c98", "compensated": "#d68910"}


def fdpi_split(frf: FRF) -> PoleTable:
    """FDPI as the review used it: 20 to 45 and 45 to 70 Hz apart."""
    parts = [fdpi(frf.lines(slice(0, 251)), FDPI_ORDER), fdpi(frf.lines(slice(250, 501)), FDPI_ORDER)]
    edge = 2 * np.pi * 45.0
    valid = [parts[0].valid & (jnp.abs(parts[0].poles) < edge), parts[1].valid & (jnp.abs(parts[1].poles) >= edge)]
    poles = jnp.concatenate([p.poles for p in parts], axis=1)
    return PoleTable(poles, jnp.concatenate(valid, axis=1), None, (FDPI_ORDER,), "fdpi")


METHODS: dict[str, Callable[[FRF], PoleTable]] = {
    "LSCF": lambda f: lscf(f, ORDER),
    "LSCE": lambda f: lsce(f, ORDER),
    "FDPI": fdpi_split,
    "subspace": lambda f: subspace(f, 10, weights="variance"),
    "compensated": lambda f: compensated(f, 20, weights="variance"),
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
    """Mode 3 at 25 % noise by every definition, form and option, predicted without a draw."""
    rows = []
    options = {"arc 0.6, n = 32": dict(order=32), "circle, n = 20": dict(order=20, arc=1.0)}
    for name in DEFINITIONS:
        row = [name]
        for form in ("receptance", "accelerance"):
            frf = noisy_case(name, form)
            for option in options.values():
                chosen = dict(option)
                bias = predicted_damping_bias(
                    frf, TRUE, chosen.pop("order"), variance=frf.variance * LEVELS[-1] ** 2, **chosen
                )
                value = 100 * float(bias.relative_damping[2])
                row.append(f"{value:.1f}" + (" (unstable: lost)" if value <= -100 else ""))
        rows.append(row)
    head = [f"{form}, {o}" for form in ("receptance", "accelerance") for o in options]
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
            stats = [_stats(results[name, level], mode) for level in LEVELS]
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
    axes[1, 0].legend(fontsize=8)
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
                f, _, z, sz, lost = _stats(results[name, level], mode)
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
            _, _, z, sz, lost = _stats(results["LSCF", level], mode)
            p = 100 * float(predicted[level].relative_damping[mode])
            flag = "" if bool(predicted[level].valid[mode]) else " flagged"
            cells.append(f"{p:+.2f} against {z:+.2f} ± {sz / np.sqrt(DRAWS - lost):.2f}{flag}")
        rows.append([str(mode + 1), *cells])
    return table(["mode", *[f"{100 * v:g} %" for v in LEVELS]], rows)


def prediction(advance: Callable[[], None]) -> str:
    """Predicted against drawn LSCF damping bias in white noise: levels, modes, three orders and two forms."""
    rows = []
    for form in ("receptance", "accelerance"):
        base = noisy_case(list(DEFINITIONS)[0], form)
        for order in (16, 24, 32):
            estimator = partial(lscf, orders=order)
            met, counted, worst, flagged, second_met = 0, 0, 0.0, 0, 0
            for level in LEVELS:
                variance = base.variance * level**2
                bias = predicted_damping_bias(base, TRUE, order, variance=variance)
                moments = second_order(base, bias.poles, order, variance=variance)
                poles, valid = map(
                    np.asarray,
                    draw_poles(base, jnp.asarray(level), 21, estimator=estimator, sampler=gaussian, count=DRAWS),
                )
                near = np.argmin(
                    np.where(valid[:, :, None], abs(poles[:, :, None] - np.asarray(bias.poles)), np.inf), 1
                )
                found = np.take_along_axis(poles, near, axis=1)
                zeta = -found.real / np.abs(found)
                error = 2 * zeta.std(0) / np.sqrt(DRAWS)
                good = np.asarray(bias.valid)
                gap = np.abs(zeta.mean(0) - ZETA - np.asarray(bias.damping))
                allowed = np.maximum(0.03 * np.abs(np.asarray(bias.damping)), error)
                met, counted, flagged = (
                    met + (gap <= allowed)[good].sum(),
                    counted + good.sum(),
                    flagged + (~good).sum(),
                )
                second_met += (np.abs(zeta.mean(0) - np.asarray(moments.damping)) <= allowed)[good].sum()
                worst = max(worst, 100 * float((gap / ZETA)[good].max()))
                advance()
            rows.append([
                form, str(order), f"{met} of {counted}", f"{second_met} of {counted}", f"{worst:.2f}", str(flagged)
            ])  # fmt: skip
    return table(
        ["form", "order", "first order: within 3 % of the bias or two standard errors", "with the second order",
         "largest gap [% of the damping]", "flagged as lost"], rows,
    )  # fmt: skip


EXPECTED: dict[str, tuple[Callable, Callable]] = {
    "LSCE, order 16": (partial(lsce, orders=16), partial(expected_lsce_bias, order=16)),
    "LSCE, order 32": (partial(lsce, orders=32), partial(expected_lsce_bias, order=32)),
    "LSCE backward, order 32": (
        partial(lsce, orders=32, constraint="a0"), partial(expected_lsce_bias, order=32, constraint="a0")
    ),
    "FDPI, order 5": (partial(fdpi, orders=5), partial(expected_fdpi_bias, order=5)),
    "FDPI, order 8": (partial(fdpi, orders=8), partial(expected_fdpi_bias, order=8)),
}  # fmt: skip
EXPECTED_LEVELS = (0.0, 0.01, 0.05, 0.15)


def expected(advance: Callable[[], None]) -> str:
    """Damping bias of LSCE and FDPI from their expected normal equations, against drawn; 0 % is the cut band alone."""
    base, rows = noisy_case(list(DEFINITIONS)[0]), []
    for name, (estimator, predict) in EXPECTED.items():
        for level in EXPECTED_LEVELS:
            bias = predict(base, TRUE, variance=base.variance * max(level, 1e-9) ** 2)
            count = DRAWS if level else 1
            poles, valid = map(
                np.asarray,
                draw_poles(base, jnp.asarray(level), 21, estimator=estimator, sampler=gaussian, count=count),
            )
            near = np.argmin(np.where(valid[:, :, None], abs(poles[:, :, None] - np.asarray(bias.poles)), np.inf), 1)
            found = np.take_along_axis(poles, near, axis=1)
            drawn = 100 * (-found.real / np.abs(found) / ZETA - 1)
            row = [name, f"{100 * level:g}"]
            for mode in range(5):
                flag = "" if bool(bias.valid[mode]) else " flagged"
                told = f"{100 * float(bias.relative_damping[mode]):+.2f}"
                error = f" ± {drawn[:, mode].std() / np.sqrt(count):.2f}" if level else ""
                row.append(f"{told} against {drawn[:, mode].mean():+.2f}{error}{flag}")
            rows.append(row)
            advance()
    return table(["method", "noise [%]", *[f"mode {k}: predicted against drawn [%]" for k in range(1, 6)]], rows)


def _stats(found: np.ndarray, mode: int) -> tuple[float, float, float, float, int]:
    df, dz = errors(found)
    kept = np.isfinite(dz[:, mode])
    if not kept.any():
        return (float("nan"),) * 4 + (len(kept),)
    f, z = df[kept, mode], dz[kept, mode]
    return float(f.mean()), float(f.std()), float(z.mean()), float(z.std()), int((~kept).sum())


ESTIMATORS: dict[str, Callable[[FRF], PoleTable]] = {
    "LSCF a0": lambda f: lscf(f, 20),
    "LSCF a0, variance weights": lambda f: lscf(f, 20, weights="variance"),
    "LSCF aN, order 10": lambda f: lscf(f, 10, constraint="aN"),
    "compensated": lambda f: compensated(f, 20, weights="variance"),
    "GTLS, order 8": lambda f: gtls(f, 8, weights="variance"),
    "subspace": lambda f: subspace(f, 10, weights="variance"),
    "reweighted aN, order 7": lambda f: reweighted(f, 7),
    "reweighted a0, order 7": lambda f: reweighted(f, 7, constraint="a0"),
}


def estimators(advance: Callable[[], None]) -> str:
    """Bias, spread, ratio to the Cramer-Rao bound and lost modes, mode 3 and mode 1."""
    base = noisy_case(OWN)
    exact = residues(base, TRUE, weights="variance")
    bound = np.asarray(refine(base, exact, scale_errors="never").damping_std) / ZETA * 100  # at level 1
    rows = []
    for name, estimator in ESTIMATORS.items():
        found = [
            pick(*map(np.asarray, draw_poles(
                base, jnp.asarray(level), 12, estimator=estimator, sampler=gaussian, count=DRAWS
            )))
            for level in LEVELS
        ]  # fmt: skip
        for mode in (0, 2):
            cells = [_cell(f, mode, bound[mode] * level) for f, level in zip(found, LEVELS, strict=True)]
            rows.append([name, str(mode + 1), *cells])
        advance()
    cells: dict[int, list[str]] = {0: [], 2: []}
    for level in LEVELS:
        found = _likelihood(base, level, 20)
        for mode in (0, 2):
            cells[mode].append(_cell(found, mode, bound[mode] * level))
        advance()
    rows += [["maximum likelihood (20 draws)", str(m + 1), *cells[m]] for m in (0, 2)]
    return table(["estimator", "mode", *[f"{100 * v:g} %: bias ± std (std / bound) [%]" for v in LEVELS]], rows)


def _cell(found: np.ndarray, mode: int, bound: float) -> str:
    _, _, z, sz, lost = _stats(found, mode)
    if lost > len(found) // 2:
        return f"lost {lost} of {len(found)}"
    return f"{z:+.1f} ± {sz:.1f} ({sz / bound:.2f})" + (f", {lost} lost" if lost else "")


def _likelihood(base: FRF, level: float, count: int) -> np.ndarray:
    """Maximum likelihood from the poles of the signal subspace."""
    found = []
    for key in jax.random.split(jax.random.key(13), count):
        data = with_noise(base, gaussian(key, base, jnp.asarray(level)), jnp.asarray(level))
        start = _fit_table("subspace", data)
        poles = pick(np.asarray(start.poles), np.asarray(start.valid))[0]
        if np.isnan(poles).any():
            found.append(np.full(5, np.nan, complex))
            continue
        refined = refine(data, residues(data, poles))
        found.append(np.asarray(refined.model.poles))
    poles = np.array(found)
    return np.array([pick(p[None], np.isfinite(p)[None])[0] for p in poles])


def imposed_damping(out: Path) -> str:
    """Figure 9: +50 % on the damping of mode 1, then residues by least squares, on the receptance."""
    omega = np.abs(TRUE)
    zeta = np.full(5, ZETA)
    zeta[0] *= 1.5
    wrong = -zeta * omega + 1j * omega * np.sqrt(1 - zeta**2)
    true_mass, true_shape = np.array([2.52, 1.97, 0.90, 1.09, 1.05]), np.asarray(MODES.normalised().shapes.real)

    def fit(frf: FRF) -> tuple[np.ndarray, float, float]:
        model = residues(frf, wrong, residuals="complex", weights="unit").normalised()
        mass = np.asarray(model.modal_mass("1"))
        shapes = np.asarray(model.shapes)
        deviation = np.abs(shapes[0]) / np.abs(true_shape[0]) - 1
        value = float(np.asarray(mac(jnp.asarray(shapes[:1]), jnp.asarray(true_shape[:1] + 0j)))[0, 0])
        return 100 * (mass.real / true_mass - 1), 100 * value, 100 * float(deviation[np.argmax(np.abs(deviation))])

    frf = clean().band(*BAND)
    quiet = fit(frf)
    rows = [["noise-free", "-20.8", "+51.2", "-", "-"],
            ["ours", f"{quiet[0][0]:+.1f}", f"{quiet[0][2]:+.1f}", f"{quiet[1]:.2f}", f"{quiet[2]:+.1f}"],
            ["15 % noise", "-26.6", "+31.3", "99.96", "-5.1"]]  # fmt: skip
    for name in (OWN, *list(DEFINITIONS)[:1], *list(DEFINITIONS)[3:5]):
        base = noisy_case(name)
        sampler = uniform_own if name == OWN else gaussian
        runs = []
        for key in jax.random.split(jax.random.key(5), DRAWS):
            noise = sampler(key, base, jnp.asarray(0.15))
            runs.append(fit(with_noise(base, noise, jnp.asarray(0.15))))
        m1, m3 = np.array([[r[0][0], r[0][2]] for r in runs]).T
        shape, dev = np.array([[r[1], r[2]] for r in runs]).T
        cells = [f"{v.mean():+.1f} ± {v.std():.1f}" for v in (m1, m3)]
        rows.append(
            [f"ours, {name}", *cells, f"{shape.mean():.2f} ± {shape.std():.2f}", f"{dev.mean():+.1f} ± {dev.std():.1f}"]
        )
    _draw_fit(out, wrong)
    return table(["", "mass of mode 1 [%]", "mass of mode 3 [%]", "MAC of mode 1 [%]", "largest shape error [%]"], rows)


def _draw_fit(out: Path, wrong: np.ndarray) -> None:
    base = noisy_case(OWN)
    data = with_noise(base, uniform_own(jax.random.key(5), base, jnp.asarray(0.15)), jnp.asarray(0.15))
    made = residues(data, wrong, weights="unit").frf(data.freq)
    fig, axes = plt.subplots(1, 2, figsize=(13, 4.5))
    for ax, limits in zip(axes, ((20, 70), (23, 29)), strict=True):
        ax.semilogy(data.freq, np.abs(data.H[:, 0, 0]), ".", ms=3, color="#555555", label="with 15 % noise")
        ax.semilogy(data.freq, np.abs(made.H[:, 0, 0]), color="#c0392b", label="fit, damping of mode 1 +50 %")
        ax.set_xlim(*limits)
        ax.set_xlabel("frequency [Hz]")
        ax.set_ylabel("drive point receptance [m/N]")
        ax.grid(alpha=0.3)
    axes[0].legend()
    fig.tight_layout()
    fig.savefig(out / "fig9_imposed_damping.png", dpi=110)
    plt.close(fig)


def masses(advance: Callable[[], None]) -> str:
    """Modal mass and MAC errors with the poles that LSCF, and that the subspace method, finds in noise."""
    base = noisy_case(OWN)
    true_mass = np.array([2.52, 1.97, 0.90, 1.09, 1.05])
    true_shape = MODES.normalised().shapes
    rows = []
    for name in ("LSCF", "subspace"):
        for level in (0.05, 0.15, 0.25):
            mass, macs = [], []
            for key in jax.random.split(jax.random.key(17), 20):
                data = with_noise(base, uniform_own(key, base, jnp.asarray(level)), jnp.asarray(level))
                found = _fit_table(name, data)
                poles = pick(np.asarray(found.poles), np.asarray(found.valid))[0]
                if np.isnan(poles).any():
                    continue
                model = residues(data, poles, weights="unit").normalised()
                mass.append(100 * (np.asarray(model.modal_mass("1")).real / true_mass - 1))
                macs.append(100 * np.diag(np.asarray(mac(model.shapes, true_shape))))
            m, s, c = np.mean(mass, 0), np.std(mass, 0), np.min(macs, 0)
            rows.append(
                [
                    name,
                    f"{100 * level:g}",
                    *[f"{m[k]:+.1f} ± {s[k]:.1f} / {c[k]:.2f}" for k in range(5)],
                    str(20 - len(mass)),
                ]
            )
            advance()
    return table(
        ["poles from", "noise [%]", *[f"mode {k}: mass error / least MAC [%]" for k in range(1, 6)], "lost"], rows
    )


@partial(jax.jit, static_argnames="name")
def _fit_table(name: str, frf: FRF) -> PoleTable:
    return METHODS[name](frf)


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
