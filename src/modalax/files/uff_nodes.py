"""Nodes, lines and mode shapes of universal files (15, 2411, 82, 2412, 55, 2414)."""

import warnings
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from modalax.data.dofs import DIRECTIONS, parse_dof
from modalax.data.geometry import Geometry
from modalax.files.uff_functions import node_numbers
from modalax.model.modal import ModalModel, in_order, poles_from

Set = Mapping[str, Any]
NORMAL, COMPLEX_FIRST, COMPLEX_SECOND = 2, 3, 7
# Derivatives that shapes of each data type are of the displacement: unknown, general, displacement, velocity,
# acceleration.
DERIVATIVES = {0: 0, 1: 0, 8: 0, 11: 1, 12: 2}
LONGEST_LINE = 250  # entries of one data set 82


def geometry_of(sets: Sequence[Set]) -> Geometry:
    """Nodes [m] and lines of a file; elements are drawn by their edges.

    Raises
    ------
    ValueError
        If there are no nodes.
    """
    places: dict[str, np.ndarray] = {}
    lines: list[tuple[str, ...]] = []
    for s in sets:
        if s["type"] in (15, 2411):
            length = s["units"].length if s["units"] else 1.0
            xyz = length * np.array([s["x"], s["y"], s["z"]], dtype=float).T
            places |= {str(int(n)): p for n, p in zip(s["node_nums"], xyz, strict=True)}
        elif s["type"] == 82:
            lines += _polylines([int(n) for n in s["nodes"]])
        elif s["type"] == 2412:
            elements = [e for key, value in s.items() if isinstance(key, int) for e in value]
            lines += [_outline([str(n) for n in e["nodes_nums"]]) for e in elements]
    if not places:
        raise ValueError("holds no nodes (data set 15 or 2411)")
    whole = [line for line in lines if all(n in places for n in line)]
    if len(whole) < len(lines):
        warnings.warn(f"{len(lines) - len(whole)} lines go to nodes without position and were left out", stacklevel=4)
    return Geometry(list(places), np.array(list(places.values())), whole)


def _polylines(trace: Sequence[int]) -> list[tuple[str, ...]]:
    """Polylines of a trace, where 0 lifts the pen."""
    lines: list[list[str]] = [[]]
    for n in trace:
        if n == 0:
            lines.append([])
        else:
            lines[-1].append(str(n))
    return [tuple(line) for line in lines if len(line) > 1]


def _outline(nodes: Sequence[str]) -> tuple[str, ...]:
    return tuple(nodes) if len(nodes) < 3 else (*nodes, nodes[0])


def geometry_sets(geometry: Geometry, names: Sequence[str]) -> list[dict[str, Any]]:
    """Data sets 2411 and 82 of a geometry, nodes numbered as those of the DoFs ``names``."""
    numbers = node_numbers([parse_dof(n).node for n in names], geometry)
    renamed = [n for n in geometry.nodes if str(numbers[n]) != n]
    if renamed:
        shown = ", ".join(f"{n} -> {numbers[n]}" for n in renamed[:4])
        warnings.warn(f"universal files number their nodes: {shown}", UserWarning, stacklevel=5)
    xyz, zero = np.asarray(geometry.xyz), [0] * len(geometry.nodes)
    nodes = {
        "type": 2411, "node_nums": [numbers[n] for n in geometry.nodes], "def_cs": zero, "disp_cs": zero,
        "color": zero, "x": xyz[:, 0], "y": xyz[:, 1], "z": xyz[:, 2],
    }  # fmt: skip
    traces = [list(t) for t in _traces([[numbers[n] for n in line] for line in geometry.lines])]
    return [nodes] + [
        {"type": 82, "trace_num": k + 1, "id": "NONE", "color": 0, "nodes": np.array(t)} for k, t in enumerate(traces)
    ]


def _traces(lines: Sequence[Sequence[int]]) -> Iterator[Sequence[int]]:
    """The lines, cut where one is too long for a data set; the cut ends where the next piece begins."""
    for line in lines:
        for start in range(0, len(line) - 1, LONGEST_LINE - 1):
            yield line[start : start + LONGEST_LINE]


class Modes(NamedTuple):
    """Mode shapes as a file holds them.

    Attributes
    ----------
    poles
        Shape ``(n,)`` [rad/s].
    shapes
        Shape ``(n, dof)``.
    modal_a
        Scaling of each mode, residues are ``shape shape / modal_a``; 0 where the file gives none.
    dofs
        DoF names.
    """

    poles: np.ndarray
    shapes: np.ndarray
    modal_a: np.ndarray
    dofs: tuple[str, ...]

    def model(self) -> ModalModel:
        """The modal model, if every mode is scaled.

        Raises
        ------
        ValueError
            If a mode has no scaling (modal mass or modal a of 0).
        """
        missing = [str(k + 1) for k in np.flatnonzero(self.modal_a == 0)]
        if missing:
            which = f"modes {', '.join(missing)} have" if len(missing) > 1 else f"mode {missing[0]} has"
            raise ValueError(
                f"{which} no modal mass or modal a, so the model has no scale; "
                "modalax.files.load_modes reads the shapes alone"
            )
        participation = self.shapes / self.modal_a[:, None]
        return in_order(ModalModel(self.poles, self.shapes, participation, outputs=self.dofs, inputs=self.dofs))


class _Mode(NamedTuple):
    pole: complex
    modal_a: complex
    nodes: list[int]
    values: np.ndarray  # (node, direction)


def modes_of(sets: Sequence[Set]) -> Modes | None:
    """Mode shapes of data sets 55 and 2414 at nodes; None where there are none.

    Raises
    ------
    ValueError
        If the shapes are not given at the same nodes.
    """
    modes = [m for m in (_mode(s) for s in sets if s["type"] in (55, 2414)) if m is not None]
    if not modes:
        return None
    if any(m.nodes != modes[0].nodes or m.values.shape != modes[0].values.shape for m in modes):
        raise ValueError("its mode shapes are given at different nodes; they need the same nodes in the same order")
    values = np.array([m.values for m in modes])
    for what, numbers in (
        ("shapes", values),
        ("poles", [m.pole for m in modes]),
        ("scales", [m.modal_a for m in modes]),
    ):
        if not np.isfinite(numbers).all():
            raise ValueError(f"the {what} of its modes hold numbers that are not finite")
    # A direction that is zero in every shape was not measured: the format has no other way to say so.
    seen = np.argwhere((values != 0).any(axis=0))
    dofs = tuple(f"{modes[0].nodes[n]}:+{DIRECTIONS[d]}" for n, d in seen)
    return Modes(
        np.array([m.pole for m in modes]), values[:, seen[:, 0], seen[:, 1]], np.array([m.modal_a for m in modes]), dofs
    )


def _mode(s: Set) -> _Mode | None:
    return _mode_55(s) if s["type"] == 55 else _mode_2414(s)


def _mode_55(s: Set) -> _Mode | None:
    kind = s["analysis_type"]
    if kind not in (NORMAL, COMPLEX_FIRST, COMPLEX_SECOND) or s["spec_data_type"] not in DERIVATIVES:
        return None
    values = np.array([s[f"r{k}"] for k in range(1, 7) if f"r{k}" in s], dtype=complex).T
    nodes = [int(n) for n in s["node_nums"]]
    if kind == NORMAL:
        pole = _pole(s["freq"], s["modal_damp_vis"] or s["modal_damp_his"] / 2)
        return _Mode(pole, 2j * pole.imag * s["modal_m"] * _mass_unit(s), nodes, values)
    pole = complex(s["eig"])
    # Shapes of velocity are pole times shapes of displacement, and their modal a pole squared times as large.
    return _complex_mode(pole, s["modal_a"] * _mass_unit(s), nodes, values, DERIVATIVES[s["spec_data_type"]])


def _pole(frequency_hz: float, damping_ratio: float) -> complex:
    """The pole of a mode; a loss factor is taken as twice the damping ratio, which it is at resonance."""
    return complex(poles_from([frequency_hz], [damping_ratio])[0])


def _complex_mode(pole: complex, a: complex, nodes: list[int], values: np.ndarray, derivatives: int) -> _Mode:
    """A complex mode by its upper pole, as displacement; shapes of velocity or acceleration lose their scale."""
    if pole.imag < 0:
        pole, a, values = pole.conjugate(), a.conjugate(), values.conj()
    return _Mode(pole, a if derivatives == 0 else 0.0, nodes, values / pole**derivatives)


def _mass_unit(s: Set) -> float:
    """What one unit of mass (force s^2 / length) of the file is in kg."""
    return s["units"].force / s["units"].length if s["units"] else 1.0


def _mode_2414(s: Set) -> _Mode | None:
    kind = s["analysis_type"]
    if s["dataset_location"] != 1 or kind not in (NORMAL, COMPLEX_FIRST, COMPLEX_SECOND):
        return None
    if s["result_type"] not in DERIVATIVES:
        return None
    data = np.array(s["data_at_node"], dtype=float)
    values = data[:, 0::2] + 1j * data[:, 1::2] if s["data_type"] in (5, 6) else data.astype(complex)
    nodes = [int(n) for n in s["node_nums"]]
    real = lambda record, field: float(s.get(f"record{record}_field{field}", 0.0) or 0.0)
    if kind == NORMAL:
        pole = _pole(real(12, 2), real(12, 5) or real(12, 6) / 2)
        return _Mode(pole, 2j * pole.imag * real(12, 4) * _mass_unit(s), nodes, values)
    pole, a = complex(real(13, 1), real(13, 2)), complex(real(13, 3), real(13, 4))
    return _complex_mode(pole, a * _mass_unit(s), nodes, values, DERIVATIVES[s["result_type"]])


def mode_sets(model: ModalModel, geometry: Geometry | None) -> Iterator[dict[str, Any]]:
    """Data sets 55 (complex modes of displacement) of a modal model, six digits a number.

    Raises
    ------
    ValueError
        If a DoF is a rotation, which pyuff cannot write for complex shapes.
    """
    dofs = [parse_dof(n) for n in model.outputs]
    turned = [d.name for d in dofs if (d.direction or "").startswith("R")]
    if turned:
        raise ValueError(f"DoFs {', '.join(turned)} are rotations; complex shapes in UFF 55 hold translations only")
    _tell_what_is_lost(model, dofs)
    numbers = node_numbers([d.node for d in dofs], geometry)
    nodes = list(dict.fromkeys(d.node for d in dofs))
    a = np.asarray(model.modal_a()) if model.drive_points() else np.zeros(len(model.poles))
    for r, shape in enumerate(np.asarray(model.shapes)):
        values = np.zeros((len(nodes), 3), dtype=complex)
        for d, value in zip(dofs, shape, strict=True):
            values[nodes.index(d.node), "XYZ".index(d.direction or "X")] = d.sign * value
        yield {
            "type": 55, "id1": f"Mode {r + 1}", "model_type": 1, "analysis_type": COMPLEX_FIRST, "data_ch": 2,
            "spec_data_type": 8, "load_case": 0, "mode_n": r + 1, "eig": complex(model.poles[r]),
            "modal_a": complex(a[r]), "modal_b": complex(-a[r] * model.poles[r]),
            "node_nums": [numbers[n] for n in nodes], "r1": values[:, 0], "r2": values[:, 1], "r3": values[:, 2],
        }  # fmt: skip


def _tell_what_is_lost(model: ModalModel, dofs: Sequence[Any]) -> None:
    lost = []
    if np.any(np.asarray(model.upper)) or np.any(np.asarray(model.lower)):
        lost.append("residual terms")
    if not model.drive_points():
        lost.append("the scaling (no drive point)")
    elif model.outputs != model.inputs:
        lost.append("participation other than by reciprocity")
    if np.any(np.asarray(model.frequency_std)) or np.any(np.asarray(model.damping_std)):
        lost.append("the claimed standard deviations")
    if any(d.direction is None for d in dofs):
        lost.append("DoFs without direction, which become X")
    if lost:
        warnings.warn(f"UFF 55 does not hold {', '.join(lost)}; .npz keeps everything", UserWarning, stacklevel=5)
