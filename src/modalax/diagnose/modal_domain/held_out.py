"""What the corrected simulation and the causes gain on a block of the data that they were not fitted to."""

from dataclasses import replace

import numpy as np

from modalax.diagnose.deadline import Deadline
from modalax.diagnose.decision.gain import Gain
from modalax.diagnose.holdout import BLOCKS, RESAMPLED, held_out_block
from modalax.diagnose.modal_domain.causes import Change, own_sizes
from modalax.diagnose.modal_domain.corrected import frf_of
from modalax.diagnose.modal_domain.explain import Explanation
from modalax.diagnose.modal_domain.features import chosen, features_of, sure
from modalax.diagnose.modal_domain.fit import Fit, fit, without_causes
from modalax.diagnose.modal_domain.free_residues import Channels
from modalax.diagnose.modal_domain.further_causes import MissingMode
from modalax.diagnose.modal_domain.levels.seen import foretold
from modalax.diagnose.modal_domain.mode_count import blind_modes, misfit
from modalax.diagnose.modal_domain.polish import lines_of, on_lines
from modalax.diagnose.modal_domain.stage import Stage
from modalax.diagnose.modal_domain.state import Setting


def gain_of(stage: Stage, found: Explanation, before: np.ndarray) -> Gain:
    """Fit again without the held-out block and compare on it; ``before`` is the simulation's FRF, ``(f, o, i)``."""
    m = stage.measurement
    H, sigma = np.asarray(m.H), stage.measured.noise.sigma
    joint = None if stage.seen is None else foretold(stage.seen)
    alike = len(stage.measured.runs) == len(H) or joint is not None
    words, mask = held_out_block(np.asarray(m.level), m.inputs, H.shape, H.shape[1], alike)
    after = frf_of(stage, _without(stage, found.fit, mask)) if joint is None else joint
    weight = np.where(mask, np.sqrt(2) / sigma, 0.0)
    count = 2 * int(mask.sum())
    chi2 = [np.abs(weight * (H - p)) ** 2 for p in (before, after)]
    by_line = 0.5 * (chi2[0] - chi2[1]).sum(axis=(0, 2, 3))
    blocks = np.array([b.sum() for b in np.array_split(by_line, min(BLOCKS, len(by_line)))])
    rng = np.random.default_rng(0)
    draws = blocks[rng.integers(len(blocks), size=(RESAMPLED, len(blocks)))].sum(axis=1)
    return Gain(
        words, float(chi2[0].sum() / count), float(chi2[1].sum() / count), float(by_line.sum()), float(draws.std())
    )


def _without(stage: Stage, f: Fit, mask: np.ndarray) -> Fit:
    """The same explanation fitted to all but the held-out samples; the fit to all where that cannot be."""
    m, found = stage.measurement, stage.measured
    H, sigma = np.asarray(m.H)[found.runs], found.noise.sigma[found.runs]
    weight = np.where(mask[found.runs], 0.0, 1 / sigma**2)
    total = weight.sum(axis=0)
    kept = total.any(axis=(0, 1))  # inputs that are left
    if not kept.any():
        return f
    mean = ((weight * H).sum(axis=0) / np.maximum(total, 1e-300))[:, :, kept]
    flat = (len(mean), -1)
    c = found.channels
    channels = Channels(c.s, mean.reshape(flat), 2 * total[:, :, kept].reshape(flat), c.order, c.outside)
    modes = blind_modes(channels, found.modes.poles)
    features = features_of(modes, mean.shape[1], mean.shape[2], misfit(modes, channels))
    size = np.abs(features.poles)
    known = sure(features) & (size > abs(c.s[0])) & (size < abs(c.s[-1]))
    if not known.any():
        return f
    features = chosen(features, known)
    try:
        whitener = np.linalg.inv(np.linalg.cholesky(features.covariance))
    except np.linalg.LinAlgError:
        return f
    inputs = stage.coordinates.inputs[kept]
    setting = replace(
        stage.setting, coordinates=replace(stage.coordinates, inputs=inputs), features=features, whitener=whitener
    )
    names = m.outputs, m.inputs
    moved = [(k, _renumbered(cause, kept, setting, names)) for k, cause in enumerate(f.causes)]
    some = np.concatenate([np.zeros(0, int)] + [
        np.arange(len(f.u))[own_sizes(f.causes, k)] for k, cause in moved if cause is not None])  # fmt: skip
    causes = tuple(cause for _, cause in moved if cause is not None)
    again = fit(setting, tuple(_seen(cause, kept) for cause in causes), without_causes(f), f.u[some], temperatures=())
    if again is None:
        return f
    again = on_lines(setting, again, lines_of(channels, setting), Deadline())
    u = f.u.copy()
    u[some] = again.u
    every = tuple(whole if isinstance(whole, MissingMode) else cause for cause, (_, whole) in zip(
        f.causes, moved, strict=True))  # fmt: skip
    return replace(f, causes=every, sizes=again.sizes, u=u)


def _seen(cause: Change, kept: np.ndarray) -> Change:
    """A mode that the simulation lacks, at the inputs that are left."""
    if not isinstance(cause, MissingMode) or cause.residue is None:
        return cause
    return replace(cause, residue=cause.residue[:, kept])


def _renumbered(
    cause: Change, kept: np.ndarray, setting: Setting, names: tuple[tuple[str, ...], tuple[str, ...]]
) -> Change | None:
    """A cause on the inputs that are left; None where it sits on another."""
    if isinstance(cause, MissingMode):
        f = setting.features
        k = int(np.argmin(np.abs(f.poles - cause.pole)))
        residue = by_reciprocity(f.residues[k] * f.units[k], kept, *names)
        return replace(cause, number=k, pole=complex(f.poles[k]), residue=residue)
    if cause.slug != "force_gain":
        return cause
    if not kept[cause.channel[1]]:
        return None
    return replace(cause, channel=(1, int(kept[: cause.channel[1]].sum())))


def by_reciprocity(A: np.ndarray, kept: np.ndarray, outputs: tuple[str, ...], inputs: tuple[str, ...]) -> np.ndarray:
    """Residues of a mode at all inputs from those at some, ``A`` of shape ``(o, kept)``; 0 where none can be known.

    A mode moves an input as it moves the output there, so one measured at its own driving point tells the others.
    """
    out = np.zeros((len(outputs), len(inputs)), complex)
    out[:, kept] = A
    driven = [(n, k) for n, k in enumerate(np.flatnonzero(kept)) if inputs[k] in outputs]
    if not driven:
        return out
    n, _ = max(driven, key=lambda one: abs(A[outputs.index(inputs[one[1]]), one[0]]))
    shape = A[:, n]
    own = shape[outputs.index(inputs[np.flatnonzero(kept)[n]])]
    for k in np.flatnonzero(~kept):
        if inputs[k] in outputs and own != 0:
            out[:, k] = shape * shape[outputs.index(inputs[k])] / own
    return out
