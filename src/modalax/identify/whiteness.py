"""Whether a residual is noise that no line shares with the next."""

import numpy as np
from scipy.special import gammaincc


def whiteness_of(residual: np.ndarray, lags: int = 3) -> float:
    r"""Portmanteau test, :math:`2N\sum_k|\rho_k|^2 \sim \chi^2` over the first lags of every channel (Box-Pierce)."""
    n = residual.shape[0]
    power = np.maximum(np.sum(np.abs(residual) ** 2, axis=0), 1e-300)
    rho = [np.sum(residual[k:] * residual[: n - k].conj(), axis=0) / power for k in range(1, lags + 1)]
    return float(gammaincc(lags * power.size, n * np.sum(np.abs(rho) ** 2)))
