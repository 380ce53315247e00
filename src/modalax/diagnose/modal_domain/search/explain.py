r"""Search for causes beyond the general inaccuracy: screening, fits, and the probability of every explanation.

Before the data, half of the probability is that nothing stands out; the rest is shared by kind of cause, then by place.
A second cause is added where it raises the log evidence by more than its low prior probability costs.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from modalax.diagnose.deadline import NEVER, Deadline
from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.fitting.attempts import attempt, explains, key_of, without
from modalax.diagnose.modal_domain.fitting.explanation import Explanation, Prior, ranked_by
from modalax.diagnose.modal_domain.fitting.fit import Fit, Found, fit, without_causes
from modalax.diagnose.modal_domain.fitting.inaccuracy import WITHIN
from modalax.diagnose.modal_domain.fitting.narrowed import DIRECTIONS, narrowed
from modalax.diagnose.modal_domain.fitting.state import Setting
from modalax.diagnose.modal_domain.fitting.throughout import (
    beside_one_factor,
    instead_of_a_gain,
    start_in,
    with_groups,
    with_more,
)
from modalax.diagnose.modal_domain.search.attached_bodies import attached_bodies
from modalax.diagnose.modal_domain.search.oscillators import acting_alike, attached, attached_beside
from modalax.diagnose.modal_domain.search.outlying_elements import outlying_elements
from modalax.diagnose.modal_domain.search.refitted import (
    AGAIN,
    Finer,
    beside_a_factor,
    beside_the_rest,
    from_the_simulation,
    in_full,
    made_exact,
    rest_anew,
)
from modalax.diagnose.modal_domain.search.starts import FITTED, starts
from modalax.diagnose.modal_domain.search.steps import (
    MOST,
    WORTH,
    Search,
    apart,
    fewer,
    further_cause,
    neighbours,
    other_forms,
    settled,
    several,
    with_losses,
)
from modalax.diagnose.modal_domain.search.uneven_element import off_unevenly

UNLIKE = 10.0  # chi-square per feature beside the general inaccuracy from which on a cause is tried before all else
MOSTLY = 0.25  # share of what the simulation leaves, below which a change of the structure explains most of it

Tell = Callable[[str], None]
Enough = Callable[[Setting, list[Explanation]], bool]
# What hypotheses were fitted in, every cause and place there, and the explanations by falling probability.
Searched = tuple[Setting, list[Change], list[Explanation]]


def explain(
    setting: Setting, candidates: list[Change], late: Deadline, tell: Tell = lambda _: None,
    finer: Finer | None = None, enough: Enough | None = None, known: Found | None = None,
) -> Searched:  # fmt: skip
    """Explanations by falling probability, with what they were fitted in; the best so far if interrupted.

    Parameters
    ----------
    late
        Whether time is up; an interrupt ends it.
    tell
        Called with what is being done.
    finer
        The simulation with all its exactness about some places, and the candidates there; None where it has it all.
    enough
        Asked where one cause at most does not explain the modes, whether further ones are not to be looked for.
    known
        Fits of the same features that explain them, which others are looked for beside and in place of.
    """
    start = narrowed(setting) or setting
    few, candidates, explanations = _searched(start, candidates, late, tell, finer, enough, known)
    if few.features is setting.features or not explanations:
        return few, candidates, explanations
    tell("fitting the leading ones to all channels")
    whole, found = in_full(narrowed(setting, DIRECTIONS) or setting, replace(few, late=late), explanations, late)
    if not found:
        return few, candidates, explanations
    search = Search(whole, found, whole, candidates, [c for c in candidates if not c.local])
    if not late() and len(search.best.causes) < MOST:
        further_cause(search, search.best, late)
    return replace(whole, late=NEVER), candidates, search.ranked


def _searched(
    setting: Setting, candidates: list[Change], late: Deadline, tell: Tell, finer: Finer | None,
    enough: Enough | None, known: Found | None,
) -> Searched:  # fmt: skip
    """Explanations by falling probability, by all features of a setting."""
    setting = replace(setting, late=late)
    null = fit(setting, basin=UNLIKE)
    setting, candidates, led = leading(setting, null, candidates, late, tell, finer, known)
    if null is None:  # a simulation of too few modes for those measured is compared without one of them
        search = Search(setting, led or _less_a_mode(setting, candidates), setting, candidates)
        if not search.found:
            return replace(setting, late=NEVER), candidates, []
    else:
        search = Search(setting, led, setting, candidates) if led else _beside_the_null(setting, null, candidates)
    try:
        if not (led or null is None or late()):
            _first_fits(search, late, tell)
            _about_the_leading(search, tell, finer)
        _settled(search, late, finer)
        asked = enough is not None and not late() and not explains(search.best)
        if asked and enough(search.setting, search.ranked):
            return replace(search.setting, late=NEVER), search.candidates, search.ranked
        if not late():
            _all_steps(search, late)
        if not late():
            _without_a_gain(search)
            off_unevenly(search, late)
            outlying_elements(search, late)
            attached_bodies(search, late)
        if late():  # which may have cut the fit of what leads short: others are compared with it
            best = search.best
            attempt(replace(search.setting, late=NEVER), search.found, best.causes, best.u, best, gentle=False)
    except KeyboardInterrupt:
        late.stop()
    return replace(search.setting, late=NEVER), search.candidates, search.ranked


def _beside_the_null(setting: Setting, null: Fit, candidates: list[Change]) -> Search:
    """The search that begins where the general inaccuracy alone stands, with all that the data ask of that."""
    found = fit(setting) if far_off(null) else null
    assert found is not None
    bare, setting = setting, with_more(setting, found)
    if setting is not bare:
        found = fit(setting) or start_in(setting, found)
    setting, first = beside_one_factor(bare, setting, found, candidates, Prior(candidates))
    return Search(setting, first, bare, candidates)


def _first_fits(search: Search, late: Deadline, tell: Tell) -> None:
    """Screen all causes and places, and fit the leading ones."""
    setting, found, candidates = search.setting, search.found, search.candidates
    tell(f"screening {len(candidates)} causes and places")
    trials = list(starts(setting, found[()], candidates, search.prior.each(candidates)))
    tell(f"fitting {len(trials)} of them")
    for cause, u, start in trials:
        if late():
            return
        if not _found(found, cause):
            attempt(setting, found, (cause,), cause.of_size(u), start, gentle=start is None)


def _about_the_leading(search: Search, tell: Tell, finer: Finer | None) -> None:
    """Make a large simulation exact about the places that lead; errors beside them are then asked for again."""
    exact, there, found = made_exact(search.setting, search.candidates, search.found, finer, tell)
    if exact is not search.setting:
        search.setting, search.bare, search.found = exact, exact, found
        search.candidates = search.asked = there


def _settled(search: Search, late: Deadline, finer: Finer | None) -> None:
    """Settle place and form of one cause that explains the modes; in a large simulation whatever the time.

    Few shapes do not tell a place from those beside it, of which one may leave no more than noise.
    """
    if finer is None:
        settled(search, late)
        return
    setting, search.setting = search.setting, replace(search.setting, late=NEVER)
    settled(search, NEVER)
    search.setting = setting


def one_cause(setting: Setting, candidates: list[Change], late: Deadline) -> list[Explanation]:
    """Explanations by at most one cause, by falling probability; empty where the simulation has too few modes."""
    null, prior = fit(setting), Prior(candidates)
    found = _less_a_mode(setting, candidates) if null is None else {(): null}
    for cause, u, start in [] if null is None else starts(setting, null, candidates, prior.each(candidates)):
        if late():
            break
        attempt(setting, found, (cause,), cause.of_size(u), start, gentle=start is None)
    return ranked_by(found, prior) if found else []


def one_more(
    setting: Setting, explanations: Sequence[Explanation], candidates: list[Change], late: Deadline
) -> list[Explanation]:
    """Explanations together with those by a further cause beside the likeliest, by falling probability."""
    search = Search(setting, {key_of(e.causes): e.fit for e in explanations}, setting, candidates)
    further_cause(search, search.best, late)
    return search.ranked


def again(setting: Setting, earlier: Sequence[Explanation], candidates: list[Change]) -> list[Explanation]:
    """The likeliest of earlier explanations and the general inaccuracy alone, fitted to features that have changed."""
    found: Found = {}
    attempt(setting, found, (), np.zeros(0), None)
    best = earlier[0]
    if best.causes and all(replace(c, along="") in candidates for c in best.causes):
        attempt(setting, found, best.causes, best.fit.u, None, gentle=False)
    return ranked_by(found, Prior(candidates)) if found else []


def further(
    setting: Setting, explanations: Sequence[Explanation], candidates: list[Change], cause: Change, u: float
) -> list[Explanation]:
    """Explanations together with those in which a cause joins the likeliest, or takes the place of one of its causes.

    Parameters
    ----------
    u
        Size that it is fitted from.
    """
    found = {key_of(e.causes): e.fit for e in explanations}
    best, own = explanations[0].fit, cause.of_size(u)
    for k in range(len(best.causes)):
        kept = tuple(c for j, c in enumerate(best.causes) if j != k)
        attempt(setting, found, (*kept, cause), np.append(without(best, k), own), without_causes(best), gentle=False)
    if len(best.causes) < MOST:
        attempt(setting, found, (*best.causes, cause), np.append(best.u, own), without_causes(best), gentle=False)
    left = {id(e.fit): e.misfit for e in explanations}
    return [replace(e, misfit=left.get(id(e.fit), e.misfit)) for e in ranked_by(found, Prior(candidates))]


def _less_a_mode(setting: Setting, candidates: list[Change]) -> Found:
    """Fits in which one measured mode is none of the simulation's."""
    found: Found = {}
    for cause in candidates:
        if cause.freed is not None:
            attempt(setting, found, (cause,), np.zeros(cause.count), None)
    return found


def _all_steps(search: Search, late: Deadline) -> None:
    """Seek a further cause and other places beside what was fitted first, as long as there is time."""
    if search.setting.inaccuracy.between_modes:
        from_the_simulation(search.setting, search.found, search.prior)
    attached_bodies(search, late)
    attached(search.setting, search.found, search.candidates, search.prior, late)
    with_losses(search, late)
    several(search, late)
    search.setting, search.found = beside_a_factor(search.bare, search.setting, search.found, search.prior)
    search.setting, search.found = beside_the_rest(search.setting, search.found, search.prior, late)
    _beside(search, late)
    best = search.best
    if not late():
        attached_beside(search.setting, search.found, search.candidates, search.prior, late)
    if search.best is not best:
        search.setting, search.found = rest_anew(search.setting, search.found, search.prior, late)
        _beside(search, late)


def _beside(search: Search, late: Deadline) -> None:
    """Seek a further cause and other places and forms beside what leads."""
    for _ in range(MOST):
        best = search.best
        if late():
            return
        if best.causes:
            fewer(search, best)
            apart(search, best)
            neighbours(search, best, late)
            acting_alike(search.setting, search.found, search.asked, search.prior, late)
            other_forms(search)
            if len(search.best.causes) > 1:  # another form of one cause may do without the others
                fewer(search, search.best)
            best = search.best
        if len(best.causes) >= MOST or not further_cause(search, best, late):
            return
        if len(search.best.causes) == len(best.causes):
            return
        fewer(search, search.best)
        search.setting, search.found = rest_anew(search.setting, search.found, search.prior, late)


def _found(found: Found, cause: Change) -> bool:
    """Whether a cause was fitted from another start, explains the modes, and is likelier than none."""
    f, null = found.get((cause,)), found.get(())
    if f is None or null is None:
        return False
    return f.log_evidence > null.log_evidence + WORTH and explains(f)


def _without_a_gain(search: Search) -> None:
    """Where a gain of all FRFs is left, try factors on all of stiffness and mass in its place."""
    near = search.ranked[:AGAIN]
    other = instead_of_a_gain(search.setting, search.bare, near[0].fit, search.prior)
    if other is None:
        return
    search.setting, found = other[0], {key_of(other[1].causes): other[1]}
    for e in near:
        attempt(search.setting, found, e.causes, e.fit.u, start_in(search.setting, e.fit), gentle=False)
    search.found = found


def far_off(null: Fit) -> bool:
    """Whether the general inaccuracy alone does not come near to the measured modes."""
    return null.chi2 > UNLIKE * null.state.difference.size


def leading(
    setting: Setting, null: Fit | None, candidates: list[Change], late: Deadline, tell: Callable[[str], None],
    finer: Finer | None, known: Found | None = None,
) -> tuple[Setting, list[Change], Found]:  # fmt: skip
    """The leading causes by finite changes, where one of them explains what the inaccuracy is far from; else nothing.

    Others are then looked for beside it and in its place, and no inaccuracy is, that would do without it. So are those
    beside what is ``known`` to explain the modes.
    """
    if known:
        return made_exact(setting, candidates, known if null is None else {(): null, **known}, finer, tell)
    if null is None or not far_off(null):
        return setting, candidates, {}
    prior, found = Prior(candidates), {(): null}
    try:
        tell(f"screening {len(candidates)} causes and places")
        for cause, u, start in islice(starts(setting, null, candidates, prior.each(candidates), far=MOSTLY), FITTED):
            attempt(setting, found, (cause,), cause.of_size(u), start, basin=UNLIKE)
            if late():
                break
        exact, there, found = made_exact(setting, candidates, found, finer, tell)
        best = ranked_by(found, Prior(there))[0]
        if explains(best.fit) and not _unevenly_off(setting, best, prior):
            return exact, there, found
    except KeyboardInterrupt:
        late.stop()
    return setting, candidates, {}


def _unevenly_off(setting: Setting, best: Explanation, prior: Prior) -> bool:
    """Whether elements that are off unevenly, as parallel members of two kinds are, are likelier than what leads."""
    least = best.log_posterior - prior.of(())
    for name in setting.sought if setting.uneven and best.causes else ():
        wider = with_groups(setting, (WITHIN[name],))
        found = None if wider is None else fit(wider, best_else=least, basin=UNLIKE)
        if found is not None and explains(found) and found.log_evidence > least:
            return True
    return False
