r"""Bootstrap studies: how far the modes of one measurement scatter, from the measurement itself.

Repeats of the measurement (runs at one force level) are drawn with replacement and averaged. Where there are none, the
draws are the FRFs of the fitted model with noise of the measured variance (the parametric bootstrap).

Efron and Tibshirani (1993), An Introduction to the Bootstrap, chapters 6 and 10.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from modalax.study.fits import fit_row, quantities
from modalax.study.noise import FITS
from modalax.study.settings import of_key
from modalax.study.work import Row, Work, chunk_for, key_of, seed_of

FEWEST = 3  # repeats below which drawing among them says nothing


@dataclass(frozen=True)
class BootstrapWork(Work):
    """Fits of FRFs drawn from a measurement.

    Attributes
    ----------
    measurement
        Runs that are repeats of each other; None where noise is drawn.
    frf
        FRFs of the fitted model, with the measured variance.
    poles
        Poles of the modes fitted to the measurement [rad/s].
    fit
        The table ``[fit]``.
    """

    measurement: Any
    frf: Any
    poles: np.ndarray
    fit: dict[str, Any]

    def item(self, index: int) -> Row:
        """The modes fitted to draw ``index``."""
        drawn = self._noisy(index) if self.measurement is None else self._resampled(index)
        return fit_row(drawn, self.fit, self.poles)

    def _noisy(self, index: int) -> Any:
        import jax

        real, imag = jax.random.normal(key_of(self.seed, index), (2, *self.frf.H.shape))
        noise = np.sqrt(np.asarray(self.frf.variance) / 2) * (np.asarray(real) + 1j * np.asarray(imag))
        return self.frf.replace(H=np.asarray(self.frf.H) + noise)

    def _resampled(self, index: int) -> Any:
        H = np.asarray(self.measurement.H)
        runs = len(H)
        drawn = H[np.random.default_rng(seed_of(self.seed, index)).integers(runs, size=runs)]
        variance = np.sum(np.abs(drawn - drawn.mean(axis=0)) ** 2, axis=0) / (runs * (runs - 1))
        return self.frf.replace(H=drawn.mean(axis=0), variance=_positive(variance), averages=runs)


def prepare(settings: dict[str, Any], folder: Path) -> Work:
    """The work of a bootstrap study.

    Raises
    ------
    ValueError
        If the file holds no FRFs, no such run, or neither repeats nor a variance to draw from.
    """
    from modalax.data import Measurement
    from modalax.files import load
    from modalax.identify import fit as identify
    from modalax.identify.mode_search import synthesis
    from modalax.identify.noise import smooth_variance

    data, fit = settings["data"], settings["fit"]
    path = folder / data["file"]
    with of_key("[data] file"):
        measured = load(path)
    if not isinstance(measured, Measurement):
        raise ValueError(f"[data] file: {path} holds a {type(measured).__name__}; measured FRFs are needed")
    measured = measured if data["band"] is None else measured.band(*data["band"])
    level = np.asarray(measured.level)
    repeats = measured.runs >= FEWEST and bool(np.isnan(level).all() or np.ptp(level) <= 1e-3 * np.abs(level).max())
    resample = data["resample"]
    if resample == "runs" and not repeats:
        raise ValueError(
            f"{path}: [data] resample is runs, but the file has {measured.runs} runs at the force amplitudes "
            f"{level.tolist()} N; at least {FEWEST} runs at one force amplitude are needed"
        )
    if data["run"] > measured.runs:
        raise ValueError(f"{path}: [data] run: there is no run {data['run']}; the runs are 1 to {measured.runs}")
    by_runs = repeats and resample != "variance"
    frf = _mean(measured) if by_runs else measured.run(data["run"] - 1)
    result = identify(frf, fit["method"], fit["order"], fit["refine"])
    poles = np.asarray(result.model.poles)[np.asarray(result.inside)]
    weighted = smooth_variance(result.frf)
    if weighted.variance is None and not by_runs:
        raise ValueError(
            f"{path} holds neither {FEWEST} runs at one force amplitude nor a noise variance; there is nothing to "
            "draw from"
        )
    clean = synthesis(result.model, weighted).replace(variance=weighted.variance, averages=None)
    lines = slice(None)
    if by_runs and clean.shape[0] != frf.shape[0]:
        lines = np.searchsorted(np.asarray(frf.freq), np.asarray(clean.freq))
    runs = measured.replace(freq=measured.freq[lines], H=measured.H[:, lines], variance=None) if by_runs else None
    return BootstrapWork(
        settings["draws"], chunk_for(settings["draws"], settings["chunk"], FITS), settings["seed"], runs, clean, poles,
        fit, quantities=quantities(poles, fit["refine"]),
    )  # fmt: skip


def _mean(measured: Any) -> Any:
    """The mean over the runs, with the variance of the mean that their scatter shows."""
    H = np.asarray(measured.H)
    runs = len(H)
    variance = np.sum(np.abs(H - H.mean(axis=0)) ** 2, axis=0) / (runs * (runs - 1))
    return measured.run(0).replace(H=H.mean(axis=0), variance=_positive(variance), averages=runs, coherence=None)


def _positive(variance: np.ndarray) -> np.ndarray:
    """A variance that is nowhere zero, as it comes out where one run was drawn every time."""
    least = np.min(variance, where=variance > 0, initial=np.inf)
    return np.maximum(variance, least if np.isfinite(least) else 1.0)
