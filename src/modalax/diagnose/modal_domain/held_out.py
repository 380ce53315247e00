"""What the corrected simulation and the causes gain on a block of the data that they were not fitted to."""

from dataclasses import dataclass, replace

import numpy as np

from modalax.diagnose.deadline import Deadline
from modalax.diagnose.decision.gain import Gain
from modalax.diagnose.holdout import deviation_of_sum, held_out_block
from modalax.diagnose.modal_domain.causes.change import Change, own_sizes
from modalax.diagnose.modal_domain.causes.further_causes import MissingMode
from modalax.diagnose.modal_domain.corrected import frf_of
from modalax.diagnose.modal_domain.fitting.explanation import Explanation
from modalax.diagnose.modal_domain.fitting.fit import Fit, fit, without_causes
from modalax.diagnose.modal_domain.fitting.narrowed import DIRECTIONS, narrowed
from modalax.diagnose.modal_domain.fitting.state import Setting, state_at
from modalax.diagnose.modal_domain.levels.seen import drift_by_run, foretold
from modalax.diagnose.modal_domain.modes.features import Features, chosen, sure, whitener_of
from modalax.diagnose.modal_domain.modes.free_residues import Channels
from modalax.diagnose.modal_domain.modes.measured import channels_of, features_at
from modalax.diagnose.modal_domain.modes.mode_count import blind_modes, heavy, misfit
from modalax.diagnose.modal_domain.on_lines.lines import lines_of
from modalax.diagnose.modal_domain.on_lines.polish import BEYOND_MODES, chi2_of, on_lines, unforeseen
from modalax.diagnose.modal_domain.search.explain import far_off
from modalax.diagnose.modal_domain.stage import Stage

APART = 10.0  # times that the deviations of a mode may grow once a column is held out
ELSEWHERE = 3.0  # half-bandwidths by which a peak is beyond what steps on the lines reach
BESIDE = 5.0  # half-bandwidths by which a mode may move once a block is held out


def gain_of(stage: Stage, found: Explanation, before: np.ndarray) -> Gain:
    """Fit again without the held-out block and compare on it; ``before`` is the simulation's FRF, ``(f, o, i)``.

    With three force levels that is the highest whatever was found (beside a joint that is told from the highest on the
    lowest), but a drift from run to run, which tells nothing of a further run.
    """
    m, seen = stage.measurement, stage.seen
    H, sigma, level = np.asarray(m.H), stage.measured.noise.sigma, np.asarray(m.level)
    joint = None if seen is None else foretold(seen)
    drifts = seen is not None and seen.drift is not None
    levels = len(np.unique(level)) if np.isfinite(level).all() else 0
    alike = not drifts and (len(stage.measured.runs) == len(H) or joint is not None or levels > 2)
    lacking = any(c.freed is not None for c in found.causes)  # of a further column its shape tells nothing
    exchanged = any(c.at_inputs and len(c.where) > 1 and m.inputs[-1] in c.where for c in found.causes)
    column = not lacking and not exchanged and last_is_foretold(stage.measured.features)
    fitted_down = joint is not None and seen is not None and seen.levels.force[0] > seen.levels.force[-1]
    words, mask = held_out_block(level, m.inputs, H.shape, H.shape[1], alike, column, fitted_down)
    beyond = float("nan")
    if joint is None or seen is None:
        rest = _rest(stage, mask)
        alone = next((e.fit for e in stage.explanations if not e.causes), None) if found.causes else None
        fitted = _without(stage, found.fit, rest)
        after, beyond = frf_of(stage, fitted), _beyond_errors(stage, fitted, mask)
        plain = None if alone is None else frf_of(stage, _without(stage, alone, rest))
        if drifts and seen is not None:
            moved, words = drift_by_run(seen, stage.measured, level), f"{words}; the drift was fitted to all"
            after, plain = after + moved, None if plain is None else plain + moved
    else:
        after, plain = joint, seen.base.H
    weight = np.where(mask, np.sqrt(2) / sigma, 0.0)
    count = 2 * int(mask.sum())
    chi2 = [np.abs(weight * (H - p)) ** 2 for p in (before, after)]
    by_line = 0.5 * (chi2[0] - chi2[1]).sum(axis=(0, 2, 3))
    gain = Gain(
        words, float(chi2[0].sum() / count), float(chi2[1].sum() / count), float(by_line.sum()),
        deviation_of_sum(by_line), chi2_unforeseen=beyond,
    )  # fmt: skip
    if plain is None:
        return gain
    alone_chi2 = np.abs(weight * (H - plain)) ** 2
    worse = 0.5 * (chi2[1] - alone_chi2).sum(axis=(0, 2, 3))[mask.any(axis=(0, 2, 3))]
    preferred = float(worse.sum()) / max(deviation_of_sum(worse), 1e-300)
    return replace(gain, chi2_plain=float(alone_chi2.sum() / count), preferred=preferred)


def last_is_foretold(f: Features) -> bool:
    """Whether the other columns tell of all modes that the last input excites; one that it excites alone they do not.

    What a column tells of a mode grows with the squares of its residues over their deviations.
    """
    told = (np.abs(f.residues) ** 2).sum(axis=1)
    return bool((told[:, -1] <= APART**2 * told[:, :-1].sum(axis=1)).all())


def _beyond_errors(stage: Stage, f: Fit, mask: np.ndarray) -> float:
    """Chi-square per sample on the held-out samples that errors of a fit to the others do not explain."""
    H, found = np.asarray(stage.measurement.H), stage.measured
    c, used = found.channels, np.isin(np.arange(len(H)), found.runs)[:, None, None, None]
    fitted, left_out = (
        lines_of(channels_of(c.s, H, np.where(some, found.noise.sigma, 0.0), c.order, c.outside), stage.setting)
        for some in (~mask & used, mask)
    )
    return unforeseen(stage.setting, f, fitted, left_out) / max(left_out.samples, 1)


@dataclass(frozen=True)
class Rest:
    """All but the held-out samples: what hypotheses are fitted to, their lines, and which inputs are left."""

    setting: Setting
    channels: Channels
    kept: np.ndarray


def _rest(stage: Stage, mask: np.ndarray) -> Rest | None:
    """Identify all but the held-out samples again; None where nothing is left to identify."""
    m, found = stage.measurement, stage.measured
    H, sigma = np.asarray(m.H)[found.runs], found.noise.sigma[found.runs]
    weight = np.where(mask[found.runs], 0.0, 1 / sigma**2)
    total = weight.sum(axis=0)
    kept = total.any(axis=(0, 1))  # inputs that are left
    if not kept.any():
        return None
    mean = ((weight * H).sum(axis=0) / np.maximum(total, 1e-300))[:, :, kept]
    flat = (len(mean), -1)
    c = found.channels
    channels = Channels(c.s, mean.reshape(flat), 2 * total[:, :, kept].reshape(flat), c.order, c.outside)
    modes = blind_modes(channels, found.modes.poles)
    features, several = features_at(modes, channels, mean.shape[1:], misfit(modes, channels), found.apart)
    size = np.abs(features.poles)
    known = sure(features) & ~heavy(features.poles) & (size > abs(c.s[0])) & (size < abs(c.s[-1])) & ~several
    if not known.any():
        return None
    features = chosen(features, known)
    whitener = whitener_of(features)
    inputs = stage.coordinates.inputs[kept]
    setting = replace(
        stage.setting, coordinates=replace(stage.coordinates, inputs=inputs), features=features, whitener=whitener
    )
    return Rest(narrowed(setting, DIRECTIONS) or setting, channels, kept)


def _without(stage: Stage, f: Fit, rest: Rest | None) -> Fit:
    """The same explanation fitted to all but the held-out samples; the fit to all where that cannot be.

    FRFs that are no sum of modes, as those beside a joint that relaxes, have other modes in a part of them: what was
    fitted to all is as good a start there as a fit to the modes of that part.
    """
    if rest is None or (not f.causes and far_off(f)):
        return f
    setting, kept = rest.setting, rest.kept
    moved = [(k, _renumbered(cause, kept, setting)) for k, cause in enumerate(f.causes)]
    some = np.concatenate([np.zeros(0, int)] + [
        np.arange(len(f.u))[own_sizes(f.causes, k)] for k, cause in moved if cause is not None])  # fmt: skip
    causes = tuple(cause for _, cause in moved if cause is not None)
    again = fit(setting, causes, without_causes(f), f.u[some], temperatures=())
    if again is None:
        return f
    if _peaks_elsewhere(again, setting.features):
        return replace(f, sizes=again.sizes)
    lines = lines_of(rest.channels, setting)
    again = on_lines(setting, again, lines, Deadline())
    left = chi2_of(setting, again, lines)
    if len(some) == len(f.u) and left > BEYOND_MODES * stage.measured.misfit * lines.samples:
        try:
            known = replace(f, causes=causes, state=state_at(setting, f.sizes, causes, f.u))
        except np.linalg.LinAlgError:
            known = again
        known = on_lines(setting, known, lines, Deadline())
        again = known if chi2_of(setting, known, lines) < left else again
    u = f.u.copy()
    u[some] = again.u
    every = tuple(whole if isinstance(whole, MissingMode) else cause for cause, (_, whole) in zip(
        f.causes, moved, strict=True))  # fmt: skip
    return replace(f, causes=every, sizes=again.sizes, u=u)


def _peaks_elsewhere(f: Fit, features: Features) -> bool:
    """Whether the general inaccuracy alone leaves most peaks elsewhere, from where no steps on the lines lead to them.

    Of a hypothesis with causes that is for the lines to say, which know it better than its modes do.
    """
    apart = np.abs(f.state.modes.poles[f.state.pairs] - features.poles)
    return not f.causes and bool(np.median(apart / np.abs(features.poles.real)) > ELSEWHERE)


def _renumbered(cause: Change, kept: np.ndarray, setting: Setting) -> Change | None:
    """A cause on the inputs that are left; None where it sits on another."""
    if isinstance(cause, MissingMode):
        f = setting.features
        k = int(np.argmin(np.abs(f.poles - cause.pole)))
        if abs(f.poles[k] - cause.pole) > BESIDE * abs(cause.pole.real):  # its peak is what was held out
            return None
        return replace(cause, number=k, pole=complex(f.poles[k]), residue=f.residues[k] * f.units[k])
    return cause.among(kept)
