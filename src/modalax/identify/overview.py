"""Results beside a fit, as text for ``print``: refinement, bounds, bias, tests, selections and modes over the level."""

from typing import TYPE_CHECKING, Any

import numpy as np

from modalax._numerics.text import text_table, with_error
from modalax.data.overview import counted, unreadable

if TYPE_CHECKING:
    from modalax.identify.bandwidth import BandwidthTest
    from modalax.identify.bias import DampingBias
    from modalax.identify.bound import Bound
    from modalax.identify.over_amplitude import OverAmplitude
    from modalax.identify.refine import Refined
    from modalax.identify.select import Selection
    from modalax.identify.tables import PoleTable

HERTZ = 2 * np.pi


def of_refined(found: "Refined") -> str:
    """How the search ended, frequencies and damping ratios with standard deviations, and how well the model fits."""
    if unreadable(found, found.frequency_std_hz):
        return repr(found)
    frequency, damping = np.asarray(found.model.frequency_hz), np.asarray(found.model.damping_ratio)
    stds = zip(np.asarray(found.frequency_std_hz), np.asarray(found.damping_std), strict=True)
    rows = [
        [str(k + 1), with_error(frequency[k], f), with_error(damping[k], z, 100.0)] for k, (f, z) in enumerate(stds)
    ]
    chi2, dof = float(found.chi2), float(found.dof)
    end = "refined" if bool(found.success) else "not refined"
    return "\n".join([
        f"{counted(len(rows), 'mode')}, {end} in {counted(int(found.steps), 'step')}: {found.reason}",
        text_table(("Mode", "Frequency [Hz]", "Damping [%]"), rows),
        f"chi-square {chi2:.6g} of {dof:.0f} degrees of freedom, noise scale {float(found.noise_scale):.4g}, "
        f"whiteness p = {float(found.whiteness):.3g}",
    ])  # fmt: skip


def of_bound(bound: "Bound") -> str:
    """The least standard deviations of each mode."""
    if unreadable(bound, bound.frequency_std_hz):
        return repr(bound)
    shape = np.abs(np.asarray(bound.shape_std)).max(axis=1, initial=0.0)
    every = zip(np.asarray(bound.frequency_std_hz), np.asarray(bound.damping_std), shape, strict=True)
    rows = [[str(k + 1), f"{f:.3g}", f"{100 * z:.3g}", f"{s:.3g}"] for k, (f, z, s) in enumerate(every)]
    header = ("Mode", "Frequency [Hz]", "Damping [%]", "Shape (largest 1)")
    return "\n".join(["Least standard deviations of an unbiased estimate", text_table(header, rows)])


def of_bias(bias: "DampingBias") -> str:
    """The bias of each mode; of several orders that of the last."""
    if unreadable(bias) or bias.poles.ndim not in (1, 2):
        return repr(bias)
    several = bias.poles.ndim == 2
    last = lambda a: np.asarray(a)[-1] if several else np.asarray(a)
    every = (bias.poles, bias.damping, bias.relative_damping, bias.relative_frequency, bias.valid)
    rows = [
        [str(k + 1), f"{abs(pole) / HERTZ:.6g}", f"{100 * z:+.3g}", f"{100 * part:+.3g}", f"{100 * f:+.2g}"]
        if sure
        else [str(k + 1), *4 * ["-"]]
        for k, (pole, z, part, f, sure) in enumerate(zip(*map(last, every), strict=True))
    ]
    header = ("Mode", "Frequency [Hz]", "Damping [%]", "of the damping [%]", "of the frequency [%]")
    which = f", the last of {bias.poles.shape[0]} orders" if several else ""
    lost = ["-: lost in the noise, no bias can be told"] if any(r[1] == "-" for r in rows) else []
    title = f"Predicted bias due to noise{which}: frequency found, error of the damping"
    return "\n".join([title, text_table(header, rows), *lost])


def of_bandwidth(test: "BandwidthTest") -> str:
    """The mode in both bands, and how likely such a difference is of a linear one."""
    if unreadable(test, test.frequency_hz):
        return repr(test)
    (f, g), (z, y), std = (np.asarray(a) for a in (test.frequency_hz, test.damping_ratio, test.difference_std))
    said = [
        f"Mode in a wide and a narrow band: {f:.6g} and {g:.6g} Hz, damping {100 * z:.4g} and {100 * y:.4g} %",
        f"  frequency differs by {with_error(g / f - 1, std[0], 100.0)} %, "
        f"damping by {with_error(y / z - 1, std[1], 100.0)} % (± expected of a linear mode)",
        f"  p = {float(test.p_value):.3g} if the structure is linear (statistic {float(test.statistic):.4g})",
    ]
    return "\n".join(said if bool(test.valid) else [*said, "  not valid: the searches do not allow the test"])


def of_selection(chosen: "Selection") -> str:
    """Frequency, damping, score and order of each pole that was taken."""
    if unreadable(chosen, chosen.poles):
        return repr(chosen)
    poles = np.asarray(chosen.poles)
    rows = [
        [str(k + 1), f"{abs(p) / HERTZ:.6g}", f"{-100 * p.real / abs(p):.4g}", f"{score:.2f}", f"{spread:.2g}", str(n)]
        for k, (p, score, spread, n) in enumerate(
            zip(poles, *map(np.asarray, (chosen.score, chosen.spread, chosen.order)), strict=True)
        )
    ]
    header = ("Mode", "Frequency [Hz]", "Damping [%]", "Score", "Spread", "Order")
    return "\n".join([f"{counted(len(rows), 'pole')} selected", *([text_table(header, rows)] if rows else [])])


def of_poles(table: "PoleTable") -> str:
    """Estimator, orders, and how many poles could be modes."""
    if unreadable(table) or table.poles.ndim != 2:
        return repr(table)
    could = np.asarray(table.physical()).sum(axis=1)
    orders = f"order {table.orders[0]}" if len(table.orders) == 1 else f"orders {table.orders[0]} to {table.orders[-1]}"
    return (
        f"Poles by {table.method}, {orders} ({len(table.orders)}): at the highest "
        f"{int(np.asarray(table.valid)[-1].sum())}, {could[-1]} of which could be modes"
    )


def of_levels(found: "OverAmplitude") -> str:
    """Frequency and damping of each mode at the lowest and at the highest level."""
    if unreadable(found):
        return repr(found)
    ends = [0, -1] if len(found.level) > 1 else [0]
    rows = [[str(k + 1), *_at_levels(found, k, ends)] for k in range(found.frequency_hz.shape[1])]
    at = [f"{found.level[r]:.4g} N" for r in ends]
    header = ["Mode", *(f"Frequency [Hz] at {a}" for a in at), *(f"Damping [%] at {a}" for a in at)]
    seen = ", ".join(f"{f:.6g}" for f in found.seen_once)
    return "\n".join([
        f"{counted(len(rows), 'mode')} at {counted(len(found.level), 'force level')}: "
        f"{', '.join(f'{x:.4g}' for x in found.level)} N (± one standard deviation)",
        *([text_table(header, rows)] if rows else []),
        *([f"at some levels only: {seen} Hz"] if seen else []),
    ])  # fmt: skip


def _at_levels(found: Any, mode: int, ends: list[int]) -> list[str]:
    pairs = ((found.frequency_hz, found.frequency_std_hz, 1.0), (found.damping_ratio, found.damping_std, 100.0))
    return [with_error(float(y[r, mode]), float(std[r, mode]), unit) for y, std, unit in pairs for r in ends]
