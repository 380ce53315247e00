r"""Shapes of a simulation that is known by its modes alone are off at each DoF by itself.

Modes that were not exported take part in those of the structure. As their shapes are not known, that is a scatter of
shapes, of one size relative to the motion of each mode, chosen by evidence and added to the covariance of the features.
Before FRFs are looked at line by line, the shapes are corrected by what the likeliest explanation makes of it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from modalax.diagnose.modal_domain.explain import Explanation
from modalax.diagnose.modal_domain.features import slopes_of_values, whitener_of
from modalax.diagnose.modal_domain.fit import Fit, fit
from modalax.diagnose.modal_domain.state import Setting, State, state_at

SIZES = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2)  # relative scatter that is tried
AGAIN = 3  # explanations that are fitted with the shapes corrected


def with_scatter(setting: Setting) -> Setting:
    """The setting with the scatter that makes the measurement likeliest, nothing standing out."""
    best, top = setting, -np.inf
    for size in (0.0, *SIZES):
        try:
            trial = _widened(setting, size)
        except np.linalg.LinAlgError:
            return setting
        f = fit(trial)
        value = -np.inf if f is None else f.log_evidence + float(np.linalg.slogdet(trial.whitener)[1])
        if value > top:
            best, top = trial, value
    return best


def scatter_told(setting: Setting, explanations: Sequence[Explanation]) -> tuple[Setting, list[Explanation]]:
    """The setting with corrected shapes in the place of their scatter, and the explanations; probabilities stay."""
    told = _corrected(setting, explanations[0].fit)
    out = []
    for e in explanations[:AGAIN]:
        again = fit(told, e.causes, e.fit, e.fit.u, temperatures=())
        out.append(e if again is None else replace(e, fit=again))
    return told, [*out, *explanations[AGAIN:]]


def _widened(setting: Setting, size: float) -> Setting:
    if not size:
        return setting
    J = size * scatter_slopes(setting, state_at(setting, np.zeros(len(setting.inaccuracy.group_of))))
    features = replace(setting.features, covariance=setting.features.covariance + J @ J.T)
    return replace(setting, whitener=whitener_of(features), scatter=size)


def scatter_slopes(setting: Setting, state: State) -> np.ndarray:
    """Derivatives of the features by relative changes of the shapes at each DoF, ``(features, modes * DoFs)``."""
    f = setting.features
    outs, ins, rms = _shapes(setting, state)
    k, d = len(rms), len(_rows(setting))
    moved = np.zeros((k, k, d, *f.units.shape[1:]), complex)
    for j, (at, to) in enumerate(_rows(setting)):
        for r in range(k):
            if at is not None:
                moved[r, r, j, at] += rms[r] * ins[r]
            if to is not None:
                moved[r, r, j, :, to] += rms[r] * outs[r]
    moved = moved.reshape(k, k * d, *f.units.shape[1:]) / f.units[:, None]
    still = np.zeros((k, k * d), complex)
    seen = state.residues[state.pairs] / f.units
    poles = state.modes.poles[state.pairs]
    return slopes_of_values(poles, seen, f.tangent, still, moved, setting.linear).reshape(-1, k * d)


def _rows(setting: Setting) -> list[tuple[int | None, int | None]]:
    """Of each measured DoF its number among outputs and inputs."""
    c = setting.coordinates
    same = [next((k for k, row in enumerate(c.outputs) if np.array_equal(row, b)), None) for b in c.inputs]
    rows: list[tuple[int | None, int | None]] = [
        (k, same.index(k) if k in same else None) for k in range(len(c.outputs))
    ]  # fmt: skip
    return rows + [(None, j) for j, k in enumerate(same) if k is None]


def _shapes(setting: Setting, state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shapes of the paired modes at outputs and inputs, and how much each moves in the mean."""
    c, v = setting.coordinates, state.modes.vectors[state.pairs]
    outs, ins = v @ c.outputs.T, v @ c.inputs.T
    turn = np.sqrt(1 / (2j * state.modes.poles[state.pairs].imag))  # of shapes of unit modal mass
    return outs, ins, turn * np.sqrt((np.abs(outs / turn[:, None]) ** 2).mean(axis=1))


def _corrected(setting: Setting, f: Fit) -> Setting:
    """The setting with the shapes at measured DoFs corrected by the likeliest scatter beside a fit."""
    c, state = setting.coordinates, f.state
    J = setting.scatter * scatter_slopes(setting, state)
    whitened = setting.whitener @ J
    z = (setting.scatter * whitened.T @ state.difference).reshape(len(state.pairs), -1)
    v, (_, _, rms) = state.modes.vectors[state.pairs], _shapes(setting, state)
    turn = np.sqrt(1 / (2j * state.modes.poles[state.pairs].imag))
    real, moved = (v / turn[:, None]).real, np.abs(rms / turn)[:, None] * z
    change = np.linalg.lstsq(real, moved, rcond=None)[0]
    outputs, inputs, shapes = c.outputs.copy(), c.inputs.copy(), c.shapes.copy()
    for j, (at, to) in enumerate(_rows(setting)):
        row = c.outputs[at] if at is not None else c.inputs[to]
        shapes[(c.shapes == row).all(axis=1)] += change[:, j]
        if at is not None:
            outputs[at] += change[:, j]
        if to is not None:
            inputs[to] += change[:, j]
    told = replace(c, outputs=outputs, inputs=inputs, shapes=shapes, everywhere=shapes)
    return replace(setting, coordinates=told, whitener=whitener_of(setting.features), scatter=0.0)
