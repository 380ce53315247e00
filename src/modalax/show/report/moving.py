"""Mode shapes of a report that move on the geometry: what the page's own program draws."""

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from modalax.data.geometry import Geometry
from modalax.show.shapes import moving


@dataclass(frozen=True)
class Shapes:
    """Mode shapes on a geometry, one at a time on screen and all on paper.

    Attributes
    ----------
    geometry
        Nodes and lines.
    modes
        Label and displacement of every node, complex ``(node, 3)`` with a largest size of 1, of each mode.
    caption, description
        What stands below, and what a reader who cannot see the picture is told.
    """

    geometry: Geometry
    modes: Sequence[tuple[str, np.ndarray]]
    caption: str
    description: str = "Mode shapes on the geometry."

    def json(self) -> str:
        """Geometry and displacements for ``shape.js``, as JSON that may stand inside a script element."""
        drawn = {
            "xyz": np.asarray(self.geometry.xyz).round(6).tolist(), "pieces": self.geometry.segments.tolist(),
            "placed": True, "modes": [{"label": label, "u": packed_shape(u)} for label, u in self.modes],
        }  # fmt: skip
        text = json.dumps(drawn, allow_nan=False)
        return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def packed_shape(u: np.ndarray) -> str:
    """Real and imaginary part of the displacements as the base64 text of single-precision numbers."""
    pairs = np.stack([u.real, u.imag], axis=-1)
    return base64.b64encode(np.ascontiguousarray(pairs, "<f4").tobytes()).decode()


def shapes_on(geometry: Geometry, dofs: Sequence[str], shapes: Any, frequency_hz: Any) -> Shapes:
    """Mode shapes, ``(mode, dof)``, on the geometry, each scaled so that its largest displacement is 1."""
    modes = []
    for k, (shape, f) in enumerate(zip(np.asarray(shapes), np.asarray(frequency_hz), strict=True)):
        u = moving(geometry, dofs, shape)
        top = float(np.linalg.norm(u, axis=1).max()) or 1.0
        modes.append((f"{k + 1}: {f:.5g} Hz", u / top))
    return Shapes(
        geometry, modes, "Mode shapes, enlarged, over the structure at rest in grey. Drag to turn, wheel to zoom, "
        "double-click to start over.",
    )  # fmt: skip
