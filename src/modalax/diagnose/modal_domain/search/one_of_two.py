"""Two close modes of which the simulation has one.

Errors of elements turn modes that are close into each other, so that what is known of them is known of both together
(:mod:`modalax.diagnose.modal_domain.modes.repeated`). Where one of the two is none of the simulation's that comparison
never agrees; each is then compared by itself, as :func:`modalax.diagnose.modal_domain.modes.measured.told_one_by_one`
has them.
"""

import numpy as np

from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.fitting.attempts import attempt
from modalax.diagnose.modal_domain.fitting.explanation import Prior, ranked_by
from modalax.diagnose.modal_domain.fitting.fit import Found
from modalax.diagnose.modal_domain.fitting.narrowed import narrowed
from modalax.diagnose.modal_domain.fitting.state import Setting
from modalax.diagnose.modal_domain.modes.features import Features
from modalax.diagnose.modal_domain.search.beside_a_mode import causes_beside_a_mode

TRIED = 6  # of a mode that is free and a cause beside it, or none, that are fitted
BEYOND = 0.05  # relative distance from the measured modes within which modes of the simulation may be among them
NEARLY = 100.0  # chi-square per feature up to which a rest that no element explains may be all that is left


def has_fewer(setting: Setting) -> bool:
    """Whether the simulation has fewer modes about the measured ones than were measured."""
    w, size = setting.coordinates.frequencies[:-1], np.abs(setting.features.poles)
    near = (w > size.min() * (1 - BEYOND)) & (w < size.max() * (1 + BEYOND))
    return int(np.count_nonzero(near)) < len(size)


def lacking_one_of_two(setting: Setting, candidates: list[Change], together: Features) -> Found:
    """Fits in which one mode that is told ``together`` with another is none of the simulation's; else nothing.

    Beside it there may be one other cause. Empty where none of them comes near to explaining the modes.
    """
    setting, found = narrowed(setting) or setting, {}
    for extra, other, u in causes_beside_a_mode(setting, candidates, TRIED):
        attempt(setting, found, (*other, extra), np.append(u, np.zeros(extra.count)), None)
    best = ranked_by(found, Prior(candidates))[0].fit if found else None
    if best is None or best.chi2 > NEARLY * best.state.difference.size:
        return {}
    alone, poles = together.poles[~together.grouped], setting.features.poles
    one = any(c.freed is not None and poles[c.freed] not in alone for c in best.causes)
    return found if one else {}
