"""Where an attached oscillator may sit, by finite sizes: its places are screened once a measured mode is too many."""

import numpy as np

from modalax.diagnose.modal_domain.causes import Change
from modalax.diagnose.modal_domain.further_causes import TunedMass
from modalax.diagnose.modal_domain.screen import STILL, distance, tolerance
from modalax.diagnose.modal_domain.state import Setting

NEAR = (0.88, 0.94, 0.98, 1.0, 1.02, 1.06, 1.12)  # frequencies that are tried, over that of the mode too many
MASSES = (0.1, 0.4, 1.0)  # roots of masses that are tried, over the usual
LEADING = 6  # places that are fitted


def oscillators(
    setting: Setting, candidates: list[Change], extra: Change
) -> list[tuple[TunedMass, np.ndarray]]:  # fmt: skip
    """Leading places of an oscillator near the pole of the mode that is too many, with sizes to start from."""
    assert extra.freed is not None
    near_to = abs(setting.features.poles[extra.freed])
    shrink, found = tolerance(setting, lacking=(extra,))[1], []
    for cause in candidates:
        if not isinstance(cause, TunedMass):
            continue
        trials = [
            np.array([u, np.log(near_to * near / cause.middle) / cause.width, 0.0]) for u in MASSES for near in NEAR
        ]
        values = [
            distance(setting, shrink, poles, residues) + float(u @ u)
            for u, (poles, residues) in zip(trials, _modes(setting, cause, trials), strict=True)
        ]
        best = int(np.argmin(values))
        found.append((values[best], cause, trials[best]))
    found.sort(key=lambda one: one[0])
    return [(cause, u) for _, cause, u in found[:LEADING]]


def _modes(setting: Setting, cause: TunedMass, trials: list[np.ndarray]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Poles and residues of the simulation with an oscillator, damping mode by mode, which is exact enough to rank."""
    c = setting.coordinates
    changes = [cause.changes(u) for u in trials]
    values, Q = np.linalg.eigh(np.diag(c.frequencies**2) + np.stack([change["K"] for change in changes]))
    m = c.solved
    w, Q = np.sqrt(np.maximum(values[:, :m], 0.0)), Q[:, :, :m]
    w = np.maximum(w, STILL * c.frequencies[-2])
    damping = c.damping + np.stack([change["C"] for change in changes])
    own = np.clip(np.einsum("knr,knr->kr", Q, damping @ Q), 1e-6 * w, 1.9 * w)
    poles = -own / 2 + 1j * np.sqrt(w**2 - own**2 / 4)
    residues = np.einsum("kom,kim->kmoi", c.outputs @ Q, c.inputs @ Q) / (2j * poles.imag)[:, :, None, None]
    return list(zip(poles, residues, strict=True))
