r"""A simulation of which modes alone are known, as of a modal model: no matrices, and no elements to read off them.

What is known of the modes that it leaves out is how many there are likely to be: frequencies of a structure rise as a
power of their number, :math:`\omega_s\propto s^p`, and far above the band modes are alike in size, so that those above
the last, N, have the flexibility :math:`\sum_{s>N}\phi_s^2/\omega_s^2\approx\bar\phi^2N/((2p-1)\,\omega_N^2)` at a DoF,
the sum as an integral from :math:`N+\tfrac12` on.

Residues :math:`\psi_o\psi_i/a` of a structure whose damping couples no modes are :math:`\phi_o\phi_i/(2j\omega_d)`,
with real shapes :math:`\phi` of unit modal mass. What further modes add between drive points, the residual terms
:math:`U` and :math:`W`, is that of modes far above the others and of rigid bodies: with
:math:`U_{dd} = GG^T` the shapes :math:`\Omega\,U_{od}G^{-T}` of frequency :math:`\Omega` (the Nystroem approximation).
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from modalax._numerics.remembered import remembered
from modalax.data import FRF
from modalax.model import ModalModel, Structure

REAL = 0.05  # imaginary part of shapes, relative to the real one, up to which damping is taken to couple no modes
FAR = 10.0  # frequency of what stands for further modes, over the highest of all
POWERS = 0.75, 2.0  # of the number of a mode with which frequencies may rise: a plate's with 1, a beam's with 2
RANK = 1e-9  # part of a residual term, relative to the largest, below which it is rounding


@dataclass(frozen=True)
class ModesOnly:
    """Real modes of unit modal mass, as far as a modal model tells them.

    Attributes
    ----------
    model
        The modal model.
    dofs
        Its DoFs.
    frequencies, damping
        Natural circular frequencies [rad/s] and twice the decay rates [1/s], shape ``(m,)``, by rising frequency.
    shapes
        Shape ``(dof, m)`` [1/sqrt(kg)].
    frequency_std, damping_std
        Relative standard deviations that the author claims, as in the modal model.
    stiffness_std, mass_std, pairs, groups, elements
        None, as a modal model claims and names none.
    """

    model: ModalModel
    dofs: tuple[str, ...]
    frequencies: np.ndarray
    damping: np.ndarray
    shapes: np.ndarray
    frequency_std: np.ndarray
    damping_std: np.ndarray
    stiffness_std: None = field(default=None, init=False)
    mass_std: None = field(default=None, init=False)
    pairs: None = field(default=None, init=False)
    groups: None = field(default=None, init=False)
    elements: None = field(default=None, init=False)

    def frf(self, freq: np.ndarray, **asked: Any) -> FRF:
        """FRFs of the modal model, see :meth:`modalax.ModalModel.frf`."""
        return self.model.frf(freq, **asked)


Simulation = Structure | ModesOnly  # what the modal domain compares a measurement with


@remembered(2)
def modes_only(model: ModalModel) -> ModesOnly | None:
    """A modal model as real modes; None where it has none, or where no drive point tells their modal mass."""
    if not model.drive_points() or not len(model.poles):
        return None
    dofs = model.outputs + tuple(name for name in model.inputs if name not in model.outputs)
    poles, a = np.asarray(model.poles), np.asarray(model.modal_a())
    phi = np.asarray(model.shapes_at(dofs)) * np.sqrt(2j * poles.imag / a)[:, None]
    turned = np.where(np.abs(phi.imag).max(axis=1) > np.abs(phi.real).max(axis=1), 1j, 1.0)  # either root of one is one
    phi = phi * turned[:, None]
    if np.linalg.norm(phi.imag) > REAL * np.linalg.norm(phi.real) or (turned != 1).any():
        return None
    order = np.argsort(np.abs(poles))
    frequencies, damping, shapes = np.abs(poles)[order], -2 * poles.real[order], phi.real[order].T
    far = FAR * frequencies[-1]
    drives = [dofs.index(name) for name in model.drive_points()]
    rigid, above = (
        between_drives(np.asarray(model._residual(term, dofs, dofs)).real, drives)
        for term in (model.lower, model.upper)
    )
    count = rigid.shape[1], above.shape[1]
    return ModesOnly(
        model, dofs, np.concatenate([np.zeros(count[0]), frequencies, np.full(count[1], far)]),
        np.concatenate([np.zeros(count[0]), damping, np.full(count[1], far * damping[-1] / frequencies[-1])]),
        np.hstack([rigid, shapes, far * above]), np.asarray(model.frequency_std), np.asarray(model.damping_std),
    )  # fmt: skip


def flexibility_above(frequencies: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """Flexibility [m/N] at each DoF of the modes above those known, whose shapes are ``(dof, m)``, shape ``(dof,)``."""
    elastic = np.flatnonzero(frequencies > RANK * frequencies.max(initial=0.0))
    upper = elastic[len(elastic) // 2 :]
    power = POWERS[0]
    if len(upper) > 1:
        slope = np.polyfit(np.log(upper + 1.0), np.log(frequencies[upper]), 1)[0]
        power = float(np.clip(slope, *POWERS))
    size = (shapes[:, upper] ** 2).mean(axis=1)
    last = len(frequencies)
    tail = last * (1 + 0.5 / last) ** (1 - 2 * power) / (2 * power - 1)  # sum of (s / N)^(-2p) as an integral
    return size * tail / frequencies[-1] ** 2


def between_drives(term: np.ndarray, drives: list[int]) -> np.ndarray:
    """F with ``F F'`` a residual term of all DoFs, by its columns at drive points; shape ``(dof, r)``."""
    own = term[np.ix_(drives, drives)]
    values, vectors = np.linalg.eigh((own + own.T) / 2)
    kept = values > RANK * max(values[-1], 1e-300)
    return term[:, drives] @ (vectors[:, kept] / np.sqrt(values[kept]))
