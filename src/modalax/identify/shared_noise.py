r"""Noise that all outputs share: that of the force, which makes one error of a line's FRFs in proportion to them.

Noise on the force of an input turns its FRFs :math:`H_o` into :math:`H_o(1+e)` with one :math:`e` for all outputs. What
a fit leaves, whitened and differenced twice over the lines so that smooth misfit drops out, is then along the whitened
response :math:`h`. Of independent noise :math:`d_k` in :math:`n` outputs the part

.. math:: \varphi_k = \frac{|h_k^Hd_k|^2}{|h_k|^2\,|d_k|^2}

is a beta variable :math:`B(1, n-1)` at whatever level, so that half of the lines are above its median
:math:`1-2^{-1/(n-1)}`: a sign test, which a few lines of misfit do not upset. Close to a resonance all that a change of
its pole makes is along the response too. There such noise counts as much more than each output's own as the largest
eigenvalue of its covariance over the outputs is, :math:`nc/(c+n-1)`. The ratio :math:`c` of that to all others follows
from the median :math:`m` of the parts, weighed by the response: :math:`m/(1-m) = c\,(2^{1/(n-1)}-1)`.
"""

import numpy as np
import scipy.special

from modalax.identify.information import LAGS
from modalax.identify.whiteness import whiteness_of

CHANCE = 1e-6  # chance at which noise is taken for shared that is not
MISFIT = 1e-3  # chance at which noise along the response is taken for misfit, which lines share


def shared_noise(response: np.ndarray, residual: np.ndarray) -> float:
    """By how much noise that the outputs share counts more than as much of each output's own; 1 where none is shared.

    Of several inputs, each with a force of its own, that which counts most.

    Parameters
    ----------
    response, residual
        What a model makes and what it leaves, over the noise's standard deviations, shape ``(f, o, i)``.

    Notes
    -----
    Nearer lines than ``LAGS`` may be correlated: only every ``LAGS``-th is in the tests. Misfit that two differences
    leave is over more lines still, so what is along the response must be white there.
    """
    lines, n, inputs = residual.shape
    if n < 2 or lines < 3:
        return 1.0
    change = residual[:-2] - 2 * residual[1:-1] + residual[2:]
    level = np.sqrt(np.median(_squares(change), axis=0)) + 1e-300
    change, response = change / level, response[1:-1] / level
    size, power = (np.sum(_squares(a), axis=1) for a in (response, change))
    along = np.sum(response.conj() * change, axis=1) / np.sqrt(np.maximum(size * power, 1e-300))
    squares, some = _squares(along), along[::LAGS]
    above = np.sum(squares[::LAGS] > 1 - 2 ** (-1 / (n - 1)), axis=0)
    chance = scipy.special.bdtrc(above - 1, len(some), 0.5)
    told = np.array(
        [p < CHANCE / inputs and whiteness_of(a[:, None]) > MISFIT for p, a in zip(chance, some.T, strict=True)]
    )
    middle = np.array([_median(squares[:, i], np.sqrt(size[:, i])) for i in np.flatnonzero(told)])
    ratio = middle / np.maximum(1 - middle, 1e-300) / (2 ** (1 / (n - 1)) - 1)
    return float(np.max(n * ratio / (ratio + n - 1), initial=1.0))


def shared_notes(shared: float) -> list[str]:
    """A sentence on noise that outputs share, where there is some."""
    if shared == 1.0:
        return []
    return [
        "The noise of all outputs is common: each line has one error in proportion to its FRFs, as noise on the force "
        f"makes it. Beside a resonance it counts as noise of {shared:.2g} times its variance in each output by itself "
        "would, as the error bars and the evidence for modes know; a cleaner force signal helps, more outputs do not."
    ]


def _median(values: np.ndarray, weight: np.ndarray) -> float:
    """Value that half of the weight is below."""
    order = np.argsort(values)
    below = np.cumsum(weight[order])
    return float(values[order[np.searchsorted(below, 0.5 * below[-1])]])


def _squares(z: np.ndarray) -> np.ndarray:
    return z.real**2 + z.imag**2
