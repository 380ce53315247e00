r"""What a finite record or a fast sweep makes of a mode: the impulse response is seen through a window of the delay.

The transform :math:`1/x` of :math:`e^{-xt}` becomes :math:`\int_0^T w(t)e^{-xt}dt`. Blocks of a random force without a
window give :math:`w = 1 - t/T`, with a Hann window its autocorrelation, and a record after a hit that ends too early is
cut off, :math:`w = 1`. A linear sweep of S rad/s in a second gives :math:`w = e^{jSt^2/2}`. Sources: Bendat and Piersol
(2010), Random Data, 4th ed., section 11.5; Harris (1978), Proc. IEEE 66:51, for the windows.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy.special

Kind = Literal["hann", "boxcar", "cut"]
KINDS: tuple[Kind, ...] = "hann", "boxcar", "cut"  # in the order of the catalogue's variants
Both = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Window:
    """A record of a length [s], through which modes are seen; an infinite one shows them as they are."""

    kind: Kind
    length: float

    def transform(self, x: np.ndarray) -> Both:
        """What :math:`1/x` becomes, and its derivative by x."""
        if np.isinf(self.length):
            return 1 / x, -1 / x**2
        if self.kind == "cut":
            return _cut(x, self.length)
        return (_boxcar if self.kind == "boxcar" else _hann)(x, self.length)


@dataclass(frozen=True)
class Sweep:
    """A linear sweep of a rate [rad/s^2], down where it is negative; one of rate 0 shows modes as they are."""

    rate: float

    def transform(self, x: np.ndarray) -> Both:
        r"""What :math:`1/x` becomes, :math:`\int_0^\infty e^{-xt + jSt^2/2}dt`, and its derivative by x."""
        if self.rate == 0:
            return 1 / x, -1 / x**2
        root = np.sqrt(-0.5j * self.rate)
        kernel = 0.5 * np.sqrt(np.pi) / root * scipy.special.wofz(0.5j * x / root)
        return kernel, (1 - x * kernel) / (1j * self.rate)


def _cut(x: np.ndarray, T: float) -> Both:
    e = np.exp(-x * T)
    return (1 - e) / x, T * e / x - (1 - e) / x**2


def _boxcar(x: np.ndarray, T: float) -> Both:
    e = np.exp(-x * T)
    return 1 / x - (1 - e) / (x**2 * T), -1 / x**2 - e / x**2 + 2 * (1 - e) / (x**3 * T)


def _hann(x: np.ndarray, T: float) -> Both:
    """Of the autocorrelation 2/3 (1-u)(1 + cos(2 pi u)/2) + sin(2 pi u)/(2 pi), u = t/T."""
    y = 2j * np.pi / T
    plain, turns = _boxcar(x, T), (_boxcar(x - y, T), _boxcar(x + y, T))
    ends = _cut(x - y, T), _cut(x + y, T)
    parts = [
        2 / 3 * (plain[k] + 0.25 * (turns[0][k] + turns[1][k])) + (ends[0][k] - ends[1][k]) / (4j * np.pi)
        for k in range(2)
    ]
    return parts[0], parts[1]
