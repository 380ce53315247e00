r"""Search for causes beyond the general inaccuracy: screening, fits, and the probability of every explanation.

Before the data, half of the probability is that nothing stands out; the rest is shared by kind of cause, then by place.
A second cause is added where it raises the log evidence by more than its low prior probability costs.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from modalax.diagnose.deadline import NEVER, Deadline
from modalax.diagnose.modal_domain.attached import acting_alike, attached
from modalax.diagnose.modal_domain.attempts import attempt, explains, key_of, possible, without
from modalax.diagnose.modal_domain.causes import Change, own_sizes
from modalax.diagnose.modal_domain.damped_along import damped_along
from modalax.diagnose.modal_domain.exact_places import Finer, Found, made_exact
from modalax.diagnose.modal_domain.explanation import Explanation, ranked_by
from modalax.diagnose.modal_domain.far_off import UNLIKE, far_off, leading
from modalax.diagnose.modal_domain.fit import Fit, fit, without_causes
from modalax.diagnose.modal_domain.force_places import JOINTS, as_limits, losses_at
from modalax.diagnose.modal_domain.narrowed import DIRECTIONS, narrowed
from modalax.diagnose.modal_domain.prior import SECOND, Prior
from modalax.diagnose.modal_domain.refitted import AGAIN, beside_a_factor, beside_the_rest, in_full
from modalax.diagnose.modal_domain.screen import about, narrower, replaced, scores
from modalax.diagnose.modal_domain.starts import FITTED, NEXT, as_signs, starts
from modalax.diagnose.modal_domain.state import Setting
from modalax.diagnose.modal_domain.throughout import (
    beside_one_factor,
    instead_of_a_gain,
    start_in,
    with_more,
)
from modalax.diagnose.thresholds import THRESHOLDS

NEAR = 12.0  # nats behind the best up to which other places are fitted
WORTH = 4.0  # nats that a further cause must promise beyond the cost of its prior probability
MOST = 2  # causes in one answer
MANY, CHAINS = 4, 2  # the same where the inaccuracy would be far from usual, and first causes that others are added to
FAR = 3.0  # times as large as usual from which on an inaccuracy of stiffness or mass is far from it
JOINED = "joint_stiffness", "local_damper"  # what a joint may be taken for
PROMISING = 10.0  # times the misfit of the best explanation up to which one is worth a further cause beside it
LOSS = 0.3  # strength of a joint's loss that is fitted from, over the usual one


Tell = Callable[[str], None]
# What hypotheses were fitted in, every cause and place there, and the explanations by falling probability.
Searched = tuple[Setting, list[Change], list[Explanation]]


@dataclass
class _Search:
    """What a search has found so far; ``bare`` is the setting with errors of single elements alone."""

    setting: Setting
    found: Found
    bare: Setting
    candidates: list[Change]

    @property
    def prior(self) -> Prior:
        """What is as likely before the data, of the candidates."""
        return Prior(self.candidates)


def explain(
    setting: Setting, candidates: list[Change], late: Deadline, tell: Tell = lambda _: None, finer: Finer | None = None
) -> Searched:
    """Explanations by falling probability, with what they were fitted in; the best so far if interrupted.

    Parameters
    ----------
    late
        Whether time is up; an interrupt ends it.
    tell
        Called with what is being done.
    finer
        The simulation with all its exactness about some places, and the candidates there; None where it has it all.
    """
    few, candidates, explanations = _searched(narrowed(setting) or setting, candidates, late, tell, finer)
    if few.features is setting.features or not explanations:
        return few, candidates, explanations
    tell("fitting the leading ones to all channels")
    prior = Prior(candidates)
    whole, found = in_full(narrowed(setting, DIRECTIONS) or setting, replace(few, late=late), explanations, late)
    if not found:
        return few, candidates, explanations
    best = ranked_by(found, prior)[0].fit
    if not late() and len(best.causes) < MOST:
        _further(whole, found, best, [c for c in candidates if not c.local], prior, late)
    return replace(whole, late=NEVER), candidates, ranked_by(found, prior)


def _searched(setting: Setting, candidates: list[Change], late: Deadline, tell: Tell, finer: Finer | None) -> Searched:
    """Explanations by falling probability, by all features of a setting."""
    setting = replace(setting, late=late)
    null = fit(setting, basin=UNLIKE)
    setting, candidates, led = leading(setting, null, candidates, late, tell, finer)
    if null is None:  # a simulation of too few modes for those measured is compared without one of them
        search = _Search(setting, _less_a_mode(setting, candidates), setting, candidates)
        if not search.found:
            return replace(setting, late=NEVER), candidates, []
    else:
        search = _Search(setting, led, setting, candidates) if led else _beside_the_null(setting, null, candidates)
    try:
        if not (led or null is None or late()):
            _first_fits(search, late, tell)
            _about_the_leading(search, late, tell, finer)
        if not late():
            _all_steps(search, late)
        if not late():
            _without_a_gain(search)
    except KeyboardInterrupt:
        late.stop()
    return replace(search.setting, late=NEVER), search.candidates, ranked_by(search.found, search.prior)


def _beside_the_null(setting: Setting, null: Fit, candidates: list[Change]) -> _Search:
    """The search that begins where the general inaccuracy alone stands, with all that the data ask of that."""
    found = fit(setting) if far_off(null) else null
    assert found is not None
    bare, setting = setting, with_more(setting, found)
    if setting is not bare:
        found = fit(setting) or start_in(setting, found)
    setting, first = beside_one_factor(bare, setting, found, candidates, Prior(candidates))
    return _Search(setting, first, bare, candidates)


def _first_fits(search: _Search, late: Deadline, tell: Tell) -> None:
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


def _about_the_leading(search: _Search, late: Deadline, tell: Tell, finer: Finer | None) -> None:
    """Make a large simulation exact about the places that lead; errors beside them are then asked for again."""
    exact, there, found = made_exact(search.setting, search.candidates, search.found, None if late() else finer, tell)
    if exact is not search.setting:
        search.setting, search.bare, search.candidates, search.found = exact, exact, there, found


def one_cause(setting: Setting, candidates: list[Change], late: Deadline) -> list[Explanation]:
    """Explanations by at most one cause, by falling probability; empty where the simulation has too few modes."""
    null, prior = fit(setting), Prior(candidates)
    found = _less_a_mode(setting, candidates) if null is None else {(): null}
    for cause, u, start in [] if null is None else starts(setting, null, candidates, prior.each(candidates)):
        if late():
            break
        attempt(setting, found, (cause,), cause.of_size(u), start, gentle=start is None)
    return ranked_by(found, prior) if found else []


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


def _all_steps(search: _Search, late: Deadline) -> None:
    """Seek a further cause and other places beside what was fitted first, as long as there is time."""
    setting, found, candidates, prior = search.setting, search.found, search.candidates, search.prior
    attached(setting, found, candidates, prior, late)
    candidates = _with_losses(setting, found, candidates, prior, late)
    _several(setting, found, candidates, prior, late)
    search.setting, search.found = setting, found = beside_a_factor(search.bare, setting, found, prior)
    search.setting, search.found = setting, found = beside_the_rest(setting, found, prior, late)
    for _ in range(MOST):
        best = ranked_by(found, prior)[0]
        if late():
            return
        if best.causes:
            _fewer(setting, found, best.fit)
            _apart(setting, found, best.fit, candidates)
            _neighbours(setting, found, best.fit, candidates, prior, late)
            acting_alike(setting, found, candidates, prior, late)
            _other_forms(setting, found, candidates, prior)
            best = ranked_by(found, prior)[0]
            if len(best.causes) > 1:  # another form of one cause may do without the others
                _fewer(setting, found, best.fit)
                best = ranked_by(found, prior)[0]
        if len(best.causes) >= MOST or not _further(setting, found, best.fit, candidates, prior, late):
            return
        if len(ranked_by(found, prior)[0].causes) == len(best.causes):
            return
        _fewer(setting, found, ranked_by(found, prior)[0].fit)
        search.setting, search.found = setting, found = beside_the_rest(setting, found, prior, late)


def _found(found: Found, cause: Change) -> bool:
    """Whether a cause was fitted from another start, explains the modes, and is likelier than none."""
    f, null = found.get((cause,)), found.get(())
    if f is None or null is None:
        return False
    return f.log_evidence > null.log_evidence + WORTH and explains(f)


def _with_losses(
    setting: Setting, found: Found, candidates: list[Change], prior: Prior,
    late: Callable[[], bool],
) -> list[Change]:  # fmt: skip
    """Candidates, and losses of a joint where one leads and they were not looked for; these are fitted at once.

    A joint that nobody knew of is seldom a spring or damper alone, and while it is taken for one nothing else shows.
    Beside one that leaves no more than noise they are fitted too: few modes tell one law from another, and dampings
    that are off in general hide that a spring loses energy.
    """
    ranked = ranked_by(found, prior)
    noise, first = ranked[0].misfit < THRESHOLDS.as_noise, ranked[0].causes
    if noise and not (len(first) == 1 and first[0].slug in (*JOINED, *JOINTS)):
        return candidates
    explained, every, seen = explains(ranked[0].fit), list(candidates), set()
    singles = [e for e in ranked if len(e.causes) == 1]
    leads = [e for some in (JOINED, JOINTS) for e in [e for e in singles if e.causes[0].slug in some][:CHAINS]]
    leads = ranked[:1] if noise else leads
    for e in leads:
        place = e.causes[0].where
        spring = next((c for c in candidates if c.slug == "joint_stiffness" and c.where == place), None)
        behind = e.misfit > (1.0 if explained else PROMISING) * ranked[0].misfit
        if spring is None or spring.direction is None or place in seen or behind:
            continue
        seen.add(place)
        for loss in losses_at(spring, candidates, setting.coordinates):
            known = loss in candidates
            every += [] if known else [loss]
            u = np.full(loss.count, LOSS) * (np.arange(loss.count) == 0)
            stiff = e.fit.u if e.causes[0] == spring else spring.of_size(LOSS)
            alone = [] if known and loss.screened else [((loss,), u)]
            both = [] if explained else [((spring, loss), np.concatenate([stiff, u]))]
            for causes, sizes in alone + both:
                if not late():
                    attempt(setting, found, causes, sizes, without_causes(e.fit))
    return every


def _several(
    setting: Setting, found: Found, candidates: list[Change], prior: Prior,
    late: Callable[[], bool],
) -> None:  # fmt: skip
    """Add one cause after the other where all elements would be far more off than usual.

    Of several things that are wrong each one alone explains little beside what is learnt of all elements; they show
    where the inaccuracy is held to its usual size until they are found.
    """
    ranked, usual = ranked_by(found, prior), setting.inaccuracy.usual
    matrices = np.isin(setting.inaccuracy.groups, ("stiffness", "mass"))
    if not (ranked[0].fit.epsilon > FAR * usual)[matrices].any():
        return
    for e in [e for e in ranked if len(e.causes) == 1 and e.causes[0].local][:CHAINS]:
        f = e.fit
        while len(f.causes) < MANY and not late():
            held, at = replace(f, epsilon=np.minimum(f.epsilon, usual)), about(setting, f, candidates)
            value = scores(setting, held, at)[0] + prior.each(candidates) + math.log(SECOND)
            value[[k for k, c in enumerate(candidates) if c in f.causes or c.shares_place(f.causes)]] = -np.inf
            if value.max() < WORTH:
                break
            cause = candidates[int(np.argmax(value))]
            u = np.append(f.u, cause.of_size(0.0))
            wider = fit(setting, (*f.causes, cause), without_causes(held), u, temperatures=(3.0,))
            if wider is None or not possible(wider):
                break
            f, key = wider, key_of((*f.causes, cause))
            if key not in found or f.log_evidence > found[key].log_evidence:
                found[key] = f


def _without_a_gain(search: _Search) -> None:
    """Where a gain of all FRFs is left, try factors on all of stiffness and mass in its place."""
    near = ranked_by(search.found, search.prior)[:AGAIN]
    other = instead_of_a_gain(search.setting, search.bare, near[0].fit, search.prior)
    if other is None:
        return
    search.setting, found = other[0], {key_of(other[1].causes): other[1]}
    for e in near:
        attempt(search.setting, found, e.causes, e.fit.u, start_in(search.setting, e.fit), gentle=False)
    search.found = found


def _fewer(setting: Setting, found: Found, best: Fit) -> None:
    """Fit the best explanation without each of its causes, starting from its own sizes."""
    for k in range(len(best.causes)):
        kept = tuple(c for j, c in enumerate(best.causes) if j != k)
        attempt(setting, found, kept, without(best, k), without_causes(best), gentle=False)


def _apart(setting: Setting, found: Found, best: Fit, candidates: list[Change]) -> None:
    """Fit what is told at several places as a cause of its own at each."""
    for k, together in enumerate(best.causes):
        each = [c for name in together.told_as for c in candidates if c.told_as == (name,) and not c.absent]
        others = tuple(c for j, c in enumerate(best.causes) if j != k)
        if 1 < len(each) <= MANY - len(others) and len(each) == len(together.told_as):
            sizes = [c.of_size(together.size(best.u[own_sizes(best.causes, k)]) * c.whole / c.scale) for c in each]
            u = np.concatenate([without(best, k), *sizes])
            attempt(setting, found, (*others, *each), u, without_causes(best), gentle=False)


def _neighbours(
    setting: Setting, found: Found, best: Fit, candidates: list[Change], prior: Prior,
    late: Callable[[], bool],
) -> None:  # fmt: skip
    """Replace each cause of the best explanation by other places and kinds, screened about that explanation."""
    at = about(setting, best, candidates)
    for k in range(len(best.causes)):
        kept = tuple(c for j, c in enumerate(best.causes) if j != k)
        gain, size = replaced(setting, best, k, at)
        value = gain + prior.each(candidates)
        for j in np.argsort(-value)[: FITTED + NEXT]:
            causes = (*kept, candidates[j])
            known = any(set(key) == set(causes) and len(key) == len(causes) for key in found)
            known = known or candidates[j] in kept or candidates[j].shares_place(kept)
            if late():
                return
            if known or not value[j] > max(value.max() - NEAR, -np.inf):
                continue
            u = np.append(without(best, k), candidates[j].of_size(float(np.clip(size[j], -3, 3))))
            attempt(setting, found, causes, u, without_causes(best), gentle=False)


def _further(
    setting: Setting, found: Found, best: Fit, candidates: list[Change], prior: Prior,
    late: Callable[[], bool],
) -> bool:  # fmt: skip
    """Add a cause where one promises enough log evidence; whether one was tried.

    A second cause, too, may hide in the inaccuracy, and show once that is held to its usual size, or to less.
    """
    share = prior.each(candidates) + math.log(SECOND)
    usual = replace(best, epsilon=np.minimum(best.epsilon, setting.inaccuracy.usual))

    def promising(gain: np.ndarray, least: float) -> list[int]:
        new = [int(j) for j in np.argsort(-(gain + share))[:NEXT] if candidates[j] not in best.causes]
        return [j for j in new if gain[j] + share[j] > least and not candidates[j].shares_place(best.causes)]

    at = about(setting, best, candidates)
    screened = [scores(setting, f, at)[0] for f in (best, usual)]
    starts_of = {j: best for gain in screened for j in promising(gain, WORTH - math.log(10))}
    gain, which, narrow = narrower(setting, best, at)
    starts_of |= {j: narrow[which[j]] for j in promising(gain, WORTH)}
    for j, f in starts_of.items():
        if late():
            break
        u = np.append(best.u, candidates[j].of_size(0.0))
        attempt(setting, found, (*best.causes, candidates[j]), u, without_causes(f), gentle=False)
    return bool(starts_of)


def _other_forms(
    setting: Setting, found: Found, candidates: list[Change], prior: Prior
) -> None:  # fmt: skip
    """Fit the leading explanations with damping that goes with a cause, signs in place of gains, and simpler joints."""
    ranked = ranked_by(found, prior)
    near = [e.fit for e in ranked[:AGAIN] if e.log_posterior > ranked[0].log_posterior - NEAR]
    limits = as_limits(near, candidates)
    for causes, u, start in (*as_signs(near, candidates), *limits):
        attempt(setting, found, causes, u, start, gentle=start is None)
    # a joint that loses energy may be a spring with damping along: what that leaves tells, not what the spring does
    simple = [found[key] for key in dict.fromkeys(key_of(causes) for causes, _, _ in limits) if key in found]
    for causes, u, start in damped_along(setting, near + simple):
        attempt(setting, found, causes, u, start, gentle=False)
