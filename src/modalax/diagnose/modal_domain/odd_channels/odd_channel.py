r"""Whether one channel alone differs from all others, in a way that no cause of the catalogue explains.

What is wrong with one sensor may be nothing that has a name: a gain that wanders, a cable that resonates. What is wrong
with one force neither: a shaker that also pushes another point, a hammer that hits askew. An element, a mass or
crosstalk at its place may then explain a part of it. Here each mode's residues at one channel are free by a complex
factor of usual size, which adds

.. math:: \sigma^2\sum_k D_k D_k^T,

:math:`D_k` the derivatives of the features of mode k by real and imaginary part of that factor, to the covariance of
the features. Where the general inaccuracy beside such a channel is likelier than every cause, none is a name for it.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from modalax._numerics.triangles import forward
from modalax.diagnose.causes.base import RARE
from modalax.diagnose.decision.beyond import OddChannel
from modalax.diagnose.modal_domain.causes.channel_faults import GAIN
from modalax.diagnose.modal_domain.fitting.explanation import Explanation
from modalax.diagnose.modal_domain.fitting.fit import fit
from modalax.diagnose.modal_domain.fitting.state import Setting
from modalax.diagnose.modal_domain.modes.features import Features
from modalax.diagnose.modal_domain.search.explain import UNLIKE
from modalax.diagnose.thresholds import THRESHOLDS

FEWEST = 3  # outputs among which one can differ from the others
OTHERS = 1 / 3  # mean square of a mode's residues at other outputs, relative to that at its largest
SURE = 5.0  # nats by which a mode must be likelier at one output alone
TRIED = 2  # channels of each side that are tried, those likeliest about the general inaccuracy alone


def odd_channel(
    setting: Setting, explanations: Sequence[Explanation], outputs: Sequence[str], inputs: Sequence[str]
) -> OddChannel | None:  # fmt: skip
    """The channel that is likelier to be odd than every explanation is to be true; None where there is none.

    Parameters
    ----------
    setting
        In which the explanations were fitted.
    explanations
        By falling probability.
    """
    plain = next((e for e in explanations if not e.causes), None)
    if plain is None or not explanations[0].causes:
        return None
    found: list[OddChannel] = []
    named = all(c.local and c.kind or c.in_channels for c in explanations[0].causes)
    settled = named and explanations[0].misfit < THRESHOLDS.as_noise
    for force, names in ((False, outputs), (True, inputs)):
        if len(names) < (2 if force else FEWEST):
            continue
        r, free = plain.fit.state.difference, [_freed(setting, force, k) for k in range(len(names))]
        left = np.array([_left_beside(W, r) for W in free])
        for k in np.argsort(left)[:TRIED]:
            if settled and left[k] > UNLIKE * len(r):  # channels besides that one are far off as well
                continue
            L = np.linalg.cholesky(np.eye(len(r)) + free[k] @ free[k].T)
            beside = math.log(RARE / len(names)) - volume(L) - explanations[0].log_posterior
            f = fit(replace(setting, whitener=forward(L, setting.triangle)), best_else=-beside)
            if f is not None:
                found.append(OddChannel(names[k], force, f.log_evidence + beside))
    best = max(found, key=lambda o: o.nats, default=None)
    return best if best is not None and best.nats > 0 else None


def is_of_the_structure(explanations: Sequence[Explanation], f: Features) -> bool:
    """Whether changes of the structure leave no more than noise, and frequencies are far off without them.

    All channels tell frequencies alike, so that no channel is what these changes stand for.
    """
    best, plain = explanations[0], next((e for e in explanations if not e.causes), None)
    if plain is None or not best.causes or not all(c.local and c.kind for c in best.causes):
        return False
    state, alone = plain.fit.state, ~f.grouped
    apart = np.log(np.abs(state.modes.poles[state.pairs] / f.poles))[alone]
    known = np.diag(f.covariance).reshape(f.values.shape)[alone, 0]
    return bool(alone.any() and best.misfit < THRESHOLDS.as_noise and (apart**2 / known).mean() > UNLIKE)


def only_output(f: Features, mode: int) -> int | None:
    r"""The output that alone shows a measured mode; None where others do, or where that is not sure.

    A structure's mode moves other outputs as well: their residues, in units of their noise, would be normal with a
    variance q, a third of that of the largest. For :math:`z_k^2`, the sum of squares at output k to n inputs, that they
    are noise alone is likelier by :math:`\sum_k n\ln(1+q) - z_k^2 q/(1+q)`.
    """
    z = (np.abs(f.residues[mode]) ** 2).sum(axis=1)
    inputs, largest = f.residues.shape[2], int(np.argmax(z))
    if len(z) < FEWEST:
        return None
    q, others = z[largest] / inputs * OTHERS, np.delete(z, largest)
    nats = float((inputs * np.log1p(q) - others * q / (1 + q)).sum())
    return largest if nats > SURE else None


def _freed(setting: Setting, force: bool, channel: int) -> np.ndarray:
    """Whitened derivatives by the factors of one channel, over their usual size, two of each mode."""
    f = setting.features
    own = (slice(None), slice(None), channel) if force else (slice(None), channel)
    row = np.zeros_like(f.seen)
    row[own] = f.seen[own]
    still = np.zeros((len(f.poles), 2))
    slopes = f.slopes(f.poles, f.seen, still, np.stack([row, 1j * row], axis=1))
    D = np.zeros((len(f.poles), f.width, len(f.poles), 2))
    D[range(len(f.poles)), :, range(len(f.poles))] = GAIN * slopes
    return setting.triangle @ D.reshape(len(f.poles) * f.width, -1)


def _left_beside(W: np.ndarray, r: np.ndarray) -> float:
    r"""Chi-square left beside what is free, and its volume: :math:`r^T(I+WW^T)^{-1}r + \ln\det(I+W^TW)`."""
    L = np.linalg.cholesky(np.eye(W.shape[1]) + W.T @ W)
    return float(r @ r - (forward(L, W.T @ r) ** 2).sum()) + 2 * volume(L)


def volume(L: np.ndarray) -> float:
    """Logarithm of the determinant of a triangular root with a positive diagonal, shape ``(m, m)``."""
    return float(np.log(np.diag(L)).sum())
