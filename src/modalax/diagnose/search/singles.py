"""From screening to fitted hypotheses of one cause each."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from modalax.diagnose.causes.base import Cause, ElementCause, PatternCause
from modalax.diagnose.causes.joints import FRACTIONS
from modalax.diagnose.decision.beliefs import believed
from modalax.diagnose.fitting.gauss_newton import ROUNDS
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.screening.every_cause import chosen, screen_all
from modalax.diagnose.screening.local_elements import fit_elements
from modalax.diagnose.screening.score_state import ScoreState, score_state_of
from modalax.diagnose.screening.screen import Trial, fit_screened
from modalax.diagnose.search.candidates import best_of_each, moderate, start_from, with_hum
from modalax.diagnose.search.pattern_sizes import FIRST_ROUNDS, settle_pattern

SIZES = (0.6, 1.0, 1.6)  # stiffness of the joint over the drift seen
PATIENT = 4 * ROUNDS  # steps of a fit in full: a window and the damping of all modes share a long valley
STARTS = 2  # further starts of the leading trials of each kind
CLOSE = 12.0  # chi-square above the best up to which a hypothesis is fitted in full
PROMISES = 8  # trials of one kind fitted in full where the fit with linear nuisances fell short of the screening
SLACK = 0.15  # share of the best explanation by which the screening of such a trial may be lower
LOOKED_AT = 48  # most trials that get such a fit
IN_FULL = 4  # leading hypotheses fitted with the modal parameters in full
STRAYED = (
    8.0  # claimed standard deviations of a modal parameter beyond which fitting the simulation alone is not trusted
)


def from_nominal_modes(look: ScoreState, causes: Sequence[Cause]) -> list[Hypothesis]:
    """Look for single causes about the modes of the simulation, if fitting it alone drove its modes far off.

    The modes then move in linear order about their nominal values; the leading causes are fitted from there too.

    Parameters
    ----------
    look
        The simulation alone, its modal parameters adapted, and its residual.
    causes
        What to look for.
    """
    comparison, null = look.comparison, look.hypothesis
    assert null.theta is not None
    if np.abs(null.theta).max(initial=0.0) <= STRAYED or comparison.late():
        return []
    nominal = comparison.fit([replace(null, theta=np.zeros_like(null.theta))], 0)[0]
    state = score_state_of(comparison, nominal)
    trials = [t for t in screen_all(state, causes).trials if not t.cause.leaves_out_lines]
    moved = replace(nominal, chi2=nominal.chi2 - state.drop)
    found = fit_single(replace(state, hypothesis=moved), chosen(trials))
    again = [replace(h, theta=np.zeros_like(null.theta)) for h in found[: 2 * IN_FULL]]
    # what changes all channels and has no size (units) promises nothing until the modes have moved with it
    again += [start_from(nominal, t, t.start) for t in trials if not t.cause.parameters and not t.place.where]
    return best_of_each(found + comparison.fit(again, PATIENT), comparison)


def fit_single(state: ScoreState, trials: list[Trial]) -> list[Hypothesis]:
    """Fit each trial alone, from several starts.

    Kinds that promise more come first, of those that promise alike the usual ones, as time may be up before the last.

    Parameters
    ----------
    state
        The simulation alone, and its residual.
    trials
        Causes at places, the best first.
    """
    comparison, null = state.comparison, state.hypothesis
    fine: list[Hypothesis] = []
    by_promise = sorted(trials, key=lambda t: -(t.gain + 2 * np.log(t.cause.prior) + 2 * believed(t.cause.slug)))
    for cause in dict.fromkeys(t.cause for t in by_promise):
        if fine and comparison.late():
            break
        mine = [t for t in trials if t.cause == cause]
        if cause.leaves_out_lines:
            fine += [with_hum(null, t.extra) for t in mine]
            continue
        starts = [
            start_from(null, t, p) for k, t in enumerate(mine) for p in [t.start, *t.starts[: STARTS if k < 4 else 0]]
        ]
        fine += refit(state, starts)
    fine = best_of_each([h for h in fine if moderate(h, comparison)], comparison)
    if comparison.nuisance.active and fine and not comparison.late():
        # far from the simulation the modal parameters follow in other than linear ways
        close = [h for h in fine if h.causes and h.hum is None and h.chi2 < fine[0].chi2 + CLOSE][:IN_FULL]
        kept = [h for h in fine if not any(h is other for other in close)]
        likely, maybe = _broken_promises(null, trials, fine)
        looked = comparison.fit(maybe, FIRST_ROUNDS)
        close += likely + [h for h in looked if h.chi2 < fine[0].chi2 + 2 * CLOSE]
        fine = best_of_each(comparison.fit(close, PATIENT) + looked + kept, comparison)
    return fine


def _broken_promises(
    null: Hypothesis, trials: list[Trial], fine: list[Hypothesis]
) -> tuple[list[Hypothesis], list[Hypothesis]]:
    """Starts of trials whose fit with linear nuisances fell far short of what the screening promised.

    First those that promised to be among the best, which are fitted in full; then those that promised a little less,
    which are fitted in a few steps, because the screening is linear too.
    """
    reached = {(h.causes, h.places): h.chi2 for h in reversed(fine)}
    best, slack = fine[0].chi2 + CLOSE, SLACK * (null.chi2 - fine[0].chi2)
    likely: list[Hypothesis] = []
    maybe: list[Hypothesis] = []
    for t in sorted(trials, key=lambda t: -t.gain):
        promised, found = null.chi2 - t.gain, reached.get(((t.cause,), (t.place,)), np.inf)
        if t.cause.leaves_out_lines or promised > best + slack or found < promised + CLOSE:
            continue
        few = promised < best and sum(h.causes == (t.cause,) for h in likely) < PROMISES
        (likely if few else maybe).append(start_from(null, t, t.start))
    return likely[: 4 * PROMISES], maybe[:LOOKED_AT]


def refit(state: ScoreState, starts: list[Hypothesis]) -> list[Hypothesis]:
    """Fit hypotheses that all have a single cause of the same kind.

    Parameters
    ----------
    state
        The simulation alone, and its residual.
    starts
        Hypotheses with the parameters to start from.
    """
    if not starts:
        return []
    comparison, null, cause = state.comparison, state.hypothesis, starts[0].causes[0]
    if isinstance(cause, PatternCause):
        return [settle_pattern(comparison, h) for h in comparison.fit(starts, ROUNDS)]
    if isinstance(cause, ElementCause) and state.reduced:
        found = fit_elements(comparison, starts, state.reduced[cause.per_run], null, ROUNDS + 6)
    else:
        found = fit_screened(comparison, starts, state.sides[cause.per_run], null, ROUNDS)
    return [replace(h, theta=h.theta + state.shift) for h in found if h.theta is not None]


def joints_for_drifts(state: ScoreState, found: Sequence[Hypothesis], causes: Sequence[Cause]) -> list[Hypothesis]:
    """Fit joints of stiffness and threshold where the leading hypothesis is one spring that drifts.

    A joint that is stiff at one level and lets go at the next is far from any small size that it is screened at.

    Parameters
    ----------
    state
        The simulation alone, and its residual.
    found
        Fitted hypotheses, the best first.
    causes
        What to look for.
    """
    if not found or not found[0].causes or not found[0].causes[0].drifts or state.comparison.late():
        return []
    scene = state.comparison.scene
    at, drift = found[0].places[0].index, abs(float(found[0].params[0][0]))
    laws = [c for c in causes if c.has_threshold]
    out: list[Hypothesis] = []
    for cause in laws:
        place = next((p for p in cause.places(scene) if p.index == at), None)
        if place is not None:
            starts = [np.array([k * drift, x]) for k in SIZES for x in scene.amplitudes(place, FRACTIONS)]
            out += refit(state, [state.hypothesis.with_cause(cause, place, None, p) for p in starts])
    return out
