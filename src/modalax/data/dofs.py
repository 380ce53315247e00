"""Names of degrees of freedom: a node and a direction, written ``12:+Z``."""

import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

DIRECTIONS = ("X", "Y", "Z", "RX", "RY", "RZ")
_NAME = re.compile(r"(?P<node>.+):(?P<sign>[+-]?)(?P<direction>R?[XYZ])", re.IGNORECASE)


class Dof(NamedTuple):
    """A degree of freedom.

    Attributes
    ----------
    node
        Name of the node.
    direction
        ``X``, ``Y``, ``Z`` (translation), ``RX``, ``RY``, ``RZ`` (rotation), or None where the name gives none.
    sign
        +1, or -1 where the channel counts positive against the direction.
    """

    node: str
    direction: str | None
    sign: int

    @property
    def name(self) -> str:
        """The name in full, for example ``12:-Z``; the node alone where there is no direction."""
        return self.node if self.direction is None else f"{self.node}:{'-' if self.sign < 0 else '+'}{self.direction}"


def parse_dof(name: str) -> Dof:
    """Read a name ``<node>:<+/-><direction>``; a name of another form is a node without direction.

    Parameters
    ----------
    name
        For example ``12:+Z``, ``12:-Z``, ``12:Z`` (taken as +), ``wing:12:+RX`` (node ``wing:12``) or ``5``.

    Raises
    ------
    ValueError
        If the name is empty.
    """
    text = name.strip()
    if not text:
        raise ValueError("a DoF name is empty; it needs a node, for example '12:+Z' or '5'")
    match = _NAME.fullmatch(text)
    if match is None:
        return Dof(text, None, 1)
    return Dof(match["node"], match["direction"].upper(), -1 if match["sign"] == "-" else 1)


def same_place(a: str, b: str) -> int:
    """Compare two DoFs: +1 if they are the same, -1 if they differ in sign alone, 0 if they are different."""
    first, second = parse_dof(a), parse_dof(b)
    if first[:2] != second[:2]:
        return 0
    return first.sign * second.sign


def direction_vectors(names: Sequence[str]) -> np.ndarray:
    """Unit vector of each DoF, shape ``(dof, 3)``: the translation, or the axis of a rotation; 0 without direction."""
    vectors = np.zeros((len(names), 3))
    for row, name in zip(vectors, names, strict=True):
        dof = parse_dof(name)
        if dof.direction is not None:
            row["XYZ".index(dof.direction[-1])] = dof.sign
    return vectors


def as_names(names: str | Iterable[str]) -> tuple[str, ...]:
    """Names as a tuple; a text is one name."""
    return (names,) if isinstance(names, str) else tuple(names)
