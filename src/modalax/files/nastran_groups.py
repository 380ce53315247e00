"""Groups of elements of a Nastran deck: those of one property, and of one material with several properties.

The entries are those of the MSC Nastran Quick Reference Guide (CBAR, PBAR, MAT1 and their like).
"""

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from modalax.files.nastran import cards, whole
from modalax.model.elements import Element
from modalax.model.groups import Groups

Pair = tuple[int, int]
JOINING = ("CBAR", "CBEAM", "CROD", "CTUBE", "CBUSH", "CELAS1")  # element, property, then the grid points
OF_MATERIAL = ("PBAR", "PBARL", "PBEAM", "PBEAML", "PROD", "PTUBE")  # property, then the material
SPRINGS = ("PBUSH", "PELAS")
MOST_VALUES = 6_000_000  # numbers that the shares of all groups may hold


def read_groups(path: Path) -> dict[str, set[Pair]]:
    """Pairs of grid points that elements of each property join, by names such as ``PBEAM 12``.

    Where elements of several properties join the same points, only their sum is in a stiffness matrix, and they make a
    group such as ``PBEAM 12 + PBEAM 13``. A material of several groups makes one as well, such as ``MAT1 3``.
    """
    joined: dict[Pair, set[int]] = defaultdict(set)
    names: dict[int, str] = {}
    materials: dict[int, int] = {}
    for card, fields in cards(path):
        if card in JOINING:
            a, b = (fields[2], fields[4]) if card == "CELAS1" else (fields[2], fields[3])
            if a and b:
                first, second = sorted((whole(a), whole(b)))
                joined[first, second].add(whole(fields[1] or fields[0]))
        elif card in (*OF_MATERIAL, *SPRINGS):
            names[whole(fields[0])] = f"{card} {whole(fields[0])}"
            if card in OF_MATERIAL and len(fields) > 1 and fields[1]:
                materials[whole(fields[0])] = whole(fields[1])
    found: dict[str, set[Pair]] = defaultdict(set)
    of_material: dict[int, set[Pair]] = defaultdict(set)
    for pair, numbers in joined.items():
        found[" + ".join(names.get(number, f"property {number}") for number in sorted(numbers))].add(pair)
        made_of = {materials.get(number) for number in numbers}
        if len(made_of) == 1 and None not in made_of:
            of_material[materials[min(numbers)]].add(pair)
    return {**found, **{f"MAT1 {number}": of_material[number] for number in sorted(of_material)}}


def groups_of(
    named: dict[str, set[Pair]], parts: Sequence[Element], size: int, motion: np.ndarray | None
) -> Groups | None:
    """Groups of several elements, by those that a stiffness matrix parts into; None where there are none, or too many.

    Parameters
    ----------
    size
        Number of DoFs of the whole model.
    motion
        How these follow the DoFs that the groups are told over, shape ``(size, kept)``; None for all of them.
    """
    own = {part.nodes: part for part in parts if len(part.nodes) == 2}
    found: dict[frozenset[Pair], str] = {}
    for name, pairs in named.items():
        there = frozenset(pairs & own.keys())
        if len(there) > 1:  # a material whose elements are all of one property is told by that
            found.setdefault(there, name)
    if not found or len(found) * size**2 > MOST_VALUES:
        return None
    shares = np.zeros((len(found), size, size))
    for share, pairs in zip(shares, found, strict=True):
        for pair in pairs:
            share[np.ix_(own[pair].dofs, own[pair].dofs)] += own[pair].matrix
    return Groups(list(found.values()), shares if motion is None else motion.T @ shares @ motion)
