r"""Whether FRFs of motion differentiated in time are those of records under an exponential window that nobody told.

A window :math:`e^{-at}` on force and response turns :math:`H(s)` into :math:`H(s+a)`. Of a receptance that moves the
poles alone; a mobility or an accelerance, of power :math:`p` of :math:`s`, is also multiplied by
:math:`((s+a)/s)^p`, which no poles make. Low modes, weak in accelerance, bend to make up for it. To first order in
:math:`a` it adds :math:`a\,pH/s` to all channels with one unknown, so that a score test tells it.
"""

from typing import NamedTuple

import numpy as np
import scipy.special

from modalax.data.frf import DERIVATIVES, FRF
from modalax.identify.kernels import kernels, residual_terms
from modalax.identify.maximum import columns_of
from modalax.identify.neighbourhood import Left, channel_noise
from modalax.identify.plain import modal_of
from modalax.identify.projection import orthonormal, stacked
from modalax.model.modal import ModalModel

CHANCE = 1e-6  # chance at which a window is told that is not there
MOSTLY = 0.5  # least part of what amplitudes of their own in every channel would explain


class UntoldWindow(NamedTuple):
    """Decay rate that a window added [1/s], its standard deviation, and the rise of twice the log-likelihood."""

    decay: float
    std: float
    gain: float


def window_notes(frf: FRF, model: ModalModel, left: Left) -> list[str]:
    """A sentence on an exponential window that is not told, where :func:`untold_window` finds one."""
    window = untold_window(frf, model, *left)
    if window is None:
        return []
    return [
        "These FRFs are those of records under an exponential window that is not told, of a decay rate of "
        f"{window.decay:.3g} +- {window.std:.2g} 1/s: it is in all damping ratios, and bends low modes that are weak "
        "by more than their error bars; state it as the added decay of the measurement, and fit again."
    ]


def untold_window(
    frf: FRF, model: ModalModel, residual: np.ndarray, scatter: np.ndarray | None = None
) -> UntoldWindow | None:
    """The decay that an exponential window added to records, where the FRFs show one; None where they do not.

    Parameters
    ----------
    frf, model
        The FRF and a modal model of it with the same outputs and inputs; all that its residues, poles and residual
        terms could make is left to them.
    residual
        The FRF less what the model makes, shape ``(f, o, i)``.
    scatter
        Power by which noise that is not known counts, as for :func:`modalax.identify.neighbourhood.around`.
    """
    power, used = DERIVATIVES[frf.form], np.asarray(frf.freq) > 0
    if power == 0:
        return None
    s = (np.asarray(frf.added_decay) + 2j * np.pi * np.asarray(frf.freq))[used]
    size, course = channel_noise(frf, residual, slice(int(np.argmax(used)), None), True, scatter)
    poles = np.asarray(model.poles)
    columns = np.concatenate([kernels(s, power, poles), residual_terms(s, power, "complex")], axis=1)
    A = stacked((columns / course[:, None]).T).T
    Q = orthonormal(A / np.linalg.norm(A, axis=0))[0]
    # All channels make pH/s of the same few columns: what the basis leaves of these is all that is needed of it.
    columns, made = columns_of(modal_of(model), s, power)
    asked = stacked((power * columns / (s * course)[:, None]).T)
    asked -= (asked @ Q) @ Q.T
    made = made * (np.sqrt(2) / size)
    left, rest = np.empty((2, len(s), len(size))), residual[used].reshape(len(s), -1)
    weight = np.sqrt(2) / (course[:, None] * size)
    np.multiply(rest.real, weight, out=left[0])
    np.multiply(rest.imag, weight, out=left[1])
    left = left.reshape(-1, len(size))
    inside = Q.T @ left
    own = np.einsum("kc,kl,lc->c", made, asked @ asked.T, made, optimize=True)
    along = np.sum(made * (asked @ left), axis=0)
    level = max((float(np.vdot(left, left)) - float(np.vdot(inside, inside))) / left.size, 1.0)
    gain, free = along.sum() ** 2 / own.sum() / level, float(np.sum(along**2 / np.maximum(own, 1e-300))) / level
    decay, std = along.sum() / own.sum(), float(np.sqrt(level / own.sum()))
    slowest = float(np.min(-np.asarray(model.poles.real)))
    real = decay > 0 and decay - 3 * std < slowest
    if not real or gain < scipy.special.chdtri(1, CHANCE) or gain < MOSTLY * free:
        return None
    return UntoldWindow(float(decay), std, float(gain))
