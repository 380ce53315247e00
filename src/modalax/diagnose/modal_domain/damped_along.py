r"""Damping that goes with what is wrong of stiffness or mass, as an element's own damping goes with it.

A joint that is softer mostly damps less as well. Either damping is in proportion to stiffness and mass (Rayleigh 1877),
or modes keep their damping ratios: with :math:`C = 2\zeta K^{1/2}` in coordinates of unit mass, a small change has
:math:`\Delta C_{ij} = 2\zeta\,\Delta K_{ij}/(\omega_i+\omega_j)`, and one of mass
:math:`2\zeta\,\Delta M_{ij}\,\omega_i\omega_j/(\omega_i+\omega_j)`. Whether, how and how much is for the data to
tell: the change is fitted as it is and with either damping by a factor to be found, which is no second cause.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from modalax.diagnose.modal_domain.causes import Change, own_sizes
from modalax.diagnose.modal_domain.coordinates import Coordinates
from modalax.diagnose.modal_domain.fit import Fit, without_causes
from modalax.diagnose.modal_domain.state import Setting

STILL = 1e-3  # frequency, relative to the highest measured, below which a mode is that of a rigid body


def damped_along(setting: Setting, fits: Sequence[Fit]) -> Iterator[tuple[tuple[Change, ...], np.ndarray, Fit]]:
    """Causes of each fit with the damping of one along, in place of a loss there; sizes and fit to start from."""
    for f in fits:
        for k, cause in enumerate(f.causes):
            lossy = [j for j, c in enumerate(f.causes) if c.dissipates and set(c.where) == set(cause.where)]
            kept = [j for j in range(len(f.causes)) if j not in lossy]
            sizes = [f.u[own_sizes(f.causes, j)] for j in kept]
            for along in with_loss(cause, setting.coordinates, f.state.pairs):
                causes = tuple(along if j == k else f.causes[j] for j in kept)
                u = [np.append(x, 0.0) if j == k else x for j, x in zip(kept, sizes, strict=True)]
                yield causes, np.concatenate(u), without_causes(f)


def with_loss(cause: Change, c: Coordinates, inside: np.ndarray) -> list[Change]:
    """The cause with damping along in either way, as much as the most damped of the modes ``inside`` has.

    Empty for what changes neither stiffness nor mass, and for what has several sizes. ``inside`` are numbers of modes.
    """
    if cause.kind not in ("K", "M") or cause.count != 1:
        return []
    w = np.maximum(c.frequencies, STILL * c.frequencies[inside].max())
    damping = np.diag(c.damping)
    ratio = float((damping / w ** (2 if cause.kind == "K" else 0))[inside].max())
    twice = float((damping / w)[inside].max())
    if ratio <= 0:
        return []
    both = np.add.outer(w, w)
    kept = twice * (1.0 if cause.kind == "K" else np.outer(w, w)) / both
    return [
        replace(cause, along="in proportion", loss=np.full_like(both, ratio)),
        replace(cause, along="at equal damping ratios", loss=kept),
    ]
