"""The noise bias of damping: predicted against drawn, and what estimators leave of it."""

from collections.abc import Callable
from functools import partial

import jax.numpy as jnp
import numpy as np
from section3 import DRAWS, likelihood
from system import (
    DEFINITIONS,
    LEVELS,
    MODES,
    OWN,
    TRUE,
    ZETA,
    draw_poles,
    gaussian,
    noisy_case,
    pick,
    statistics,
    table,
)

from modalax.data.frf import FRF
from modalax.identify import (
    compensated,
    cramer_rao,
    fdpi,
    gtls,
    lsce,
    lscf,
    predicted_damping_bias,
    reweighted,
    subspace,
)
from modalax.identify.expected import expected_fdpi_bias, expected_lsce_bias
from modalax.identify.spread import second_order
from modalax.identify.tables import PoleTable


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


ESTIMATORS: dict[str, Callable[[FRF], PoleTable]] = {
    "LSCF a0": lambda f: lscf(f, 20),
    "LSCF a0, variance weights": lambda f: lscf(f, 20, weights="variance"),
    "LSCF aN, order 10": lambda f: lscf(f, 10, constraint="aN"),
    "compensated": lambda f: compensated(f, 20, weights="variance"),
    "GTLS, order 8": lambda f: gtls(f, 8, weights="variance"),
    "subspace": lambda f: subspace(f, 10, weights="variance"),
    "reweighted aN, order 7": lambda f: reweighted(f, 7),
    "reweighted a0, order 7": lambda f: reweighted(f, 7, constraint="a0"),
    "maximum likelihood": likelihood,
}


def estimators(advance: Callable[[], None]) -> str:
    """Bias, spread, ratio to the Cramer-Rao bound and lost modes, mode 3 and mode 1."""
    base = noisy_case(OWN)
    bound = np.asarray(cramer_rao(MODES, base).damping_std) / ZETA * 100  # at level 1
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
    return table(["estimator", "mode", *[f"{100 * v:g} %: bias ± std (std / bound) [%]" for v in LEVELS]], rows)


def _cell(found: np.ndarray, mode: int, bound: float) -> str:
    _, _, z, sz, lost = statistics(found, mode)
    if lost > len(found) // 2:
        return f"lost {lost} of {len(found)}"
    return f"{z:+.1f} ± {sz:.1f} ({sz / bound:.2f})" + (f", {lost} lost" if lost else "")
