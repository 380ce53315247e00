r"""A simulation in its modal coordinates: poles and residues under changes of mass, damping and stiffness.

With shapes of unit modal mass the undamped simulation is :math:`I s^2 + \mathrm{diag}(\omega^2)`, and a change of the
matrices is a symmetric matrix in these coordinates. Derivatives of poles and shapes follow from one bordered system a
mode (Nelson 1976), whatever the other modes are: oscillating, overdamped or those of a rigid body.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from scipy.linalg.lapack import dtrtrs

from modalax._numerics.remembered import remembered
from modalax.diagnose.modal_domain.elements import nodes_of
from modalax.diagnose.modal_domain.enriched import ritz_basis
from modalax.diagnose.modal_domain.factored import Factored
from modalax.diagnose.modal_domain.loads import Load, loaded_modes, responses
from modalax.diagnose.modal_domain.parts import parts_of
from modalax.model import Structure

QUICK = 1e3  # frequency of a DoF by itself, over that of the band, above which it is given mass
SPARED = 0.99  # frequency, relative to the spare coordinate's, above which a mode is that coordinate
SPARE = 4.0  # frequency of a coordinate to which nothing is attached, over the highest of all
LARGEST = 120  # modal coordinates of large simulations
FURTHER, AT_LEAST = 10, 60  # modes above the band, and in all, that are solved with their damping
REPEATED = 1e-6  # relative distance of two poles below which they count as repeated in derivatives


@dataclass(frozen=True)
class Coordinates:
    """A simulation in modal coordinates.

    The last coordinate is spare, for an oscillator that may be attached: of unit mass, far above the others, seen by no
    channel.

    Attributes
    ----------
    frequencies
        Natural circular frequencies without damping, shape ``(n,)`` [rad/s].
    damping
        Modal damping matrix, shape ``(n, n)`` [1/s].
    shapes
        Shapes of unit modal mass over all DoFs, shape ``(dof, n)``.
    outputs, inputs
        Rows of ``shapes`` at the measured channels, shapes ``(o, n)`` and ``(i, n)``.
    solved
        Modes that are solved with their damping, the lowest ones.
    names, everywhere
        DoFs that the simulation's elements know and their rows of shapes, also those that follow the others statically;
        where no elements are told, all DoFs.
    """

    frequencies: np.ndarray
    damping: np.ndarray
    shapes: np.ndarray
    outputs: np.ndarray
    inputs: np.ndarray
    solved: int
    names: tuple[str, ...]
    everywhere: np.ndarray

    @property
    def size(self) -> int:
        """Number of modal coordinates."""
        return len(self.frequencies)


@dataclass(frozen=True)
class Modes:
    """Modes of a changed simulation, by rising frequency, normalised so that residues are ``y x'``.

    Vectors of a symmetric structure serve both sides; where ``loads`` act on it, those from the left differ.

    Attributes
    ----------
    poles
        Shape ``(m,)`` [rad/s].
    vectors
        In the modal coordinates of the simulation, shape ``(m, n)``.
    parts
        The same by the real shapes that they are solved in, shape ``(m, l)``.
    low
        These real shapes, of unit mass, their squared circular frequencies and damping, shapes ``(l, n)``, ``(l,)``
        and ``(l, l)``.
    high
        Real shapes and squared circular frequencies of the modes above, shapes ``(h, n)`` and ``(h,)``.
    lefts, left_parts
        Vectors from the left as ``vectors`` and ``parts``; None where they are the same.
    loads
        Forces that are no symmetric change of matrices, their directions by the shapes of ``low``.
    """

    poles: np.ndarray
    vectors: np.ndarray
    parts: np.ndarray
    low: tuple[np.ndarray, np.ndarray, np.ndarray]
    high: tuple[np.ndarray, np.ndarray]
    lefts: np.ndarray | None = None
    left_parts: np.ndarray | None = None
    loads: tuple[Load, ...] = ()

    def residues(self, c: Coordinates) -> np.ndarray:
        """Residues by outputs and inputs, shape ``(m, o, i)``."""
        left = self.vectors if self.lefts is None else self.lefts
        return np.einsum("ko,ki->koi", self.vectors @ c.outputs.T, left @ c.inputs.T)


def coordinates_of(
    simulation: Structure, outputs: tuple[str, ...], inputs: tuple[str, ...], highest: float
) -> Coordinates:
    """Modal coordinates of a simulation whose band ends at ``highest`` [rad/s]."""
    names, frequencies, shapes, inside = _solved(simulation, highest)
    spare = SPARE * max(float(frequencies[-1]), highest)
    frequencies, everywhere = np.append(frequencies, spare), np.pad(shapes, ((0, 0), (0, 1)))
    shapes = everywhere if names == simulation.dofs else everywhere[[names.index(name) for name in simulation.dofs]]
    damping = _damping(simulation, frequencies, shapes, highest)
    rows, columns = ([simulation.index(name) for name in channels] for channels in (outputs, inputs))
    return Coordinates(
        frequencies, damping, shapes, shapes[rows], shapes[columns],
        min(len(frequencies), max(inside + FURTHER, AT_LEAST)), names, everywhere,
    )  # fmt: skip


def _damping(simulation: Structure, frequencies: np.ndarray, shapes: np.ndarray, highest: float) -> np.ndarray:
    """Modal damping matrix; none of the spare coordinate."""
    rate = np.sqrt(np.maximum(frequencies, 1e-3 * highest))
    hysteretic = shapes.T @ np.asarray(simulation.D) @ shapes
    return shapes.T @ np.asarray(simulation.C) @ shapes + hysteretic / rate[:, None] / rate


@remembered(4)
def _solved(simulation: Structure, highest: float) -> tuple[tuple[str, ...], np.ndarray, np.ndarray, int]:
    """DoFs, frequencies and shapes over them, and how many modes are in the band; of large simulations few shapes."""
    told = simulation.elements
    if told is None or not told.dofs:
        names, M, K = simulation.dofs, np.asarray(simulation.M), np.asarray(simulation.K)
    else:
        names = told.dofs
        K, M = (np.einsum("enr,emr->nm", a, a, optimize=True) for a in map(np.asarray, (told.stiffness, told.mass)))
    if len(K) <= LARGEST:
        # a DoF without mass, as a rotation of a lumped model, moves as its stiffness demands
        M = M + np.diag(np.maximum(np.diag(K) / (QUICK * highest) ** 2 - np.diag(M), 0.0))
        values, shapes = scipy.linalg.eigh(K, M)
        return names, np.sqrt(np.maximum(values, 0.0)), shapes, int(np.count_nonzero(values < highest**2))
    if told is None:
        nodes = nodes_of(names)
        parts = parts_of(K, nodes), parts_of(M, nodes, mass=True)
        stiffness, mass = ([(p.dofs, p.matrix) for p in some] for some in parts)
    else:
        stiffness, mass = ([_piece(F) for F in np.asarray(factors)] for factors in (told.stiffness, told.mass))
    return names, *ritz_basis(K, M, stiffness, mass, highest, LARGEST)


def _piece(F: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """An element by its DoFs and its matrix over these."""
    dofs = np.flatnonzero(F.any(axis=1))
    return dofs, F[dofs] @ F[dofs].T


def modes_of(
    c: Coordinates, dM: np.ndarray | None = None, dC: np.ndarray | None = None, dK: np.ndarray | None = None,
    loads: Sequence[Load] = (),
) -> Modes:  # fmt: skip
    """Modes with changes added, shapes ``(n, n)`` in modal coordinates, and forces as :func:`with_loads`.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the changed mass is not positive.
    """
    A = np.diag(c.frequencies**2)
    A = A if dK is None else A + dK
    if dM is None:
        values, Q = np.linalg.eigh(A)
    else:
        L = np.linalg.cholesky(np.eye(c.size) + dM)
        half = dtrtrs(L, A, lower=1)[0]
        values, U = np.linalg.eigh(dtrtrs(L, half.T, lower=1)[0])
        Q = dtrtrs(L, U, lower=1, trans=1)[0]
    m = c.solved
    low = Q[:, :m]
    damping = low.T @ (c.damping if dC is None else c.damping + dC) @ low
    solved, above = (low.T, values[:m], damping), (Q[:, m:].T, values[m:])
    if loads:
        return _loaded(solved, above, loads)
    # of displacements times their frequencies and of velocities, so that all parts are of one size
    w = np.sqrt(np.abs(values[:m]))
    state, each = np.zeros((2 * m, 2 * m)), np.arange(m)
    state[each, m + each], state[m + each, each], state[m:, m:] = w, -np.sign(values[:m]) * w, -damping
    poles, vectors = np.linalg.eig(state)
    up = poles.imag > 1e-6 * w.max()
    poles, vectors = poles[up], (vectors[m:, up] / poles[up]).T
    order = np.argsort(np.abs(poles))
    poles, vectors = poles[order], vectors[order]
    a = 2 * poles * (vectors**2).sum(axis=1) + ((vectors @ damping) * vectors).sum(axis=1)
    parts = vectors / np.sqrt(a)[:, None]
    return Modes(poles, parts @ low.T, parts, solved, above)


def with_loads(modes: Modes, loads: Sequence[Load]) -> Modes:
    """Modes of the same structure with forces that act on those modes that are solved with their damping."""
    return _loaded(modes.low, modes.high, loads) if loads else modes


def _loaded(
    low: tuple[np.ndarray, np.ndarray, np.ndarray], high: tuple[np.ndarray, np.ndarray], loads: Sequence[Load]
) -> Modes:
    shapes, squares, damping = low
    own = tuple(replace(load, basis=shapes @ load.basis) for load in loads)
    poles, right, left = loaded_modes(squares, damping, own)
    return Modes(poles, right @ shapes, right, low, high, left @ shapes, left, own)


@dataclass(frozen=True)
class Slopes:
    """Matrices from which derivatives of some modes follow; ``which`` holds the numbers of the modes.

    For a change ``B`` of the dynamic stiffness at the pole, the pole moves by ``-y' B v`` and the shape at the outputs
    by ``-G_o B v`` (at the inputs by ``-G_i B' y``), ``v`` the mode's vector and ``y`` that from the left.
    """

    poles: np.ndarray
    vectors: np.ndarray
    left: np.ndarray
    at_outputs: np.ndarray
    at_inputs: np.ndarray
    shape_outputs: np.ndarray
    shape_inputs: np.ndarray


def slopes_of(c: Coordinates, modes: Modes, which: np.ndarray) -> Slopes:
    """Matrices of derivatives of the modes ``which``."""
    poles, (high, squares) = modes.poles[which], modes.high
    rows = np.concatenate([c.outputs, c.inputs])
    v = modes.vectors[which]
    left = v if modes.lefts is None else modes.lefts[which]
    far = np.matmul(1 / (squares + poles[:, None] ** 2)[:, None] * (rows @ high.T), high)
    near = _near_loads(c, modes, which) if modes.loads else _near_all(modes, poles, rows)
    at_outputs, at_inputs = np.split(near + far, [len(c.outputs)], axis=1)
    return Slopes(poles, v, left, at_outputs, at_inputs, v @ c.outputs.T, left @ c.inputs.T)


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
    own = np.matmul(t.left[:, None], moved)[:, 0]
    out, inn = (np.matmul(at, by).transpose(0, 2, 1) for at, by in ((t.at_outputs, moved), (t.at_inputs, back)))
    return _with_norm(t, kind, factor, own, out, inn)


def factored_slopes(t: Slopes, kind: str, changes: Factored) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Derivatives as :func:`pattern_slopes`, by changes that are given by their directions."""
    right = changes.along(t.vectors)
    left = right if t.left is t.vectors else changes.along(t.left)
    own = changes.summed(changes.sign * left * right)
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
    return _with_norm(t, kind, t.poles ** POWER[kind], across * back, out, inn)


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
    own, norm = np.einsum("mpa,mpa->mp", left, moved), np.einsum("mpa,mpab,mpb->mp", left, slope, right)
    out, inn = (
        np.einsum("mrn,pnk,mpk->mpr", at, basis, by, optimize=True)
        for at, by in ((t.at_outputs, moved), (t.at_inputs, back))
    )
    half = 0.5 * norm[:, :, None]
    return -own, -out - half * t.shape_outputs[:, None, :], -inn - half * t.shape_inputs[:, None, :]


def _with_norm(
    t: Slopes, kind: str, factor: np.ndarray, own: np.ndarray, out: np.ndarray, inn: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    # normalisation v'(2 s M + C)v = 1 moves with M and C themselves
    norm = {"K": 0 * t.poles, "C": 0.5 + 0 * t.poles, "M": t.poles}[kind][:, None] * own
    change_out = -factor[:, None, None] * out - norm[:, :, None] * t.shape_outputs[:, None, :]
    change_in = -factor[:, None, None] * inn - norm[:, :, None] * t.shape_inputs[:, None, :]
    return -factor[:, None] * own, change_out, change_in
