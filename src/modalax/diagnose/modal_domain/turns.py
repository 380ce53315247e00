r"""Which DoFs are rotations, where names do not tell: read off the stiffness matrix.

Nothing that joins DoFs resists a translation of all of them by one: with ``t`` one at displacements and zero at
rotations, row ``w`` of :math:`Kt` is zero unless ``w`` is held by the ground. What has to be left out of a row so that
the rest of it sums to zero, its own diagonal or what a lever couples it to, are rotations. A rotation turns with the
one displacement that all it is coupled to are coupled to as well.
"""

import itertools
import re

import numpy as np

NEGLIGIBLE = 1e-7  # coupling, or what a row sums to, relative to the diagonal, that counts as none
AT_ONCE = 2  # rotations that one row may be coupled to
MOST = 60  # couplings of a row, of more of which no rotations are sought
FEWEST = 2  # rows that must show a rotation
# A node and a letter or word for the direction, as in 3w, 3_theta, or in w3, theta_3
_PATTERNS = (
    re.compile(r"(?P<node>.*\d)[_.\- ]?(?P<kind>[A-Za-z]+)"),
    re.compile(r"(?P<kind>[A-Za-z]+)[_.\- ]?(?P<node>\d.*)"),
)


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
        turning = _left_out(row[near]) if len(near) <= MOST else None
        if turning is not None:
            told += 1
            shown[near[turning]] += 1
            straight[np.delete(near, turning)] = True
    turns = np.flatnonzero(shown >= FEWEST)
    if not len(turns) or straight[shown > 0].any() or 2 * told < len(K):
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
        As far as the names tell it: 0 to 2 for displacements, 3 to 5 for rotations, -1 if unknown.
    """
    read = next((m for m in ([p.fullmatch(d) for d in dofs] for p in _PATTERNS) if None not in m), None)
    if read is None:
        return None
    nodes, kinds = ([m[part] for m in read if m is not None] for part in ("node", "kind"))
    known: dict[str, int] = {}
    for kind, one in zip(kinds, axis.tolist(), strict=True):
        if known.setdefault(kind, one) != one:
            return None
    if len(set(zip(nodes, kinds, strict=True))) < len(dofs) or len(set(nodes)) == len(dofs):
        return None
    alike = {kind: np.array([k == kind for k in kinds]) for kind in known}
    moves = [kind for kind, one in known.items() if one < 0 and _free(K, alike[kind])]
    along = _axes(known, moves, [kind for kind, one in known.items() if one < 0 and kind not in moves])
    if along is None or not all(_free(K, alike[kind]) for kind, one in known.items() if 0 <= one < 3):
        return None
    return nodes, np.array([along[kind] for kind in kinds])


def _free(K: np.ndarray, moved: np.ndarray) -> bool:
    """Whether most of the rows that some DoFs act on feel nothing where all of these move by one."""
    own = np.abs(K[:, moved]).max(axis=1)
    acted = own > NEGLIGIBLE * np.abs(np.diag(K))
    return bool(2 * (np.abs(K[:, moved].sum(axis=1))[acted] < NEGLIGIBLE * own[acted]).sum() > acted.sum())


def _axes(known: dict[str, int], moves: list[str], turns: list[str]) -> dict[str, int] | None:
    """An axis for every kind of DoF; None where that of a rotation would have to be guessed."""
    out = {kind: one for kind, one in known.items() if one >= 0}
    for kind, one in zip(moves, [a for a in (2, 1, 0) if a not in out.values()], strict=False):
        out[kind] = one
    straight = [one for one in out.values() if one < 3]
    across = [3 + a for a in (1, 2, 0) if 3 + a not in out.values() and (len(straight) > 1 or a not in straight)]
    if len(straight) > 1:  # in a plane it turns about what is normal to it
        across = [one for one in across if one - 3 not in straight]
    if not straight or len(turns) > len(across) or len(out) < len(known) - len(turns):
        return None
    return out | dict(zip(turns, across, strict=False))
