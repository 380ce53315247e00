r"""What is off by one factor throughout: all of the stiffness, or all of the mass.

A modulus or a thickness that is wrong is no scatter of elements. Where the data are clearly likelier with such a factor
:math:`e^x`, x is fitted beside the errors of single elements, which are then told as much smaller as they are.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from modalax._numerics.text import with_error
from modalax.diagnose.modal_domain.discrepancy import beside
from modalax.diagnose.modal_domain.fit import Fit, fit, linear_at, without_causes
from modalax.diagnose.modal_domain.inaccuracy import THROUGHOUT, UNKNOWN, USUAL
from modalax.diagnose.modal_domain.state import Setting
from modalax.diagnose.thresholds import THRESHOLDS

CLEARER = 5.0  # nats of log evidence that each such factor must gain
WIDER = 3.0  # a factor throughout before the data, relative to the usual errors of single elements


def with_throughout(setting: Setting, alone: Fit) -> Setting:
    """The setting with the factors throughout that the data ask for beside the causes of the fit ``alone``."""
    names = tuple(name for name in setting.sought if THROUGHOUT[name] not in setting.inaccuracy.groups)
    found = [(alone.log_evidence, setting)]
    for some in [*((name,) for name in names), names]:
        if len(some) == 2 and len(found) == 1:  # neither by itself
            break
        wider = _with(setting, some)
        start = start_in(wider, alone) if alone.causes else None
        trial = fit(wider, alone.causes, start, alone.u, **({"temperatures": (3.0,)} if alone.causes else {}))
        if trial is not None and trial.log_evidence - CLEARER * len(some) > alone.log_evidence:
            found.append((trial.log_evidence - CLEARER * len(some), wider))
    return max(found, key=lambda one: one[0])[1]


def start_in(setting: Setting, f: Fit) -> Fit:
    """The inaccuracy of a fit as a start in a setting with factors throughout, or without them."""
    count, groups = len(setting.inaccuracy.group_of), len(setting.inaccuracy.groups)
    few = replace(f, sizes=f.sizes[:count], epsilon=f.epsilon[:groups], determined=f.determined[:groups])
    return beside(setting, without_causes(few))


def _with(setting: Setting, names: tuple[str, ...]) -> Setting:
    a = setting.inaccuracy
    whole = tuple(a.patterns[a.groups.index(name)].sum(axis=0)[None] for name in names)
    more = replace(
        a, groups=(*a.groups, *(THROUGHOUT[name] for name in names)), patterns=(*a.patterns, *whole),
        usual=np.append(a.usual, [WIDER * USUAL[name] for name in names]),
        spread=np.append(a.spread, [UNKNOWN] * len(names)), claimed=(*a.claimed, *(False for _ in names)),
        positive=np.append(a.positive, [True] * len(names)),
    )  # fmt: skip
    return replace(setting, inaccuracy=more)


def throughout_told(setting: Setting, f: Fit) -> dict[str, dict[str, float]]:
    """By how much the simulation's stiffness or mass is too high throughout, where it surely is off.

    The value is :math:`e^{-x}-1`, the simulation relative to the structure: positive where the simulation is too stiff.
    """
    a, told = setting.inaccuracy, {}
    if not set(THROUGHOUT.values()) & set(a.groups):
        return {}
    linear = linear_at(setting, f.state, f.causes, f.sizes, f.u)
    variance = np.diag(linear.solve(f.epsilon)[1]) * linear.prior(f.epsilon) ** 2
    for name, group in THROUGHOUT.items():
        if group not in a.groups:
            continue
        (k,) = np.flatnonzero(a.group_of == a.groups.index(group))
        x, std = float(f.sizes[k]), float(np.sqrt(variance[k]))
        if abs(x) > THRESHOLDS.stands_out * std:
            told[name] = {"value": float(np.expm1(-x)), "std": float(np.exp(-x) * std)}
    return told


def throughout_said(told: dict[str, Any]) -> list[str]:
    """The same in sentences."""
    return [
        f"throughout, the {name} of the simulation is {with_error(abs(v['value']), v['std'], 100)} % too "
        f"{'high' if v['value'] > 0 else 'low'}; the general inaccuracy is what elements are off beside that"
        for name, v in told.items()
    ]
