r"""Laws of a joint fitted to the force that is measured at its place, with the harmonics that each law's force has.

Where a force at one place explains the data, nothing but that force is left to explain. With :math:`\hat q` the force
that leaves least (:mod:`~modalax.diagnose.search.measured_force`), any other leaves

.. math:: \chi^2(q) = \chi^2(\hat q) + \sum_l |w H_b|_l^2\,|q_l - \hat q_l|^2,

exactly, one complex number for each line, run and input, however many outputs there are. Where the modes are known
within a claimed spread only, :math:`\chi^2(\hat q)`, :math:`\hat q` and the law's force follow their parameters, which
are fitted with those of the law, about modal parameters that are moved until the steps are small.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from modalax.diagnose.causes.base import ElementCause, JointCause, LocalCause
from modalax.diagnose.comparison import Comparison
from modalax.diagnose.fitting.gauss_newton import covariance_of, damped_step
from modalax.diagnose.fitting.hypothesis import bounds_of, from_search, to_search
from modalax.diagnose.prediction.balanced_force import harmonics_of, has_law
from modalax.diagnose.prediction.harmonics import FEWER_INSTANTS, HIGHEST, INSTANTS, MORE_INSTANTS
from modalax.diagnose.screening.modes_beside import Beside
from modalax.diagnose.search.force_sizes import misfit, sized
from modalax.diagnose.search.law_force import Seen, beyond, force_of, seen_at
from modalax.diagnose.search.measured_force import MeasuredForce, force_beside
from modalax.diagnose.search.rows import CLEAR, HALF, MOST, OUTLYING
from modalax.diagnose.thresholds import THRESHOLDS

ROUNDS = 40  # most steps of a fit, with lines far off counting little, and again as least squares
HOPED = 12  # of these, in which a fit that gains no more by each should come near another law
ROUGHLY, SETTLED = 1.0, 1e-2  # changes of chi-square at which the first and the second end
CHOSEN = 128  # lines by which starts are compared
MOST_LAWS = 8  # that are fitted where none leaves no more than noise
BEHIND = 40.0  # chi-square behind the best, harmonics apart, from which on a law is not fitted
ALIKE = 2.0  # times what a law misses by one harmonic at one place, up to which it is fitted at another too
FARTHEST, PART = 3.0, 0.2  # largest changes in a step: of a logarithm, and over what lies between two bounds
DAMPED = 1e-3  # first damping of a step, over the diagonal
MEASURED_AGAIN, SAME = 4, 0.1  # times that the force is measured about modes moved on, and chi-square that ends it
MAY = 3.0  # times what harmonics left out are expected to do, up to which they may be why a law leaves more than noise
MORE_HARMONICS = 21  # highest harmonic where those up to the usual one leave more than noise, and may be why

# Of a law by one harmonic: its robust and its plain misfit, its number, and parameters to start from.
_Sized = tuple[float, float, int, list[np.ndarray]]


@dataclass(frozen=True)
class ForceFit:
    """A law fitted to a measured force.

    Attributes
    ----------
    cause
        The law.
    params
        Its parameters.
    chi2
        What it leaves of the measurement.
    aside
        Lines at which it has no motion near the measured one, shape ``(n,)``; they are not in ``chi2``.
    residual, slopes
        Of the whitened force, and its derivatives by the searched parameters and then by the modal ones that are open,
        shapes ``(n,)`` and ``(parameter, n)``.
    motion
        Harmonics of the motion across the place, shape ``(n, h)`` [m].
    seen
        What was measured there, with the modes beside this law.
    highest
        Highest harmonic that was balanced.
    missed
        Chi-square between the measured force and the law's by one harmonic.
    """

    cause: ElementCause
    params: np.ndarray
    chi2: float
    aside: np.ndarray
    residual: np.ndarray
    slopes: np.ndarray
    motion: np.ndarray
    seen: Seen
    highest: int = HIGHEST
    missed: float = np.inf

    @property
    def alone(self) -> np.ndarray:
        """Slopes by the law's parameters with the modal ones always at their best; 0 at lines set aside."""
        J, K, C = self._parts()
        return J if C is None else J - C.T @ K

    @property
    def covariance(self) -> np.ndarray:
        """Of the law's searched parameters, by the noise of the force and the spread of the modes."""
        J, K, C = self._parts()
        information = (J.conj() @ J.T).real
        return covariance_of(information if C is None else information - (J.conj() @ K.T).real @ C)

    def _parts(self) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Slopes by the law's parameters, by modal ones, and how these follow the former."""
        count = len(self.cause.parameters)
        J, K = np.split(np.where(self.aside, 0.0, self.slopes), [count])
        f = self.seen.follow
        if f is None:
            return J, K, None
        return J, K, np.linalg.solve((K.conj() @ K.T).real + f.curvature, (K.conj() @ J.T).real)


def fit_to_force(
    cause: ElementCause, starts: Sequence[np.ndarray], seen: Seen, late: Callable[[], bool] = lambda: False,
    rival: float = np.inf,
) -> ForceFit | None:  # fmt: skip
    """Fit a law to a measured force, from the start that most lines agree with; None where nothing can be balanced.

    Lines far off count little at first (Cauchy's distribution); those that stay so are set aside, each of them paid for
    as two unknowns by whoever weighs the fit.

    Parameters
    ----------
    cause
        The law.
    starts
        Parameters.
    seen
        What was measured.
    late
        Tells when time is up, and no further steps are taken.
    rival
        Robust misfit that another law left; one that comes to it too slowly is not followed to its end. Not asked of
        dry friction, which is followed at few instants first, so that it leaves more than it will.
    """
    first, rival = (FEWER_INSTANTS, np.inf) if slides(cause, seen) else (INSTANTS, rival)
    some = seen.telling(CHOSEN) if len(starts) > 1 and seen.several else seen
    left = [_residual(some, *force_of(cause, p, some, instants=first, neighbours=0)[::2]) for p in starts]
    tried = [(misfit(r, True), k) for k, r in enumerate(left)]
    if not tried or not np.isfinite(min(tried)[0]):
        return None
    u, motion = to_search(cause, starts[min(tried)[1]]), None
    aside = np.zeros(len(seen.force), bool)
    for robust in (True, False):
        instants = first if robust else INSTANTS
        u, seen, motion, r, J, sound = _descended(cause, u, seen, motion, aside, robust, instants, late, rival)
        aside = _far_off(seen, r, sound)
        if misfit(r, True) + seen.left > rival + BEHIND:
            break
    # a linear element has one motion at every line, and so has a joint too weak for harmonics to count
    linear = isinstance(cause, LocalCause) or not seen.several
    if linear or aside.mean() > MOST or _holds_most(seen, aside):
        aside = np.zeros(len(r), bool)
    return _ended(cause, u, seen, motion, r, J, aside)


def finely(fit: ForceFit, late: Callable[[], bool]) -> ForceFit:
    """A fit of dry friction with many instants, or of another law with many harmonics, from that with few.

    Lines that were set aside begin so; any that it then explains are kept.
    """
    many = HIGHEST if slides(fit.cause, fit.seen) else MORE_HARMONICS
    u, kept = to_search(fit.cause, fit.params), (False, MORE_INSTANTS, late)
    u, seen, motion, r, J, sound = _descended(fit.cause, u, fit.seen, fit.motion, fit.aside, *kept, highest=many)
    return _ended(fit.cause, u, seen, motion, r, J, _far_off(seen, r, sound), many)


def _paid(fit: ForceFit) -> float:
    """Chi-square that a law leaves, with two for each of the two unknowns of a line that was set aside."""
    return fit.chi2 + 4 * int(fit.aside.sum())


def _lacks_harmonics(fit: ForceFit) -> bool:
    """Whether a law leaves more than noise of a force, and harmonics that were left out may be why."""
    law, seen = fit.cause, fit.seen
    if not seen.several or not has_law(law) or 0 in harmonics_of(law, fit.params):
        return False
    count = max(2 * int((seen.precision > 0).sum()), 1)
    excess = fit.chi2 - seen.left - count
    if excess < THRESHOLDS.one_force * np.sqrt(2 * count) or fit.aside.mean() > MOST:
        return False
    force, _, sound, motion = force_of(law, fit.params, seen, fit.motion)
    other, _, also, _ = force_of(law, fit.params, seen, motion, fewer=True)
    change = seen.precision * np.where(sound & also & ~fit.aside, force - other, 0.0)
    return excess < (MAY * beyond(HIGHEST)) ** 2 * float((np.abs(change) ** 2).sum())


def _far_off(seen: Seen, r: np.ndarray, sound: np.ndarray) -> np.ndarray:
    """Lines at which a law has no motion near the measured one."""
    paid = 2 * np.log(max(seen.samples, 30))
    usual = float(np.quantile(np.abs(r) ** 2, 1 - MOST))
    return ~sound | ~(np.abs(r) ** 2 <= max(OUTLYING * usual, paid))


def _holds_most(seen: Seen, aside: np.ndarray) -> bool:
    """Whether lines set aside are most of those that show a force, so that a law explains none of it."""
    shown = np.abs(seen.precision * seen.force) > CLEAR
    return bool((aside & shown).sum() > HALF * shown.sum())


def _ended(
    cause: ElementCause, u: np.ndarray, seen: Seen, motion: Any, r: np.ndarray, J: np.ndarray, aside: np.ndarray,
    highest: int = HIGHEST,
) -> ForceFit:  # fmt: skip
    p = np.asarray(from_search(cause, u))
    return ForceFit(cause, p, seen.left + float((np.abs(r[~aside]) ** 2).sum()), aside, r, J, motion, seen, highest)


def slides(cause: ElementCause, seen: Seen) -> bool:
    """Whether a law is dry friction, whose motion is found at instants where harmonics count."""
    return isinstance(cause, JointCause) and cause.rigid and seen.several


def fit_with_modes(
    comparison: Comparison, cause: ElementCause, starts: Sequence[np.ndarray], force: MeasuredForce, seen: Seen,
    near: float, rival: float = np.inf,
) -> ForceFit | None:  # fmt: skip
    """Fit a law to a measured force, and measure that again about the modal parameters found, until these stay.

    Parameters
    ----------
    comparison
        Data and simulation.
    cause, starts
        The law, and parameters to start from.
    force, seen
        The force that was measured, and what was measured with it.
    near
        Chi-square above which a law is not worth it.
    rival
        As for :func:`fit_to_force`.
    """
    fit = fit_to_force(cause, starts, seen, comparison.late, rival)
    for _ in range(MEASURED_AGAIN if seen.follow is not None else 0):
        if fit is None or fit.chi2 > near or comparison.late():
            break
        beside = Beside.at(comparison, fit.seen.theta)
        left = beside.linear(beside.direction(force.place), beside.turned(force.place))[0]
        before = fit.seen.left
        again = seen_at(comparison, force_beside(force.place, left, beside), seen.least, seen.several)
        fit = fit_to_force(cause, [fit.params], again, comparison.late) or fit
        if abs(left - before) < SAME:
            break
    if fit is None or fit.chi2 > near or comparison.late():
        return fit
    if slides(cause, seen):
        return finely(fit, comparison.late)
    return min(fit, finely(fit, comparison.late), key=_paid) if _lacks_harmonics(fit) else fit


def _residual(seen: Seen, force: np.ndarray, sound: np.ndarray) -> np.ndarray:
    """Whitened; what the force itself is where no motion was found."""
    return seen.precision * np.where(sound, np.where(sound, force, 0.0) - seen.force, seen.force)


def _descended(
    cause: ElementCause, u: np.ndarray, seen: Seen, motion: np.ndarray | None, aside: np.ndarray, robust: bool,
    instants: int, late: Callable[[], bool], rival: float = np.inf, highest: int = HIGHEST,
) -> tuple[np.ndarray, Seen, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Damped Gauss-Newton steps of law and modes: where they end, motion, residual, slopes and soundness there."""
    low, high = bounds_of([cause])
    logarithmic, own = np.array([q.log for q in cause.parameters]), len(cause.parameters)
    farthest = np.where(logarithmic, FARTHEST, PART * (high - low))

    def at(u: np.ndarray, seen: Seen, motion: np.ndarray | None) -> tuple[Any, ...]:
        p = np.asarray(from_search(cause, u))
        force, slopes, sound, moved = force_of(cause, p, seen, motion, instants=instants, highest=highest)
        slopes = np.where(sound, slopes, 0.0)
        slopes[:own] *= np.where(logarithmic, p, 1.0)[:, None]
        if seen.follow is not None:
            slopes[own:] -= np.where(sound, seen.follow.force.T, 0.0)
        r, kept = _residual(seen, force, sound), 0.0 if motion is None else motion
        J = seen.precision * slopes
        # where modes have moved out of all bounds nothing is a number, and no step begins there
        cost = misfit(r[~aside], robust) + seen.left if np.isfinite(J).all() else np.inf
        moved = np.where(sound[:, None], moved, kept if np.shape(kept)[1:] == moved.shape[1:] else 0.0)
        return cost, r, J, moved, sound

    cost, r, J, motion, sound = at(u, seen, motion)
    damping, enough = DAMPED, ROUGHLY if robust else SETTLED
    for turn in range(ROUNDS):
        if late() or not np.isfinite(cost):
            break
        w = np.where(aside, 0.0, 1 / (1 + np.abs(r) ** 2) if robust else 1.0)
        A, g = ((J.conj() * w) @ J.T).real, ((J.conj() * w) @ r).real
        if seen.follow is not None:
            A[own:, own:] += seen.follow.curvature
            g[own:] -= seen.follow.downhill
        held = np.concatenate(
            [((u <= low) & (g[:own] > 0)) | ((u >= high) & (g[:own] < 0)), np.zeros(len(g) - own, bool)]
        )
        step = damped_step(A, g, damping, held)
        if -step @ g < enough:
            break
        moved = np.clip(u + np.clip(step[:own], -farthest, farthest), low, high)
        further = seen.moved(step[own:])
        there = at(moved, further, motion)
        if there[0] < cost:
            gain = cost - there[0]
            done = gain < enough or robust and there[0] - max(HOPED - turn, 1) * gain > rival + BEHIND
            u, seen, (cost, r, J, motion, sound), damping = moved, further, there, 0.1 * damping
            if done:
                break
        elif damping > 1e3 or not len(step[own:]) and np.allclose(moved, u, rtol=1e-9, atol=0):
            break
        else:
            damping *= 10
    return u, seen, np.asarray(motion), r, J, sound


def laws_by_force(
    comparison: Comparison, causes: Sequence[ElementCause], force: MeasuredForce, effect: float,
    least: float = np.inf, several: bool = True, elsewhere: Sequence[ForceFit] = (),
) -> list[ForceFit]:  # fmt: skip
    """Fit causes that can sit at the place of a measured force, those first that one harmonic shows to be the nearest.

    Once one leaves no more than noise, a law is fitted only if its harmonics may bring it as near, as they have brought
    it elsewhere where it misses as much by one; by one harmonic all are fitted, which costs no more than to ask.

    Parameters
    ----------
    comparison
        Data and simulation.
    causes
        What to look for.
    force
        The force that was measured.
    effect
        Chi-square that the force takes away.
    least
        What is left by the best that was fitted elsewhere.
    several
        Whether harmonics above the first count.
    elsewhere
        Laws that were fitted at other places.
    """
    scene, seen = comparison.scene, seen_at(comparison, force, several=several)
    order: list[_Sized] = []
    for k, cause in enumerate(causes):
        at = force.place_of(cause, scene)
        if at is not None and not (cause.each_run and several) and cause.parameters:
            order += [(*one[:2], k, one[2]) for one in [sized(comparison, cause, at, force, seen)] if one is not None]
    out: list[ForceFit] = []
    for count, (_, missed, k, starts) in enumerate(_limits_first(order, causes)):
        if comparison.late():
            break
        best = min([least, *(f.chi2 for f in out)])
        near = best + 4 * causes[k].fidelity ** 2 * effect + BEHIND
        done = best - seen.samples < THRESHOLDS.one_force * np.sqrt(2 * seen.samples)
        noise = min(missed, 2 * len(seen.force))  # of the rest, three quarters may be the error of one harmonic
        far = seen.left + noise + (missed - noise) / 4 > near if done else count >= MOST_LAWS
        far = far and not any(f.cause is causes[k] and f.chi2 < near and missed < ALIKE * f.missed for f in elsewhere)
        if several and far and (not isinstance(causes[k], LocalCause) or seen.left > near):
            continue
        rival = min((misfit(f.residual, True) + f.seen.left for f in out), default=np.inf)
        found = fit_with_modes(comparison, causes[k], starts, force, seen, near, rival)
        out += [] if found is None else [replace(found, missed=missed)]
    return out


def _limits_first(order: Sequence[_Sized], causes: Sequence[ElementCause]) -> list[_Sized]:
    """The nearest laws first; after the law that one becomes as its strength grows, where that is about as near.

    A fit of the former to the latter's force follows its strength without an end.
    """
    near = {causes[k]: robust for robust, _, k, _ in order}

    def rank(one: _Sized) -> tuple[float, bool, float, int]:
        robust, missed, k, starts = one
        cause = causes[k]
        limit = cause.simpler(starts[0]) if isinstance(cause, JointCause) else None
        of_limit = np.inf if limit is None else near.get(limit[0], np.inf)
        after = of_limit < ALIKE * robust
        return max(robust, of_limit) if after else robust, after, missed, k

    return sorted(order, key=rank)
