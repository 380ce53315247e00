"""Damping that goes with what is wrong of stiffness or mass, as an element's own damping goes with it.

A joint that is softer mostly damps less as well. Whether, how (:mod:`modalax.diagnose.modal_domain.causes.losses`) and
how much is for the data to tell: the change is fitted as it is and with either damping by a factor to be found, which
is no second cause.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from modalax.diagnose.modal_domain.causes.change import Change, own_sizes
from modalax.diagnose.modal_domain.causes.losses import AtEqualRatios, InProportion
from modalax.diagnose.modal_domain.fitting.fit import Fit, without_causes
from modalax.diagnose.modal_domain.fitting.inaccuracy import KINDS
from modalax.diagnose.modal_domain.fitting.state import Setting
from modalax.diagnose.modal_domain.structure.coordinates import Coordinates

START = 0.5  # of what usually goes along, that a fit begins with
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
                u = [np.append(x, START) if j == k else x for j, x in zip(kept, sizes, strict=True)]
                yield causes, np.concatenate(u), _as_simulated(setting, f)


def _as_simulated(setting: Setting, f: Fit) -> Fit:
    """The inaccuracy as a start with the damping as simulated, which had to stand for what goes along."""
    a = setting.inaccuracy
    damping = np.array([KINDS[g] == "C" for g in a.groups])
    epsilon = np.where(damping, a.usual, f.epsilon)
    return replace(without_causes(f), sizes=np.where(damping[a.group_of], 0.0, f.sizes), epsilon=epsilon)


def with_loss(cause: Change, c: Coordinates, inside: np.ndarray) -> list[Change]:
    """The cause with damping along in either way, as much as the most damped of the modes ``inside`` has.

    Empty for what changes neither stiffness nor mass, and for what has several sizes. ``inside`` are numbers of modes.
    """
    if cause.kind not in ("K", "M") or cause.count != 1:
        return []
    least = STILL * float(c.frequencies[inside].max())
    w = np.maximum(c.frequencies, least)
    damping, of_mass = np.diag(c.damping), cause.kind == "M"
    ratio = float((damping / w ** (0 if of_mass else 2))[inside].max())
    if ratio <= 0:
        return []
    twice = damping / w
    twice[-1] = twice[-2]  # the spare coordinate, which a stiffer mode may pass
    kept = AtEqualRatios(twice, w, least, of_mass)
    return [
        replace(cause, along="in proportion", loss=InProportion(ratio)),
        replace(cause, along="at equal damping ratios", loss=kept),
    ]
