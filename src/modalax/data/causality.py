"""Time convention of measured FRFs, found from causality: the response follows the force unless it was conjugated."""

import numpy as np

from modalax.data.dofs import same_place
from modalax.data.frf import FRF
from modalax.data.measurement import Measurement

# A sum of terms with random signs exceeds this many standard deviations once in 30,000 files.
CERTAIN = 4.0
LEANING = 1.0  # standard deviations of the phase test beyond which a drive point may decide


def phase_fall(frf: FRF | Measurement) -> float:
    r"""Evidence that the phase falls with frequency, in standard deviations of a sum of random signs.

    With :math:`p_k = H_{k+1} H_k^*`, the sum over lines and channels of :math:`-\mathrm{Im}\,p_k` is, on evenly
    spaced lines over the record length :math:`T`, the moment :math:`\int |h(t)|^2 \sin(2\pi t/T)\,dt` of the impulse
    response: positive if the response follows the force. A mode adds
    :math:`|R|^2\sigma\,\Delta\omega/|\cdot|^2 > 0` at every pair of lines, however coarse they are; constant terms
    and signs of channels add nothing. Terms are weighted by :math:`|p_k|^{-1/2}`, so that neither a few
    strong lines nor the noise floor decides alone.

    Returns
    -------
    float
        About +5 to +100 for measurements in the convention :math:`e^{+j\omega t}`, the same below zero for
        conjugated ones, within ±3 for noise alone; 0 for a single line.
    """
    H = np.array(frf.H, dtype=complex)
    pairs = H[..., 1:, :, :] * H[..., :-1, :, :].conj()
    size = np.sqrt(np.abs(pairs))
    return _surely(-np.divide(np.imag(pairs), size, out=np.zeros_like(size), where=size > 0))


def _surely(terms: np.ndarray) -> float:
    spread = np.sqrt(np.sum(terms**2))
    return float(np.sum(terms) / spread) if spread > 0 else 0.0


def drive_point_loss(frf: FRF | Measurement) -> float:
    r"""Evidence that the structure takes up energy at its drive points, in standard deviations; 0 without drive point.

    The force at a drive point never gains energy from a passive structure: :math:`\mathrm{Im} H \le 0` for receptance,
    :math:`\ge 0` for accelerance. The real part of a mobility, which says the same, does not change sign when
    conjugated, so mobilities tell nothing here.
    """
    sign = {"receptance": -1, "mobility": 0, "accelerance": 1}[frf.form]
    loss = np.imag(frf.H)
    terms = [
        same_place(out, into) * sign * loss[..., :, o, i]
        for o, out in enumerate(frf.outputs)
        for i, into in enumerate(frf.inputs)
    ]
    return _surely(np.array(terms))


def looks_conjugated(frf: FRF | Measurement) -> bool:
    r"""Whether the FRFs seem to be in the time convention :math:`e^{-j\omega t}`, that is conjugated.

    Judged by causality (:func:`phase_fall`) over all lines and channels; where that is unsure, as for a few lines
    of one channel, a drive point that gains energy decides (:func:`drive_point_loss`). Unsure means False.
    """
    fall = phase_fall(frf)
    if abs(fall) >= CERTAIN:
        return fall < 0
    return fall < -LEANING and drive_point_loss(frf) < -CERTAIN
