r"""Features along the leading directions of shapes: what many sensors tell of a cause, in a few numbers of each mode.

Errors of a simulation move the shape of mode r along those of all others (Fox and Kapoor 1968, equation 22), by

.. math:: \phi_s\,\frac{\phi_s^T\,\delta K\,\phi_r}{\omega_r^2 - \omega_s^2},

for errors of a part :math:`\epsilon` about :math:`\epsilon\,\omega_r\omega_s/|\omega_r^2-\omega_s^2|` of it. Most of
this lies in a few directions at the sensors, and a cause moves shapes along them as well. Causes are looked for by
these; the leading explanations are then fitted to all that the sensors tell, of very many sensors to so many more
directions that the others hold next to nothing.
"""

from dataclasses import replace

import numpy as np
import scipy.linalg

from modalax.diagnose.modal_domain.fitting.state import Setting
from modalax.diagnose.modal_domain.modes.features import Features, whitener_of
from modalax.diagnose.modal_domain.modes.repeated import Group
from modalax.diagnose.modal_domain.structure.coordinates import Coordinates

LEADING = 24  # directions of the shape and of the participation of each mode that causes are looked for by
DIRECTIONS = 60  # the same that explanations are fitted to in the end
SPARED = 1.5  # times as many as these there must be, so that doing without the others is worth it
OFF = 0.1  # relative error of elements that directions are weighed by


def narrowed(setting: Setting, count: int | None = None) -> Setting | None:
    """The setting by ``count`` leading directions alone, ``LEADING`` by default; None where there are hardly more."""
    f, count = setting.features, LEADING if count is None else count
    o, i = f.residues.shape[1:]
    kept = min(o - 1, count), min(i - 1, count)
    if not len(f.poles) or o + i - 2 <= SPARED * sum(kept):
        return None
    few = along_leading(f, setting.coordinates, *kept)
    return replace(setting, features=few, whitener=whitener_of(few))


def along_leading(f: Features, c: Coordinates, outputs: int, inputs: int) -> Features:
    """Features along so many ``outputs`` of a shape's directions and ``inputs`` of a participation's.

    With unitary B of the directions that are kept, as rows, they are ``B z`` of complex features z, their covariance
    that of their real and imaginary parts; shapes ``(k, 4 + 2 (outputs + inputs))``.
    """
    o, count, width = f.residues.shape[1], len(f.poles), 4 + 2 * (outputs + inputs)
    tangent = f.tangent[:, np.r_[: 1 + outputs, o : o + inputs]]  # those of groups are not turned, as none reads them
    T = np.zeros((count, width, f.width))
    groups = {k: (n, row) for n, group in enumerate(f.groups) for row, k in enumerate(group.rows)}
    turned: list[Group] = list(f.groups)
    for k, pole in enumerate(f.poles):
        group = f.groups[groups[k][0]] if k in groups else None
        weight, units = _weights(c, abs(pole if group is None else group.pole)), f.units[k]
        rows, columns = (c.outputs / units[:, :1] * weight).T, (c.inputs / units[:1].T * weight).T
        if group is not None:
            few = len(group.rows)
            left = _leading(rows @ group.left[:, few:].conj(), outputs + 1 - few)
            right = _leading(columns @ group.right[:, few:], inputs + 1 - few)
            parts = [np.eye(2 * (few - 1)), left, right]
            if groups[k][1] == 0:
                turned[groups[k][0]] = replace(
                    group, left=np.hstack([group.left[:, :few], group.left[:, few:] @ left.conj().T]),
                    right=np.hstack([group.right[:, :few], group.right[:, few:] @ right.T]),
                )  # fmt: skip
        else:
            u, _, vh = np.linalg.svd(f.tangent[k, 0])
            left = _leading(rows @ (f.tangent[k, 1:o] @ vh[0].conj()).conj().T, outputs)
            right = _leading(columns @ (u[:, 0].conj() @ f.tangent[k, o:]).conj().T, inputs)
            parts = [left, right]
            turn = scipy.linalg.block_diag(*parts).conj()
            tangent[k, 1:] = np.tensordot(turn, f.tangent[k, 1:], 1)
        B = scipy.linalg.block_diag(*parts)
        T[k] = scipy.linalg.block_diag(np.eye(4), np.block([[B.real, -B.imag], [B.imag, B.real]]))
    covariance = f.covariance.reshape(count, f.width, count, f.width)
    covariance = np.einsum("kab,kblc,ldc->kald", T, covariance, T, optimize=True).reshape(count * width, -1)
    values = np.einsum("kab,kb->ka", T, f.values)
    return replace(f, tangent=tangent, values=values, covariance=covariance, groups=tuple(turned), origin=None)


def _weights(c: Coordinates, w: float) -> np.ndarray:
    """How far errors of elements move a shape of circular frequency ``w`` along each of the simulation's."""
    apart = np.abs(w**2 - c.frequencies**2)
    return np.minimum(1.0, OFF * w * c.frequencies / np.maximum(apart, 1e-300))


def _leading(moved: np.ndarray, count: int) -> np.ndarray:
    """Orthonormal directions in which most of some rows lies, as rows that they are multiplied by: ``(count, n)``."""
    return np.linalg.svd(moved.T)[0][:, :count].conj().T
