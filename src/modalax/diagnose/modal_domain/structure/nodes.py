"""Nodes of a simulation, by the names of its degrees of freedom."""

import re
from dataclasses import dataclass

import numpy as np

from modalax.data.dofs import parse_dof

NEGLIGIBLE = 1e-7  # size of a coupling, relative to the diagonal, below which there is none
AXES = ("X", "Y", "Z", "RX", "RY", "RZ")
# Names such as 12z, n3_ry or 12.RX, besides those written 12:+Z
_SHORT = re.compile(r"(?P<node>.*?[^A-Za-z]|[A-Za-z]+?)[_.\- ]?(?P<direction>[rR]?[xyzXYZ])")
_AHEAD = re.compile(r"u?(?P<turn>r|rot)?(?P<along>[xyz])[_.\- ]?(?P<node>\d+)", re.IGNORECASE)  # z12, rotx_3, ux4
_IN_PLANE = re.compile(r"(?P<node>.*\d)[_.\- ]?(?P<way>[uvw]|phi|theta)", re.IGNORECASE)  # N9u, 3_phi
_WAYS = {"u": "X", "v": "Y", "w": "Z"}


@dataclass(frozen=True)
class Nodes:
    """Which DoFs belong to one node; ``axis`` is 0 to 2 for displacements, 3 to 5 for rotations, -1 if unknown."""

    members: list[np.ndarray]
    axis: np.ndarray
    sign: np.ndarray

    @property
    def of_dofs(self) -> np.ndarray:
        """Number of the node of each DoF, shape ``(n,)``."""
        out = np.zeros(len(self.axis), int)
        for k, members in enumerate(self.members):
            out[members] = k
        return out

    def held_more(self, i: int, j: int) -> tuple[int, int] | tuple[()]:
        """Two nodes, that one last of which a displacement is held that the other has; empty if neither is."""
        free = [{int(axis) for axis in self.axis[self.members[k]] if 0 <= axis < 3} for k in (i, j)]
        if free[1] < free[0]:
            return i, j
        return (j, i) if free[0] < free[1] else ()

    def hinges(self, K: np.ndarray) -> dict[int, int]:
        """Nodes with rotations alone, and the node whose displacements each shares.

        It is the one whose displacements, and not its rotations, go with all that the rotations are coupled to.
        """
        size = np.sqrt(np.maximum(np.abs(np.diag(K)), 1e-300))
        unit = np.abs(K) / size[:, None] / size > NEGLIGIBLE
        joined = lambda a, b: bool(len(a) and len(b) and unit[np.ix_(a, b)].any())
        moves = [m[(self.axis[m] >= 0) & (self.axis[m] < 3)] for m in self.members]
        turns = [m[self.axis[m] > 2] for m in self.members]
        out = {}
        for b in range(len(self.members)):
            if len(moves[b]) or not len(turns[b]):
                continue
            near = [k for k in range(len(self.members)) if k != b and joined(self.members[k], turns[b])]
            for a in near:
                others = [c for c in near if c != a and len(moves[c])]
                if (
                    others
                    and joined(turns[a], turns[b])
                    and all(joined(moves[a], self.members[c]) and not joined(turns[a], self.members[c]) for c in others)
                ):
                    out[b] = a
                    break
        return out


def nodes_of(dofs: tuple[str, ...]) -> Nodes:
    """Nodes by the names of their DoFs, those of each in the order of its directions, whatever that of the names.

    Where names do not show the node, every DoF is a node of its own.
    """
    found: dict[object, list[int]] = {}
    axis, sign = np.full(len(dofs), -1), np.ones(len(dofs))
    for k, (node, direction, way) in enumerate(_read(dofs)):
        if direction in AXES:
            axis[k] = AXES.index(direction)
        sign[k] = way
        found.setdefault((node,) if axis[k] >= 0 else dofs[k], []).append(k)
    return Nodes([np.array(sorted(v, key=lambda k: axis[k])) for v in found.values()], axis, sign)


def _read(dofs: tuple[str, ...]) -> list[tuple[str, str | None, int]]:
    """Node, direction and sign of each name.

    Letters alone, and letters before a number, may also count points; they are directions where that shows: where a
    body turns, and where one number has several directions. The last letter of a word, as of ``body``, is one where
    all names end in one, or the rest of that word ends in several.
    """
    names = [name.strip() for name in dofs]
    plane = _read_in_plane(names)
    if plane:
        return plane
    alone = any(name.upper() in AXES[3:] for name in names)
    ahead = [_AHEAD.fullmatch(name) for name in names]
    numbered = [(m["node"], f"{'R' * bool(m['turn'])}{m['along'].upper()}") for m in ahead if m is not None]
    many = len({node for node, _ in numbered}) < len(set(numbered))
    behind = [_SHORT.fullmatch(name) for name in names]
    words = [m["node"] for m in behind if m is not None and m["node"].isalpha()]
    found: list[tuple[str, str | None, int]] = []
    for name, first, last in zip(names, ahead, behind, strict=True):
        node, direction, way = parse_dof(name)
        if last is not None and words.count(last["node"]) == 1 and None in behind:
            last = None
        if direction is not None:
            found.append((node, direction, way))
        elif alone and name.upper() in AXES:
            found.append(("", name.upper(), 1))
        elif first is not None and many:
            found.append((first["node"], f"{'R' * bool(first['turn'])}{first['along'].upper()}", 1))
        elif last is not None:
            found.append((last["node"].rstrip("_.- "), last["direction"].upper(), 1))
        else:
            found.append((name, None, 1))
    return found


def _read_in_plane(names: list[str]) -> list[tuple[str, str | None, int]]:
    """The same where all names end in u, v or w, and in one rotation about the axis that two of these leave."""
    found = [m for m in map(_IN_PLANE.fullmatch, names) if m is not None]
    ways = {m["way"].lower() for m in found}
    straight, turns = sorted(_WAYS[way] for way in ways & set(_WAYS)), ways - set(_WAYS)
    if len(found) < len(names) or len(straight) < 2 or len(turns) > 1 or (turns and len(straight) > 2):
        return []
    about = {way: f"R{next(x for x in 'XYZ' if x not in straight)}" for way in turns}
    return [(m["node"], (_WAYS | about)[m["way"].lower()], 1) for m in found]


def rigid_moves(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Rigid motion at axes ``b`` of a node by that at axes ``a`` of another: constant, and by each component of r."""
    out = np.zeros((4, len(b), len(a)))
    out[0] = (b[:, None] == a) & (b[:, None] >= 0)
    # displacement of j = displacement of i + rotation x r
    for axis, (first, second) in enumerate(((1, 2), (2, 0), (0, 1))):
        for row, col, r, sign in ((first, axis, second, -1.0), (second, axis, first, 1.0)):
            out[1 + r] += sign * np.outer(b == row, a == 3 + col)
    return out
