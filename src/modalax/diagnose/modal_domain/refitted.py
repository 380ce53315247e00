"""Explanations fitted again in another setting: beside factors throughout, uneven errors, the rest, or all features."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

from modalax.diagnose.deadline import NEVER
from modalax.diagnose.modal_domain.attempts import attempt, explains
from modalax.diagnose.modal_domain.causes import Change
from modalax.diagnose.modal_domain.discrepancy import learnt_rest, with_rest
from modalax.diagnose.modal_domain.explanation import Explanation, ranked_by
from modalax.diagnose.modal_domain.fit import Fit, fit, without_causes
from modalax.diagnose.modal_domain.prior import Prior
from modalax.diagnose.modal_domain.state import Setting
from modalax.diagnose.modal_domain.throughout import start_in, with_more

AGAIN = 6  # leading explanations that are fitted again,
NEAR = 12.0  # and nats behind the first up to which they are, where few features told of them
FAR = 60.0  # the same where the first explains the modes, and the rest that no element explains is fitted as well
HARDLY = -math.log(0.05)  # the same where no cause is needed: one that is as much less likely is not told


def beside_a_factor(
    bare: Setting, setting: Setting, found: dict[tuple[Change, ...], Fit], prior: Prior
) -> tuple[Setting, dict[tuple[Change, ...], Fit]]:
    """Fit the leading explanations again with the factors throughout and uneven errors that the data ask for.

    Without a cause these may stand for it, and with one may have been hidden; ``bare`` is the setting without any.
    """
    ranked = ranked_by(found, prior)
    leading = ranked[:AGAIN] + [e for e in ranked[AGAIN:] if not e.causes]
    if explains(leading[0].fit):
        asked = _asked_beside(bare, setting, leading[0])
        if asked.inaccuracy.groups == setting.inaccuracy.groups:
            return setting, found
        again = _fitted_again(asked, leading)
        return (asked, again) if again else (setting, found)
    trials = [(setting, found)]  # several causes may stand for what elements are off unevenly
    for e in leading[:1] + [e for e in ranked if len(e.causes) == 1][:1]:
        asked = _asked_beside(bare, setting, e)
        if all(asked.inaccuracy.groups != other.inaccuracy.groups for other, _ in trials):
            trials.append((asked, _fitted_again(asked, [*leading, e])))
    return max((t for t in trials if t[1]), key=lambda t: ranked_by(t[1], prior)[0].log_posterior)


def _asked_beside(bare: Setting, setting: Setting, e: Explanation) -> Setting:
    """The setting with what the data ask for beside the causes of an explanation."""
    f = e.fit
    alone = fit(bare, e.causes, start_in(bare, f), f.u, temperatures=(3.0,)) if e.causes else None
    keep = explains(f) and alone is not None and setting is not bare and f.log_evidence > alone.log_evidence
    if alone is None or keep:
        return setting
    if any(c.scales_all for c in e.causes):  # which stand for one of the mass
        bare = replace(bare, sought=tuple(name for name in bare.sought if name != "mass"))
    return with_more(bare, alone)


def _fitted_again(setting: Setting, explanations: Sequence[Explanation]) -> dict[tuple[Change, ...], Fit]:
    """Explanations in another setting; what explains nothing also from a simulation that is not off."""
    again: dict[tuple[Change, ...], Fit] = {}
    for e in explanations:
        attempt(setting, again, e.causes, e.fit.u, start_in(setting, e.fit), gentle=False)
        if e.causes and not explains(e.fit):
            attempt(setting, again, e.causes, e.fit.u, None)
    return again


def beside_the_rest(
    setting: Setting, found: dict[tuple[Change, ...], Fit], prior: Prior, late: Callable[[], bool]
) -> tuple[Setting, dict[tuple[Change, ...], Fit]]:
    """Fit the leading explanations again, together with the rest that no element explains."""
    ranked = ranked_by(found, prior)
    leading, bare = near_the_first(ranked[:AGAIN], FAR), [e for e in ranked if not e.causes]
    leading = leading if explains(ranked[0].fit) else ranked[:AGAIN]
    singles = [e for e in ranked if len(e.causes) == 1][:2]
    leading += [e for e in bare + singles if all(e is not other for other in leading)]
    some = [*leading[:2], *bare, *singles[:1]]
    new, size = learnt_rest(setting, [e.fit for e in some], [prior.of(e.causes) for e in some])
    if size == 0.0 or late():
        return setting, found
    again: dict[tuple[Change, ...], Fit] = {}
    for e in leading:
        attempt(new, again, e.causes, e.fit.u, without_causes(e.fit), gentle=False)
    return (new, again) if again else (setting, found)


def near_the_first(ranked: Sequence[Explanation], nats: float) -> list[Explanation]:
    """Those hardly less likely than the first, by so many nats at most; by fewer where that needs no cause."""
    nats = nats if ranked[0].causes or not explains(ranked[0].fit) else HARDLY
    return [e for e in ranked if e.log_posterior > ranked[0].log_posterior - nats]


def in_full(
    whole: Setting, few: Setting, explanations: Sequence[Explanation], late: Callable[[], bool]
) -> tuple[Setting, dict[tuple[Change, ...], Fit]]:
    """Fit the leading explanations of a search by ``few`` features again, to the whole of them.

    Beside what the search has learnt of the simulation: what it is off by, and the rest.
    """
    setting = replace(few, features=whole.features, whitener=whole.whitener, rest=0.0)
    best = explanations[0]
    if few.rest:
        setting = with_rest(setting, best.fit, few.rest)
    leading = near_the_first(explanations[:AGAIN], NEAR)
    again: dict[tuple[Change, ...], Fit] = {}
    bare = [e for e in explanations if not e.causes and all(e is not other for other in leading)]
    for e in leading + bare:
        if not (again and late()):
            within = setting if again else replace(setting, late=NEVER)  # what leads is fitted to its end
            attempt(within, again, e.causes, e.fit.u, without_causes(e.fit), gentle=False)
    return setting, again
