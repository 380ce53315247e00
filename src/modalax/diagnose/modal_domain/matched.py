r"""Places ranked by the sizes of a change of rank one at which the structure has the measured frequencies.

With a change :math:`u\,bb^T` of the stiffness, in modal coordinates of circular frequencies :math:`\omega_k`, the
structure has a mode of :math:`\lambda = \omega^2` exactly where
:math:`1 + u\sum_k b_k^2/(\omega_k^2 - \lambda) = 0`, and with one of the mass where
:math:`1 - u\lambda\sum_k b_k^2/(\omega_k^2 - \lambda) = 0` (Golub 1973, section 5). So each measured frequency tells at
once which size of each place it asks for, however far it has moved, and at the right place all ask for one. Of a place
that a mode hardly sees it asks for a huge size, times a derivative that is as small.
"""

import numpy as np

from modalax.diagnose.modal_domain.causes import Change
from modalax.diagnose.modal_domain.coordinates import Modes
from modalax.diagnose.modal_domain.features import Features

# Relative change of a squared frequency that an inaccuracy of the elements may make, and what is left of it once the
# elements follow other modes; times it from which on a mode is as little explained as any.
CLOSE, FOLLOWED, FAR = 0.03, 0.01, 4.0
LIGHT = -0.95  # least mass over that of the structure at a place; below it nothing is left there


def missed_frequencies(
    features: Features, modes: Modes, candidates: list[Change], sizes: np.ndarray, close: float = CLOSE
) -> tuple[np.ndarray, np.ndarray]:
    """Least sum of squared, bounded misses of the measured frequencies by each candidate, and its size.

    Of candidates of another kind the sum is infinite.

    Parameters
    ----------
    modes
        Of the structure that is changed.
    sizes
        Over the usual ones, tried for each besides those that a frequency asks for, shape ``(s,)``.
    close
        Relative miss of a squared frequency that counts as one.
    """
    out, found = np.full(len(candidates), np.inf), np.zeros(len(candidates))
    shapes, measured = np.concatenate([modes.low[0], modes.high[0]]), np.abs(features.poles) ** 2
    squares = np.concatenate([modes.low[1], modes.high[1]])
    apart = squares - measured[:, None]
    apart = np.where(np.abs(apart) < 1e-9 * measured[:, None], 1e-9 * measured[:, None], apart)
    for kind in "KM":
        which, b2 = _directions(candidates, kind, shapes)
        if not which:
            continue
        flexible = b2 @ (1 / apart).T  # (place, mode)
        if kind == "K":
            asked = -1 / _nonzero(flexible)
            slope = 1 / _nonzero(asked**2 * (b2 @ (1 / apart**2).T))
        else:
            asked = 1 / _nonzero(measured * flexible)
            slope = -1 / _nonzero(asked**2 * (b2 @ (squares / apart**2).T))
        tried = np.concatenate([np.broadcast_to(sizes, (len(which), len(sizes))), asked], axis=1)
        off = (tried[:, :, None] - asked[:, None]) * (slope / (close * measured))[:, None]
        missed = np.minimum(off**2, FAR**2).sum(axis=2)
        if kind == "M":
            missed = np.where(tried * b2.sum(axis=1)[:, None] < LIGHT, np.inf, missed)
        best = np.argmin(missed, axis=1)[:, None]
        out[which], found[which] = (np.take_along_axis(a, best, 1)[:, 0] for a in (missed, tried))
    return out, found


def _directions(candidates: list[Change], kind: str, shapes: np.ndarray) -> tuple[list[int], np.ndarray]:
    """Numbers of the candidates of rank one, and the squares of their directions by some shapes ``(place, shape)``."""
    which, rows = [], []
    for k, c in enumerate(candidates):
        if c.kind == kind and c.direction is not None and c.pattern is None:
            which.append(k)
            rows.append(c.scale * (shapes @ c.direction) ** 2)
    return which, np.array(rows).reshape(len(which), len(shapes))


def _nonzero(x: np.ndarray) -> np.ndarray:
    return np.where(x == 0, 1e-300, x)
