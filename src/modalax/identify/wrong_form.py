r"""Whether the modes of a fit say that FRFs, or those of some outputs, are not of the form that they are called.

Modes of light damping are all but real, and the residues of receptances at :math:`s=\lambda_r` then all but imaginary,
:math:`A_r = \phi_r\phi_r^T/(2j\omega_r m_r)`. Read with one time derivative too many or too few they are real. Force
over motion has no poles where the structure resonates, and the inverse of each FRF has.
"""

import numpy as np
from jaxtyping import Float

from modalax.data.frf import DERIVATIVES, FRF
from modalax.identify.diagram import diagram
from modalax.identify.neighbourhood import residual_of
from modalax.identify.residues import residues
from modalax.model.modal import ModalModel

SURE = 0.5  # grade from which on a mode is asked
FEWEST = 3  # modes that must agree
TURNED = -0.8  # mean cosine of twice the angle to the imaginary axis from which down residues are turned
LOST = 0.3  # part of the sum of squares that is misfit from which on the inverse is tried
BETTER = 0.1  # part of that misfit which the inverse may leave


def form_notes(frf: FRF, model: ModalModel, sure: Float[np.ndarray, " n"], misfit: float) -> list[str]:
    """Sentences on FRFs that are not of their form; none where nothing speaks for it.

    Parameters
    ----------
    frf, model
        The FRF and a modal model of it.
    sure
        Grade of each mode, 0 for modes outside the band, shape ``(n,)``.
    misfit
        Part of the sum of squares that the model does not explain and that is no noise.
    """
    if misfit > LOST and _inverse_is_modal(frf, misfit):
        return [
            "These FRFs are not explained, and the inverse of each one is: they are force over motion, not "
            f"{frf.form}; invert each FRF, for one of motion over force is needed."
        ]
    turned = turned_outputs(model, sure >= SURE)
    if not turned.any():
        return []
    options = [form for form, power in DERIVATIVES.items() if abs(power - DERIVATIVES[frf.form]) == 1]
    if turned.all():
        return [
            f"The residues of all modes are turned by 90 degrees: these FRFs are {' or '.join(options)}, not "
            f"{frf.form}, and shapes and modal masses are wrong until that is corrected in the file (or by --form, "
            "where the file states no form or is a universal file)."
        ]
    names = ", ".join(name for name, told in zip(frf.outputs, turned, strict=True) if told)
    return [
        f"The residues of all modes at {names} are turned by 90 degrees beside those of the other outputs: "
        f"{' or '.join(options)} among {frf.form}; bring all outputs to one form, or leave these out (--without)."
    ]


def turned_outputs(model: ModalModel, which: np.ndarray) -> np.ndarray:
    """Outputs at which the residues of all of some modes are real rather than imaginary, shape ``(o,)``."""
    residues = np.asarray(model.residues)[which]
    if len(residues) < FEWEST:
        return np.zeros(residues.shape[1], bool)
    own = residues / np.sqrt(np.mean(np.abs(residues) ** 2, axis=(1, 2), keepdims=True))
    along = -np.real(np.sum(own**2, axis=2))  # the real part of a square is the cosine of twice the angle
    size = np.sum(np.abs(own) ** 2, axis=2)
    seen = size > 0.01 * np.mean(size, axis=0)  # not at the nodes of a shape
    every = ((along < 0.5 * TURNED * size) | ~seen).all(axis=0) & (seen.sum(axis=0) >= FEWEST)
    return every & (along.sum(axis=0) < TURNED * size.sum(axis=0))


def _inverse_is_modal(frf: FRF, misfit: float) -> bool:
    """Whether a diagram of the inverse of each FRF explains nearly all of it."""
    if not np.abs(np.asarray(frf.H)).all():
        return False
    inverse = frf.replace(H=1 / frf.H, variance=None)
    selection = diagram(inverse, "lscf", None)[1]
    if not selection.poles.size:
        return False
    left = residual_of(inverse, residues(inverse, selection.poles))
    rest = float(np.sum(np.abs(left) ** 2) / np.sum(np.abs(np.asarray(inverse.H)) ** 2))
    return rest < BETTER * misfit
