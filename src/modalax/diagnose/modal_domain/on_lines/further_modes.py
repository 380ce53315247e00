r"""What modes add to the FRFs that a simulation leaves out which is given as modes.

A modal model ends at some mode. The modes above add :math:`U_{oi}` to a receptance in the band, real where they are
lightly damped. The measurement tells it: what its own modes in the band leave, less the modes beyond the band that the
simulation does have. Faults of channels act on it as on all else. In modal coordinates it is that of spare ones,
:math:`U_{oi} = \sum_k\phi_{ok}\phi_{ik}/\Omega^2`, as many as there are channels on the shorter side.
"""

from dataclasses import replace

import numpy as np

from modalax.diagnose.modal_domain.causes.change import Change, shown
from modalax.diagnose.modal_domain.fitting.fit import Fit
from modalax.diagnose.modal_domain.fitting.state import Setting
from modalax.diagnose.modal_domain.modes.measured import Measured
from modalax.diagnose.modal_domain.on_lines.polish import frf_on_lines

LINES = 60  # frequency lines at which residual terms are compared, which are smooth
NEXT = 1.5  # times the ends of the band within which a mode of the simulation is next to it
OFF = 0.05  # usual error of its residues, relative to the largest of them


def with_further_modes(setting: Setting, f: Fit, measured: Measured) -> Setting:
    """The setting with residual terms of each FRF, beside a fit of the modes."""
    c = setting.coordinates
    flexible = residual_terms(setting, f, measured)
    outputs, inputs = c.outputs.copy(), c.inputs.copy()
    spare = np.arange(c.size - c.spares, c.size - 1)
    unit = np.eye(len(spare))
    outer, inner = (flexible, unit) if len(inputs) == len(spare) else (unit, flexible.T)
    outputs[:, spare], inputs[:, spare] = outer * c.frequencies[spare], inner * c.frequencies[spare]
    return replace(setting, coordinates=replace(c, outputs=outputs, inputs=inputs))


def residual_terms(setting: Setting, f: Fit, measured: Measured) -> np.ndarray:
    """U [m/N] of each FRF, shape ``(o, i)``.

    Modes next to the band are off as those in it are, which must not be taken for a residual term: beside it their
    residues may be off by a part of their size.
    """
    c, channels, modes = setting.coordinates, measured.channels, measured.modes
    origin, shape = measured.features.origin, (len(c.outputs), len(c.inputs))
    known = np.arange(len(modes.poles)) if origin is None else origin.together.every
    others = np.setdiff1d(np.arange(len(modes.poles)), known)
    few = np.linspace(0, len(channels.s) - 1, min(LINES, len(channels.s))).astype(int)
    rest = replace(modes, poles=modes.poles[others], residues=modes.residues[others]).made(channels)[few]
    s, found = channels.s[few], f.state.modes
    form = s[:, None, None] ** channels.order
    inside = f.state.together.every
    beyond = np.setdiff1d(np.arange(len(found.poles)), inside)
    poles, residues = found.poles[beyond], found.residues(c)[beyond]
    own = shown(f.causes, f.u, s, _made(s, found.poles[inside], found.residues(c)[inside]) * form)
    left = rest.reshape(-1, *shape) + own - frf_on_lines(setting, f.causes, f.sizes, f.u, s, channels.order)
    shapes, squares = found.high
    above = (c.outputs @ shapes.T / squares) @ (shapes @ c.inputs.T)
    low, high = np.abs(channels.s[[0, -1]])
    size = np.abs(poles)
    beside = np.flatnonzero((size > low / NEXT) & (size < high * NEXT))
    static = np.abs(residues / poles[:, None, None])[size > high].sum(axis=0) + np.abs(above)
    usual = [np.full(shape, max(float(static.max(initial=0.0)), 1e-300))]
    kernels = [form[:, 0, 0]]
    for k in beside:
        own = np.full(shape, OFF * np.abs(residues[k]).max())
        for part in (1.0, 1j):
            kernels.append(_made(s, poles[[k]], np.full((1, 1, 1), part))[:, 0, 0] * form[:, 0, 0])
            usual.append(np.maximum(own, 1e-300))
    weight = channels.weight[few].reshape(-1, *shape)
    return _fitted(f.causes, f.u, s, np.stack(kernels), np.stack(usual), left, weight)


def _made(s: np.ndarray, poles: np.ndarray, residues: np.ndarray) -> np.ndarray:
    """Receptance of poles and residues ``(m, o, i)``, shape ``(f, o, i)``."""
    up, down = (1 / (s[:, None] - x) for x in (poles, poles.conj()))
    return np.einsum("fm,moi->foi", up, residues) + np.einsum("fm,moi->foi", down, residues.conj())


def _fitted(
    causes: tuple[Change, ...], u: np.ndarray, s: np.ndarray, forms: np.ndarray, usual: np.ndarray, data: np.ndarray,
    weight: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Real size ``(o, i)`` of the first of some forms ``(k, f)`` that is nearest to data ``(f, o, i)``.

    Channels show it with their faults, an output that is exchanged in the place of the other. The other forms are
    fitted beside it, each of a size that is ``usual``, shape ``(k, o, i)``, before the data.
    """
    _, o, i = data.shape
    out = np.zeros((o, i))
    for k in range(o):
        unit = np.where(np.arange(o)[:, None] == k, 1.0 + 0j, 0.0) * np.ones((len(s), 1, i))
        seen = shown(causes, u, s, unit)
        row = int(np.argmax(np.abs(seen).sum(axis=(0, 2))))  # the channel that shows this output
        for j in range(i):
            root, scale = np.sqrt(weight[:, row, j]), usual[:, k, j]
            A, y = (root * seen[:, row, j])[:, None] * forms.T * scale, root * data[:, row, j]
            A = np.concatenate([A.real, A.imag, np.eye(len(forms))])
            y = np.concatenate([y.real, y.imag, np.zeros(len(forms))])
            out[k, j] = np.linalg.lstsq(A, y, rcond=None)[0][0] * scale[0]
    return out
