r"""Derivatives of shapes along the directions of the features alone, before residues are made of them.

A residue is a product of a shape and a participation, and so is every direction that it is compared along. With parts
:math:`x_a` of the shape and :math:`y_b` of the participation along their own directions it is :math:`x_a y_b`, in as
many numbers as there are directions, not channels.
"""

from dataclasses import replace

import numpy as np

from modalax.diagnose.modal_domain.modes.features import INVISIBLE, Features, slopes_along
from modalax.diagnose.modal_domain.modes.repeated import Together
from modalax.diagnose.modal_domain.structure.slopes import Slopes


def by_features(t: Slopes, f: Features, seen: Together, whole: np.ndarray) -> Slopes:
    """Slopes of outputs and inputs by the directions of the features and, last, by what residues grow by.

    Parameters
    ----------
    whole
        Residues in the place of the measured ones, in units of the channels, shape ``(k, o, i)``.
    """
    row, (left, right) = seen.row, sides(f)
    energy = np.maximum((np.abs(whole) ** 2).sum(axis=(1, 2), keepdims=True), INVISIBLE**2)
    growth = (whole.conj() / f.units / energy)[row]
    left = np.concatenate([left[row], np.matmul(growth, t.shape_inputs[:, :, None]).transpose(0, 2, 1)], axis=1)
    right = np.concatenate([right[row], np.matmul(t.shape_outputs[:, None], growth)], axis=1)
    outputs, inputs = np.matmul(left, t.shape_outputs[:, :, None]), np.matmul(right, t.shape_inputs[:, :, None])
    return replace(
        t, at_outputs=np.matmul(left, t.at_outputs), at_inputs=np.matmul(right, t.at_inputs),
        shape_outputs=outputs[:, :, 0], shape_inputs=inputs[:, :, 0], along=True,
    )  # fmt: skip


def sides(f: Features) -> tuple[np.ndarray, np.ndarray]:
    """What shapes and participations are multiplied by for their parts along the directions of the features.

    Shapes ``(k, a, o)`` and ``(k, b, i)``. The tangent's directions are products of the first of one side with all of
    the other, those of the outputs before those of the inputs; of groups they are all singular vectors.
    """
    _, _, vh = np.linalg.svd(f.tangent[:, 0])
    across = np.einsum("kdoi,ki->kdo", f.tangent, vh[:, 0].conj())
    outs = np.linalg.norm(across[0], axis=1) > 0.5  # the others are at right angles to the first participation
    further = np.einsum("ko,kdoi->kdi", across[:, 0].conj(), f.tangent[:, ~outs])
    left, right = across[:, outs].conj(), np.concatenate([vh[:, :1], further], axis=1).conj()
    for group in f.groups:
        left[list(group.rows)], right[list(group.rows)] = group.left.conj().T, group.right.T
    return left / f.units[:, None, :, 0], right / f.units[:, None, 0] * f.units[:, :1, :1]


def along_features(
    t: Slopes, seen: Together, own: np.ndarray, dpoles: np.ndarray, dout: np.ndarray, dinn: np.ndarray,
    sizes: np.ndarray | None,
) -> np.ndarray:  # fmt: skip
    """Derivatives of the features, shape ``(m, p)``, by changes along :func:`by_features`.

    Parameters
    ----------
    own
        Sizes of the residues in the place of the measured ones, in units of the channels, shape ``(k,)``.
    dpoles, dout, dinn
        Of poles ``(n, p)`` and of both sides ``(n, p, directions)``.
    sizes
        As of :func:`modalax.diagnose.modal_domain.modes.features.values_of`.
    """
    (n, p), k, row = dout.shape[:2], len(own), seen.row
    x, y = t.shape_outputs[:, :-1], t.shape_inputs[:, :-1]
    A = x[:, :, None] * y[:, None]
    dA = dout[:, :, :-1, None] * y[:, None, None] + x[:, None, :, None] * dinn[:, :, None, :-1]
    turned: dict[int, np.ndarray] = {}
    for (a, b), change in zip(t.repeated, dpoles[n:], strict=True):
        if row[a] == row[b]:
            both = x[a][:, None] * y[b] + x[b][:, None] * y[a]
            more = change[:, None, None] * both
            turned[int(row[a])] = turned[int(row[a])] + more if int(row[a]) in turned else more
    groups = tuple(replace(g, left=np.eye(A.shape[1]), right=np.eye(A.shape[2])) for g in seen.groups)
    here, along = Together(np.arange(k), seen.rows, np.arange(k, n), groups), np.zeros((k, *A.shape[1:]))
    along[:, 0, 0] = 1.0
    mean, whole = here.seen(along, t.poles, A)
    dmean, dwhole = here.moved(along, t.poles, A, dpoles[:n], dA, turned)
    grown = np.zeros((k, p))
    np.add.at(grown, row, (dout[:, :, -1] + dinn[:, :, -1]).real)
    flat = lambda B: np.concatenate([B[..., 0], B[..., 0, 1:]], axis=-1)
    out = slopes_along(mean, dmean, own, grown, flat(whole), flat(dwhole).transpose(0, 2, 1), sizes)
    for group in groups:
        out[list(group.rows)] = np.moveaxis(group.features(*(dwhole[j] for j in group.rows[:2])), 0, -1)
    return out.reshape(-1, p)
