"""What the page is told: diagram, geometry, picks, curves, MAC and shapes as plain values and packed arrays."""

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np

from modalax.data.dofs import parse_dof
from modalax.data.geometry import Geometry
from modalax.model.indicators import auto_mac, cmif, mpc, sum_frf
from modalax.show.shapes import moving
from modalax.show.stabilization import KINDS, pole_kinds
from modalax.show.style import frf_label
from modalax.view.beside import Beside, compare
from modalax.view.session import Session

ROUNDED = 16  # modes are filled up to a multiple of it, so that programs are compiled for few sizes only
SUM = "sum"  # name of the channel that is the sum of all


def packed(values: Any, kind: str = "f4") -> dict[str, str]:
    """An array as the base64 text of its numbers, as Plotly reads it."""
    return {"dtype": kind, "bdata": base64.b64encode(np.ascontiguousarray(values, kind).tobytes()).decode()}


class Answers:
    """What is told of a session.

    Parameters
    ----------
    session
        The picks.
    beside
        Modes to compare with, where there are any.
    """

    def __init__(self, session: Session, beside: Beside | None = None):
        self.session, self.beside = session, beside
        whole = session.whole
        self.turned = len(whole.inputs) > len(whole.outputs)
        self.dofs: tuple[str, ...] = whole.inputs if self.turned else whole.outputs
        self.geometry, self.moved = drawn(session.geometry, self.dofs)

    def opening(self) -> dict[str, Any]:
        """What never changes: channels, and where the nodes are."""
        whole = self.session.whole
        freq = np.asarray(whole.freq)
        return {
            "outputs": list(whole.outputs), "inputs": list(whole.inputs), "label": frf_label(whole.form),
            "sumLabel": frf_label(whole.form, "Sum FRF"), "band": [float(freq[0]), float(freq[-1])],
            "nodes": list(self.geometry.nodes), "xyz": np.asarray(self.geometry.xyz).round(6).tolist(),
            "pieces": self.geometry.segments.tolist(), "placed": self.session.geometry is self.geometry,
            "beside": None if self.beside is None else self.beside.label, "method": self.session.method,
        }  # fmt: skip

    def diagram(self) -> dict[str, Any]:
        """The poles of all orders that lie in the band, by kind, over sum FRF and the roots of the CMIF."""
        here = self.session.diagram
        lines = here.lines
        table = here.table
        poles, kinds = np.asarray(table.poles), pole_kinds(table, here.stability)
        f, zeta = np.abs(poles) / (2 * np.pi), -poles.real / np.maximum(np.abs(poles), 1e-300)
        orders = np.broadcast_to(np.asarray(table.orders)[:, None], poles.shape)
        inside = (f >= here.frf.ends[0]) & (f <= here.frf.ends[1])
        found = []
        for kind, (*_, name) in enumerate(KINDS):
            which = (kinds == kind) & inside
            found.append({
                "name": name, "x": packed(f[which], "f8"), "y": packed(orders[which], "i4"),
                "zeta": packed(100 * zeta[which]),
            })  # fmt: skip
        singular = np.sqrt(np.asarray(cmif(here.frf)))[lines]
        roots = [packed(singular[:, k]) for k in range(min(3, singular.shape[1]))] if singular.shape[1] > 1 else []
        return {
            "poles": found, "freq": packed(np.asarray(here.frf.freq)[lines], "f8"),
            "sum": packed(np.asarray(sum_frf(here.frf))[lines]), "cmif": roots,
            "orders": [int(table.orders[0]), int(table.orders[-1])], "notes": list(here.notes),
        }  # fmt: skip

    def now(self, channel: Any = SUM, mode: int = 1) -> dict[str, Any]:
        """Everything that a step changes: picks, the curve of a channel, MAC, and the shape of a mode."""
        session, state = self.session, self.session.state
        synthesis = session.synthesis
        count = len(state.picks)
        size = -(-max(count, 1) // ROUNDED) * ROUNDED
        shapes = np.zeros((size, synthesis.shapes.shape[1]), complex)
        shapes[:count] = synthesis.shapes
        if state.refined is not None:
            model = state.refined.model
            shapes[:count] = np.asarray(model.participation if self.turned else model.shapes)
        collinear = np.asarray(mpc(shapes))[:count]
        shapes_now = shapes[:count]
        beside = self._beside(shapes_now)
        return {
            "modes": self._modes(collinear), "unexplained": synthesis.unexplained,
            "mac": np.asarray(auto_mac(shapes))[:count, :count].round(4).tolist(), "curve": self.curve(channel),
            "shape": self.shape(shapes_now, mode, beside), "beside": None if beside is None else beside["told"],
            "undo": bool(session.past), "redo": bool(session.future), "band": list(state.band), "order": state.order,
            "refined": state.refined is not None, "diagram": f"{state.band[0]} {state.band[1]} {state.order}",
        }  # fmt: skip

    def _modes(self, collinear: np.ndarray) -> list[dict[str, Any]]:
        refined = self.session.state.refined
        std = lambda name, k: None if refined is None else _number(np.asarray(getattr(refined, name))[k])
        return [
            {
                "f": p.frequency_hz, "zeta": -p.pole.real / abs(p.pole), "name": p.name, "order": p.order,
                "fStd": std("frequency_std_hz", k), "zetaStd": std("damping_std", k), "mpc": _number(collinear[k]),
            }
            for k, p in enumerate(self.session.state.picks)
        ]  # fmt: skip

    def curve(self, channel: Any) -> dict[str, Any]:
        """Measured and synthesised FRF of a channel ``[output, input]`` by number, or of the sum of all.

        Raises
        ------
        ValueError
            If there is no such channel.
        """
        here, synthesis = self.session.diagram, self.session.synthesis
        lines = here.lines
        if channel == SUM:
            both = np.asarray(sum_frf(here.frf))[lines], synthesis.sum(lines)
            return {"magnitude": [packed(v) for v in both], "phase": None}
        _, outputs, inputs = here.frf.shape
        if not (isinstance(channel, list) and len(channel) == 2 and all(isinstance(c, int) for c in channel)):
            raise ValueError(f"channel {channel!r}; it is 'sum' or [output, input] by number from 0")
        o, i = channel
        if not (0 <= o < outputs and 0 <= i < inputs):
            raise ValueError(f"there is no channel {o}, {i}; the FRFs have {outputs} outputs and {inputs} inputs")
        both = here.responses.H[lines, o, i], synthesis.channel(lines, o, i)
        phases = [np.degrees(np.angle(v)) for v in both]
        # A line from -180 to 180 degrees is no jump of the phase, so that it is not drawn.
        phases[1][1:][np.abs(np.diff(phases[1])) > 180] = np.nan
        return {"magnitude": [packed(np.abs(v)) for v in both], "phase": [packed(v) for v in phases]}

    def shape(self, shapes: np.ndarray, mode: int, beside: dict[str, Any] | None = None) -> dict[str, Any] | None:
        """Displacement of every node in a mode, counted from 1, and in its partner beside; None where there is none."""
        if not 1 <= mode <= len(shapes):
            return None
        own = shapes[mode - 1]
        u = moving(self.geometry, self.moved[1], own[self.moved[0]])
        top = float(np.abs(u).max()) or 1.0
        found: dict[str, Any] = {"mode": mode, "u": packed(_parts(u / top)), "other": None}
        if beside is not None and beside["partners"][mode - 1] is not None:
            other = moving(self.geometry, beside["dofs"], beside["partners"][mode - 1])
            found["other"] = packed(_parts(_aligned(other, u) / top))
        return found

    def _beside(self, shapes: np.ndarray) -> dict[str, Any] | None:
        """MAC with the modes beside, and the partners' shapes at the nodes that are drawn."""
        if self.beside is None or not len(shapes):
            return None
        frequency = np.array([p.frequency_hz for p in self.session.state.picks])
        try:
            found = compare(self.beside, frequency, shapes, self.dofs, self.session.state.band)
        except ValueError as error:  # another band may have none of its modes; the picks go on without it
            return {"told": {"error": str(error)}, "partners": [None] * len(shapes), "dofs": []}
        at = {column: k for k, column in enumerate(found.columns)}
        common = [c for c in self.moved[0] if c in at]
        names = [self.moved[1][self.moved[0].index(c)] for c in common]
        paired = found.correlation.pairs >= 0
        partners = [row[[at[c] for c in common]] if yes and common else None
                    for row, yes in zip(found.partners, paired, strict=True)]  # fmt: skip
        told = {
            "mac": found.correlation.mac.round(4).tolist(), "f": found.frequency_hz.tolist(),
            "pairs": found.correlation.pairs.tolist(), "common": len(found.columns), "of": len(self.dofs),
        }  # fmt: skip
        return {"told": told, "partners": partners, "dofs": names}


def drawn(geometry: Geometry | None, dofs: Sequence[str]) -> tuple[Geometry, tuple[list[int], list[str]]]:
    """What moves on the page, and which DoFs move it, by index and name.

    Without a geometry, or where it has none of the DoFs, they stand in a row in their order and move upwards.
    """
    if geometry is not None:
        parsed = [parse_dof(d) for d in dofs]
        keep = [k for k, d in enumerate(parsed) if d.node in geometry.nodes and d.direction in ("X", "Y", "Z")]
        if keep:
            return geometry, (keep, [dofs[k] for k in keep])
    names = [str(k + 1) for k in range(len(dofs))]
    x = np.linspace(0, 1, len(dofs)) if len(dofs) > 1 else np.zeros(1)
    row = Geometry(names, np.stack([x, 0 * x, 0 * x], axis=1), [names])
    return row, (list(range(len(dofs))), [f"{n}:+Z" for n in names])


def _aligned(other: np.ndarray, u: np.ndarray) -> np.ndarray:
    """A partner's displacements in phase with those of the shape picked; each was turned by itself."""
    inner = np.vdot(other, u)
    return other * (inner / abs(inner)) if abs(inner) else other


def _parts(u: np.ndarray) -> np.ndarray:
    return np.stack([u.real, u.imag], axis=-1)


def _number(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None
