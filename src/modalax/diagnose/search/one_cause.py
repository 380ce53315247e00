"""Hypotheses of one cause each, from all starts: screening, nominal modes and the force measured at a place."""

from collections.abc import Sequence

from modalax.diagnose.causes.base import Cause, UndampedCause
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.screening.every_cause import chosen
from modalax.diagnose.search.candidates import best_of_each
from modalax.diagnose.search.look import Look
from modalax.diagnose.search.measured_force import STRONG, robust_starts, starts_from_forces
from modalax.diagnose.search.rows import fitted_beside_outliers
from modalax.diagnose.search.singles import IN_FULL, PATIENT, fit_single, from_nominal_modes, joints_for_drifts, refit


def singles(look: Look, causes: Sequence[Cause]) -> list[Hypothesis]:
    """Hypotheses of a single cause each, fitted."""
    found = fit_single(look.state, chosen(look.screening.trials))
    found += from_nominal_modes(look.state, causes)
    # a modal parameter far off is found where the modes follow it exactly
    if look.again is not None and not look.comparison.late():
        other = look.again
        trials = [t for t in chosen(other.screening.trials) if isinstance(t.cause, UndampedCause)]
        found += fit_single(other.state, trials) if trials else []
    strong = [] if look.comparison.late() else starts_from_forces(look.comparison, look.null, causes)
    if look.comparison.nuisance.active:  # the modes stand elsewhere beside the force, where nothing else is linear
        found += look.comparison.fit(strong[:IN_FULL], PATIENT)
    else:
        for cause in dict.fromkeys(h.causes[0] for h in strong):
            found += refit(look.state, [h for h in strong if h.causes[0] == cause])
    found += beside_outliers(look, found, causes) if strong else []
    return found + joints_for_drifts(look.state, best_of_each(found, look.comparison), causes)


def untried(look: Look, fitted: Sequence[Hypothesis]) -> tuple[str, ...]:
    """Kinds of causes that were to be looked for or fitted alone when time was up."""
    if not look.comparison.late():
        return ()
    done = {c for h in fitted for c in h.causes}
    promising = [t.cause for t in chosen(look.screening.trials) if t.cause not in done]
    return tuple(dict.fromkeys(c.slug for c in (*promising, *look.screening.unscreened)))


def beside_outliers(look: Look, found: list[Hypothesis], causes: Sequence[Cause]) -> list[Hypothesis]:
    """Joints fitted beside lines at which they have no steady motion, where nothing has explained the data so far."""
    comparison = look.comparison
    enough = STRONG * comparison.problem.samples
    out: list[Hypothesis] = []
    for h in [] if min(h.chi2 for h in found) < enough else robust_starts(comparison, look.null, causes):
        if not comparison.late():
            out.append(fitted_beside_outliers(comparison, h))
    return out
