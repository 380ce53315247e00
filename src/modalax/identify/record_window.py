r"""Resonances as they appear in FRFs from records of finite length.

An FRF estimated from blocks of length :math:`T` is the transform of the impulse response times a lag window,
:math:`\hat H(\omega) = \int_0^T h(t)\,g(t/T)\,e^{-j\omega t}dt`. A mode :math:`h = Re^{\lambda t}` so makes
:math:`R\,G(j\omega-\lambda)`, :math:`G(q) = \int_0^T g(t/T) e^{-qt} dt`, instead of :math:`R/(j\omega-\lambda)`:

- a transient at the start of a rectangular block (a hammer): :math:`g = 1`. On lines :math:`k/T` this is the same pole
  with a residue times :math:`1-e^{\lambda T}`; between them, where a block was padded with zeros, it ripples;
- continuous random excitation: :math:`g` is the autocorrelation of the taper, for a rectangle :math:`1-x`, for Hann's
  :math:`(1-x)(2+\cos 2\pi x)/3 + \sin(2\pi x)/(2\pi)`. Where the response does not die out within the block this
  flattens the peak: the damping comes out too large, and a second pole beside the first would mend the shape;
- random bursts over a part :math:`b` of the block: the response to an impulse at :math:`u` is seen for :math:`T-u`, so
  that :math:`g = 1` up to :math:`1-b` and falls from there to 0 in a straight line.

References
----------
Bendat and Piersol, Random Data, 4th edition (2010), section 8.5 on resolution bias and 11.6 on lag windows.
"""

import numpy as np
from jaxtyping import Complex

RECORDS = {
    "steady": "a steady state",
    "padded": "rectangular blocks of half of {T:.3g} s, padded with zeros",
    "random": "rectangular blocks of {T:.3g} s of continuous random excitation",
    "burst_half": "blocks of {T:.3g} s with random bursts over some half of each",
    "burst_most": "blocks of {T:.3g} s with random bursts over some three quarters of each",
    "hann": "Hann-tapered blocks of {T:.3g} s of continuous random excitation",
}
BURSTS = {"burst_half": 0.5, "burst_most": 0.75}  # part of the block that is excited


def record_kernel(
    s: Complex[np.ndarray, " f"], pole: complex, duration: float, record: str
) -> Complex[np.ndarray, " f"]:
    r"""Transform :math:`G(s-\lambda)` of a mode of unit residue in records of a kind.

    Parameters
    ----------
    s
        Where the FRF was evaluated, shape ``(f,)`` [1/s].
    pole
        :math:`\lambda` [1/s].
    duration
        :math:`T`, the inverse of the distance between lines [s].
    record
        A key of ``RECORDS``.

    Raises
    ------
    ValueError
        If there is no such kind.
    """
    q, T = s - pole, duration
    if record == "steady":
        return 1 / q
    if record == "padded":
        return _box(q, T / 2)
    if record == "random":
        return _triangle(q, T)
    if record in BURSTS:
        rest = (1 - BURSTS[record]) * T
        return (T * _triangle(q, T) - rest * _triangle(q, rest)) / (T - rest)
    if record != "hann":
        raise ValueError(f"record is {record!r}; it must be one of {', '.join(RECORDS)}")
    turn = 2j * np.pi / T
    wave = (_box(q - turn, T) - _box(q + turn, T)) / 2j
    return (2 * _triangle(q, T) + (_triangle(q - turn, T) + _triangle(q + turn, T)) / 2) / 3 + wave / (2 * np.pi)


def _box(q: np.ndarray, T: float) -> np.ndarray:
    """Transform of 1 over the block."""
    return -np.expm1(-q * T) / q


def _triangle(q: np.ndarray, T: float) -> np.ndarray:
    """Transform of 1 - t/T over the block."""
    return (1 - _box(q, T) / T) / q
