r"""From screening to fitted hypotheses: single causes first, then one more at a time and pairs of the leading ones."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from modalax.diagnose.causes.base import Cause, Place
from modalax.diagnose.causes.lines import HumLines, MainsHum
from modalax.diagnose.causes.patterns import PatternCause
from modalax.diagnose.elements import at_places, fit_elements, screen_elements
from modalax.diagnose.evidence import is_element
from modalax.diagnose.fit import ROUNDS, Hypothesis
from modalax.diagnose.screen import Trial, fit_screened, screen_cause, screen_pattern
from modalax.diagnose.state import State, alike, state_of
from modalax.diagnose.study import Study, hum_of

FIRST_ROUNDS = 4
PATIENT = 4 * ROUNDS  # steps of a fit in full: a window and the damping of all modes share a long valley
STARTS = 2  # further starts of the leading trials of each kind
CLOSE = 12.0  # chi-square above the best up to which a hypothesis is fitted in full
PROMISES = 8  # trials of one kind fitted in full where linear nuisances did not let them keep what they promised
SLACK = 0.15  # of what the best explains, that a promise may fall short by and still be worth a look
LOOKED_AT = 48  # trials that get such a look, at most
IN_FULL = 4  # leading hypotheses fitted with the modal parameters in full
A_KIND, LIKELY, ALTOGETHER = 3, 40, 150  # candidates refitted of one kind, of one kind near the best, and in all
STRAYED = 8.0  # claimed standard deviations of a modal parameter beyond which the simulation alone led it astray
FAR = 1e4  # times the largest strength that a cause is screened at, beyond which a fit is no explanation
ONE_SENSOR = 0.97  # share of a mode's energy at one output beyond which it is that sensor's fault


@dataclass(frozen=True)
class Screening:
    """All trials, and the trial directions of each side (all runs together, or apart)."""

    trials: list[Trial]
    theta: np.ndarray

    @property
    def ranked(self) -> list[Trial]:
        """By falling gain."""
        return sorted(self.trials, key=lambda t: -t.gain)


def from_home(study: Study, null: Hypothesis, causes: Sequence[Cause]) -> list[Hypothesis]:
    """Single causes looked for where the simulation has its modes, if what is wrong drove these far off.

    The modes then move in linear order about where the simulation has them; the leading ones are fitted from there too.
    """
    assert null.theta is not None
    if np.abs(null.theta).max(initial=0.0) <= STRAYED:
        return []
    home = study.fit([replace(null, theta=np.zeros_like(null.theta))], 0)[0]
    state = state_of(study, home)
    trials = [t for t in screen_all(study, home, causes, state).trials if t.cause.stage != "lines"]
    found = fit_single(study, replace(home, chi2=home.chi2 - state.drop), chosen(trials), state)
    again = [replace(h, theta=np.zeros_like(null.theta)) for h in found[: 2 * IN_FULL]]
    # what changes all channels and has no size (units) promises nothing until the modes have moved with it
    again += [_start(home, t, t.start) for t in trials if not t.cause.parameters and not t.place.where]
    return best_of_each(found + study.fit(again, PATIENT), study)


def screen_all(study: Study, h: Hypothesis, causes: Sequence[Cause], state: State, finite: bool = True) -> Screening:
    """Screen every cause at every place on what a hypothesis leaves; ``finite`` tries larger sizes of joints too."""
    assert h.theta is not None
    trials: list[Trial] = []
    products: dict[Any, Any] = {}
    for cause in causes:
        side = cause.per_run
        problem, nuisance, _ = study.side(side)
        if isinstance(cause, PatternCause):
            if cause.several and min(problem.channels) < 2:  # nothing else than one
                continue
            trials.append(screen_pattern(cause, study.scene, state.sides[side], problem))
        elif isinstance(cause, MainsHum):
            mains = cause.places(study.scene)
            for place in mains:
                lines, size = hum_of(cause, place, study, state.whole), len(mains)
                if lines.lines.any():
                    start = np.array([lines.amplitude])
                    trials.append(Trial(cause, place, -lines.chi2, np.nan, start, trials=size, extra=lines))
        elif not (places := cause.places(study.scene)):
            continue
        elif is_element(cause) and state.reduced:
            near, key = state.nearest(study, cause, places), alike(places)
            if (side, key) not in products:
                apart = products.setdefault((True, key), at_places(state.reduced[True], near))
                one = study.pooled is study.problem
                products[False, key] = apart if one else at_places(state.reduced[False], near, apart=apart)
            at = products[side, key]
            weight = np.asarray(problem.weight)
            found = screen_elements(cause, study.scene, state.reduced[side], at, near, weight, finite)
            trials += [replace(t, trials=round(t.trials * len(places) / len(near))) for t in found]
        else:
            near = state.nearest(study, cause, places)
            found = screen_cause(cause, study.scene, near, h.theta, state.sides[side], problem, nuisance, True)
            trials += [replace(t, trials=round(t.trials * len(places) / len(near))) for t in found]
    return Screening(trials, h.theta)


def chosen(trials: list[Trial]) -> list[Trial]:
    """Trials worth a fit: the best few of each kind, if they are not hopeless beside the best of all."""
    ranked = sorted((t for t in trials if t.gain > 0), key=lambda t: -t.gain)
    if not ranked:
        return []
    best, count, out = ranked[0].gain, {}, []
    for t in ranked:
        seen = count.get(t.cause, 0)
        if seen < (LIKELY if t.gain > 0.6 * best else A_KIND) and (
            t.gain > 0.15 * best or (seen == 0 and t.gain > 0.02 * best)
        ):
            out.append(t)
            count[t.cause] = seen + 1
    return out[:ALTOGETHER]


def fit_single(study: Study, null: Hypothesis, trials: list[Trial], state: State) -> list[Hypothesis]:
    """Fit each trial alone, from several starts."""
    fine: list[Hypothesis] = []
    for cause in dict.fromkeys(t.cause for t in trials):
        mine = [t for t in trials if t.cause == cause]
        if cause.stage == "lines":
            fine += [with_hum(null, t.extra) for t in mine]
            continue
        starts = [
            _start(null, t, p) for k, t in enumerate(mine) for p in [t.start, *t.starts[: STARTS if k < 4 else 0]]
        ]
        fine += refit(study, null, starts, state)
    fine = best_of_each([h for h in fine if _moderate(h, study)], study)
    if study.nuisance.active and fine:
        # far from the simulation the modal parameters follow in other than linear ways
        close = [h for h in fine if h.causes and h.hum is None and h.chi2 < fine[0].chi2 + CLOSE][:IN_FULL]
        kept = [h for h in fine if not any(h is other for other in close)]
        likely, maybe = _broken_promises(null, trials, fine)
        looked = study.fit(maybe, FIRST_ROUNDS)
        close += likely + [h for h in looked if h.chi2 < fine[0].chi2 + 2 * CLOSE]
        fine = best_of_each(study.fit(close, PATIENT) + looked + kept, study)
    return fine


def _broken_promises(
    null: Hypothesis, trials: list[Trial], fine: list[Hypothesis]
) -> tuple[list[Hypothesis], list[Hypothesis]]:
    """Starts of trials whose fit, with linear nuisances, fell far short of what they promised.

    First those that promised to be among the best, worth a fit in full; then those that did so but for some of what the
    best explains, as promises are linear too: worth a look.
    """
    reached = {(h.causes, h.places): h.chi2 for h in reversed(fine)}
    best, slack = fine[0].chi2 + CLOSE, SLACK * (null.chi2 - fine[0].chi2)
    likely: list[Hypothesis] = []
    maybe: list[Hypothesis] = []
    for t in sorted(trials, key=lambda t: -t.gain):
        promised, found = null.chi2 - t.gain, reached.get(((t.cause,), (t.place,)), np.inf)
        if t.cause.stage == "lines" or promised > best + slack or found < promised + CLOSE:
            continue
        few = promised < best and sum(h.causes == (t.cause,) for h in likely) < PROMISES
        (likely if few else maybe).append(_start(null, t, t.start))
    return likely[: 4 * PROMISES], maybe[:LOOKED_AT]


def refit(study: Study, null: Hypothesis, starts: list[Hypothesis], state: State) -> list[Hypothesis]:
    """Fit hypotheses of one kind, each of one cause."""
    if not starts:
        return []
    cause = starts[0].causes[0]
    if isinstance(cause, PatternCause):
        return [_settle_pattern(study, h) for h in study.fit(starts, ROUNDS)]
    if is_element(cause) and state.reduced:
        found = fit_elements(study, starts, state.reduced[cause.per_run], null, ROUNDS + 6)
    else:
        found = fit_screened(study, starts, state.sides[cause.per_run], null, ROUNDS)
    return [replace(h, theta=h.theta + state.shift) for h in found if h.theta is not None]


def fit_further(study: Study, base: Hypothesis, trials: list[Trial]) -> list[Hypothesis]:
    """Fit ``base`` with each trial added, everything together."""
    found = fit_together(study, [_start(base, t, t.start) for t in trials if t.cause.stage != "lines"])
    found = [h for h in found if _moderate(h, study)]
    if base.hum is None:
        found += [with_hum(base, t.extra) for t in trials if t.cause.stage == "lines"]
    return best_of_each(found, study)


def fit_together(study: Study, starts: list[Hypothesis]) -> list[Hypothesis]:
    """Fit hypotheses in full; where hum is among the causes, to the lines that it leaves alone."""
    hum = starts[0].hum if starts else None
    used = study if hum is None else study.without(hum.lines)
    fine = [_settle_pattern(used, h) for h in used.fit(starts, PATIENT)]
    if hum is None:
        return fine
    out = []
    for h in fine:
        whole = study.residual(h)
        lines = hum_of(MainsHum(), Place((), (round(hum.frequency), -1, 0)), study, whole)
        chi2 = h.chi2 + float((np.abs(whole[:, : len(hum.lines)][:, hum.lines]) ** 2).sum())
        bare = replace(h, chi2=chi2, freedom=h.freedom - hum.freedom, hum=None)
        out.append(with_hum(bare, lines) if lines.lines.any() else bare)
    return out


def exchanged(study: Study, h: Hypothesis, rest: Callable[[Hypothesis], list[Trial]], count: int) -> list[Hypothesis]:
    """Hypotheses with one of several causes taken out and the most promising others put in its place."""
    out: list[Hypothesis] = []
    for j in range(len(h.causes)):
        keep = [k for k in range(len(h.causes)) if k != j]
        pick = lambda items: tuple(items[k] for k in keep)  # noqa: B023, E731
        base = replace(
            h, causes=pick(h.causes), places=pick(h.places), extras=pick(h.extras), params=pick(h.params),
            covariance=None, freedom=0.0,
        )  # fmt: skip
        base = replace(base, freedom=cost_of(base.causes, base.extras) + (h.hum.freedom if h.hum else 0.0))
        base = fit_together(study, [base])[0]
        out += [base, *fit_further(study, base, rest(base)[:count])]
    return out


def _start(base: Hypothesis, trial: Trial, p: np.ndarray) -> Hypothesis:
    low = np.array([q.lower for q in trial.cause.parameters])
    high = np.array([q.upper for q in trial.cause.parameters])
    h = base.with_cause(trial.cause, trial.place, trial.extra, np.clip(p, low, high) if len(low) else p)
    return replace(h, freedom=cost_of(h.causes, h.extras) + (h.hum.freedom if h.hum is not None else 0.0))


def cost_of(causes: Sequence[Cause], extras: Sequence[Any]) -> float:
    """Number of unknowns that causes cost."""
    total = 0.0
    for cause, extra in zip(causes, extras, strict=True):
        if isinstance(cause, PatternCause):
            total += cause.cost(*extra.shape[1:])
        else:
            total += len(cause.parameters) - cause.unseen
    return total


def _settle_pattern(study: Study, h: Hypothesis) -> Hypothesis:
    """Estimate the sizes in the channels again at the fitted shape, and fit again."""
    which = [k for k, c in enumerate(h.causes) if isinstance(c, PatternCause)]
    for _ in range(3):
        if not which or not np.isfinite(h.chi2):
            return h
        before = h.chi2
        for k in which:
            cause = h.causes[k]
            assert isinstance(cause, PatternCause)
            off = np.concatenate([np.zeros(cause.terms), h.params[k][cause.terms :]])
            bare = replace(h, params=(*h.params[:k], off, *h.params[k + 1 :]))
            fixed = _Fixed(cause, h.params[k][cause.terms :])
            side = state_of(study, bare).sides[False]
            t = screen_pattern(fixed, study.scene, side, study.pooled)  # pyright: ignore[reportArgumentType]
            trial = replace(
                h, extras=(*h.extras[:k], t.extra, *h.extras[k + 1 :]),
                params=(*h.params[:k], t.start, *h.params[k + 1 :]),
            )  # fmt: skip
            new = study.fit([trial], FIRST_ROUNDS)[0]
            h = new if new.chi2 < h.chi2 else h
        if before - h.chi2 < 0.1:
            break
    return h


@dataclass
class _Fixed(PatternCause):
    """A pattern cause at one shape."""

    cause: PatternCause
    q: np.ndarray

    @property
    def several(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.cause.several

    @property
    def terms(self) -> int:
        return self.cause.terms

    def shapes(self, scene: Any) -> np.ndarray:
        return self.q[None]

    def curves(self, s: Any, q: Any) -> Any:
        return self.cause.curves(s, q)


def with_hum(h: Hypothesis, lines: HumLines) -> Hypothesis:
    """The same with some lines explained by hum; what was fitted stays."""
    return replace(h, chi2=h.chi2 + lines.chi2, freedom=h.freedom + lines.freedom, hum=lines)


def _sensible(h: Hypothesis, study: Study) -> bool:
    """Whether every cause still means what its name says, and every mode that was added is more than one sensor's."""
    for c, p, extra in zip(h.causes, h.params, h.extras, strict=True):
        if not c.fits(p, study.scene) or (isinstance(c, PatternCause) and _one_sensor(extra, study)):
            return False
    return True


def _moderate(h: Hypothesis, study: Study) -> bool:
    """Whether every strength is within reach of those that the cause is looked for with; no damper of 1e9 N s/m."""
    for cause, place, p in zip(h.causes, h.places, h.params, strict=True):
        if isinstance(cause, PatternCause) or not len(p):
            continue
        key = ("reach", cause, place)
        if key not in study.scene.cache:
            study.scene.cache[key] = float(np.abs(cause.grid(study.scene, place)[:, 0]).max())
        if abs(p[0]) > FAR * study.scene.cache[key]:
            return False
    return True


def _one_sensor(sizes: np.ndarray, study: Study) -> bool:
    """Whether a mode shows at one output and in the noise of the others: no mode of a structure does.

    ``sizes`` has the shape ``(term, o, i)``; they are compared in units of each channel's noise.
    """
    unit = np.asarray(study.pooled.weight)[0].max(axis=0)
    energy = ((np.asarray(sizes) * unit) ** 2).sum(axis=(0, 2))
    live = int((energy > 0).sum())
    return live > 2 and float(energy.max()) > ONE_SENSOR * float(energy.sum())


def best_of_each(hypotheses: list[Hypothesis], study: Study) -> list[Hypothesis]:
    """The best fit of each set of causes and places, by rising chi-square."""
    best: dict[Any, Hypothesis] = {}
    for h in hypotheses:
        if not _sensible(h, study):
            continue
        key = (frozenset(zip(h.causes, h.places, strict=True)), h.hum is None)
        if np.isfinite(h.chi2) and (key not in best or h.chi2 < best[key].chi2):
            best[key] = h
    return sorted(best.values(), key=lambda h: h.chi2)
