r"""What the data show beside the verdict: tests of the usual assumptions, and errors by mode, channel and level.

All of it follows from measured and predicted FRFs and their whitened residuals, whichever way the verdict was found.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.special

from modalax.diagnose.decision.omnibus import Omnibus

REACH = 4.0  # half-bandwidths on either side of a mode that its local fit takes; bent peaks need as many
FEWEST = 5  # lines that a local fit needs
ROUNDS = 6  # times that the window of a local fit follows its pole
ASTRAY = 0.2  # relative distance from where it began beyond which a local fit is of another mode
EVEN = 1e-3  # relative scatter of the spacing of lines up to which these are equispaced


@dataclass(frozen=True)
class Compared:
    """Measured FRFs beside those of the simulation and of the extended one, shape ``(run, f, o, i)``.

    Attributes
    ----------
    freq
        Lines [Hz], shape ``(f,)``.
    measured, before, after
        In the form of the measurement.
    residuals
        Whitened, before and after; 0 where a sample does not count.
    tests
        What simulation and extended one leave.
    level
        Force of each run [N], NaN where unknown.
    outputs, inputs
        Names.
    order
        Derivatives of the displacement that were measured.
    modes
        Frequencies [Hz] and damping ratios of the simulation in the band, shape ``(2, n)``.
    """

    freq: np.ndarray
    measured: np.ndarray
    before: np.ndarray
    after: np.ndarray
    residuals: tuple[np.ndarray, np.ndarray]
    tests: tuple[Omnibus, Omnibus]
    level: np.ndarray
    outputs: Sequence[str]
    inputs: Sequence[str]
    order: int
    modes: np.ndarray

    @property
    def variance(self) -> np.ndarray:
        r"""Variance :math:`E|e|^2` of each sample, infinite where it does not count."""
        r = np.abs(self.residuals[0])
        with np.errstate(divide="ignore", invalid="ignore"):
            found = 2 * np.abs(self.measured - self.before) ** 2 / r**2
        return np.where((r > 0) & np.isfinite(found) & (found > 0), found, np.inf)

    def whitened(self, H: np.ndarray) -> np.ndarray:
        """FRFs of one run ``(f, o, i)`` as ``(f, channel)``, each channel over its mean noise in the first run.

        Channels then count by what they tell, whatever their units. One of unknown noise counts as the others do.
        """
        variance = self.variance[0]
        known = np.isfinite(variance)
        power = np.where(known, variance, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
        usual = power[power > 0].mean() if (power > 0).any() else 1.0
        return (H / np.sqrt(np.where(power > 0, power, usual))).reshape(len(self.freq), -1)


def evidence_of(c: Compared) -> dict[str, Any] | None:
    """Everything as plain data; None where there are no lines."""
    if not len(c.freq):
        return None
    return {
        "tests": {
            "reciprocity": reciprocity(c), "level_homogeneity": homogeneity(c),
            "band": {"before": band(c, c.before), "after": band(c, c.after)},
            "whiteness": {"before": whiteness(c.tests[0]), "after": whiteness(c.tests[1])},
        },
        "by_mode": by_mode(c),
        "by_channel": by_channel(c),
        "by_level": by_level(c),
    }  # fmt: skip


def _tested(chi2: float, freedom: int, **more: Any) -> dict[str, Any]:
    return {"chi2": chi2, "freedom": freedom, "p_value": float(scipy.special.chdtrc(freedom, chi2)), **more}


def reciprocity(c: Compared) -> dict[str, Any] | None:
    """Whether the response at one place to a force at another is that of the reverse; None where none is measured."""
    chi2, freedom, worst = 0.0, 0, (0.0, "")
    for a in range(len(c.inputs)):
        for b in range(a):
            if c.inputs[a] not in c.outputs or c.inputs[b] not in c.outputs:
                continue
            o = (c.outputs.index(c.inputs[a]), b), (c.outputs.index(c.inputs[b]), a)
            one, other = (c.measured[:, :, p, q] for p, q in o)
            variance = sum(c.variance[:, :, p, q] for p, q in o)
            own = 2 * np.abs(one - other) ** 2 / variance
            live = np.isfinite(variance)
            chi2, freedom = chi2 + float(own.sum()), freedom + 2 * int(live.sum())
            worst = max(worst, (float(own.sum() / max(2 * live.sum(), 1)), f"{c.inputs[a]} - {c.inputs[b]}"))
    return _tested(chi2, freedom, worst=worst[1]) if freedom else None


def homogeneity(c: Compared) -> dict[str, Any] | None:
    """Whether all runs are the same but for noise, as a linear structure's are at any force; None for one run."""
    if len(c.measured) < 2:
        return None
    weight = 1 / c.variance
    total = weight.sum(axis=0)
    mean = (weight * c.measured).sum(axis=0) / np.maximum(total, 1e-300)
    freedom = 2 * int((weight > 0).sum() - (total > 0).sum())
    return _tested(2 * float((weight * np.abs(c.measured - mean) ** 2).sum()), freedom) if freedom > 0 else None


def band(c: Compared, predicted: np.ndarray) -> dict[str, Any] | None:
    r"""Whether one part of the band tells the same as all of it (Hausman 1978, theorem 2.1).

    Of :math:`H = \alpha\hat H` the factor by all lines is the efficient estimate, that by the lower half (of the
    information) a consistent one: :math:`h = 2|\alpha_l - \alpha|^2/(V_l - V)` has two degrees of freedom under a right
    model.
    """
    weight = 1 / c.variance
    size = (weight * np.abs(predicted) ** 2).sum(axis=(0, 2, 3))
    if not size.sum() > 0:
        return None
    product = (weight * predicted.conj() * c.measured).sum(axis=(0, 2, 3))
    half = np.cumsum(size) <= 0.5 * size.sum()
    if not half.any() or half.all() or not size[half].sum() > 0:
        return None
    low, every = (product[k].sum() / size[k].sum() for k in (half, slice(None)))
    variance = 1 / size[half].sum() - 1 / size.sum()
    return _tested(float(2 * abs(low - every) ** 2 / variance), 2, up_to_hz=float(c.freq[half][-1]))


def whiteness(test: Omnibus) -> dict[str, float]:
    """Correlation of residuals of neighbouring lines, and the chance of it under noise."""
    rho, score = test.whiteness
    return {"correlation": float(rho), "p_value": math.erfc(abs(float(score)) / math.sqrt(2))}


def _per_sample(r: np.ndarray) -> float | None:
    count = 2 * int(np.count_nonzero(r))
    return float((np.abs(r) ** 2).sum() / count) if count else None


def by_level(c: Compared) -> list[dict[str, Any]]:
    """Chi-square per real sample of each run, and how far its Hilbert transform misses it, measured and predicted."""
    out = []
    for k, level in enumerate(c.level):
        before, after = (_per_sample(r[k]) for r in c.residuals)
        missed = [hilbert(c, H[k]) for H in (c.measured, c.after)]
        out.append({
            "run": k + 1, "level": None if np.isnan(level) else float(level), "chi2_before": before,
            "chi2_after": after, "hilbert_measured": missed[0], "hilbert_extended": missed[1],
        })  # fmt: skip
    return out


def by_channel(c: Compared) -> list[dict[str, Any]]:
    """Chi-square per real sample and frequency response assurance criterion of each channel."""
    out = []
    for i, source in enumerate(c.inputs):
        for o, output in enumerate(c.outputs):
            before, after = (_per_sample(r[:, :, o, i]) for r in c.residuals)
            fracs = [_frac(c.measured[:, :, o, i], p[:, :, o, i]) for p in (c.before, c.after)]
            out.append({"output": output, "input": source, "chi2_before": before, "chi2_after": after,
                        "frac_before": fracs[0], "frac_after": fracs[1]})  # fmt: skip
    return out


def _frac(a: np.ndarray, b: np.ndarray) -> float:
    both = float((np.abs(a) ** 2).sum() * (np.abs(b) ** 2).sum())
    return float(np.abs((a.conj() * b).sum()) ** 2 / both) if both > 0 else 0.0


def hilbert(c: Compared, H: np.ndarray) -> float | None:
    r"""Energy of the real part that the Hilbert transform of the imaginary part misses, relative; 0 for a linear one.

    :math:`\mathrm{Re}H(\omega) = -\frac2\pi P\!\!\int \frac{x\,\mathrm{Im}H(x)}{x^2 - \omega^2}dx` on every other line
    (Ohta and Ishida 1988, Applied Spectroscopy 42), modes beyond the band by a constant and terms in
    :math:`\omega^{\pm2}`. Non-linear structures miss more (Simon and Tomlinson 1984, JSV 96). None where the lines are
    not equispaced, or too coarse for the narrowest peak.
    """
    omega = 2 * np.pi * c.freq
    step = np.diff(omega)
    narrowest = 2 * np.pi * float((c.modes[0] * c.modes[1]).min(initial=np.inf))
    if len(omega) < 4 * FEWEST or np.ptp(step) > EVEN * step.mean() or step.mean() > narrowest:
        return None
    receptance = (H / (1j * omega[:, None, None]) ** c.order).reshape(len(omega), -1)
    number = np.arange(len(omega))
    apart = (number[:, None] - number) % 2 == 1
    kernel = np.zeros((len(omega), len(omega)))
    rows, columns = np.nonzero(apart)
    kernel[rows, columns] = omega[columns] / (omega[columns] ** 2 - omega[rows] ** 2)
    real = receptance.real + (4 / np.pi) * step.mean() * kernel @ receptance.imag
    x = omega / np.sqrt(omega[0] * omega[-1])
    beyond = np.stack([np.ones_like(x), x**2, x**-2], axis=1)
    left = real - beyond @ np.linalg.lstsq(beyond, real, rcond=None)[0]
    return float((left**2).sum() / max(float((receptance.real**2).sum()), 1e-300))


def by_mode(c: Compared) -> list[dict[str, Any]]:
    """Of each mode frequency, damping ratio and peak as measured, and their errors before and after; chi-square there.

    Frequencies and dampings are those of a local fit to all channels of the first run, each over its noise, peaks those
    of the root mean square over them. Errors are relative, of peaks in dB; None where a curve shows no such mode. Where
    the fits of two simulated modes end at one measured mode, it is that of the nearer one; the other does not show.
    """
    out = []
    curves = [c.whitened(H[0]) for H in (c.measured, c.before, c.after)]
    starts = [complex(2 * np.pi * f * (-zeta + 1j * math.sqrt(max(1 - zeta**2, 0.0)))) for f, zeta in c.modes.T]
    found = [(start, local_pole(c, curves[0], start)) for start in starts]
    for start, measured in found:
        if measured is None:
            continue
        same = [near for near, other in found if other is not None and abs(other - measured) < -measured.real]
        if abs(start - measured) > min(abs(near - measured) for near in same):
            continue
        before, after = local_pole(c, curves[1], start), local_pole(c, curves[2], measured)
        at = abs(measured) / 2 / np.pi
        near = np.abs(c.freq - at) <= -measured.real / 2 / np.pi
        row: dict[str, Any] = {"frequency_hz": at, "damping_ratio": -measured.real / abs(measured)}
        for name, pole, H, r in (("before", before, curves[1], 0), ("after", after, curves[2], 1)):
            row[f"chi2_{name}"] = _per_sample(c.residuals[r][:, near])
            known = pole is not None
            row[f"frequency_error_{name}"] = abs(pole) / abs(measured) - 1 if known else None
            row[f"damping_error_{name}"] = (
                (pole.real / abs(pole)) / (measured.real / abs(measured)) - 1 if known else None
            )
            row[f"peak_error_db_{name}"] = (
                20 * math.log10(_peak(c, H, pole) / _peak(c, curves[0], measured)) if known else None
            )
        out.append(row)
    return out


def _peak(c: Compared, H: np.ndarray, pole: complex) -> float:
    """Largest root mean square over channels within the half-power bandwidth, or on the nearest line."""
    omega = 2 * np.pi * c.freq
    near = np.abs(omega - abs(pole)) <= -pole.real
    near[int(np.argmin(np.abs(omega - abs(pole))))] = True
    return float(np.sqrt((np.abs(H[near]) ** 2).mean(axis=1)).max()) + 1e-300


def local_pole(c: Compared, H: np.ndarray, start: complex) -> complex | None:
    r"""Pole of the mode nearest to ``start``, of FRFs ``(f, channel)``; None where it has none there.

    In a narrow window :math:`H_c = (r_c + d_c (s - s_0) + e_c (s - s_0)^2)/(s - \lambda)`, which is linear in
    :math:`\lambda` and the numerators after multiplication, weighted by the last :math:`|s - \lambda|^{-1}`. What
    lines show no better with a pole than by a parabola alone, as noise at a single line, is no mode: its pole and
    residues lower :math:`n \log \sum |H - \hat H|^2` by no more than two each (Akaike 1974; n the real values less
    the numbers that are fitted).
    """
    s, pole = 2j * np.pi * c.freq, start
    H = H / np.maximum(np.abs(s[:, None]) ** c.order, 1e-300) * (-1j) ** c.order
    for k in range(ROUNDS):
        distance = np.abs(s.imag - pole.imag)
        width = max(REACH * abs(pole.real), float(np.sort(distance)[min(FEWEST, len(s)) - 1]))
        near = distance <= width
        if near.sum() < FEWEST or not H[near].any():
            return None
        x, weight = s[near] - 1j * pole.imag, 1 / np.abs(s[near] - pole)
        scale = np.abs(x).max()
        numerator = weight[:, None] * np.stack([np.ones_like(x), x / scale, (x / scale) ** 2], axis=1)
        Q = np.linalg.qr(numerator)[0]
        left, right = weight[:, None] * H[near], weight[:, None] * H[near] * x[:, None]
        left, right = (a - Q @ (Q.conj().T @ a) for a in (left, right))
        energy = float((np.abs(left) ** 2).sum())
        if not energy > 0:
            return None
        shift = complex((left.conj() * right).sum() / energy)
        pole = 1j * pole.imag + shift
        if not pole.real < 0 or abs(abs(pole) / abs(start) - 1) > ASTRAY:
            return None
        if k == ROUNDS - 1 and not _sharper(H[near], numerator / weight[:, None], right - shift * left):
            return None
    return pole


def _sharper(H: np.ndarray, plain: np.ndarray, beside: np.ndarray) -> bool:
    """Whether FRFs ``(f, channel)`` show a pole, beside which ``beside`` is left, by more than its numbers cost."""
    Q = np.linalg.qr(plain)[0]
    without = float((np.abs(H - Q @ (Q.conj().T @ H)) ** 2).sum())
    left = float((np.abs(beside) ** 2).sum())
    freedom = 2 * (len(H) - plain.shape[1]) * H.shape[1] - 2
    return freedom * math.log(max(without, 1e-300) / max(left, 1e-300)) > 4 * (1 + H.shape[1])
