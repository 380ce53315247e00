r"""Fits of hypotheses to measured modes, together with the general inaccuracy, and their evidence.

The unknowns ``x`` (parts of the inaccuracy over their sizes, causes over theirs) are standard normal before the data.
Each step solves the linearised problem exactly; the sizes of the inaccuracy are learnt on the way (MacKay 1992,
equations 2.15-2.20): the logarithmic evidence rises with :math:`\ln\epsilon` of a group by :math:`\sum(x^2 + V - 1)`,
``V`` the posterior variances. So are those of causes beyond their usual ones: a size of ten times the usual one is
rare, but no more a contradiction than an inaccuracy of that kind.
"""

from dataclasses import dataclass, replace

import numpy as np

from modalax.diagnose.modal_domain.causes.change import Change, own_sizes
from modalax.diagnose.modal_domain.fitting.inaccuracy import UNKNOWN
from modalax.diagnose.modal_domain.fitting.linear import SMALLEST, Linear, linear_of, widths
from modalax.diagnose.modal_domain.fitting.state import Setting, State, evidence_of_free, slopes_at, state_at, unseen

TEMPERATURES = (100.0, 10.0, 3.0)  # widening of the features' covariance in the first steps of a fit
LEARNING = 10.0  # greatest of these at which sizes of the inaccuracy are estimated; far from the data all seem large
LAST = 25  # most steps at the true covariance
AGAIN, WORTH = 8, 1.0  # further times that these are taken, as long as the log evidence gains as many nats
BASIN = 1000.0  # chi-square per feature from which on they are not: what is 30 deviations off may go anywhere
FARTHEST = 1.5  # change of the logarithm of a size in one step
SETTLED = 0.02  # change of log evidence at which a fit has ended
HOPELESS = 15.0  # nats behind another hypothesis from which a fit ends where its steps are cut short,
SHORT, SHARE = 0.2, 0.12  # to less than this part, and gain less than this share of them: in its basin it gains most


@dataclass(frozen=True)
class Fit:
    """A fitted hypothesis.

    Attributes
    ----------
    causes
        Causes in addition to the general inaccuracy.
    sizes
        Of all patterns, relative to the whole.
    u
        Sizes of causes, those of each in turn, over their usual ones.
    epsilon
        Learnt size of each group of the inaccuracy.
    log_evidence
        Up to what all hypotheses share.
    covariance
        Of ``u``.
    chi2
        Of the features, without what the prior costs.
    determined
        Number of well-determined parts of each group.
    state
        Predicted modes.
    """

    causes: tuple[Change, ...]
    sizes: np.ndarray
    u: np.ndarray
    epsilon: np.ndarray
    log_evidence: float
    covariance: np.ndarray
    chi2: float
    determined: np.ndarray
    state: State


Found = dict[tuple[Change, ...], Fit]  # fits that a search has made, by their causes


def linear_at(setting: Setting, state: State, causes: tuple[Change, ...], sizes: np.ndarray, u: np.ndarray) -> Linear:
    """The problem linearised about a state."""
    J = slopes_at(setting, state, causes, u)
    return linear_of(setting.inaccuracy, J, state.difference + J @ np.concatenate([sizes, u]), u)


def scale_of(setting: Setting, f: Fit, epsilon: np.ndarray | None = None) -> np.ndarray:
    """Standard deviations before the data of all unknowns of a fit, or with other sizes of the inaccuracy."""
    return np.concatenate([(f.epsilon if epsilon is None else epsilon)[setting.inaccuracy.group_of], widths(f.u)])


def hyperprior(setting: Setting, epsilon: np.ndarray, u: np.ndarray) -> float:
    """Logarithmic prior of sizes of the inaccuracy and widths of causes, without the widths of their posteriors."""
    a = setting.inaccuracy
    parts = np.concatenate([np.log(epsilon / a.usual) / a.spread, np.log(widths(u)) / UNKNOWN])
    return float(-0.5 * (parts**2).sum())


def fit(
    setting: Setting, causes: tuple[Change, ...] = (), start: Fit | None = None, u: np.ndarray | None = None,
    temperatures: tuple[float, ...] = TEMPERATURES, best_else: float = -np.inf, basin: float = BASIN,
) -> Fit | None:  # fmt: skip
    """Fit a hypothesis; None where the search leads to matrices without enough modes.

    Parameters
    ----------
    start
        A fit whose inaccuracy is the starting point; the simulation itself if None.
    u
        Sizes of the causes to start from.
    best_else
        Log evidence of the best other hypothesis: a fit that is far behind and hardly gains ends where it is.
    basin
        Chi-square per feature from which on no further steps are taken once these have been, and none where they would
        not lead below it.
    """
    a = setting.inaccuracy
    sizes = np.zeros(len(a.group_of)) if start is None else start.sizes
    epsilon = a.usual.copy() if start is None else start.epsilon
    u = np.zeros(sum(c.count for c in causes)) if u is None else np.asarray(u, float)
    free, lost = evidence_of_free(setting, causes), False
    try:
        state = state_at(setting, sizes, causes, u)
        for temperature in temperatures:
            for _ in range(0 if lost else 3):
                linear = linear_at(setting, state, causes, sizes, u)
                epsilon = linear.learnt(epsilon, temperature, 2) if temperature <= LEARNING else epsilon
                x = linear.mean(epsilon, temperature)
                state, sizes, u, moved, part = _step(
                    setting, causes, state, sizes, u, x, linear.prior(epsilon), temperature
                )
                behind = best_else + 0.5 * float(state.difference @ state.difference)
                lost = temperature <= LEARNING and _lost(behind, moved * temperature, part)
                if moved < 0.5 or lost:
                    break
        best, linear, ended = _at_true_covariance(
            setting, causes, state, sizes, u, epsilon, best_else, free, lost, basin
        )
        for _ in range(AGAIN):
            if ended or not 1.0 < best.chi2 / setting.features.values.size < basin:
                break
            more = best.state, best.sizes, best.u, best.epsilon
            again, at, ended = _at_true_covariance(setting, causes, *more, best_else, free, False)
            gained = again.log_evidence - best.log_evidence
            best, linear = (again, at) if gained > 0 else (best, linear)
            if gained < WORTH:
                break
    except np.linalg.LinAlgError:
        return None
    return replace(best, log_evidence=_with_exact(setting, best, linear, free))


def _at_true_covariance(
    setting: Setting, causes: tuple[Change, ...], state: State, sizes: np.ndarray, u: np.ndarray, epsilon: np.ndarray,
    best_else: float, free: float, lost: bool, basin: float = np.inf,
) -> tuple[Fit, Linear, bool]:  # fmt: skip
    """Fit from a start at the covariance that the features have, and whether a further one is of no use.

    It is of use where a step was cut short, from where on sizes are learnt at the place and not at the solution of the
    linear problem: an inaccuracy that is far larger than where that happened would be learnt too slowly.
    """
    best: Fit | None = None
    straight = True
    for _ in range(LAST):
        linear = linear_at(setting, state, causes, sizes, u)
        # once the linear problem has led astray, sizes learnt at its solution would go round in circles
        epsilon = linear.learnt(epsilon, 1.0, 8, None if straight else np.concatenate([sizes, u]))
        now = linear.solve(epsilon)
        scale = linear.prior(epsilon)
        # Laplace where the fit stands, not where the linear problem ends: at the optimum the same, elsewhere lower
        chi2 = float(state.difference @ state.difference)
        cost = chi2 + float(((np.concatenate([sizes, u]) / scale) ** 2).sum())
        evidence = -0.5 * cost + now.volume + hyperprior(setting, epsilon, u) + free
        evidence -= 0.5 * unseen(setting.features, causes, state.modes.poles, state.residues, state.pairs)
        wide = linear.widths
        here = Fit(
            causes, sizes, u, epsilon, evidence, now.covariance * np.outer(wide, wide), chi2, now.determined, state
        )
        gained = np.inf if best is None else evidence - best.log_evidence
        behind = best_else - evidence
        hopeless = lost or (behind > HOPELESS and gained < behind / LAST) or setting.late()
        hopeless |= gained < (0.5 * chi2 - 0.5 * basin * setting.features.values.size) / LAST
        best = here
        if hopeless or abs(gained) < SETTLED:
            return best, linear, straight or hopeless
        state, sizes, u, moved, part = _step(setting, causes, state, sizes, u, now.mean, scale, 1.0)
        straight &= part == 1.0
        lost = _lost(behind, moved, part)
        if moved < 1e-3:
            break
    assert best is not None
    return best, linear, straight  # pyrefly: ignore[unbound-name]


def _with_exact(setting: Setting, f: Fit, linear: Linear, free: float) -> float:
    """Log evidence where a simulation of which nothing is claimed may also be exact, as that of a virtual test is.

    Before the data both are as likely. What is fitted is so near to an exact simulation that the linear problem tells
    what that leaves; where it is not, it leaves too much by any problem.
    """
    if any(linear.inaccuracy.claimed):
        return f.log_evidence
    exact, old, none = np.full(len(f.epsilon), SMALLEST), np.concatenate([f.sizes, f.u]), len(f.sizes)
    now = linear.solve(exact)
    x = now.mean
    here = f.chi2 + linear.rise(old, x) + float(((x / linear.prior(exact)) ** 2).sum())
    sizes = -0.5 * float(((np.log(widths(x[none:])) / UNKNOWN) ** 2).sum())
    beside = -0.5 * unseen(setting.features, f.causes, f.state.modes.poles, f.state.residues, f.state.pairs)
    return float(np.logaddexp(f.log_evidence, -0.5 * here + now.volume + sizes + free + beside)) - np.log(2)


def _lost(behind: float, gained: float, part: float) -> bool:
    """Whether a fit that is so far behind another is not on its way to a better end."""
    return behind > HOPELESS and part < SHORT and gained < SHARE * behind


def _step(
    setting: Setting, causes: tuple[Change, ...], state: State, sizes: np.ndarray, u: np.ndarray, x: np.ndarray,
    scale: np.ndarray, temperature: float,
) -> tuple[State, np.ndarray, np.ndarray, float, float]:  # fmt: skip
    """Step towards the solution of the linear problem as the cost falls; by how much, and the part taken.

    Causes far beyond their usual sizes act in proportion no longer: a spring that holds two points together does so at
    any size above some. Where a step is larger than a size itself, one by a factor is tried too.
    """
    old = np.concatenate([sizes, u])
    n = len(sizes)
    cost = lambda s, y: 0.5 * float(s.difference @ s.difference) / temperature + 0.5 * float(((y / scale) ** 2).sum())
    before, part = cost(state, old), 1.0
    for _ in range(7):
        trials = []
        for new in _ways(old, part * (x - old), n):
            try:
                trial = state_at(setting, new[:n], causes, new[n:])
                trials.append((cost(trial, new), trial, new))
            except np.linalg.LinAlgError:
                pass
        after, trial, new = min(trials, key=lambda one: one[0], default=(np.inf, state, old))
        if after < before:
            return trial, new[:n], new[n:], before - after, part
        part /= 3
    return state, sizes, u, 0.0, 0.0


def _ways(old: np.ndarray, step: np.ndarray, n: int) -> list[np.ndarray]:
    r"""Where a step leads: straight on, and, where that is far, also by :math:`\sinh^{-1}u` of the causes' sizes."""
    u, du = old[n:], step[n:]
    ways = [old + step]
    if (np.abs(du) > widths(u)).any():
        bent = np.sinh(np.arcsinh(u) + np.clip(du / np.sqrt(1 + u**2), -FARTHEST, FARTHEST))
        ways.append(np.concatenate([ways[0][:n], bent]))
    return ways


def widths_of_sizes(f: Fit, setting: Setting) -> np.ndarray:
    """Standard deviations of the logarithms of the learnt sizes."""
    return 1 / np.sqrt(2 * f.determined + 1 / setting.inaccuracy.spread**2)


def without_causes(f: Fit) -> Fit:
    """The same inaccuracy, as a start for other causes."""
    return replace(f, causes=(), u=np.zeros(0))


def by_data(f: Fit, causes: tuple[Change, ...], cause: Change) -> float:
    """Log evidence less what the prior width of one cause's size adds: two kinds of cause have unlike usual sizes."""
    own = own_sizes(causes, causes.index(cause))
    wide = widths(f.u[own])
    known = np.maximum(np.diag(f.covariance)[own] / wide**2, 1e-300)
    return f.log_evidence + 0.5 * float(((f.u[own] / wide) ** 2 - np.log(known)).sum())
