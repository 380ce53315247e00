r"""A simulation in its modal coordinates: poles and residues under changes of mass, damping and stiffness.

With shapes of unit modal mass the undamped simulation is :math:`I s^2 + \mathrm{diag}(\omega^2)`, and a change of the
matrices is a symmetric matrix in these coordinates.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from scipy.linalg.lapack import dtrtrs

from modalax._numerics.remembered import remembered
from modalax.diagnose.modal_domain.structure.enriched import ritz_basis
from modalax.diagnose.modal_domain.structure.loads import REAL, Load, loaded_modes
from modalax.diagnose.modal_domain.structure.modes_only import ModesOnly, Simulation, flexibility_above
from modalax.diagnose.modal_domain.structure.nodes import nodes_of
from modalax.diagnose.modal_domain.structure.parts import parts_of
from modalax.diagnose.modal_domain.structure.turns import nodes_in
from modalax.model import Structure

QUICK = 1e3  # frequency of a DoF by itself, over that of the band, above which it is given mass
SPARED = 0.99  # frequency, relative to the spare coordinate's, above which a mode is that coordinate
SPARE = 4.0  # frequency of a coordinate to which nothing is attached, over the highest of all
FAR = 4.0  # frequency of coordinates of single DoFs beside modes alone, over the highest of these
FEW = 40  # measured DoFs up to which each has one
LARGEST = 120  # modal coordinates of large simulations
DRIVEN = 20  # channels of one side up to which the static responses to forces at these are kept as well
NEXT_TO = 60  # DoFs about which a large simulation is made exact up to which those of nodes next to them are too
FURTHER, AT_LEAST = 10, 60  # modes above the band, and in all, that are solved with their damping
ROUNDING = 1e-10  # relative distance of two poles below which nothing but rounding tells them apart


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
    spares
        Coordinates at the end to which nothing belongs: the spare one, and before it, of modes alone, those that may
        stand for modes further above.
    local
        Coordinates before these that move one measured DoF each, as flexible as the modes there that are not known.
    """

    frequencies: np.ndarray
    damping: np.ndarray
    shapes: np.ndarray
    outputs: np.ndarray
    inputs: np.ndarray
    solved: int
    names: tuple[str, ...]
    everywhere: np.ndarray
    spares: int = 1
    local: int = 0

    @property
    def size(self) -> int:
        """Number of modal coordinates."""
        return len(self.frequencies)

    @property
    def end(self) -> float:
        """Circular frequency [rad/s] from which on poles are of coordinates that stand for no mode."""
        return SPARED * float(self.frequencies[self.size - self.spares - self.local])


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
    simulation: Simulation, outputs: tuple[str, ...], inputs: tuple[str, ...], highest: float,
    exact: tuple[str, ...] = (), errors: np.ndarray | None = None,
) -> Coordinates:  # fmt: skip
    """Modal coordinates of a simulation whose band ends at ``highest`` [rad/s].

    A large one has few; by these it gives way as the whole does under forces at the inputs, or at the outputs where
    these are fewer, moves as that does if what acts on the nodes of the DoFs ``exact`` changes, and under the forces of
    ``errors`` of elements, shape ``(n, f)`` over the DoFs that these know.
    """
    if isinstance(simulation, ModesOnly):
        return _of_modes(simulation, outputs, inputs, highest)
    fewer = min(outputs, inputs, key=len)  # by static responses to forces at one side the FRFs follow at the other
    driven = fewer if len(fewer) <= DRIVEN else ()
    names, frequencies, shapes, inside = _solved(simulation, highest, LARGEST, exact, errors, driven)
    spare = SPARE * max(float(frequencies[-1]), highest)
    frequencies, everywhere = np.append(frequencies, spare), np.pad(shapes, ((0, 0), (0, 1)))
    shapes = everywhere if names == simulation.dofs else everywhere[[names.index(name) for name in simulation.dofs]]
    damping = _damping(simulation, frequencies, shapes, highest)
    rows, columns = ([simulation.index(name) for name in channels] for channels in (outputs, inputs))
    return Coordinates(
        frequencies, damping, shapes, shapes[rows], shapes[columns], _solved_with_damping(len(frequencies), inside),
        names, everywhere,
    )  # fmt: skip


def _solved_with_damping(size: int, inside: int) -> int:
    """How many of all modes are, of which some are in the band."""
    return min(size, max(inside + FURTHER, AT_LEAST))


def _of_modes(
    simulation: ModesOnly, outputs: tuple[str, ...], inputs: tuple[str, ...], highest: float
) -> Coordinates:  # fmt: skip
    """Coordinates of modes alone, beside what those that are not known add at measured DoFs."""
    known, measured = simulation.frequencies[:LARGEST], sorted({*outputs, *inputs})
    at = [simulation.dofs.index(name) for name in measured if len(measured) <= FEW]
    spares, local, last = 1 + min(len(outputs), len(inputs)), len(at), len(known)
    spare = SPARE * max(float(known[-1]), highest)
    frequencies = np.concatenate([known, np.full(local, FAR * known[-1]), np.full(spares, spare)])
    shapes = np.pad(simulation.shapes[:, :LARGEST], ((0, 0), (0, local + spares)))
    seen = shapes.copy()  # by sensors, and by forces; springs and masses may be anywhere
    seen[at, last + np.arange(local)] = FAR * known[-1] * np.sqrt(flexibility_above(known, shapes[at, :last]))
    damping = np.diag(np.append(simulation.damping[:LARGEST], np.zeros(local + spares)))
    rows, columns = ([simulation.dofs.index(name) for name in channels] for channels in (outputs, inputs))
    solved = _solved_with_damping(len(frequencies), int(np.count_nonzero(known < highest)))
    return Coordinates(
        frequencies, damping, shapes, seen[rows], seen[columns], solved, simulation.dofs, shapes, spares, local
    )


def _damping(simulation: Structure, frequencies: np.ndarray, shapes: np.ndarray, highest: float) -> np.ndarray:
    """Modal damping matrix; none of the spare coordinate."""
    rate = np.sqrt(np.maximum(frequencies, 1e-3 * highest))
    hysteretic = shapes.T @ np.asarray(simulation.D) @ shapes
    return shapes.T @ np.asarray(simulation.C) @ shapes + hysteretic / rate[:, None] / rate


@remembered(4)
def _solved(
    simulation: Structure, highest: float, largest: int, exact: tuple[str, ...], errors: np.ndarray | None,
    driven: tuple[str, ...],
) -> tuple[tuple[str, ...], np.ndarray, np.ndarray, int]:  # fmt: skip
    """DoFs, frequencies and shapes over them, and how many modes are in the band; of large simulations few shapes."""
    told = simulation.elements
    if told is None or not told.dofs:
        names, M, K = simulation.dofs, np.asarray(simulation.M), np.asarray(simulation.K)
    else:
        names = told.dofs
        K, M = (np.einsum("enr,emr->nm", a, a, optimize=True) for a in map(np.asarray, (told.stiffness, told.mass)))
    if len(K) <= largest:
        # a DoF without mass, as a rotation of a lumped model, moves as its stiffness demands
        M = M + np.diag(np.maximum(np.diag(K) / (QUICK * highest) ** 2 - np.diag(M), 0.0))
        values, shapes = scipy.linalg.eigh(K, M)
        return names, np.sqrt(np.maximum(values, 0.0)), shapes, int(np.count_nonzero(values < highest**2))
    if told is None:
        nodes = nodes_in(names, K)
        parts = parts_of(K, nodes), parts_of(M, nodes, mass=True)
        stiffness, mass = ([(p.dofs, p.matrix) for p in some] for some in parts)
    else:
        stiffness, mass = ([_piece(F) for F in np.asarray(factors)] for factors in (told.stiffness, told.mass))
    unit = np.eye(len(K))[:, [names.index(name) for name in driven] + _about(names, K, exact)]
    acting = unit if errors is None else np.hstack([unit, errors])
    return names, *ritz_basis(K, M, stiffness, mass, highest, largest, acting)


def _about(names: tuple[str, ...], K: np.ndarray, exact: tuple[str, ...]) -> list[int]:
    """DoFs of the nodes of some, and of those next to them, which may be what is meant, as far as these are few."""
    node = nodes_of(names).of_dofs
    here = np.isin(node, node[[names.index(name) for name in exact if name in names]])
    near = np.isin(node, node[(np.abs(K[:, here]) > 0).any(axis=1)])
    return np.flatnonzero(near if np.count_nonzero(near) <= NEXT_TO else here).tolist()


def is_large(simulation: Simulation) -> bool:
    """Whether few modal coordinates stand for a simulation."""
    if isinstance(simulation, ModesOnly):
        return False
    told = simulation.elements
    return len(simulation.dofs if told is None or not told.dofs else told.dofs) > LARGEST


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
    up = poles.imag > REAL * w.max()
    poles, vectors = poles[up], (vectors[m:, up] / poles[up]).T
    order = np.argsort(np.abs(poles))
    poles, vectors = poles[order], vectors[order]
    a = 2 * poles * (vectors**2).sum(axis=1) + ((vectors @ damping) * vectors).sum(axis=1)
    parts = _orthogonal(poles, vectors / np.sqrt(a)[:, None], damping)
    return Modes(poles, parts @ low.T, parts, solved, above)


def _orthogonal(poles: np.ndarray, vectors: np.ndarray, damping: np.ndarray) -> np.ndarray:
    r"""Vectors of unit norm :math:`v^T(2\lambda + C)v`, of repeated poles also orthogonal in it.

    Any vectors of a repeated pole are such ones. With the factors :math:`G = U\Sigma U^T` (Takagi 1924) of their
    products in that norm, which always exist, :math:`\Sigma^{-1/2}U^H` times them are orthogonal.
    """
    same = np.abs(np.diff(poles)) < ROUNDING * np.abs(poles[1:])
    if not same.any():
        return vectors
    out = vectors.copy()
    for some in np.split(np.arange(len(poles)), np.flatnonzero(~same) + 1):
        if len(some) < 2:
            continue
        v = np.linalg.qr(vectors[some].T)[0].T
        G = v @ (2 * poles[some].mean() * v + v @ damping).T
        G = (G + G.T) / 2
        size, joined = np.linalg.eigh(np.block([[G.real, G.imag], [G.imag, -G.real]]))
        size, joined = size[len(some) :], joined[:, len(some) :]
        out[some] = (joined[: len(some)] + 1j * joined[len(some) :]).conj().T / np.sqrt(size)[:, None] @ v
    return out


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
