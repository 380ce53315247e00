"""Where laws at a measured force start from, by one harmonic: their sizes, and how far these are from the force."""

import numpy as np

from modalax.diagnose.causes.base import ElementCause, JointCause
from modalax.diagnose.causes.scene import Place
from modalax.diagnose.comparison import Comparison
from modalax.diagnose.prediction.balanced_force import has_law
from modalax.diagnose.prediction.impedances import impedances
from modalax.diagnose.search.law_force import Seen
from modalax.diagnose.search.measured_force import MeasuredForce, robust_sizes, sizes_by_force
from modalax.diagnose.search.rows import CLEAR

AROUND = (0.75, 1.0, 1.3)  # strengths that are balanced, over the one that was read off
SLIDING = (0.95, 0.75)  # quantiles of the force measured that dry friction may have where it slides
REWEIGHED = 3  # times that lines are weighed by what they miss


def misfit(r: np.ndarray, robust: bool) -> float:
    """Of whitened residuals: their chi-square, or that in which lines far off count little (Cauchy's distribution)."""
    square = np.nan_to_num(np.abs(r) ** 2, nan=1e300, posinf=1e300)
    return float(np.log1p(square).sum() if robust else square.sum())


def sized(
    comparison: Comparison, cause: ElementCause, at: Place, force: MeasuredForce, seen: Seen
) -> tuple[float, float, list[np.ndarray]] | None:
    """A law by one harmonic: its robust and its plain misfit, and parameters to start from; None where it has none."""
    found = [p for _, p in sizes_by_force(comparison, cause, at, force)[:1]]
    groups, around = [[p] for p in found], (1.0,)
    if seen.several and isinstance(cause, JointCause) and cause.rigid:  # the force that slides is a square wave
        size = np.abs(seen.force)
        told = seen.precision * size > CLEAR
        found = [np.array([np.pi / 4 * np.quantile(size[told] if told.any() else size, q)]) for q in SLIDING]
        groups = [[p] for p in found]
    elif seen.several and isinstance(cause, JointCause):
        robust = robust_sizes(comparison, cause, at, force)
        found += [] if robust is None else [robust[1]]
        groups = [group for p in found for group in cause.untold(p)]
        around = AROUND if has_law(cause) and sum(map(len, groups)) == len(found) else (1.0,)
    if not found:
        return None
    left = [_misfits_by_one_harmonic(cause, p, seen) for p in found]
    starts = [p * np.array([s, *np.ones(len(p) - 1)]) for group in groups for p in group for s in around]
    return min(robust for robust, _ in left), min(plain for _, plain in left), starts


def _misfits_by_one_harmonic(cause: ElementCause, p: np.ndarray, seen: Seen) -> tuple[float, float]:
    """Robust and plain misfit of force that an element's impedance leaves at the measured motion, beside its modes."""
    lay = lambda x: x.reshape(seen.shape)
    Z = impedances(cause, p, lay(seen.omega)[0, :, 0], lay(np.abs(seen.motion))).ravel()
    G, f = seen.receptance[:, 1], seen.follow
    with np.errstate(all="ignore"):
        share = np.nan_to_num(seen.precision / (1 + G * Z))
        r = share * np.nan_to_num(Z * seen.motion - seen.force)
        if f is None:
            return misfit(r, True), misfit(r, False)
        motion = f.free - G[:, None] * f.force - seen.force[:, None] * f.receptance
        J = share[:, None] * np.nan_to_num(Z[:, None] * motion - f.force)
    out = []
    for robust in (True, False):
        step = np.zeros(len(f.curvature))
        for _ in range(REWEIGHED if robust else 1):
            w = 1 / (1 + np.abs(r + J @ step) ** 2) if robust else np.ones(len(r))
            A, g = (J.conj().T @ (w[:, None] * J)).real, (J.conj().T @ (w * r)).real
            step = np.linalg.solve(A + f.curvature, f.downhill - g)
        out.append(misfit(r + J @ step, robust) + float((f.curvature @ step - 2 * f.downhill) @ step))
    return out[0], out[1]
