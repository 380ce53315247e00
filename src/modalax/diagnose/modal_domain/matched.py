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
from modalax.diagnose.modal_domain.state import Setting

CLOSE = 0.03  # relative change of a squared frequency that an inaccuracy of the elements may make
FAR = 4.0  # times that from which on a mode is as little explained as any
LIGHT = -0.95  # least mass over that of the structure at a place; below it nothing is left there


def missed_frequencies(setting: Setting, candidates: list[Change], sizes: np.ndarray) -> np.ndarray:
    """Least sum of squared, bounded misses of the measured frequencies by each candidate; inf for other kinds.

    Parameters
    ----------
    sizes
        Over the usual ones, tried for each besides those that a frequency asks for, shape ``(s,)``.
    """
    out = np.full(len(candidates), np.inf)
    squares, measured = setting.coordinates.frequencies**2, np.abs(setting.features.poles) ** 2
    apart = squares - measured[:, None]
    apart = np.where(np.abs(apart) < 1e-9 * measured[:, None], 1e-9 * measured[:, None], apart)
    for kind in "KM":
        which = [
            k for k, c in enumerate(candidates) if c.kind == kind and c.direction is not None and c.pattern is None
        ]
        if not which:
            continue
        b2 = np.array([candidates[k].scale * candidates[k].direction ** 2 for k in which])  # pyright: ignore
        flexible = b2 @ (1 / apart).T  # (place, mode)
        if kind == "K":
            asked = -1 / _nonzero(flexible)
            slope = 1 / _nonzero(asked**2 * (b2 @ (1 / apart**2).T))
        else:
            asked = 1 / _nonzero(measured * flexible)
            slope = -1 / _nonzero(asked**2 * (b2 @ (squares / apart**2).T))
        whole = b2.sum(axis=1)
        tried = np.concatenate([np.broadcast_to(sizes, (len(which), len(sizes))), asked], axis=1)
        off = (tried[:, :, None] - asked[:, None]) * (slope / (CLOSE * measured))[:, None]
        missed = np.minimum(off**2, FAR**2).sum(axis=2)
        if kind == "M":
            missed = np.where(tried * whole[:, None] < LIGHT, np.inf, missed)
        out[which] = missed.min(axis=1)
    return out


def _nonzero(x: np.ndarray) -> np.ndarray:
    return np.where(x == 0, 1e-300, x)
