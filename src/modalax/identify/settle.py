"""The last look at a refined model: false modes dropped, close ones told apart, error bars that know the misfit."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
import scipy.special
from jaxtyping import Bool, Float

from modalax._numerics.checks import as_array
from modalax._numerics.cuts import cut
from modalax.data.frf import FRF
from modalax.identify.close_modes import NEAR, two_modes, windows_split
from modalax.identify.disagreement import CERTAIN, together
from modalax.identify.flags import matters
from modalax.identify.host import refine_on_host
from modalax.identify.kernels import UNDAMPED
from modalax.identify.local import fit_where_dominant
from modalax.identify.neighbourhood import LINES, WIDTH, Left, around, judged, left_of, residual_of
from modalax.identify.noise import residual_sigma
from modalax.identify.one_mode import second_mode
from modalax.identify.plain import residue_fits
from modalax.identify.quality import CHANCE, ModeQuality, gains_of, quality_of
from modalax.identify.record_kind import Record, record_of
from modalax.identify.refine import CONTRADICTION, CORRELATED, HELD, UNIT, Refined
from modalax.identify.residues import residues
from modalax.model.modal import ModalModel

TURNS = 5  # most times that modes are dropped and the others refined again
MANY = 8  # pairs of close modes, at most, that are asked about the window of a record
WINDOW = 3.0  # lines over which the window of a record spreads a peak
NARROW = 0.01  # half-bandwidth in lines below which a pole is one bad line


def settle(
    frf: FRF, refined: Refined, tell: Callable[[str], None], apart: set[tuple[float, float]] | None = None,
    **options: Any,
) -> Refined:  # fmt: skip
    """The result without modes that are none, refined again where there were any.

    Dropped are modes in the band at the end of the range of damping, those whose evidence noise alone would give, and
    the weaker of two close modes that one mode explains as well (:func:`two_modes`). Where one mode stands for two that
    the lines around it tell apart (:func:`second_mode`), the two take its place.

    Parameters
    ----------
    frf, refined
        The FRF, with its variance where it is known, and a result of maximum likelihood for it.
    tell
        Called with a word on each step.
    apart
        Takes up the pairs of close modes that were told apart, as for :func:`doubled`.
    options
        ``residuals`` and ``real_modes``, as for :func:`modalax.identify.refine`.

    Raises
    ------
    ValueError
        If no mode stands out of the noise.
    """
    if int(refined.reason_code) == HELD:
        return refined
    asked: set[tuple[float, float]] = set() if apart is None else apart
    tried: list[float] = []
    cut = False
    for _ in range(TURNS):
        bad = at_bound(frf, refined) | _in_noise(frf, refined)
        _require(frf, _inside(frf, refined.model) & ~bad)
        seen = judged(frf, residual_of(frf, refined.model))
        bad |= doubled(seen, refined.model, np.asarray(refined.evidence), bad, asked, cut)
        if bad.any():
            tell(f"{int(bad.sum())} mode{'s' * int(bad.sum() > 1)} dropped that the data do not need")
            refined = _again(frf, refined, ~bad, **options)
            continue
        more = _with_seconds(frf, refined, tried, tell, **options)
        refined = refined if more is None else more
        if more is None and (cut or not _cut_short(frf, refined.model)):
            break
        if more is None:  # then all close modes are asked about once more
            cut = True
            asked.clear()
    gains, by_chance = gains_of(judged(frf, residual_of(frf, refined.model)), refined.model)
    _require(frf, _inside(frf, refined.model) & (gains >= by_chance))
    return refined


def _cut_short(frf: FRF, model: ModalModel) -> bool:
    """Whether the resonances, or the modes that stand within a window of each other, plainly show records cut short."""
    inside, residual = _inside(frf, model), residual_of(frf, model)
    frf = judged(frf, residual)
    record = record_of(frf, model, residual, np.flatnonzero(inside))
    if record is not None and record.plain:
        return True
    f, step = np.asarray(model.frequency_hz), float(np.median(np.diff(np.asarray(frf.freq))))
    near = [int(a) for a in np.flatnonzero(np.diff(f) < WINDOW * step) if inside[[a, a + 1]].all()]
    return windows_split(frf, (around(frf, model, residual, [a, a + 1], smooth=True) for a in near[:MANY]))


def settle_diagram(
    frf: FRF, poles: Any, apart: set[tuple[float, float]] | None = None, **options: Any
) -> tuple[ModalModel, Left]:
    """The model of a diagram's poles without those that noise makes and the weaker of two that are one; what it leaves.

    A diagram that has no room finds clear modes with a damping that is far off; these stay. Where modes are dropped
    only those whose lines held one of them are asked about again.

    Parameters
    ----------
    frf, poles
        The FRF, with its variance where it is known, and the diagram's poles, shape ``(n,)`` [rad/s].
    apart
        Takes up the pairs of close modes that were told apart, as for :func:`doubled`.
    options
        ``residuals`` and ``real_modes``, as for :func:`modalax.identify.residues`.

    Raises
    ------
    ValueError
        If no mode stands out of the noise.
    """
    apart = set() if apart is None else apart
    fitted = residue_fits(frf, **options)
    model = fitted(poles)
    left = left_of(frf, model)
    seen = judged(frf, left.residual)
    gains, by_chance = np.zeros((2, len(model.poles)))
    asked = np.ones(len(model.poles), bool)
    for _ in range(TURNS):
        gains[asked], by_chance[asked] = gains_of(seen, model, np.flatnonzero(asked), searched=True, left=left)
        weak = gains < by_chance
        _require(frf, _inside(frf, model) & ~weak)
        bad = weak | doubled(seen, model, gains, weak, apart, left=left)
        if not bad.any():
            break
        asked = _beside(frf, model, bad)[~bad]
        model = fitted(cut(model.poles, ~bad))
        left = left_of(frf, model)
        seen = judged(frf, left.residual)
        gains, by_chance = gains[~bad], by_chance[~bad]
        again = {round(f, 6) for f in np.asarray(model.frequency_hz)[asked].tolist()}
        apart -= {pair for pair in apart if again & set(pair)}
    return model, left


def _beside(frf: FRF, model: ModalModel, which: Bool[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Modes in whose neighbourhood one of some modes acts."""
    f, width = np.asarray(model.frequency_hz), -np.asarray(model.poles.real) / (2 * np.pi)
    reach = np.maximum(WIDTH * width, LINES * float(np.median(np.diff(np.asarray(frf.freq)))))
    apart = np.abs(f[:, None] - f[which])
    return np.any(apart < np.maximum(reach[:, None], reach[which]), axis=1)


def _require(frf: FRF, sound: np.ndarray) -> None:
    if not sound.any():
        raise ValueError(
            f"no mode stands out of the noise between {frf.ends[0]:g} and {frf.ends[1]:g} Hz; what "
            "look like peaks are of the size that noise makes"
        )


def _inside(frf: FRF, model: ModalModel) -> Bool[np.ndarray, " n"]:
    f = np.asarray(model.frequency_hz)
    return (f >= frf.ends[0]) & (f <= frf.ends[1])


def at_bound(frf: FRF, refined: Refined) -> Bool[np.ndarray, " n"]:
    """Modes in the band without damping to speak of, or without a standard deviation."""
    f, zeta = np.asarray(refined.model.frequency_hz), np.asarray(refined.model.damping_ratio)
    step = float(np.median(np.diff(np.asarray(frf.freq))))
    std = np.asarray(refined.damping_std)
    lost = (zeta <= 1.01 * UNDAMPED) | (zeta * f < NARROW * step) | ~np.isfinite(std)
    return _inside(frf, refined.model) & lost


def _in_noise(frf: FRF, refined: Refined) -> Bool[np.ndarray, " n"]:
    """Modes in the band whose evidence a pole and a residue matrix of rank one would find in noise alone."""
    unknowns = 2 * (frf.shape[1] + frf.shape[2] - 1) + 2
    need = scipy.special.chdtri(unknowns, CHANCE)
    return _inside(frf, refined.model) & (np.asarray(refined.evidence) < need)


def doubled(
    frf: FRF, model: ModalModel, evidence: np.ndarray, gone: np.ndarray, asked: set[tuple[float, float]],
    cut: bool = False, left: Left | None = None,
) -> Bool[np.ndarray, " n"]:  # fmt: skip
    """The weaker of each two close modes that the data do not tell apart, shape ``(n,)``; see :func:`pairs_of_one`."""
    drop = np.zeros(model.poles.size, bool)
    drop[[weaker for weaker, _ in pairs_of_one(frf, model, evidence, gone, asked, cut, left)]] = True
    return drop


def pairs_of_one(
    frf: FRF, model: ModalModel, evidence: np.ndarray, gone: np.ndarray, asked: set[tuple[float, float]],
    cut: bool = False, left: Left | None = None,
) -> list[tuple[int, int]]:  # fmt: skip
    """Pairs of close modes that one mode explains as well, the weaker of each first; it is asked about no more.

    Parameters
    ----------
    frf, model
        The FRF and a modal model of it.
    evidence
        By how much each mode raises the likelihood, shape ``(n,)``.
    gone
        Modes that are not asked about, shape ``(n,)``.
    asked
        Pairs of frequencies that were asked about before and are not again; those of this call are added.
    cut
        Whether the records are known to be cut short.
    left
        What the model leaves of the FRF, if that is known.
    """
    f, width = np.asarray(model.frequency_hz), -np.asarray(model.poles.real) / (2 * np.pi)
    step = float(np.median(np.diff(np.asarray(frf.freq))))
    inside, gone, found = _inside(frf, model), gone.copy(), []
    pairs = np.transpose(np.triu_indices(len(f), 1))
    for a, b in pairs[np.argsort(np.abs(f[pairs[:, 0]] - f[pairs[:, 1]]))].tolist():  # the nearest first
        close = abs(f[a] - f[b]) < NEAR * max(step, width[a] + width[b])
        pair = (round(float(f[a]), 6), round(float(f[b]), 6))
        if not close or gone[[a, b]].any() or pair in asked or not inside[[a, b]].any():
            continue
        asked.add(pair)
        left = left_of(frf, model) if left is None else left
        # The window of a record splits a peak over the few lines that it is wide.
        window = cut and abs(f[a] - f[b]) < WINDOW * step
        if not two_modes(frf, model, left.residual, (a, b), window, left.scatter):
            found.append((a, b) if evidence[a] < evidence[b] else (b, a))
            gone[found[-1][0]] = True
    return found


def _with_seconds(
    frf: FRF, refined: Refined, tried: list[float], tell: Callable[[str], None], **options: Any
) -> Refined | None:
    """The result with two modes in the place of each that stands for two; None if there is none.

    Two stay if they leave nothing that one of them alone would explain better, nor inputs or outputs that disagree.
    Frequencies that were ``tried`` before are not tried again; those of this call are added. Where rows contradict each
    other no single set of poles explains the data, and two modes in the place of one would be no better.
    """
    model = refined.model
    if int(refined.reason_code) == CONTRADICTION:
        return None
    f, width = np.asarray(model.frequency_hz), -np.asarray(model.poles.real) / (2 * np.pi)
    inside, residual = _inside(frf, model), residual_of(frf, model)
    seen = judged(frf, residual)
    pairs: dict[int, np.ndarray] = {}
    for r in np.flatnonzero(inside):
        pair = second_mode(seen, model, residual, int(r)) if all(abs(f[r] - g) >= width[r] for g in tried) else None
        if pair is not None:
            pairs[int(r)] = pair
    tried += [float(f[r]) for r in pairs]
    if not pairs:
        return None
    tell(f"{len(pairs)} resonance{'s' * (len(pairs) > 1)} of two close modes")
    new = _from_poles(frf, refined, _split(model, pairs), **options)
    quality, poles = quality_of(seen, new.model), np.asarray(new.model.poles)
    sound = np.array([not (q.rest.plain or matters(q.inputs, w) or matters(q.outputs, w)) for q, w in
                      zip(quality, (-poles.real / (2 * np.pi)).tolist(), strict=True)])  # fmt: skip
    kept = {r: pair for r, pair in pairs.items() if all(sound[np.argmin(np.abs(poles - p))] for p in pair)}
    if not kept:
        return None
    if len(kept) < len(pairs):
        new = _from_poles(frf, refined, _split(model, kept), **options)
    return _again(frf, new, np.ones(len(new.model.poles), bool), **options)


def _split(model: ModalModel, pairs: dict[int, np.ndarray]) -> np.ndarray:
    """Poles of a model with two in the place of some."""
    return np.concatenate([pairs.get(r, np.atleast_1d(pole)) for r, pole in enumerate(np.asarray(model.poles))])


def _from_poles(frf: FRF, refined: Refined, poles: np.ndarray, **options: Any) -> Refined:
    """A refinement from other poles, with the noise that the residual of the present one shows."""
    known = frf.variance is not None
    weights: Any = "auto" if known else _weights(frf, refined)
    start = residues(frf, poles[np.argsort(np.abs(poles))], weights=weights, **options)
    return refine_on_host(frf, start, weights=weights, covariance="gauss-newton" if known else "robust", **options)


def _again(frf: FRF, refined: Refined, keep: np.ndarray, **options: Any) -> Refined:
    """The other modes refined with the weights that their own residual gives, as the search ends."""
    model = refined.model
    model = model.replace(
        poles=cut(model.poles, keep), shapes=cut(model.shapes, keep), participation=cut(model.participation, keep),
        frequency_std=0.0, damping_std=0.0,
    )  # fmt: skip
    known = frf.variance is not None
    weights: Any = "auto" if known else _weights(frf, refined)
    kind = "gauss-newton" if known else "robust"
    new = refine_on_host(frf, model, weights=weights, covariance=kind, **options)
    if int(refined.reason_code) == CONTRADICTION and float(new.whiteness) < CORRELATED:
        new = fit_where_dominant(frf, new, **options)
    return new


def _weights(frf: FRF, refined: Refined) -> Any:
    """Standard deviations that the residual of a model shows."""
    scale = UNIT * jnp.sqrt(jnp.mean(jnp.abs(frf.H) ** 2))
    plain = dataclasses.replace(refined, residual=as_array(residual_of(frf, refined.model)) / scale)
    return residual_sigma(frf, plain, "auto", proportional=True)


def with_misfit(refined: Refined, quality: list[ModeQuality]) -> Refined:
    """The result with standard deviations of poles that know how much the parts of the data disagree on them.

    Where flanks, inputs or outputs differ beyond noise, the deviation of their random-effects mean takes the place of
    a smaller one; inputs or outputs that all modes together say differ do so for each mode. Correlations stay.
    """
    f, zeta = np.asarray(refined.model.frequency_hz), np.asarray(refined.model.damping_ratio)
    old = _deviations(refined)
    sides = [[q.inputs for q in quality], [q.outputs for q in quality]]
    differ = [together([s.chance for s in side if s is not None]) < CERTAIN for side in sides]
    new = [_with_spread(old[r], f[r], zeta[r], q, differ) for r, q in enumerate(quality)]
    return _widened(refined, np.array(new))


def with_seconds(refined: Refined, quality: list[ModeQuality], which: np.ndarray) -> Refined:
    r"""The result with deviations that know how far the two modes are that one may stand for, where ``which`` says so.

    Its pole lies between theirs, :math:`\sqrt{|\overline{(\lambda_j-\lambda)^2}|}` from them, root mean square.
    Correlations stay.
    """
    f = np.asarray(refined.model.frequency_hz)
    apart = np.sqrt([abs(q.rest.spread) for q in quality]) / (2 * np.pi) * np.asarray(which)
    return _widened(refined, np.hypot(_deviations(refined), np.stack([apart, apart / f], axis=1)))


def with_record(refined: Refined, record: Record | None) -> Refined:
    """The result with standard deviations of poles that know what the window of a record may have changed.

    The variance grows by the square of the change times the probability of the record, as that of a mean over both
    models does (Hoeting, Madigan, Raftery and Volinsky 1999, equation 3). Correlations stay.
    """
    if record is None:
        return refined
    f, zeta = np.asarray(refined.model.frequency_hz), np.asarray(refined.model.damping_ratio)
    change = np.nan_to_num(np.stack([record.frequency_hz - f, record.damping_ratio - zeta], axis=1), nan=0.0)
    return _widened(refined, np.hypot(_deviations(refined), np.sqrt(record.probability) * change))


def _deviations(refined: Refined) -> Float[np.ndarray, "n 2"]:
    return np.stack([np.asarray(refined.frequency_std_hz), np.asarray(refined.damping_std)], axis=1)


def _widened(refined: Refined, new: np.ndarray) -> Refined:
    """The result with other deviations of frequencies and dampings, shape ``(n, 2)``."""
    old, new = _deviations(refined), new.reshape(-1, 2)
    scale: Float[np.ndarray, " p"] = np.where(old > 0, new / np.where(old > 0, old, 1.0), 1.0).ravel()
    return dataclasses.replace(
        refined, frequency_std_hz=as_array(new[:, 0]), damping_std=as_array(new[:, 1]),
        covariance=scale[:, None] * refined.covariance * scale,
    )  # fmt: skip


def _with_spread(std: np.ndarray, f: float, zeta: float, quality: ModeQuality, differ: list[bool]) -> np.ndarray:
    f_std, zeta_std = float(std[0]), float(std[1])
    for spread, certain in zip((quality.lines, quality.inputs, quality.outputs), (False, *differ), strict=True):
        if spread is not None and (certain or spread.chance < CERTAIN):
            f_std = max(f_std, spread.error[0])
            zeta_std = max(zeta_std, float(np.hypot(spread.error[1], zeta * spread.error[0]) / f))
    return np.array([f_std, zeta_std])
