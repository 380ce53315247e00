"""Modal masses and MAC: with a wrong damping put on a mode, and with the poles found in noise."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from section3 import DRAWS, METHODS
from system import (
    BAND,
    DEFINITIONS,
    MODES,
    OWN,
    SAMPLERS,
    TRUE,
    ZETA,
    clean,
    gaussian,
    nearest_stable,
    noisy_case,
    pick,
    table,
    uniform_own,
    with_noise,
)

from modalax.data.frf import FRF
from modalax.identify import residues
from modalax.identify.tables import PoleTable
from modalax.model.indicators import mac

MASS = np.array([2.52, 1.97, 0.90, 1.09, 1.05])  # [kg]


REVIEW = np.array([-26.6, 31.3, 99.96, -5.1])  # with 15 % noise: masses of modes 1 and 3, MAC and shape of mode 1 [%]


def imposed_damping(out: Path) -> str:
    """Figure 9: +50 % on the damping of mode 1, then residues by least squares, on the receptance."""
    zeta = np.full(5, ZETA)
    zeta[0] *= 1.5
    wrong = -zeta * np.abs(TRUE) + 1j * np.abs(TRUE) * np.sqrt(1 - zeta**2)
    quiet = np.asarray(_imposed(clean().band(*BAND), jnp.asarray(wrong)))
    cells = [f"{v:+.1f}" for v in quiet[:2]] + [f"{quiet[2]:.2f}", f"{quiet[3]:+.1f}"]
    rows = [["noise-free", "-20.8", "+51.2", "-", "-", ""], ["ours", *cells, ""],
            ["15 % noise", "-26.6", "+31.3", "99.96", "-5.1", ""]]  # fmt: skip
    for name in DEFINITIONS:
        sampler = SAMPLERS.get(name, gaussian)
        drawn = np.asarray(_draw_imposed(noisy_case(name), jnp.asarray(wrong), sampler=sampler, count=DRAWS))
        mean, std = drawn.mean(axis=0), drawn.std(axis=0)
        cells = [f"{m:+.1f} ± {s:.1f}" for m, s in zip(mean, std, strict=True)]
        cells[2] = f"{mean[2]:.2f} ± {std[2]:.2f}"
        away = (REVIEW - mean) / std
        rows.append([f"ours, {name}", *cells, f"{' '.join(f'{a:+.2f}' for a in away)}; {_as_far(drawn):.3f}"])
    _draw_fit(out, wrong)
    return table(
        ["", "mass of mode 1 [%]", "mass of mode 3 [%]", "MAC of mode 1 [%]", "largest shape error [%]",
         "review less ours [deviations]; part of our draws as far out in all four together"], rows,
    )  # fmt: skip


@jax.jit
def _imposed(frf: FRF, wrong: jax.Array) -> jax.Array:
    """Errors of the masses of modes 1 and 3, MAC of mode 1, and its largest shape error [%]."""
    shape = MODES.normalised().shapes[0]
    model = residues(frf, wrong, residuals="complex", weights="unit").normalised()
    mass = 100 * (model.modal_mass("1").real / MASS - 1)
    deviation = jnp.abs(model.shapes[0]) / jnp.abs(shape) - 1
    alike = mac(model.shapes[:1], shape[None])[0, 0]
    return jnp.stack([mass[0], mass[2], 100 * alike, 100 * deviation[jnp.argmax(jnp.abs(deviation))]])


@partial(jax.jit, static_argnames=("sampler", "count"))
def _draw_imposed(frf: FRF, wrong: jax.Array, *, sampler: Callable, count: int) -> jax.Array:
    """The four numbers of noisy copies in one vmap, shape ``(draw, 4)``."""
    level = jnp.asarray(0.15)

    def one(key: jax.Array) -> jax.Array:
        return _imposed(with_noise(frf, sampler(key, frf, level), level), wrong)

    return jax.vmap(one)(jax.random.split(jax.random.key(5), count))


def _as_far(drawn: np.ndarray) -> float:
    """Part of the draws at least as far from their mean as the review, by Mahalanobis' distance."""
    away = np.vstack([REVIEW, drawn]) - drawn.mean(axis=0)
    square = np.einsum("di,ij,dj->d", away, np.linalg.inv(np.cov(drawn.T)), away)
    return float(np.mean(square[1:] >= square[0]))


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


@partial(jax.jit, static_argnames=("estimator", "count"))
def _draw_masses(
    frf: FRF, level: jax.Array, *, estimator: Callable[[FRF], PoleTable], count: int
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Poles, modal masses and MAC of ``count`` noisy copies in one vmap, all of shape ``(draw, mode)``."""

    def one(key: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        data = with_noise(frf, uniform_own(key, frf, level), level)
        poles = nearest_stable(estimator(data))
        model = residues(data, poles, weights="unit").normalised()
        return poles, model.modal_mass("1").real, jnp.diag(mac(model.shapes, MODES.normalised().shapes))

    return jax.vmap(one)(jax.random.split(jax.random.key(17), count))


def masses(advance: Callable[[], None]) -> str:
    """Modal mass and MAC errors with the poles that three methods find in noise."""
    base, rows = noisy_case(OWN), []
    for name in ("LSCF", "subspace", "maximum likelihood"):
        for level in (0.05, 0.15, 0.25):
            poles, mass, macs = map(
                np.asarray, _draw_masses(base, jnp.asarray(level), estimator=METHODS[name], count=DRAWS)
            )
            kept = np.isfinite(pick(poles, np.isfinite(poles))).all(axis=1)
            error, least = 100 * (mass[kept] / MASS - 1), 100 * macs[kept].min(axis=0)
            middle = np.median(error, axis=0)
            low, high = np.percentile(error, [16, 84], axis=0)
            cells = [f"{middle[k]:+.1f} ({low[k]:+.1f} .. {high[k]:+.1f}) / {least[k]:.2f}" for k in range(5)]
            rows.append([name, f"{100 * level:g}", *cells, str((~kept).sum())])
            advance()
    modes = [f"mode {k}: mass error, median (16 .. 84 %) / least MAC [%]" for k in range(1, 6)]
    return table(["poles from", "noise [%]", *modes, "lost"], rows)
