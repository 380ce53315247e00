r"""Places ranked by a joint without a law: its stiffness and loss follow amplitude and, smoothly, frequency.

A force :math:`q` that is free at every line has so many unknowns that weak effects tell few places apart. Whatever an
element or joint is, its force is near to :math:`Z\,x`, with the motion x across it and

.. math:: Z = \sum_k (a_k + j b_k)\,\varphi_k(\ln A) + (c + j d)\,\ln\frac{\omega}{\bar\omega} - m\,\omega^2
    + j g\,\omega + e_r,

hats :math:`\varphi_k` over the logarithm of the amplitude A and, as these do not come near to laws that grow or
fall with a power of it, :math:`A^2` and :math:`1/A`, the stiffening of a cubic spring and the softening of a slider; a
mass m and a damper g, which the logarithm does not come near to over a wide band, and a constant :math:`e_r` for each
run after the first. These unknowns are fitted by steps of Gauss and Newton to the force that was measured there, from
none and from that at the measured motion; x follows from the force that is found, since the measured one would bring
its noise to both sides.
"""

import numpy as np

from modalax.diagnose.screening.products import At, Reduced

HATS = 6  # over the logarithm of the amplitude
LOWEST = 0.05  # quantile of the amplitudes at the lowest of them
TURNS, ENOUGH = 10, 1.0  # steps from each start at most, and gain in chi-square at which they end
SHARES = (1.0, 0.5, 0.25, 0.1)  # of a step, tried one after the other
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
    """Chi-square taken away at one place, the better of two starts, and the number of unknowns."""
    S, N = at.S[k], np.asarray(at.N[k], float)
    free, drive = np.broadcast_to(at.motion[k], S.shape), np.broadcast_to(at.drive[k][None, :, None], S.shape)

    def gain_of(Z: np.ndarray) -> float:
        y = Z * free / (1 - drive * Z)  # force over that at the input
        return float((2 * y.conj() * S).real.sum() - (N * np.abs(y) ** 2).sum())

    measured, best, count = np.divide(S, N, out=np.zeros(S.shape, complex), where=N > 0), 0.0, 0
    for x in (free, free + drive * measured):
        gain, Z, slope = 0.0, np.zeros(S.shape, complex), x
        for _ in range(TURNS):
            laws = _laws(x, reduced)
            count = len(laws)
            there = _least_squares(laws * slope, N, S - N * Z * (x - slope)) @ laws.reshape(count, -1)
            change = there.reshape(S.shape) - Z
            tried = ((gain_of(Z + share * change), Z + share * change) for share in SHARES)
            better = next((one for one in tried if one[0] > gain), None)
            if better is None:
                break
            done, (gain, Z) = better[0] - gain < ENOUGH, better
            x = free / (1 - drive * Z)
            slope = x / (1 - drive * Z)
            if done:
                break
        best = max(best, gain)
    return best, count


def _least_squares(J: np.ndarray, N: np.ndarray, aim: np.ndarray) -> np.ndarray:
    """Real unknowns of the least squares with columns ``(unknown, run, f, i)``, weights and weighted right side."""
    J = J.reshape(len(J), -1)
    A, g = ((J.conj() * N.ravel()) @ J.T).real, (J.conj() @ aim.ravel()).real
    scale = np.sqrt(np.maximum(np.diag(A), 1e-300))
    value, V = np.linalg.eigh(A / scale[:, None] / scale)
    along = np.where(value > SMALL * value[-1], (V.T @ (g / scale)) / np.maximum(value, 1e-300), 0.0)
    return (V @ along) / scale


def _laws(x: np.ndarray, reduced: Reduced) -> np.ndarray:
    """Impedances of each unknown at a motion ``(run, f, i)``, their sign turned, shape ``(unknown, run, f, i)``."""
    size = np.log(np.maximum(reduced.level[:, :, None] * np.abs(x), 1e-300))
    low, high = np.quantile(size, LOWEST), size.max() + 1e-9
    nodes = np.linspace(low, high, HATS)
    w = np.broadcast_to((reduced.omega / np.median(reduced.omega))[None, :, None], x.shape)
    over = [*(np.interp(size, nodes, row) for row in np.eye(HATS)), np.exp(2 * (size - high)), np.log(w)]
    over.append(np.exp(np.minimum(low - size, 0.0)))
    runs = np.arange(len(x))[:, None, None]
    each = [np.broadcast_to(np.where(runs == r, 1.0, 0.0), x.shape) for r in range(1, len(x))]
    return np.stack([*over, -(w**2), *each, *(1j * b for b in over), 1j * w])
