"""Steps of a search for explanations: further causes, fewer of them, other places and forms beside what leads."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from modalax.diagnose.modal_domain.causes.change import Change, own_sizes, with_sizes
from modalax.diagnose.modal_domain.fitting.attempts import attempt, explains, key_of, possible, without
from modalax.diagnose.modal_domain.fitting.explanation import SECOND, Explanation, Prior, ranked_by
from modalax.diagnose.modal_domain.fitting.fit import Fit, Found, fit, without_causes
from modalax.diagnose.modal_domain.fitting.state import Setting
from modalax.diagnose.modal_domain.search.damped_along import damped_along
from modalax.diagnose.modal_domain.search.force_places import JOINTS, as_limits, losses_at
from modalax.diagnose.modal_domain.search.refitted import AGAIN
from modalax.diagnose.modal_domain.search.screen import About, about, narrower, replaced, scores
from modalax.diagnose.modal_domain.search.starts import FITTED, NEXT, as_alike, as_signs
from modalax.diagnose.thresholds import THRESHOLDS

NEAR = 12.0  # nats behind the best up to which other places are fitted
WORTH = 4.0  # nats that a further cause must promise beyond the cost of its prior probability
MOST = 2  # causes in one answer
MOVES = 2  # times that the place of a cause that explains the modes by itself may change before others are sought
MANY, CHAINS = 4, 2  # the same where the inaccuracy would be far from usual, and first causes that others are added to
FAR = 3.0  # times as large as usual from which on an inaccuracy of stiffness or mass is far from it
JOINED = "joint_stiffness", "local_damper"  # what a joint may be taken for
PROMISING = 10.0  # times the misfit of the best explanation up to which one is worth a further cause beside it
LOSS = 0.3  # strength of a joint's loss that is fitted from, over the usual one

Late = Callable[[], bool]  # whether time is up


@dataclass
class Search:
    """What a search has found so far.

    Attributes
    ----------
    setting, found
        What explanations are fitted in, and the likeliest fit of each.
    bare
        The setting with errors of single elements alone.
    candidates
        Every cause and place, among which the prior probability is shared.
    asked
        What is screened: these, some of them, or further losses at places of joints that lead.
    """

    setting: Setting
    found: Found
    bare: Setting
    candidates: list[Change]
    asked: list[Change] = field(default_factory=list)
    _seen: tuple[Setting, list[Change], Fit, About] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        self.asked = self.asked or self.candidates

    @property
    def prior(self) -> Prior:
        """What is as likely before the data, of the candidates."""
        return Prior(self.candidates)

    @property
    def ranked(self) -> list[Explanation]:
        """Explanations by falling probability."""
        return ranked_by(self.found, self.prior)

    @property
    def best(self) -> Fit:
        """The fit of the likeliest explanation."""
        return self.ranked[0].fit

    def about(self, f: Fit) -> About:
        """What all that is asked does beside a fit; the last is remembered, as several steps ask about the same fit."""
        key = self.setting, self.asked, f
        if self._seen is None or any(a is not b for a, b in zip(key, self._seen, strict=False)):
            self._seen = *key, about(self.setting, f, self.asked)
        return self._seen[-1]

    def fit(self, causes: tuple[Change, ...], u: np.ndarray, start: Fit | None) -> None:
        """Fit causes from sizes ``u`` and a start, gently from the simulation as it is, and keep what is likelier."""
        attempt(self.setting, self.found, causes, u, start, gentle=start is None)


def fewer(search: Search, best: Fit) -> None:
    """Fit the best explanation without each of its causes, starting from its own sizes."""
    for k in range(len(best.causes)):
        search.fit(_others(best, k), without(best, k), without_causes(best))


def apart(search: Search, best: Fit) -> None:
    """Fit what is told at several places as a cause of its own at each."""
    for k, together in enumerate(best.causes):
        each = [c for name in together.told_as for c in search.asked if c.told_as == (name,) and not c.absent]
        others = _others(best, k)
        if 1 < len(each) <= MANY - len(others) and len(each) == len(together.told_as):
            sizes = [c.of_size(together.size(best.u[own_sizes(best.causes, k)]) * c.whole / c.scale) for c in each]
            search.fit((*others, *each), np.concatenate([without(best, k), *sizes]), without_causes(best))


def neighbours(search: Search, best: Fit, late: Late) -> None:
    """Replace each cause of the best explanation by other places and kinds, screened about that explanation."""
    at, share, candidates = search.about(best), search.prior.each(search.asked), search.asked
    for k in range(len(best.causes)):
        kept = _others(best, k)
        gain, size = replaced(search.setting, best, k, at)
        value = gain + share
        for j in np.argsort(-value)[: FITTED + NEXT]:
            causes = (*kept, candidates[j])
            known = any(set(key) == set(causes) and len(key) == len(causes) for key in search.found)
            known = known or candidates[j] in kept or candidates[j].shares_place(kept)
            if late():
                return
            if known or not value[j] > value.max() - NEAR:
                continue
            u = np.append(without(best, k), candidates[j].of_size(float(np.clip(size[j], -3, 3))))
            search.fit(causes, u, without_causes(best))


def other_forms(search: Search) -> None:
    """Fit the leading explanations with damping that goes with a cause, signs in place of gains, and simpler causes."""
    ranked, found = search.ranked, search.found
    near = [e.fit for e in ranked[:AGAIN] if e.log_posterior > ranked[0].log_posterior - NEAR]
    limits = [*as_alike(near, search.asked), *as_limits(near, search.asked)]
    for causes, u, start in (*as_signs(near, search.asked), *limits):
        search.fit(causes, u, start)
    # a joint that loses energy may be a spring with damping along: what that leaves tells, not what the spring does
    simple = [found[key] for key in dict.fromkeys(key_of(causes) for causes, _, _ in limits) if key in found]
    for causes, u, start in damped_along(search.setting, near + simple):
        search.fit(causes, u, start)


def settled(search: Search, late: Late) -> None:
    """Where one cause explains the modes, look for its place and form before anything is sought beside it.

    What a cause leaves at a neighbour's place, or without the damping that goes along, looks like a second one.
    """
    for _ in range(MOVES):
        best = search.best
        if late() or len(best.causes) != 1 or not explains(best):
            return
        neighbours(search, best, late)
        other_forms(search)
        now = search.best
        if len(now.causes) != 1 or now.causes[0].where == best.causes[0].where:
            return


def further_cause(search: Search, best: Fit, late: Late) -> bool:
    """Add a cause where one promises enough log evidence; whether one was tried.

    A second cause, too, may hide in the inaccuracy, and show once that is held to its usual size, or to less.
    """
    setting, candidates = search.setting, search.asked
    share = search.prior.each(candidates) + math.log(SECOND)
    usual = replace(best, epsilon=np.minimum(best.epsilon, setting.inaccuracy.usual))

    def promising(gain: np.ndarray, least: float) -> list[int]:
        new = [int(j) for j in np.argsort(-(gain + share))[:NEXT] if candidates[j] not in best.causes]
        return [j for j in new if gain[j] + share[j] > least and not candidates[j].shares_place(best.causes)]

    at = search.about(best)
    screened = [scores(setting, f, at)[0] for f in (best, usual)]
    starts_of = {j: best for gain in screened for j in promising(gain, WORTH - math.log(10))}
    gain, which, narrow = narrower(setting, best, at)
    starts_of |= {j: narrow[which[j]] for j in promising(gain, WORTH)}
    for j, f in starts_of.items():
        if late():
            break
        u = np.append(best.u, candidates[j].of_size(0.0))
        search.fit((*best.causes, candidates[j]), u, without_causes(f))
        if setting.inaccuracy.between_modes and candidates[j].in_channels:
            _drop_usual(search, (*best.causes, candidates[j]))
    return bool(starts_of)


def _drop_usual(search: Search, causes: tuple[Change, ...]) -> None:
    """Drop an explanation that adds an error of a channel no larger than is usual: shapes at a DoF are off by as much.

    Without elements these have no other name.
    """
    f = search.found.get(key_of(causes))
    sizes = [] if f is None else [abs(c.size(u)) for c, u in with_sizes(f.causes, f.u) if c == causes[-1] and c.sized]
    if any(size < THRESHOLDS.calibration for size in sizes):
        del search.found[key_of(causes)]


def with_losses(search: Search, late: Late) -> None:
    """Ask for losses of a joint, too, where one leads and they were not looked for; these are fitted at once.

    A joint that nobody knew of is seldom a spring or damper alone, and while it is taken for one nothing else shows.
    Beside one that leaves no more than noise they are fitted too: few modes tell one law from another, and dampings
    that are off in general hide that a spring loses energy.
    """
    ranked, candidates, setting = search.ranked, search.candidates, search.setting
    noise, first = ranked[0].misfit < THRESHOLDS.as_noise, ranked[0].causes
    if noise and not (len(first) == 1 and first[0].slug in (*JOINED, *JOINTS)):
        return
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
                    attempt(setting, search.found, causes, sizes, without_causes(e.fit))
    search.asked = every


def several(search: Search, late: Late) -> None:
    """Add one cause after the other where all elements would be far more off than usual.

    Of several things that are wrong each one alone explains little beside what is learnt of all elements; they show
    where the inaccuracy is held to its usual size until they are found.
    """
    setting, found, candidates = search.setting, search.found, search.asked
    ranked, usual = search.ranked, setting.inaccuracy.usual
    matrices = np.isin(setting.inaccuracy.groups, ("stiffness", "mass"))
    if not (ranked[0].fit.epsilon > FAR * usual)[matrices].any():
        return
    for e in [e for e in ranked if len(e.causes) == 1 and e.causes[0].local][:CHAINS]:
        f = e.fit
        while len(f.causes) < MANY and not late():
            held, at = replace(f, epsilon=np.minimum(f.epsilon, usual)), search.about(f)
            value = scores(setting, held, at)[0] + search.prior.each(candidates) + math.log(SECOND)
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


def _others(f: Fit, which: int) -> tuple[Change, ...]:
    """The causes of a fit but one."""
    return f.causes[:which] + f.causes[which + 1 :]
