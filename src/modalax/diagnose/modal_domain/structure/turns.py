r"""Which DoFs are rotations, where names do not tell: read off the stiffness matrix.

Nothing that joins DoFs resists a translation of all of them by one: with ``t`` one at displacements and zero at
rotations, row ``w`` of :math:`Kt` is zero unless ``w`` is held by the ground. What has to be left out of a row so that
the rest of it sums to zero, its own diagonal or what a lever couples it to, are rotations. A rotation turns with the
one displacement that all it is coupled to are coupled to as well.
"""

import itertools
import re
from collections.abc import Sequence

import numpy as np

from modalax._numerics.remembered import remembered
from modalax.diagnose.modal_domain.structure.elements import stiffness_parts
from modalax.diagnose.modal_domain.structure.modes_only import ModesOnly, Simulation
from modalax.diagnose.modal_domain.structure.nodes import NEGLIGIBLE, Nodes, nodes_of

AT_ONCE = 2  # rotations that one row may be coupled to
MOST = 60  # couplings of a row, of more of which no rotations are sought
FEWEST = 2  # rows that must show a rotation
MOST_DOFS = 6  # of one node
MANY = 0.4  # share of the rotations of one kind that bend something
FEW = 80  # nodes up to which other axes of rotation are tried than the names tell
SOUND = 1e-6  # energy that an element may give away, or stiffness that none holds, relative to the diagonal
# A node and a letter or word for the direction, as in 3w, 3:X+, 3:+TX, N3_UX, or its number, as in 3.4; or w3, theta_3
_PATTERNS = (
    re.compile(r"(?P<node>.*\d)[_.:\- ]*[+]?(?P<kind>[A-Za-z]+)[+]?"),
    re.compile(r"(?P<node>.*\d)[_.:\- ]+(?P<kind>[A-Za-z]*[1-6])"),
    re.compile(r"(?P<kind>[A-Za-z]+)[_.\- ]*(?P<node>\d.*)"),
)
_LAST = {"x": 0, "y": 1, "z": 2, "1": 0, "2": 1, "3": 2, "4": 0, "5": 1, "6": 2, "u": 0, "v": 1, "w": 2}  # of a kind


def rotations_of(K: np.ndarray) -> dict[int, int]:
    """Each rotation, and the displacement of the body that it turns; empty where the rows show none or disagree.

    Parameters
    ----------
    K
        Stiffness matrix over all DoFs, shape ``(n, n)``.
    """
    size = np.sqrt(np.maximum(np.abs(np.diag(K)), 1e-300))
    joined = np.abs(K) / size[:, None] / size > NEGLIGIBLE
    shown, straight, told = np.zeros(len(K), int), np.zeros(len(K), bool), 0
    for row, near in zip(K, map(np.flatnonzero, joined), strict=True):
        turning = _left_out(row[near]) if 0 < len(near) <= MOST else None  # a mass on a damper alone shows nothing
        if turning is not None:
            told += 1
            shown[near[turning]] += 1
            straight[np.delete(near, turning)] = True
    turns = np.flatnonzero(shown >= FEWEST)
    if not len(turns) or straight[shown > 0].any() or 2 * told < np.count_nonzero(joined.any(axis=1)):
        return {}
    moves = np.setdiff1d(np.arange(len(K)), turns)
    joined |= np.eye(len(K), dtype=bool)
    out = {}
    for turn in turns.tolist():
        near = moves[joined[turn, moves]]
        bodies = moves[joined[np.ix_(moves, near)].all(axis=1)]
        if len(bodies) != 1:
            return {}
        out[turn] = int(bodies[0])
    return out


def _left_out(row: np.ndarray) -> list[int] | None:
    """The fewest entries without which a row sums to zero; None if there are none or several such choices."""
    total, least = float(row.sum()), NEGLIGIBLE * float(np.abs(row).max())
    for count in range(AT_ONCE + 1):
        found = [
            list(which) for which in itertools.combinations(range(len(row)), count)
            if abs(total - row[list(which)].sum()) < least
        ]  # fmt: skip
        if found:
            return found[0] if len(found) == 1 else None
    return None


def directions_of(dofs: tuple[str, ...], axis: np.ndarray, K: np.ndarray) -> tuple[list[str], np.ndarray] | None:
    """Node and axis of every DoF, where the names tell nodes but no directions, or not all; None where none show.

    A kind of DoF, as all that end in ``w``, is a displacement along some axis if moving all of them by one strains
    next to nothing but what is held by the ground. The other kinds are then rotations.

    Parameters
    ----------
    axis
        As far as the names tell it: 0 to 2 for displacements, 3 to 5 for rotations, -1 if unknown; shape ``(n,)``.
    K
        Stiffness matrix, shape ``(n, n)``.
    """
    for pattern in _PATTERNS:
        read = [m for m in map(pattern.fullmatch, dofs) if m is not None]
        if len(read) == len(dofs):
            told = _by_kind([m["node"] for m in read], [m["kind"].lower() for m in read], axis, K)
            if told is not None:
                return told
    return None


def _by_kind(
    nodes: list[str], kinds: list[str], axis: np.ndarray, K: np.ndarray
) -> tuple[list[str], np.ndarray] | None:  # fmt: skip
    """The same by a node and a kind for every DoF."""
    known: dict[str, int] = {}
    for kind, one in zip(kinds, axis.tolist(), strict=True):
        if known.setdefault(kind, one) != one:
            return None
    if len(set(zip(nodes, kinds, strict=True))) < len(kinds) or len(set(nodes)) == len(kinds):
        return None
    alike = {kind: np.array([k == kind for k in kinds]) for kind in known}
    moves = [kind for kind, one in known.items() if one < 0 and _free(K, alike[kind])]
    turns = [kind for kind, one in known.items() if one < 0 and kind not in moves]
    if not turns and any(one < 0 and kind[-1] not in "xyzuvw" for kind, one in known.items()):
        return None  # letters may count chains as well as directions
    if not all(_bends(K, nodes, alike[kind], sum(alike[k] for k in known if k not in turns) > 0) for kind in turns):
        return None
    along = _axes(known, moves, turns)
    if along is None or not all(_free(K, alike[kind]) for kind, one in known.items() if 0 <= one < 3):
        return None
    return nodes, np.array([along[kind] for kind in kinds])


def _free(K: np.ndarray, moved: np.ndarray) -> bool:
    """Whether most of the rows that some DoFs act on feel nothing where all of these move by one."""
    own = np.abs(K[:, moved]).max(axis=1)
    acted = own > NEGLIGIBLE * np.abs(np.diag(K))
    return bool(2 * (np.abs(K[:, moved].sum(axis=1))[acted] < NEGLIGIBLE * own[acted]).sum() > acted.sum())


def _bends(K: np.ndarray, nodes: list[str], turns: np.ndarray, moves: np.ndarray) -> bool:
    """Whether many of some rotations are coupled to displacements of other nodes, as those of beams and levers are.

    Not all of one kind need be: what turns with bending in a fuselage twists a wing.
    """
    size = np.sqrt(np.maximum(np.abs(np.diag(K)), 1e-300))
    own = np.array([[a == b for b in nodes] for a in nodes])
    coupled = (np.abs(K) / size[:, None] / size > NEGLIGIBLE) & ~own & moves
    return bool(coupled[turns].any(axis=1).sum() >= MANY * turns.sum())


def _axes(known: dict[str, int], moves: list[str], turns: list[str]) -> dict[str, int] | None:
    """An axis for every kind of DoF, by its last letter or number where that tells; None where there are too many."""
    out = {kind: one for kind, one in known.items() if one >= 0}
    _share_out(moves, [a for a in (2, 1, 0) if a not in out.values()], out, 0)
    straight = [one for one in out.values() if one < 3]
    across = [3 + a for a in (1, 2, 0) if 3 + a not in out.values()]
    if len(straight) == 1 or (len(straight) == 2 and len(turns) == 1):  # it turns about what is normal to these
        across = [one for one in across if one - 3 not in straight]
    _share_out(turns, across, out, 3)
    return out if straight and len(out) == len(known) else None


def _share_out(kinds: list[str], axes: list[int], out: dict[str, int], first: int) -> None:
    """Give each kind the axis that its last letter tells, or else one that is left, as long as there are any."""
    hinted = {kind: first + _LAST[kind[-1]] for kind in kinds if kind[-1] in _LAST}
    if len(set(hinted.values())) == len(hinted) and set(hinted.values()) <= set(axes):
        out |= hinted
        axes = [one for one in axes if one not in hinted.values()]
        kinds = [kind for kind in kinds if kind not in hinted]
    out |= dict(zip(kinds, axes, strict=False))


@remembered(4)  # of a simulation, which is asked about by several
def nodes_at(simulation: Simulation) -> Nodes:
    """Nodes of a simulation; of one that is known by its modes alone by the names of its DoFs."""
    dofs = simulation.dofs
    return nodes_of(dofs) if isinstance(simulation, ModesOnly) else nodes_in(dofs, np.asarray(simulation.K))


def nodes_in(dofs: tuple[str, ...], K: np.ndarray) -> Nodes:
    """Nodes by the names of their DoFs, and by the stiffness matrix where names do not tell, or tell what is not so.

    A rotation may be called after the plane in which it is, though what bends along x turns about y, and may count the
    other way round.

    Parameters
    ----------
    K
        Stiffness matrix over the DoFs, shape ``(n, n)``.
    """
    plain = nodes_of(dofs)
    unknown = plain.axis < 0
    if not unknown.any():
        return _about_other_axes(plain, K)
    told = directions_of(dofs, plain.axis, K)
    if told is not None:
        members = [[k for k, own in enumerate(told[0]) if own == node] for node in dict.fromkeys(told[0])]
        return _about_other_axes(Nodes([_in_order(some, told[1]) for some in members], told[1], plain.sign), K)
    if not unknown.all():
        return plain
    turning = rotations_of(K)
    return _turning(turning, plain) if turning else _by_order(plain, K)


def _by_order(plain: Nodes, K: np.ndarray) -> Nodes:
    """Nodes of as many DoFs each, one after the other, where elements can be read so and not DoF by DoF."""
    count = len(K)
    if count > MOST_DOFS * FEW or _read_off(K, plain):
        return plain
    for each in (k for k in range(2, MOST_DOFS + 1) if count % k == 0 and count > k):
        told = _by_kind(
            [str(k // each) for k in range(count)], ["abcdef"[k % each] for k in range(count)], plain.axis, K
        )
        if told is not None and (told[1] > 2).any():
            members = [_in_order(range(k, k + each), told[1]) for k in range(0, count, each)]
            nodes = _about_other_axes(Nodes(members, told[1], plain.sign), K)
            if _read_off(K, nodes):
                return nodes
    return plain


def _about_other_axes(plain: Nodes, K: np.ndarray) -> Nodes:
    """The same with axes of rotation exchanged or one turned, where elements can be read so and not otherwise."""
    if (plain.axis < 3).all() or len(plain.members) > FEW or _read_off(K, plain):
        return plain
    seen = set()
    for order in itertools.permutations((3, 4, 5)):
        axis = np.select([plain.axis == one for one in (3, 4, 5)], order, plain.axis)
        members = [_in_order(some, axis) for some in plain.members]
        # to turn all of them is to turn the distances between nodes, which are sought anyway
        for turned in (-1, *sorted(set(axis[axis > 2].tolist()))[1:]):
            nodes = Nodes(members, axis, np.where(axis == turned, -plain.sign, plain.sign))
            key = axis.tobytes(), nodes.sign.tobytes()
            if key not in seen and _read_off(K, nodes):
                return nodes
            seen.add(key)
    return plain


def _read_off(K: np.ndarray, nodes: Nodes) -> bool:
    """Whether elements that give no energy away sum to a stiffness matrix."""
    size = np.sqrt(np.maximum(np.abs(np.diag(K)), 1e-300))
    left = K.copy()
    for p in stiffness_parts(K, nodes):
        if np.linalg.eigvalsh(p.matrix / size[p.dofs][:, None] / size[p.dofs])[0] < -SOUND:
            return False
        left[np.ix_(p.dofs, p.dofs)] -= p.matrix
    return bool((np.abs(left) / size[:, None] / size).max() < SOUND)


def _in_order(members: Sequence[int] | np.ndarray, axis: np.ndarray) -> np.ndarray:
    """DoFs of a node by their axes."""
    return np.array(sorted(members, key=lambda k: axis[k]))


def _turning(rotations: dict[int, int], plain: Nodes) -> Nodes:
    """Nodes of displacements along one axis, with the rotations that turn with them, one about each other axis."""
    bodies: dict[int, list[int]] = {}
    for turn, moves in rotations.items():
        bodies.setdefault(moves, []).append(turn)
    if not bodies or any(len(turns) > 2 for turns in bodies.values()):
        return plain
    axis = np.full(len(plain.axis), 2)
    for turns in bodies.values():
        axis[turns] = (4,) if len(turns) == 1 else (3, 4)
    moves = [k for k in range(len(axis)) if k not in rotations]
    return Nodes([np.array([k, *bodies.get(k, ())]) for k in moves], axis, plain.sign)
