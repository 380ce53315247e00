"""Modes that the simulation lacks where that must be known before all else: one of two close ones, or several.

Errors of elements turn modes that are close into each other, so that what is known of them is known of both together
(:mod:`modalax.diagnose.modal_domain.modes.repeated`). Where one of the two is none of the simulation's that comparison
never agrees; each is then compared by itself, as :func:`modalax.diagnose.modal_domain.modes.measured.told_one_by_one`
has them. Of several modes that are too many one may be taken for another of the simulation's that is far off, beside
elements that all are.
"""

from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.fitting.attempts import attempt
from modalax.diagnose.modal_domain.fitting.explanation import Prior, ranked_by
from modalax.diagnose.modal_domain.fitting.fit import Found
from modalax.diagnose.modal_domain.fitting.narrowed import narrowed
from modalax.diagnose.modal_domain.fitting.state import Setting
from modalax.diagnose.modal_domain.modes.features import Features
from modalax.diagnose.modal_domain.search.beside_modes import causes_beside_modes, with_free

TRIED = 6  # of modes that are free and a cause beside them, or none, that are fitted
NEARLY = 100.0  # chi-square per feature up to which a rest that no element explains may be all that is left


def lacking_modes(setting: Setting, candidates: list[Change], together: Features) -> Found:
    """Fits in which several modes, or one that is told ``together`` with another, are none of the simulation's.

    Beside them there may be one other cause. Empty where none of them comes near to explaining the modes.
    """
    setting, found = narrowed(setting) or setting, {}
    for extra, other, u in causes_beside_modes(setting, candidates, TRIED):
        attempt(setting, found, (*other, *extra), with_free(u, extra), None)
    best = ranked_by(found, Prior(candidates))[0].fit if found else None
    if best is None or best.chi2 > NEARLY * best.state.difference.size:
        return {}
    alone, poles = together.poles[~together.grouped], setting.features.poles
    free = [poles[c.freed] for c in best.causes if c.freed is not None]
    return found if len(free) > 1 or any(pole not in alone for pole in free) else {}
