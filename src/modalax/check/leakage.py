r"""Records shorter than the decay, found in FRFs whose lines are :math:`1/T` apart.

A record of length :math:`T` weights the impulse response: by a triangle (blocks without a window), by the
autocorrelation of the Hann window, or, after a hit, by a step that ends it. The first two change the form of each peak,
which is compared with that of a mode; the last keeps it and turns the residue by the angle of
:math:`1 - e^{\lambda_r T}`, which the pole itself predicts.
"""

from collections.abc import Iterator

import numpy as np

from modalax.check.basis import Basis, least_squares, lift
from modalax.check.finding import Finding, Picture, sureness
from modalax.check.modes import improve
from modalax.check.phases import angles_of, misfit
from modalax.check.resolution import lines_a_width, strong_modes
from modalax.check.study import Study

# Modes with more lines per half-power bandwidth than this have decayed within the record.
DECAYED = 2.5
# Factor by which a window must explain the FRFs better than modes alone.
BETTER = 1.4
# Squares of scatter that the angles of cut records must gain, and the share that may be left.
GAIN, LEFT = 6.0, 0.6
# How much more is asked of one mode alone, for both.
ALONE = 5.0
# Share of the response at the end of the record from which on it is reported.
REMAINDER = 0.05


def kernels(x: np.ndarray) -> dict[str, np.ndarray]:
    r"""Transform of :math:`e^{\lambda t}` over a record of length 1, at :math:`x = (j\omega - \lambda)T`, by window."""
    e = np.exp(-x)
    triangle = 1 / x - (1 - e) / x**2
    # The autocorrelation of the Hann window: [(1-t)(2 + cos 2 pi t)/3 + sin(2 pi t)/(2 pi)].
    total = 2 / 3 * triangle
    for turn in (2j * np.pi, -2j * np.pi):
        y = x - turn
        ey = np.exp(-y)
        total = total + (1 / y - (1 - ey) / y**2) / 6 + (1 - ey) / y / (4j * np.pi) * np.sign(turn.imag)
    return {"mode": 1 / x, "boxcar": triangle, "Hann": total}


def record_too_short(study: Study) -> Iterator[Finding]:
    """Find responses that had not decayed when the record ended."""
    step = float(np.median(np.diff(study.freq)))
    grid = study.freq / step
    # Only lines of a discrete Fourier transform tell how long the record was.
    if np.abs(grid - np.round(grid)).max() > 0.02 or np.ptp(np.diff(study.freq)) > 0.01 * step:
        return
    which, lines = strong_modes(study), lines_a_width(study)
    few = which[lines < DECAYED]
    if not len(few):
        return
    found = _windowed(study, step) or _cut(study, step)
    if found is None:
        return
    decay, how, score, picture = found
    left = float(np.exp(-decay))
    if left < REMAINDER:
        return
    yield Finding(
        "record_too_short", (), sure=sureness(score, 1.0), size=left, unit="of the response",
        evidence=f"{how}: {100 * left:.3g} % of the slowest mode is left after the {1 / step:.4g} s of a block",
        advice="record longer (closer lines), or use an exponential window on hits and take its damping out",
        picture=picture,
    )  # fmt: skip


class WindowedBasis(Basis):
    """FRFs whose modes were seen through a record of length T."""

    def __init__(self, omega: np.ndarray, power: int, weight: np.ndarray, length: float, window: str):
        super().__init__(omega, power, weight)
        self.weight, self.length, self.window = weight, length, window

    def columns(self, poles: np.ndarray) -> np.ndarray:
        """Each mode with a residue of 1, ``(f, n)``."""
        x = (self.s[:, None] - poles) * self.length
        return self.weight[:, None] * kernels(x)[self.window] * self.length

    def design(self, poles: np.ndarray) -> np.ndarray:
        """As of :class:`Basis`."""
        u, v = self.columns(poles), self.columns(poles.conj())
        return lift(np.concatenate([u + v, 1j * (u - v), self.smooth, 1j * self.smooth], axis=1))

    def slope(self, poles: np.ndarray, residues: np.ndarray) -> np.ndarray:
        """As of :class:`Basis`, by differences."""
        h = 1e-4 / self.length
        u = (self.columns(poles + h) - self.columns(poles - h)) / (2 * h)
        v = (self.columns(poles.conj() + h) - self.columns(poles.conj() - h)) / (2 * h)
        first, second = u.T[:, :, None] * residues[:, None, :], v.T[:, :, None] * residues.conj()[:, None, :]
        return np.concatenate([first + second, 1j * (first - second)])


def _windowed(study: Study, step: float) -> tuple[float, str, float, Picture] | None:
    """Least decay over a record and the window that explains the peaks; None if modes alone do as well."""
    keep = study.telling
    freq, H = study.freq[keep], study.H[0, keep].reshape(len(keep), -1)
    sigma = study.sigma[0, keep].reshape(H.shape)
    strong = np.argsort(-np.max(np.abs(H), axis=0) / np.median(sigma, axis=0))[:6]
    # A share of the peaks stands for what no model of the noise knows.
    noise = sigma[:, strong].mean(axis=0) + 0.002 * np.abs(H[:, strong]).max(axis=0)
    X, omega, weight = H[:, strong] / noise, 2 * np.pi * freq, np.ones(len(H))
    left, decay, own = {}, {}, study.modes.poles
    for window in ("mode", "boxcar", "Hann"):
        basis = WindowedBasis(omega, study.power, weight, 1 / step, window)
        best = np.inf
        # A window widens the peaks; without it they are narrower, by how much the steps have to find.
        for narrower in (1.0,) if window == "mode" else (0.5, 0.15):
            # Two poles stand for one peak where none has its form: close ones are taken as one.
            poles = np.array([narrower * own[g].real.max() + 1j * own[g].imag.mean() for g in study.groups])
            for _ in range(8):
                moved = improve(basis, poles, X)
                if len(moved) != len(poles):
                    break
                poles = moved
            Y = lift(X)
            _, U, _, _ = least_squares(basis.design(poles), Y)
            value = float(np.sum((Y - U @ (U.T @ Y)) ** 2))
            if value < best:
                best, decay[window] = value, float(np.min(-poles.real / step))
        left[window] = best
    best = min(("boxcar", "Hann"), key=lambda name: left[name])
    if left["mode"] < BETTER * left[best] or left["mode"] < 1.3 * X.size:
        return None
    how = f"the peaks have the form that a record cut by a {best} window gives them, not that of a mode"
    picture = Picture([("strongest FRF", freq, np.abs(H[:, strong[0]]))], "Frequency [Hz]", "|H|", True)
    return decay[best], how, left["mode"] / (BETTER * left[best]), picture


def _cut(study: Study, step: float) -> tuple[float, str, float, Picture] | None:
    """Least decay over a record of hits cut off, from the angles that the cut gives the residues."""
    angles = angles_of(study)
    single = np.array([len(g) == 1 for g in study.groups])
    if not len(angles.mode) or not single[angles.mode].any():
        return None
    angles = angles.take(single[angles.mode])
    poles = study.modes.poles[[int(g[0]) for g in study.groups]]
    turn = np.angle(1 - np.exp(poles / step))
    mended = angles._replace(angle=angles.angle - turn[angles.mode])
    before, after = misfit(angles), misfit(mended)
    # One mode alone may be turned by much else, but seldom by just the angle that its own decay asks for.
    alone = len(np.unique(angles.mode)) < 2
    least, part = (ALONE * GAIN, LEFT / ALONE) if alone else (GAIN, LEFT)
    if before - after < least or after > part * before:
        return None
    frequency = angles.omega / (2 * np.pi)
    shown = np.degrees((angles.angle + np.pi / 2) % np.pi - np.pi / 2)
    picture = Picture(
        [("residues", frequency, shown), ("of a cut record", frequency, np.degrees(turn[angles.mode]))],
        "Frequency [Hz]", "Angle off the imaginary axis [deg]", dots=True,
    )  # fmt: skip
    decay = float((-poles.real / step)[np.unique(angles.mode)].min())
    how = "the residues are turned by the angles that a record cut off gives them"
    return decay, how, (before - after) / GAIN, picture
