"""Derivatives of poles and shapes by changes of a simulation, in its modal coordinates.

They follow from one bordered system a mode (Nelson 1976), whatever the other modes are: oscillating, overdamped or
those of a rigid body.
"""

from dataclasses import dataclass

import numpy as np

from modalax.diagnose.modal_domain.structure.coordinates import Coordinates, Modes
from modalax.diagnose.modal_domain.structure.factored import Factored
from modalax.diagnose.modal_domain.structure.loads import responses

REPEATED = 1e-6  # relative distance of two poles below which they count as repeated


@dataclass(frozen=True)
class Slopes:
    """Matrices from which derivatives of some modes follow.

    For a change ``B`` of the dynamic stiffness at the pole, the pole moves by ``-y' B v`` and the shape at the outputs
    by ``-G_o B v`` (at the inputs by ``-G_i B' y``), ``v`` the mode's vector and ``y`` that from the left. Two modes
    ``a, b`` of one pole, those of ``repeated``, also turn into each other, by how much no derivative tells; what both
    make together moves with ``-y_a' B v_b``, which derivatives of poles hold in further rows, one for each such two.
    """

    poles: np.ndarray
    vectors: np.ndarray
    left: np.ndarray
    at_outputs: np.ndarray
    at_inputs: np.ndarray
    shape_outputs: np.ndarray
    shape_inputs: np.ndarray
    repeated: np.ndarray
    along: bool = False

    @property
    def two(self) -> tuple[np.ndarray, np.ndarray]:
        """The first and the second of each two of one pole."""
        return self.repeated[:, 0], self.repeated[:, 1]


def slopes_of(c: Coordinates, modes: Modes, which: np.ndarray) -> Slopes:
    """Matrices of derivatives of the modes ``which``."""
    poles, (high, squares) = modes.poles[which], modes.high
    rows = np.concatenate([c.outputs, c.inputs])
    v = modes.vectors[which]
    left = v if modes.lefts is None else modes.lefts[which]
    far = np.matmul(1 / (squares + poles[:, None] ** 2)[:, None] * (rows @ high.T), high)
    near = _near_loads(c, modes, which) if modes.loads else _near_all(modes, poles, rows)
    at_outputs, at_inputs = np.split(near + far, [len(c.outputs)], axis=1)
    same = np.abs(poles[:, None] - poles) < REPEATED * np.abs(poles)[:, None]
    repeated = np.argwhere(np.triu(same & (which[:, None] != which), 1))
    return Slopes(poles, v, left, at_outputs, at_inputs, v @ c.outputs.T, left @ c.inputs.T, repeated)


def _near_loads(c: Coordinates, modes: Modes, which: np.ndarray) -> np.ndarray:
    """Responses of the solved modes at poles of their own, with the forces that act on them."""
    assert modes.left_parts is not None
    shapes, squares, damping = modes.low
    some = modes.poles[which], modes.parts[which], modes.left_parts[which], squares, damping, modes.loads
    ahead, back = responses(*some, c.outputs @ shapes.T), responses(*some, c.inputs @ shapes.T, backwards=True)
    return np.concatenate([ahead, back], axis=1) @ shapes


def _near_all(modes: Modes, poles: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Responses of the solved modes, of which several may be on top of each other."""
    own = np.abs(modes.poles - poles[:, None]) < REPEATED * np.abs(poles)[:, None]
    near, count = np.zeros((len(poles), *rows.shape), complex), own.sum(axis=1)
    for some in (count == c for c in np.unique(count)):
        near[some] = _near(modes, poles[some], np.nonzero(own[some])[1].reshape(np.count_nonzero(some), -1), rows)
    return near


def _near(modes: Modes, poles: np.ndarray, own: np.ndarray, rows: np.ndarray) -> np.ndarray:
    r"""Responses at poles to unit forces along ``rows``, their own modes taken out; shape ``(pole, rows, n)``.

    With :math:`Z^{-1}(s) = v v^T/(s - \lambda) + G + O(s - \lambda)`, ``v`` of :math:`v^T Z' v = 1`, the powers of
    :math:`s - \lambda` in :math:`Z Z^{-1} = I` give :math:`Z G = I - Z'v\,v^T` and :math:`(Z'v)^T G = -(v^T M v)\,v^T`.

    Parameters
    ----------
    own
        Numbers of the modes at each pole, its own and others on top of it; as many of each.
    """
    shapes, squares, damping = modes.low
    v = modes.parts[own]
    turned = v.transpose(0, 2, 1)
    count, far = len(squares), rows @ shapes.T
    slope = 2 * poles[:, None, None] * v + v @ damping
    part = np.linalg.solve(slope @ turned, v @ far.T)
    scale = (np.abs(poles) ** 1.5)[:, None, None]  # so that all parts of the system are of one size
    size = count + own.shape[1]
    A = np.zeros((len(poles), size, size), complex)
    A[:, :count, :count] = poles[:, None, None] * damping
    A[:, range(count), range(count)] += squares + poles[:, None] ** 2
    A[:, count:, :count], A[:, :count, count:] = scale * slope, scale * slope.transpose(0, 2, 1)
    right = np.concatenate([far.T - slope.transpose(0, 2, 1) @ part, -scale * (v @ turned) @ part], axis=1)
    return np.linalg.solve(A, right)[:, :count].transpose(0, 2, 1) @ shapes


POWER = {"K": 0, "C": 1, "M": 2}


def pattern_slopes(t: Slopes, kind: str, patterns: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Derivatives by the sizes of patterns, shape ``(p, n, n)``: of poles ``(k, p)``, of both shapes ``(k, p, o)``."""
    count, n = patterns.shape[:2]
    flat = patterns.reshape(-1, n)  # real: two real products cost half of one complex one

    def moved_by(v: np.ndarray) -> np.ndarray:
        return (flat @ v.real.T + 1j * (flat @ v.imag.T)).reshape(count, n, -1).transpose(2, 1, 0)  # (k, n, p)

    factor, moved = t.poles ** POWER[kind], moved_by(t.vectors)
    back = moved if t.left is t.vectors else moved_by(t.left)
    a, b = t.two
    own = np.matmul(np.concatenate([t.left, t.left[a]])[:, None], np.concatenate([moved, moved[b]]))[:, 0]
    out, inn = (np.matmul(at, by).transpose(0, 2, 1) for at, by in ((t.at_outputs, moved), (t.at_inputs, back)))
    return _with_norm(t, kind, factor, own, out, inn)


def factored_slopes(t: Slopes, kind: str, changes: Factored) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Derivatives as :func:`pattern_slopes`, by changes that are given by their directions."""
    right = changes.along(t.vectors)
    left = right if t.left is t.vectors else changes.along(t.left)
    a, b = t.two
    own = changes.summed(changes.sign * np.concatenate([left * right, left[a] * right[b]]))
    out, inn = (
        changes.summed(changes.along(at) * (changes.sign * by)[:, None]).transpose(0, 2, 1)
        for at, by in ((t.at_outputs, right), (t.at_inputs, left))
    )
    return _with_norm(t, kind, t.poles ** POWER[kind], own, out, inn)


def direction_slopes(t: Slopes, kind: str, b: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Derivatives as :func:`pattern_slopes`, by changes ``b b'`` of rank one, ``b`` of shape ``(p, n)``."""
    across, back = t.vectors @ b.T, t.left @ b.T  # (k, p)
    out = np.matmul(t.at_outputs, b.T).transpose(0, 2, 1) * across[:, :, None]
    inn = np.matmul(t.at_inputs, b.T).transpose(0, 2, 1) * back[:, :, None]
    a, b = t.two
    own = np.concatenate([across * back, back[a] * across[b]])
    return _with_norm(t, kind, t.poles ** POWER[kind], own, out, inn)


def load_slopes(
    t: Slopes, basis: np.ndarray, change: np.ndarray, slope: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Derivatives as :func:`pattern_slopes` by forces at ``(p, n, k)`` directions each.

    Parameters
    ----------
    change, slope
        What a force changes of the dynamic stiffness between its directions at each pole, and the derivative of that
        by s, shapes ``(m, p, k, k)``.
    """
    right, left = (np.einsum("mn,pnk->mpk", v, basis, optimize=True) for v in (t.vectors, t.left))
    moved, back = np.einsum("mpab,mpb->mpa", change, right), np.einsum("mpab,mpa->mpb", change, left)
    one, two = (np.concatenate([np.arange(len(t.poles)), part]) for part in t.two)
    own = np.einsum("mpa,mpa->mp", left[one], moved[two])
    norm = np.einsum("mpa,mpab,mpb->mp", left[one], slope[two], right[two])
    out, inn = (
        np.einsum("mrn,pnk,mpk->mpr", at, basis, by, optimize=True)
        for at, by in ((t.at_outputs, moved), (t.at_inputs, back))
    )
    return -own, -out - _times(t, 0.5 * norm, t.shape_outputs), -inn - _times(t, 0.5 * norm, t.shape_inputs)


def _with_norm(
    t: Slopes, kind: str, factor: np.ndarray, own: np.ndarray, out: np.ndarray, inn: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    # normalisation v'(2 s M + C)v = 1 moves with M and C themselves
    every = np.concatenate([np.arange(len(t.poles)), t.two[0]])
    norm = {"K": 0 * t.poles, "C": 0.5 + 0 * t.poles, "M": t.poles}[kind][every, None] * own
    change_out = -factor[:, None, None] * out - _times(t, norm, t.shape_outputs)
    change_in = -factor[:, None, None] * inn - _times(t, norm, t.shape_inputs)
    return -factor[every, None] * own, change_out, change_in


def _times(t: Slopes, norm: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """What norms move of shapes: of each mode by itself, and of two of one pole by each other."""
    count = len(t.poles)
    out = norm[:count, :, None] * shapes[:, None, :]
    for (a, b), beside in zip(t.repeated, norm[count:], strict=True):
        out[a] += beside[:, None] * shapes[b]
        out[b] += beside[:, None] * shapes[a]
    return out
