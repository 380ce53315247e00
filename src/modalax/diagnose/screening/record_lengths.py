r"""Chi-square at every length at which a record may have been cut off.

A record that ends at T lacks what would have come later, so that a mode's :math:`1/x`, :math:`x = s - \lambda`, loses
:math:`e^{-xT}/x` (:class:`~modalax.diagnose.causes.records.Leakage`). Between resonances this turns with T as fast as
the band is wide, and a few lengths tell nothing of those between. It is a product of what depends on the line alone and
on the pole alone, though. With :math:`g_\lambda(s) = -(\lambda/s)^n\psi_\lambda L_\lambda/(s - \lambda)`, whitened, and
the residual r, the change :math:`e_T` takes

.. math:: 2\langle e_T, r\rangle - |e_T|^2, \qquad
    \langle e_T, r\rangle = \mathrm{Re}\sum_\lambda e^{\lambda T}\sum_s e^{-sT}\,\langle r, g_\lambda\rangle_s, \qquad
    |e_T|^2 = \sum_{\lambda\mu} e^{(\lambda^* + \mu)T}\,\langle g_\lambda, g_\mu\rangle

from chi-square, where the sums over channels and lines are the same for all lengths. Of many modes and channels those
modes are taken that decay most slowly; what chi-square loses is exact for the change that they make. Damping is taken
as viscous.
"""

import numpy as np

from modalax.diagnose.causes.records import RIPPLE
from modalax.diagnose.fitting.residual import complex_of
from modalax.diagnose.screening.sensitivities import Residual
from modalax.diagnose.setup.problem import Problem

FAINT = 9.0  # squared length of a change, in variances, below which it is not seen
LOUD = 16.0  # times the residual's chi-square, above which it cannot be what was measured
ABOVE = 2.0  # times the highest line, up to which modes are taken
AT_ONCE = 1e6  # lengths times lines side by side
WORK = 5e8  # products of two numbers for which there is time, about half a second
DECAYED, COARSE = 30.0, 400  # decay up to which lengths are looked at, at how many of them the square at first
KEPT = 8  # lengths that are given


def promising_lengths(residual: Residual, problem: Problem, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Lengths of a record that ends in a step which take most from chi-square, and how many were looked at.

    Parameters
    ----------
    residual
        What is to be explained.
    problem
        Data and simulation; of several runs, all together.
    theta
        Changes of the modal parameters, shape ``(2, n)``.

    Returns
    -------
    tuple
        Lengths [s] at which chi-square is least, the best first, the chi-square that each takes away while the modal
        parameters stay, and the number of independent lengths that were looked at.
    """
    poles, product, square = _of_poles(residual, problem, theta)
    omega = np.asarray(problem.omega)[: problem.lines]
    rates = -poles.real[poles.real < 0]  # modes below the band decay for longest, and may show in all of it
    none = np.zeros(0)
    if not len(rates) or len(omega) < 2:
        return none, none, 0.0

    coarse = np.geomspace(0.5 / rates.max(), DECAYED / rates.min(), COARSE)
    most = np.abs(np.exp(np.outer(coarse, 2 * poles.real)) @ np.diag(square).real)
    seen = coarse[(most > FAINT) & (most < LOUD * float((residual.value**2).sum()))]
    if not len(seen):
        return none, none, 0.0
    apart = RIPPLE * 2 * np.pi / (omega[-1] - omega[0])
    last = int((seen[-1] - seen[0]) / apart) + 1  # of a mode that hardly decays there are too many to be kept
    shortest = max(last + 1 - max(int(WORK / product.size), 1), 0)  # shorter ones show anyway
    lengths = seen[0] + apart * np.arange(shortest, last + 1)
    side = min(max(int(AT_ONCE / len(omega)), 1), len(lengths))
    turn, gains = np.exp(-1j * apart * np.outer(np.arange(side), omega)), np.empty(len(lengths))
    for k in range(0, len(lengths), side):
        T = lengths[k : k + side]
        alive = np.exp(np.outer(T, poles))
        along = (turn[: len(T)] @ (np.exp(-1j * T[0] * omega)[:, None] * product) * alive).sum(axis=1).real
        gains[k : k + side] = 2 * along - np.einsum("tm,mt->t", alive.conj(), square @ alive.T).real
    about = np.pad(gains, 1, constant_values=-np.inf)
    peaks = np.flatnonzero((gains >= about[:-2]) & (gains >= about[2:]))
    best = peaks[np.argsort(-gains[peaks])[:KEPT]]
    return lengths[best], gains[best], len(lengths) * RIPPLE


def _of_poles(residual: Residual, problem: Problem, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Poles, their products with the residual at each line, ``(f, pole)``, and with each other, ``(pole, pole)``."""
    runs, (n_out, n_in) = problem.data.shape[0], problem.channels
    cut = (slice(None), slice(problem.lines), slice(n_out), slice(n_in))
    weight = np.asarray(problem.weight)[cut]
    r = complex_of(residual.value, runs)[cut]
    k, c, shapes, part = map(np.asarray, problem.modal_form.adapted(theta))
    s = 1j * np.asarray(problem.omega)[: problem.lines, None]
    near = np.flatnonzero(k < (ABOVE * np.abs(s[-1, 0])) ** 2)
    near = near[np.argsort(c[near])][: max(int(np.sqrt(WORK / len(s) / n_out / n_in) / 2), 1)]
    upper = -0.5 * c + 1j * np.sqrt(k - 0.25 * c**2 + 0j)
    both = lambda a: np.concatenate([a[near], a[near].conj()])
    poles, psi = both(upper), both(shapes[:, np.asarray(problem.outputs)[:n_out]])
    L = both(part[:, np.asarray(problem.inputs)[:n_in]])
    lost = -((poles / s) ** problem.order) / (s - poles)
    toward, total = (weight * r.conj()).sum(axis=0), np.sqrt((weight**2).sum(axis=0))
    product = lost * np.einsum("foi,mo,mi->fm", toward, psi, L)
    square = np.zeros((len(poles), len(poles)), complex)
    for o in range(n_out):  # all outputs at once would take too much memory
        g = (lost[:, :, None] * total[:, o, None, :] * (psi[:, o, None] * L)).swapaxes(0, 1)
        square += np.tensordot(g.conj(), g, ((1, 2), (1, 2)))
    return poles, product, square
