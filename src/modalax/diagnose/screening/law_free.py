r"""Places ranked by a joint without a law: its stiffness and loss follow the amplitude, and gently the frequency.

A force :math:`q` that is free at every line has so many unknowns that weak effects tell few places apart. Whatever an
element or joint is, its force is near to :math:`Z\,x`, with the motion x across it and

.. math:: Z = \sum_k (a_k + j b_k)\,\varphi_k(\ln A) + (c + j d)\,\ln\frac{\omega}{\bar\omega} + e_r,

hats :math:`\varphi_k` over the amplitudes A, and a constant :math:`e_r` for each run after the first. These unknowns
are fitted by linear least squares to the force that was measured there, and x follows from the force that is found: the
measured one would bring its noise to both sides.
"""

import numpy as np

from modalax.diagnose.screening.products import At, Reduced

HATS = 6  # over the logarithm of the amplitude
LOWEST = 0.05  # quantile of the amplitudes at the lowest of them
TURNS = 3  # of force and motion, one after the other
SMALL = 1e-9  # eigenvalue of the scaled normal matrix below which a direction has no information


def gains_without_law(at: At, reduced: Reduced) -> tuple[np.ndarray, int]:
    """Chi-square that such a joint takes away at each place, shape ``(place,)``, and the number of its unknowns.

    Parameters
    ----------
    at, reduced
        Products at the places, and of the residual, without nuisances.
    """
    found = [_gain(at, reduced, k) for k in range(len(at.S))]
    return np.array([gain for gain, _ in found]), max((count for _, count in found), default=0)


def _gain(at: At, reduced: Reduced, k: int) -> tuple[float, int]:
    S, N, free = at.S[k], np.asarray(at.N[k], float), np.broadcast_to(at.motion[k], at.S[k].shape)
    drive, y, gain, count = at.drive[k][None, :, None], np.zeros(S.shape, complex), 0.0, 0
    for _ in range(TURNS):
        B = _columns(free + drive * y, reduced)
        count = len(B)
        A, g = ((B.conj() * N.ravel()) @ B.T).real, (B.conj() @ S.ravel()).real
        scale = np.sqrt(np.maximum(np.diag(A), 1e-300))
        value, V = np.linalg.eigh(A / scale[:, None] / scale)
        along = np.where(value > SMALL * value[-1], (V.T @ (g / scale)) / np.maximum(value, 1e-300), 0.0)
        y = ((V @ along) / scale @ B).reshape(S.shape)  # force over that at the input, its sign turned
        gain = float((2 * y.conj() * S).real.sum() - (N * np.abs(y) ** 2).sum())
    return gain, count


def _columns(x: np.ndarray, reduced: Reduced) -> np.ndarray:
    """Forces of each unknown at a motion ``(run, f, i)``, shape ``(unknown, sample)``."""
    size = np.log(np.maximum(reduced.level[:, :, None] * np.abs(x), 1e-300))
    nodes = np.linspace(np.quantile(size, LOWEST), size.max() + 1e-9, HATS)
    over = [np.interp(size, nodes, row) * x for row in np.eye(HATS)]
    over.append(np.log(reduced.omega / np.median(reduced.omega))[None, :, None] * x)
    runs = np.arange(len(x))[:, None, None]
    each = [np.where(runs == r, x, 0.0) for r in range(1, len(x))]
    return np.stack([b.ravel() for b in (*over, *(1j * b for b in over), *each)])
