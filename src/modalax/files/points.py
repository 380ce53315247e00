"""Positions of nodes from plain files: tables of points (CSV) and triangles (STL, text and binary)."""

import struct
from pathlib import Path

import numpy as np

from modalax.data.geometry import Geometry
from modalax.files.guard import Refused, check_size, reading

MOST_NODES = 200_000
HEADER, TRIANGLE = 84, 50  # bytes of a binary STL file before the triangles, and of each


def geometry_of_points(path: Path) -> Geometry:
    """Nodes of a table with the columns node, x, y, z [m].

    Raises
    ------
    ValueError
        If a column is missing or a row does not fit; the message names it.
    """
    with reading("the table of points"):
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    rows = [(k + 1, line) for k, line in enumerate(lines) if line.strip() and not line.startswith("#")]
    if not rows:
        raise ValueError("holds no rows; a table of points has the columns node, x, y, z [m]")
    mark = next((m for m in ("\t", ";", ",") if m in rows[0][1]), None)
    titles = [t.strip().strip('"').lower().removesuffix("[m]").strip() for t in rows[0][1].split(mark)]
    missing = [t for t in ("node", "x", "y", "z") if t not in titles]
    if missing:
        raise ValueError(f"has the columns {', '.join(titles)}; a table of points needs node, x, y, z [m]")
    _check_count(len(rows) - 1)
    names, places = [], []
    for number, line in rows[1:]:
        cells = [c.strip().strip('"') for c in line.split(mark)]
        if len(cells) < len(titles):
            raise ValueError(f"line {number} has {len(cells)} columns, the header {len(titles)}")
        names.append(cells[titles.index("node")])
        try:
            decimal = [cells[titles.index(axis)].replace(",", ".") for axis in "xyz"]
            places.append([float(c) for c in decimal])
        except ValueError as error:
            raise ValueError(f"line {number} holds what is no number ({error})") from error
    return Geometry(names, np.array(places).reshape(-1, 3))


def geometry_of_triangles(path: Path) -> Geometry:
    """Nodes 1, 2, ... of an STL file, in the order in which its corners first come, and the edges between them.

    STL files give no unit; metres are assumed.

    Raises
    ------
    ValueError
        If the file is damaged or holds no triangle.
    """
    with reading("the STL file"):
        content = path.read_bytes()
        text = content[:5].lower() == b"solid" and b"facet" in content[:1000]
        corners = _text_corners(content) if text else _binary_corners(content, path)
    if not len(corners):
        raise ValueError("holds no triangle")
    _, first, back = np.unique(corners, axis=0, return_index=True, return_inverse=True)
    _check_count(len(first))
    order = np.argsort(first)
    number = np.argsort(order)[back.ravel()]
    faces = number.reshape(-1, 3)
    edges = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1), axis=0)
    names = [str(k + 1) for k in range(len(first))]
    return Geometry(names, corners[first[order]], [(names[a], names[b]) for a, b in edges if a != b])


def _check_count(count: int) -> None:
    if count > MOST_NODES:
        raise Refused(f"holds {count} nodes; at most {MOST_NODES} are read")


def _binary_corners(content: bytes, path: Path) -> np.ndarray:
    count = struct.unpack_from("<I", content, HEADER - 4)[0]
    check_size(HEADER + TRIANGLE * count, path, "the STL file")
    if len(content) < HEADER + TRIANGLE * count:
        raise Refused(f"the STL file is cut short: it announces {count} triangles and has {len(content)} bytes")
    kind = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    return np.frombuffer(content, kind, count, HEADER)["corners"].astype(float).reshape(-1, 3)


def _text_corners(content: bytes) -> np.ndarray:
    words = [line.split() for line in content.decode("utf-8", errors="replace").splitlines()]
    corners = np.array([[float(v) for v in w[1:4]] for w in words if w[:1] == ["vertex"]]).reshape(-1, 3)
    if len(corners) % 3:
        raise Refused(f"the STL file is cut short: {len(corners)} corners make no whole triangles")
    return corners
