"""Joints written as text, ``law:DoFs:parameters``, or as tables of a TOML file."""

import dataclasses
import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def read_joints(spec: str) -> list[tuple[Any, tuple[str, ...]]]:
    """Read joints, each as (law, DoFs), from ``law:dofs:parameters`` or from a TOML file.

    The file holds tables ``[[joint]]`` with ``law``, ``where`` (one or two DoFs) and the parameters.

    Raises
    ------
    ValueError
        If the text or file cannot be read, or a law or parameter is unknown; the message lists the known ones.
    """
    if spec.endswith(".toml"):
        return _joints_of_file(Path(spec))
    law, _, rest = spec.partition(":")
    places, _, values = rest.rpartition(":")
    if not places:
        raise ValueError(f"joint {spec!r}: needs law:dofs:parameters, for example elasto_slip:3,5:k=2e4,slip_force=4")
    parameters = {}
    for item in values.split(","):
        name, equals, value = item.partition("=")
        if not equals:
            raise ValueError(f"joint {spec!r}: parameter {item!r} needs name=value")
        parameters[name.strip()] = value
    return [make_joint(spec, law.strip(), [p.strip() for p in places.split(",")], parameters)]


def _joints_of_file(path: Path) -> list[tuple[Any, tuple[str, ...]]]:
    from modalax.files.messages import about

    if path.exists() and not path.is_file():
        raise ValueError(f"{path} is no file; joints are read from a TOML file")
    with about(path):
        tables = tomllib.loads(path.read_text(encoding="utf-8")).get("joint", [])
    if not isinstance(tables, list) or not tables or not all(isinstance(table, dict) for table in tables):
        raise ValueError(f"{path} holds no table [[joint]] with law, where and parameters")
    return [joint_of_table(f"{path}, joint {k + 1}", table) for k, table in enumerate(tables)]


def make_joint(what: str, law: str, where: list[str], parameters: dict[str, Any]) -> tuple[Any, tuple[str, ...]]:
    """Make one joint of the catalogue; ``what`` names it in error messages.

    Raises
    ------
    ValueError
        If the law or a parameter is unknown or missing, or a parameter is no number or out of its bounds.
    """
    from modalax.simulate.joints import CATALOGUE

    if law not in CATALOGUE:
        raise ValueError(f"joint {what}: no law {law!r}; there are {', '.join(CATALOGUE)}")
    kind = CATALOGUE[law]
    whole = [f.name for f in dataclasses.fields(kind) if f.metadata.get("static")]  # powers, numbers of elements
    if not 1 <= len(where) <= 2:
        raise ValueError(f"joint {what}: sits at {len(where)} DoFs; it needs one (to ground) or two")
    needed, optional = _wanted(kind, whole)
    may = f"optional: {', '.join(optional.values())}" if optional else ""
    if unknown := set(parameters) - set(needed) - set(optional):
        wanted = "; ".join(filter(None, [", ".join(needed.values()), may]))
        raise ValueError(f"joint {what}: {law} has no parameter {', '.join(sorted(unknown))}; it has {wanted}")
    values = _values(what, kind, whole, parameters)
    if missing := [text for name, text in needed.items() if name not in parameters]:
        raise ValueError(f"joint {what}: {law} needs {', '.join(missing)}" + (f"; {may}" if may else ""))
    return kind(**values), tuple(where)


def _wanted(kind: Any, whole: list[str]) -> tuple[dict[str, str], dict[str, str]]:
    """Parameters that a law needs and those that have a default, each by name as name and unit."""
    texts = {name: f"{name} [{unit}]" for name, unit in kind.units.items()} | {name: name for name in whole}
    nothing = dataclasses.MISSING
    fixed = {f.name for f in dataclasses.fields(kind) if f.default is nothing and f.default_factory is nothing}
    needed = {name: text for name, text in texts.items() if name in fixed}
    return needed, {name: text for name, text in texts.items() if name not in fixed}


def _values(what: str, kind: Any, whole: list[str], parameters: dict[str, Any]) -> dict[str, Any]:
    """Parameters of a law as numbers within their bounds; those named in ``whole`` as whole numbers."""
    try:
        values: dict[str, Any] = {name: numbers(value) for name, value in parameters.items()}
    except (TypeError, ValueError) as error:
        raise ValueError(f"joint {what}: a parameter is no number: {error}") from error
    for name, value in values.items():
        several = value if isinstance(value, list) else [value]
        if not all(math.isfinite(v) for v in several):
            raise ValueError(f"joint {what}: {name} is {parameters[name]}; finite numbers are needed")
        if name in whole:
            if any(v != int(v) for v in several):
                raise ValueError(f"joint {what}: {name} is {parameters[name]}; whole numbers are needed")
            values[name] = tuple(int(v) for v in several) if name == "powers" else int(several[0])
            continue
        low, high = kind.bounds[name]
        for number in several:
            if not low <= number <= high:
                raise ValueError(f"joint {what}: {name} is {number:g}; it must lie within {low:g} and {high:g}")
        values[name] = several if "powers" in whole else value
    return values


def numbers(value: Any) -> float | list[float]:
    """Read one number, or several from a list or from text with semicolons."""
    if isinstance(value, str) and ";" in value:
        value = value.split(";")
    return [float(v) for v in value] if isinstance(value, list) else float(value)


def joint_of_table(what: str, table: Mapping[str, Any]) -> tuple[Any, tuple[str, ...]]:
    """Make one joint of a table with ``law``, ``where`` (one or two DoFs) and the parameters.

    Raises
    ------
    ValueError
        Naming ``what``, if something is missing, of the wrong kind or unknown.
    """
    missing = {"law", "where"} - set(table)
    if missing:
        raise ValueError(f"{what}: lacks {', '.join(sorted(missing))}")
    parameters = {name: value for name, value in table.items() if name not in ("law", "where")}
    where = [table["where"]] if isinstance(table["where"], str) else table["where"]
    if not isinstance(where, list) or not isinstance(table["law"], str):
        raise ValueError(f"{what}: law is a name, and where one or two names of DoFs")
    return make_joint(what, table["law"], [str(w) for w in where], parameters)
