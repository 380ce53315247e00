"""Functions at nodal DoFs (data set 58): a grid of outputs and inputs from single FRFs, and back."""

import warnings
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from modalax.data.dofs import DIRECTIONS, parse_dof
from modalax.data.frf import DERIVATIVES
from modalax.data.geometry import Geometry
from modalax.data.measurement import Measurement
from modalax.data.streaming import release
from modalax.files.gaps import mended
from modalax.files.uff_units import axis_unit, form_of, is_upside_down, response_scale, tell_other_form
from modalax.files.units import FREQUENCIES, frequency_factor

FUNCTIONS = {
    0: "general functions", 1: "time responses", 2: "autospectra", 3: "cross spectra", 4: "FRFs",
    5: "transmissibilities", 6: "coherences", 9: "power spectral densities", 12: "spectra",
}  # fmt: skip
ORDINATE = {
    "receptance": (8, "Displacement", "m"), "mobility": (11, "Velocity", "m/s"),
    "accelerance": (12, "Acceleration", "m/s^2"),
}  # fmt: skip
FORCE = (13, "Force", "N")
# Words in the identification lines that carry what the format has no field for.
OUTPUT, INPUT, RUN, VARIANCE = "modalax output ", "modalax input ", "modalax run ", "modalax variance"
STEP_DIGITS = "%13.5e"
SAME_AXIS = 1e-9
TOGETHER = 64  # outputs whose functions are laid into the array at once, a few lines of memory for each line


class Function(NamedTuple):
    """One function of the file in SI units: its kind, its DoFs, its lines (in ``axis_unit`` still) and values."""

    kind: str
    title: str
    output: str
    input: str
    form: str | None
    freq: np.ndarray
    values: np.ndarray
    about_run: str
    axis_unit: str
    upside_down: bool = False


def functions_of(sets: Sequence[Mapping[str, Any]]) -> list[Function]:
    """The functions of data sets 58, with names, forms and units made out.

    Raises
    ------
    ValueError
        If a set holds fewer values than it announces.
    """
    entities = {s[key].strip() for s in sets for key in ("rsp_ent_name", "ref_ent_name")} - {"", "NONE"}
    return [_function(k, s, prefixed=len(entities) > 1) for k, s in enumerate(sets)]


def _function(k: int, found: Mapping[str, Any], prefixed: bool) -> Function:
    count, values = found.get("num_pts", 0), _values(k, found)
    title = FUNCTIONS.get(found["func_type"], f"functions of type {found['func_type']}")
    kind = {4: "frf", 6: "coherence"}.get(found["func_type"], "other")
    scale = response_scale(found) if kind == "frf" else 1.0
    if found["id1"].startswith(VARIANCE):
        kind = "variance"
    names = [
        found[line][len(mark) :].strip() if found[line].startswith(mark) else _name(found, side, prefixed)
        for line, mark, side in (("id4", OUTPUT, "rsp"), ("id5", INPUT, "ref"))
    ]
    about_run = found["id2"][len(RUN) :] if found["id2"].startswith(RUN) else ""
    return Function(
        kind,
        title,
        names[0],
        names[1],
        form_of(found),
        np.asarray(found["x"])[:count],
        values[:count] if scale == 1 else scale * values[:count],
        about_run,
        axis_unit(found),
        is_upside_down(found),
    )


def _values(k: int, found: Mapping[str, Any]) -> np.ndarray:
    """Values of one function, after its header was compared with them.

    Raises
    ------
    ValueError
        If the header does not fit the values, or an FRF is not complex.
    """
    kind, what = found.get("ord_data_type"), f"function {k + 1}"
    if kind not in (2, 4, 5, 6):
        raise ValueError(f"{what} has the ordinate data type {kind}; it is 2 or 4 (real), 5 or 6 (complex)")
    if found["binary"] and found.get("byte_ordering") not in (1, 2):
        raise ValueError(f"{what} has the byte order {found.get('byte_ordering')}; it is 1 (little) or 2 (big endian)")
    if found["func_type"] == 4 and kind in (2, 4):
        raise ValueError(f"{what}, an FRF, holds real numbers (ordinate data type {kind}); a magnitude is not enough")
    count, values = found["num_pts"], np.asarray(found["data"])
    if not 0 < count <= len(values) <= count + 1 + count // 50:  # some writers fill up the last record
        state = "is cut short: it" if len(values) < count else "does not fit its header: it"
        raise ValueError(f"{what} {state} holds {len(values)} of the {count} values that it announces")
    return values


def _name(found: Mapping[str, Any], side: str, prefixed: bool) -> str:
    node, code, entity = found[f"{side}_node"], found[f"{side}_dir"], found[f"{side}_ent_name"].strip()
    name = f"{entity}:{node}" if prefixed and entity not in ("", "NONE") else str(node)
    if code == 0:
        return name
    if not 1 <= abs(code) <= len(DIRECTIONS):
        raise ValueError(f"direction code {code} of node {node} is not known; it is -6 to 6")
    return f"{name}:{'-' if code < 0 else '+'}{DIRECTIONS[abs(code) - 1]}"


Cells = dict[tuple[str, str], list[Function]]


def measurement_of(
    functions: Sequence[Function], form: str | None, complete: bool, frequency_unit: str | None = None
) -> Measurement:
    """A measurement from single FRFs; a pair of DoFs that stands several times makes several runs.

    Raises
    ------
    ValueError
        If pairs are missing or stand unequally often, axes or forms differ, or the form is not known.
    """
    functions = _in_hertz(functions, frequency_unit)
    functions = _of_one_form(functions) if form is None else functions
    frfs = [f for f in functions if f.kind == "frf"]
    tell_other_form((f.form for f in frfs), form)
    form = form or _common_form(frfs)
    freq = _common_axis(frfs)
    cells = _cells(frfs)
    outputs = list(dict.fromkeys(f.output for f in frfs))
    inputs = list(dict.fromkeys(f.input for f in frfs))
    outputs, inputs = _complete_grid(cells, outputs, inputs, complete)
    kept = set(outputs), set(inputs)
    runs = _runs({key: found for key, found in cells.items() if key[0] in kept[0] and key[1] in kept[1]})
    grid = lambda table: _grid(table, runs, outputs, inputs)
    extra = {}
    for kind in ("coherence", "variance"):
        table = _cells([f for f in functions if f.kind == kind])
        if table and all(len(table.get((o, i), ())) == runs for o in outputs for i in inputs):
            extra[kind] = np.real(grid(table))
        elif table:
            warnings.warn(f"a {kind} stands beside some FRFs only and was left out", UserWarning, stacklevel=5)
    _tell_left_out(functions)
    first = cells[outputs[0], inputs[0]]
    H = grid(cells).astype(complex, copy=False)
    freq, H, outputs, inputs, extra = mended(freq, H, outputs, inputs, extra, stacklevel=6)
    return Measurement(freq, H, form=form, outputs=outputs, inputs=inputs, **extra, **_run_facts(first))


def _grid(table: Cells, runs: int, outputs: Sequence[str], inputs: Sequence[str]) -> np.ndarray:
    """Values of all functions in one array, shape ``(run, f, o, i)``, filled some outputs at a time.

    What was read of the file for it is given back to the system, so that file and array are not both held.
    """
    one = table[outputs[0], inputs[0]][0].values
    kind = np.result_type(*{f.values.dtype for found in table.values() for f in found})
    H = np.empty((runs, len(one), len(outputs), len(inputs)), kind)
    for r in range(runs):
        for at in range(0, len(outputs), TOGETHER):
            several = outputs[at : at + TOGETHER]
            block = np.array([[table[o, i][r].values for i in inputs] for o in several])
            H[r, :, at : at + len(several)] = block.transpose(2, 0, 1)
            release(one)
    return H


def _cells(functions: Sequence[Function]) -> Cells:
    table: Cells = {}
    for f in functions:
        table.setdefault((f.output, f.input), []).append(f)
    return table


def _in_hertz(functions: Sequence[Function], unit: str | None) -> Sequence[Function]:
    """The functions over frequencies in Hz, by the unit that the user gave or that of each; one not known is told."""
    units = {f.axis_unit for f in functions if f.kind == "frf"} if unit is None else {unit}
    unknown = {u for u in units if u and u not in FREQUENCIES} if unit is None else set()
    if unknown:
        warnings.warn(
            f"its frequencies are in {', '.join(sorted(unknown))}, which is not known: taken as Hz; frequency_unit "
            "(--frequency-unit) tells it",
            UserWarning,
            stacklevel=6,
        )
    size = lambda f: FREQUENCIES.get(f.axis_unit, 1.0) if unit is None else frequency_factor(unit)
    return [f if size(f) == 1 else f._replace(freq=size(f) * f.freq) for f in functions]


def _of_one_form(functions: Sequence[Function]) -> Sequence[Function]:
    """The functions, FRFs of different forms turned to that of most time derivatives among them; a warning says so."""
    forms = {f.form for f in functions if f.kind == "frf"}
    if len(forms) < 2 or None in forms:
        return functions
    highest = max((f for f in forms if f), key=lambda form: DERIVATIVES[form])
    warnings.warn(f"its FRFs are {', '.join(sorted(map(str, forms)))}; all are turned to {highest}", stacklevel=6)
    turned = []
    for f in functions:
        if f.kind in ("frf", "variance") and f.form is not None and f.form != highest:
            factor = (2j * np.pi * f.freq) ** (DERIVATIVES[highest] - DERIVATIVES[f.form])
            f = f._replace(values=f.values * (factor if f.kind == "frf" else np.abs(factor) ** 2), form=highest)
        turned.append(f)
    return turned


def _common_form(frfs: Sequence[Function]) -> str:
    forms = sorted({f.form or "unknown" for f in frfs})
    if forms == ["unknown"]:
        if any(f.upside_down for f in frfs):
            raise ValueError(
                "its FRFs are force over motion, dynamic stiffness or mass; only motion over force is read: invert them"
            )
        raise ValueError(
            "its FRFs do not say whether they are receptance, mobility or accelerance (ordinate type); "
            "pass form='accelerance', for example"
        )
    if len(forms) > 1:
        example = {name: next(f for f in frfs if (f.form or "unknown") == name) for name in forms}
        shown = ", ".join(f"{name} ({f.output}/{f.input})" for name, f in example.items())
        raise ValueError(f"its FRFs are of different forms: {shown}; one form is needed, or pass form=...")
    return forms[0]


def _common_axis(frfs: Sequence[Function]) -> np.ndarray:
    first = frfs[0]
    for f in frfs[1:]:
        if len(f.freq) != len(first.freq):
            raise ValueError(
                f"FRF {f.output}/{f.input} has {len(f.freq)} lines, {first.output}/{first.input} has "
                f"{len(first.freq)}; all need one frequency axis"
            )
        if np.abs(f.freq - first.freq).max() > SAME_AXIS * np.abs(first.freq).max():
            raise ValueError(
                f"FRFs {f.output}/{f.input} and {first.output}/{first.input} have different frequencies; "
                "all need one axis"
            )
    return first.freq


def _complete_grid(cells: Cells, outputs: list[str], inputs: list[str], complete: bool) -> tuple[list[str], list[str]]:
    """Outputs and inputs of which every FRF is in the file."""
    missing = [(o, i) for o in outputs for i in inputs if (o, i) not in cells]
    if not missing:
        return outputs, inputs
    if not complete:
        shown = ", ".join(f"{o}/{i}" for o, i in missing[:6]) + (", ..." if len(missing) > 6 else "")
        raise ValueError(
            f"{len(missing)} of {len(outputs) * len(inputs)} FRFs (output/input) are missing: {shown}; "
            "complete=True (--complete) leaves out the channels that lack them"
        )
    dropped = []
    while missing:
        lacks = {("output", o): sum(m[0] == o for m in missing) / len(inputs) for o, _ in missing}
        lacks |= {("input", i): sum(m[1] == i for m in missing) / len(outputs) for _, i in missing}
        side, name = max(lacks, key=lambda key: lacks[key])
        (outputs if side == "output" else inputs).remove(name)
        dropped.append(f"{side} {name}")
        missing = [(o, i) for o, i in missing if o in outputs and i in inputs]
    warnings.warn(f"left out, because some of their FRFs are missing: {', '.join(dropped)}", UserWarning, stacklevel=6)
    return outputs, inputs


def _runs(cells: Cells) -> int:
    counts = {key: len(found) for key, found in cells.items()}
    most = max(counts, key=lambda key: counts[key])
    least = min(counts, key=lambda key: counts[key])
    if counts[most] != counts[least]:
        raise ValueError(
            f"FRF {'/'.join(most)} stands {counts[most]} times, {'/'.join(least)} {counts[least]} times; "
            "runs need every FRF equally often"
        )
    return counts[most]


def _tell_left_out(functions: Sequence[Function]) -> None:
    titles = [f.title for f in functions if f.kind == "other"]
    if titles:
        counted = ", ".join(f"{titles.count(t)} {t}" for t in sorted(set(titles)))
        warnings.warn(f"beside the FRFs it holds {counted}, which were left out", UserWarning, stacklevel=5)


def _run_facts(first: Sequence[Function]) -> dict[str, Any]:
    """Level, added decay and averages, from the words that files of our own carry."""
    words = [f.about_run.split() for f in first]
    facts = [dict(zip(w[1::2], w[2::2], strict=False)) for w in words]
    if not all("level" in f for f in facts):
        return {}
    common: dict[str, Any] = {"level": np.array([float(f["level"]) for f in facts])}
    common["added_decay"] = float(facts[0].get("added_decay", 0.0))
    if "averages" in facts[0]:
        common["averages"] = int(facts[0]["averages"])
    return common


def node_numbers(nodes: Sequence[str], geometry: Geometry | None) -> dict[str, int]:
    """A number for each node: its name where that is one, else the next that is free."""
    names = list(dict.fromkeys([*(geometry.nodes if geometry is not None else ()), *nodes]))
    numbers = {name: int(name) for name in names if name.isascii() and name.isdecimal() and str(int(name)) == name}
    free = max(numbers.values(), default=0)
    for name in names:
        if name not in numbers:
            free += 1
            numbers[name] = free
    return numbers


def function_sets(measurement: Measurement, binary: bool, geometry: Geometry | None) -> Iterator[dict[str, Any]]:
    """Data sets 58 of a measurement: FRFs, then coherences and variances.

    Raises
    ------
    ValueError
        If there is one line only, which the format cannot hold.
    """
    freq = np.asarray(measurement.freq)
    if len(freq) < 2:
        raise ValueError("a universal file needs 2 frequency lines or more, here is 1")
    even = _is_even(freq)
    if not (even or binary) and any(float(STEP_DIGITS % f) != f for f in freq):
        warnings.warn("text UFF keeps 6 digits of these frequencies; binary=True keeps all", UserWarning, stacklevel=6)
    numbers = node_numbers([parse_dof(n).node for n in (*measurement.outputs, *measurement.inputs)], geometry)
    order = DERIVATIVES[measurement.form]
    tables = {"frf": measurement.H, "coherence": measurement.coherence, "variance": measurement.variance}
    common = {
        "type": 58, "binary": int(binary), "load_case_id": 0, "x": freq, "abscissa_spacing": int(even),
        "abscissa_spec_data_type": 18, "abscissa_axis_lab": "Frequency", "abscissa_axis_units_lab": "Hz",
        "z_axis_spec_data_type": 0,
    }  # fmt: skip
    for kind, table in tables.items():
        if table is None:
            continue
        values = np.asarray(table)
        for r in range(measurement.runs):
            for o, out in enumerate(measurement.outputs):
                for i, into in enumerate(measurement.inputs):
                    yield {
                        **common, **_ordinate(kind, measurement.form), **_ends(out, into, numbers), "ver_num": r,
                        "id1": _title(kind, out, into, order), "id2": _about_run(measurement, r),
                        "data": values[r, :, o, i].copy(),
                    }  # fmt: skip


def _title(kind: str, out: str, into: str, order: int) -> str:
    word = {"frf": ("Receptance", "Mobility", "Accelerance")[order], "coherence": "Coherence", "variance": VARIANCE}[
        kind
    ]
    return f"{word} {out} / {into}"[:80]


def _is_even(freq: np.ndarray) -> bool:
    """Whether the first line and the step, as the format prints them, reproduce the frequency axis."""
    first, step = float(STEP_DIGITS % freq[0]), float(STEP_DIGITS % (freq[1] - freq[0]))
    return bool(np.allclose(first + step * np.arange(len(freq)), freq, rtol=0, atol=1e-14 * freq[-1]))


def _ordinate(kind: str, form: str) -> dict[str, Any]:
    code, label, unit = ORDINATE[form]
    if kind != "frf":
        code, label, unit = (0, "NONE", "NONE")
    force, force_label, newton = FORCE if kind == "frf" else (0, "NONE", "NONE")
    return {
        "func_type": {"frf": 4, "coherence": 6, "variance": 0}[kind],
        "ordinate_spec_data_type": code, "ordinate_axis_lab": label, "ordinate_axis_units_lab": unit,
        "orddenom_spec_data_type": force, "orddenom_axis_lab": force_label, "orddenom_axis_units_lab": newton,
    }  # fmt: skip


def _ends(out: str, into: str, numbers: Mapping[str, int]) -> dict[str, Any]:
    """Nodes and directions; names that these do not give back also stand in the identification lines."""
    ends: dict[str, Any] = {}
    for side, name, line, mark in (("rsp", out, "id4", OUTPUT), ("ref", into, "id5", INPUT)):
        dof = parse_dof(name)
        code = 0 if dof.direction is None else dof.sign * (DIRECTIONS.index(dof.direction) + 1)
        ends |= {f"{side}_node": numbers[dof.node], f"{side}_dir": code}
        if f"{numbers[dof.node]}" != dof.node or dof.name != name:
            if len(mark + name) > 80:
                raise ValueError(
                    f"DoF name {name!r} is {len(name)} letters long; universal files hold {80 - len(mark)}"
                )
            ends[line] = mark + name
    return ends


def _about_run(measurement: Measurement, run: int) -> str:
    words = f"{RUN}{run} level {float(measurement.level[run])!r} added_decay {float(measurement.added_decay)!r}"
    return words if measurement.averages is None else f"{words} averages {measurement.averages}"
