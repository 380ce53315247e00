r"""Whether one force at one place explains all that the simulation leaves, whatever the law of the force.

An element or a joint between two points changes the receptances by :math:`-H_b\,q`, one column over the outputs times
one number :math:`q` for each run, line and input. With :math:`q` free the chi-square that is left at a place is

.. math:: \chi_b^2 = |r|^2 - \sum \frac{|(wH_b)^H r|^2}{|wH_b|^2},

with r the whitened residual of the simulation and w its weights. Whatever the place, what is left of the FRFs of
several inputs is then of rank one at each line; where that leaves more than noise, no place is asked for. Where the
least of these is no more than noise, only
elements and joints are worth a search, at the places that come near it. With several outputs a fault of one output, of
one mode or at an input alone can look like that too; where one would do, nothing is said.
"""

import numpy as np

from modalax.diagnose.causes.scene import Place
from modalax.diagnose.comparison import Comparison, empty
from modalax.diagnose.deadline import NEVER, Deadline
from modalax.diagnose.fitting.residual import laid_out
from modalax.diagnose.screening.law_free import gains_without_law
from modalax.diagnose.screening.modes_beside import STEPS, Beside, modes_beside
from modalax.diagnose.screening.products import Reduced, at_places, ends, reduce
from modalax.diagnose.screening.sensitivities import Residual
from modalax.diagnose.screening.shortlist import KEPT, MANY
from modalax.diagnose.setup.noise import TRUSTED
from modalax.diagnose.thresholds import THRESHOLDS

LOUDEST, SUMS = 300, 64  # lines, of all runs, from which very many places are ranked, and sums of outputs
ENOUGH = 20  # of these, by which it shows that none of so many places explains even where most is left
RESOLVED = 1e-9  # squared length of a difference of two columns, over their own, that is more than rounding
REFINED, FIRST = 60, 15  # places at which claimed modes follow, and the first of them, by one of which all is explained
FEW = 12  # places from which on they are ranked once more, by a joint without a law
OUTPUTS = 4  # fewest outputs by which a force at one place is told from other causes


def places_of_one_force(comparison: Comparison, late: Deadline = NEVER) -> tuple[Place, ...]:
    """Places at one of which a single force explains the data; none if it does not, or if too many places would do.

    Parameters
    ----------
    comparison
        Data and simulation; its modes follow within the spread that is claimed.
    late
        From when on nothing is said where modes follow, which takes long at many places.
    """
    if not _can_tell(comparison):
        return ()
    if comparison.nuisance.active:
        return _with_modes(comparison, late)
    left, live = comparison.residual(empty(comparison)), comparison.live()
    by_output, samples = (np.abs(left) ** 2).sum(axis=(0, 1, 3)), 2 * live.sum(axis=(0, 1, 3))
    chi2, count, unknowns = by_output.sum(), samples.sum(), 2 * int(live.any(axis=2).sum())
    if (
        _exceeds_noise(left_by_any_column(left, np.asarray(comparison.problem.weight)), count - unknowns)
        > THRESHOLDS.one_force
    ):
        return ()
    reduced, noise = _reduced(comparison, left), np.sqrt(2 * max(count - unknowns, 1))
    many = len(comparison.scene.pairs()) > MANY
    if many and _left_where_loudest(reduced, left) > THRESHOLDS.one_force * noise:
        return ()
    gains, places = _gains(comparison, reduced, left)
    order = np.argsort(-gains)
    best = float(gains[order[0]])
    behind = _behind(unknowns)
    others = max(0.0, (by_output - samples).max(), _by_one_mode(comparison, left).max() - unknowns)  # 0: nothing at all
    explained = _exceeds_noise(chi2 - best, count - unknowns) < THRESHOLDS.one_force
    if _driven(comparison, places[order[0]]) or not explained or others > best - unknowns - behind:
        return ()
    near = [places[k] for k in order if gains[k] > best - behind]
    if len(near) > FEW:
        near = _likeliest(comparison, left, near)
    return tuple(near) if len(near) <= KEPT else ()


def _likeliest(comparison: Comparison, left: np.ndarray, places: list[Place]) -> list[Place]:
    """Those of many places at which a joint without a law explains about as much as at the best of them."""
    reduced = _reduced(comparison, left)
    gains, unknowns = gains_without_law(at_places(reduced, places), reduced)
    best = float(gains.max())
    inexact = THRESHOLDS.inexact_law**2 * max(best, 0.0)  # what a law of more than one harmonic leaves at its place
    behind = _behind(unknowns) + inexact
    return [places[k] for k in np.argsort(-gains) if gains[k] > best - behind]


def _behind(unknowns: int) -> float:
    """Chi-square by which another place may be behind the best, by the noise of a difference."""
    return THRESHOLDS.other_places + THRESHOLDS.one_force * np.sqrt(4 * unknowns)


def _driven(comparison: Comparison, place: Place) -> bool:
    """Whether an input drives the structure there."""
    scene = comparison.scene
    return place.index[:2] in {(scene.dofs.index(name), -1) for name in scene.inputs}


def _can_tell(comparison: Comparison) -> bool:
    exact = comparison.question == "fixed" and comparison.scene.scaled
    known = comparison.noise.freedom >= TRUSTED and comparison.problem.held is None
    return exact and known and comparison.problem.channels[0] >= OUTPUTS


def _with_modes(comparison: Comparison, late: Deadline) -> tuple[Place, ...]:
    """The places where modes move within their spread: each chi-square is the least over the modal parameters."""
    pairs, live = comparison.scene.pairs(), comparison.live()
    if len(pairs) > MANY:
        return ()
    unknowns = 2 * int(live.any(axis=2).sum())
    samples = comparison.problem.samples - unknowns
    behind = _behind(unknowns)
    found = modes_beside(comparison, pairs, FIRST, late)
    best = min((chi2 for _, chi2, _ in found), default=np.inf)
    if _exceeds_noise(best, samples) >= THRESHOLDS.one_force or _fault_or_mode_does(comparison, best + behind, late):
        return ()
    found = modes_beside(comparison, pairs, REFINED, late, found)
    ranked = sorted(((chi2, p) for p, chi2, _ in found), key=lambda one: one[0])
    best, first = ranked[0]
    if _driven(comparison, first) or late():
        return ()
    near = tuple(p for chi2, p in ranked if chi2 < best + behind)
    return near if len(near) <= KEPT else ()


def _fault_or_mode_does(comparison: Comparison, most: float, late: Deadline) -> bool:
    """Whether a fault of one output, or one mode, leaves less than ``most``, as modes follow, or time is up before."""
    nominal = Beside.nominal(comparison)
    modes = np.flatnonzero(np.abs(nominal.shapes).max(axis=1) > 0)
    others = [lambda b, k=k: (b.fault(k),) for k in range(nominal.change.shape[2])]
    others += [lambda b, k=k: (b.of_mode(k),) for k in modes]
    return any(late() or nominal.settled(other, STEPS)[0] < most for other in others)


def _exceeds_noise(chi2: float, samples: int) -> float:
    """Chi-square above that of noise in so many real samples, in standard deviations."""
    return (chi2 - samples) / np.sqrt(2 * max(samples, 1))


def left_by_any_column(left: np.ndarray, weight: np.ndarray) -> float:
    r"""Chi-square that any one column over the outputs leaves at least, with a free factor for each line and input.

    With smaller weights :math:`a_ob_i\leq w_{oi}` that is, at each line, the sum of all squared singular values of
    :math:`a_o\Delta_{oi}b_i` but the largest (Eckart and Young 1936).

    Parameters
    ----------
    left
        Whitened residual :math:`w\Delta`, complex, shape ``(run, f, o, i)``.
    weight
        Its weights, 0 of what is left out, same shape.
    """
    b = np.maximum(weight.max(axis=(1, 2), keepdims=True), 1e-300)
    a = (weight / b).min(axis=3, keepdims=True)
    part = np.divide(a * b * left, weight, out=np.zeros(left.shape, complex), where=weight > 0)
    gram = part.conj().swapaxes(2, 3) @ part
    return float(np.linalg.eigvalsh(gram)[..., :-1].sum())


def _gains(comparison: Comparison, reduced: Reduced, left: np.ndarray) -> tuple[np.ndarray, list[Place]]:
    """Chi-square that a free force takes away, and the places it was computed for: of very many the likeliest."""
    places = comparison.scene.pairs()
    if len(places) > MANY:
        a, b = ends(places)
        ranked = [np.argsort(-gain[a, np.where(b >= 0, b, a)]) for gain in _at_loudest_lines(reduced, left)]
        kept = dict.fromkeys(int(k) for both in zip(*ranked, strict=True) for k in both)
        places = [places[k] for k in list(kept)[:MANY]]
    at = at_places(reduced, places)
    share = np.divide(np.abs(at.S) ** 2, at.N, out=np.zeros(at.S.shape), where=at.N > 0)
    return share.sum(axis=(1, 2, 3)), places


def _reduced(comparison: Comparison, left: np.ndarray) -> Reduced:
    """Products of receptances with a whitened residual, complex, shape ``(run, f, o, i)``, and no nuisances."""
    problem = comparison.problem
    value = laid_out(left)
    none = Residual(value, np.zeros((0, *value.shape)), np.zeros((0, 0)))
    return reduce(problem, np.zeros((2, problem.modal_form.stiffness.shape[0])), none)


def _loudest(left: np.ndarray, count: int) -> np.ndarray:
    """Run, line and input of a whitened residual's loudest lines, shape ``(count, 3)``."""
    energy = (np.abs(left) ** 2).sum(axis=2)
    return np.stack(np.unravel_index(np.argsort(-energy.ravel())[:count], energy.shape), axis=-1)


def _left_where_loudest(reduced: Reduced, left: np.ndarray) -> float:
    """Chi-square beyond the mean of noise that the best of all places leaves where most is left."""
    free, total = 0.0, 0.0
    for run, line, i in _loudest(left, ENOUGH):
        H = reduced.summed(int(line), np.diag(np.sqrt(reduced.weight2[run, line, :, i])))
        length, product = _lengths(H), _between(reduced.S[run, line, :, i])
        free = free + np.abs(product) ** 2 / length
        samples = 2 * np.count_nonzero(reduced.weight2[run, line, :, i])
        total += float((np.abs(left[run, line, :, i]) ** 2).sum()) - samples
    return total - float(np.max(free))


def _at_loudest_lines(reduced: Reduced, left: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Chi-square that forces take away where most is left, each of shape ``(dof, dof)``, to ground on the diagonal.

    The first of a force that is free at every line; the second of one in proportion to the motion without it, with one
    complex factor a run, which has few unknowns and so tells weak effects better. Lengths are taken over random sums of
    the outputs where there are more of these (Johnson and Lindenstrauss 1984).

    Parameters
    ----------
    left
        Whitened residual, complex, shape ``(run, f, o, i)``.
    """
    rng, count = np.random.default_rng(0), left.shape[2]
    dofs = reduced.shapes.shape[1]
    motion = reduced.motion(np.arange(dofs), np.full(dofs, -1))
    free, along, size = (
        np.zeros((dofs, dofs)),
        np.zeros((len(left), dofs, dofs), complex),
        np.zeros((len(left), dofs, dofs)),
    )
    for run, line, i in _loudest(left, LOUDEST):
        signs = rng.choice([-1.0, 1.0], (SUMS, count)) / np.sqrt(SUMS) if count > 2 * SUMS else np.eye(count)
        H = reduced.summed(int(line), signs * np.sqrt(reduced.weight2[run, line, :, i]))
        length = _lengths(H)
        product, x = (_between(v) for v in (reduced.S[run, line, :, i], motion[:, line, i]))
        free += np.abs(product) ** 2 / length
        along[run] += product * x.conj()
        size[run] += length * np.abs(x) ** 2
    return free, (np.abs(along) ** 2 / np.maximum(size, 1e-300)).sum(axis=0)


def _lengths(H: np.ndarray) -> np.ndarray:
    """Squared lengths of the columns of forces between DoFs, and to ground on the diagonal, shape ``(dof, dof)``."""
    gram, own = H.conj().T @ H, (np.abs(H) ** 2).sum(axis=0)
    return np.maximum(_across(own, -2 * np.real(gram)), RESOLVED * np.maximum(own[:, None], own[None]) + 1e-300)


def _between(v: np.ndarray) -> np.ndarray:
    """Differences of a quantity at DoFs, and itself on the diagonal."""
    out = v[:, None] - v[None]
    np.fill_diagonal(out, v)
    return out


def _across(own: np.ndarray, mixed: np.ndarray) -> np.ndarray:
    """Squares of differences by squares and products at DoFs, and the square itself on the diagonal."""
    out = own[:, None] + own[None] + mixed
    np.fill_diagonal(out, own)
    return out


def _by_one_mode(comparison: Comparison, left: np.ndarray) -> np.ndarray:
    """Chi-square that each mode of the simulation would take away with a free amplitude at every line."""
    problem = comparison.problem
    shapes = np.asarray(problem.modal_form.shapes)[:, np.asarray(problem.outputs)]
    weight = np.asarray(problem.weight)
    product = np.einsum("mo,rfoi->mrfi", shapes.conj(), weight * left, optimize=True)
    length = np.einsum("mo,rfoi->mrfi", np.abs(shapes) ** 2, weight**2, optimize=True)
    return np.divide(np.abs(product) ** 2, length, out=np.zeros(length.shape), where=length > 0).sum(axis=(1, 2, 3))
