"""Settings of a study: which keys its file may hold, of what kind, and what each means."""

import difflib
import math
import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

KINDS = ("noise", "bootstrap", "parameter", "diagnosis", "function")
REQUIRED = object()  # the default of a key that must be given
MEMORY_MB = 500.0  # memory [MB] that the draws of one chunk may take together


@dataclass(frozen=True)
class Key:
    """One key of a study file.

    Attributes
    ----------
    kind
        ``whole``, ``number``, ``text``, ``flag``, ``numbers``, ``texts``, ``band``, ``tables`` or ``value`` (anything).
    meaning
        What the key means, with its unit, for errors and help.
    default
        Its value where it is not given; ``REQUIRED`` if it must be.
    least
        Smallest number allowed.
    choices
        Words allowed; all if empty.
    """

    kind: str
    meaning: str
    default: Any = None
    least: float = -math.inf
    choices: tuple[str, ...] = ()


STUDY = {
    "kind": Key("text", "kind of study", REQUIRED, choices=KINDS),
    "draws": Key("whole", "number of draws (of each combination or size)", REQUIRED, least=1.0),
    "seed": Key("whole", "seed of the study", 0, least=0.0),
    "chunk": Key("whole", "draws computed and stored together; chosen if not given", least=1.0),
    "memory_mb": Key("number", "memory that a chunk may take [MB]", MEMORY_MB, least=1.0),
}
SYSTEM = {
    "simulation": Key("text", "file of matrices or modes, or five_dof for the built-in system", REQUIRED),
    "band": Key("band", "lowest and highest frequency [Hz]", REQUIRED),
    "step": Key("number", "distance of the frequency lines [Hz]", REQUIRED, least=1e-12),
    "inputs": Key("texts", "DoFs where the force acts; the first if not given"),
    "outputs": Key("texts", "DoFs where the motion is measured; all if not given"),
    "form": Key("text", "form of the FRFs", "receptance", choices=("receptance", "mobility", "accelerance")),
    "noise": Key("number", "noise as a fraction of the reference", 0.01, least=0.0),
    "noise_reference": Key("text", "what the noise is a fraction of", "rms", choices=("rms", "peak", "local")),
    "force": Key("numbers", "force amplitudes [N], a run for each"),
    "joint": Key("tables", "joints, each with law, where and its parameters"),
    "harmonics": Key("whole", "harmonics of the response where there are joints", 3, least=1.0),
}
FIT = {
    "method": Key("text", "estimator of the poles", None, choices=("lscf", "plscf", "lsce", "fdpi")),
    "order": Key("whole", "highest model order", least=2.0),
    "refine": Key("flag", "whether to refine by maximum likelihood", True),
}
DATA = {
    "file": Key("text", "measurement to draw from", REQUIRED),
    "band": Key("band", "lowest and highest frequency [Hz]; all if not given"),
    "run": Key("whole", "run to draw from, counted from 1", 1, least=1.0),
    "resample": Key("text", "what is drawn", "auto", choices=("auto", "runs", "variance")),
}
HIDDEN = {
    "cause": Key("text", "effect that the structure has and its simulation lacks", REQUIRED),
    "where": Key("texts", "DoFs or channels of the effect", []),
    "sizes": Key("numbers", "sizes of the effect, in the unit of the parameter", REQUIRED),
    "parameter": Key("text", "parameter of a joint's law that the sizes are values of"),
    "fixed": Key("value", "values of the other parameters of the law"),
}
DIAGNOSE = {
    "causes": Key("texts", "causes to look for; all if not given"),
    "question": Key("text", "question that is asked", "auto", choices=("auto", "fixed", "free")),
}
TABLES: dict[str, dict[str, dict[str, Key] | None]] = {
    "noise": {"system": SYSTEM, "fit": FIT},
    "bootstrap": {"data": DATA, "fit": FIT},
    "parameter": {"system": SYSTEM, "fit": FIT, "vary": None},
    "diagnosis": {"system": SYSTEM, "hidden": HIDDEN, "diagnose": DIAGNOSE},
    "function": {"parameters": None},
}
NEEDED = {
    "noise": ("system",), "bootstrap": ("data",), "parameter": ("system", "vary"), "diagnosis": ("system", "hidden"),
    "function": (),
}  # fmt: skip
FUNCTION = {
    "function": Key("value", "function of a seed, as module:function", REQUIRED),
    "vmap": Key("flag", "whether jax.vmap runs the function over the keys of a chunk", False),
}


def read_settings(path: Path) -> dict[str, Any]:
    """Settings of a TOML file, checked, with the defaults filled in.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        Naming the file, what was seen and what is known, if it is no TOML or holds what no study has.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file; modalax study --example noise prints one to start from")
    try:
        given = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is no TOML file: {error}") from error
    return checked(given, str(path))


def checked(given: Mapping[str, Any], name: str = "study") -> dict[str, Any]:
    """Settings with the defaults filled in.

    Parameters
    ----------
    given
        As in a study file.
    name
        What errors begin with.

    Raises
    ------
    ValueError
        If a key is unknown, missing or of the wrong kind.
    """
    kind = _value(f"{name}: kind", STUDY["kind"], given.get("kind", REQUIRED))
    known = STUDY | (FUNCTION if kind == "function" else {})
    tables = TABLES[kind]
    top = {key: value for key, value in given.items() if key not in tables}
    found = _table(name, known, top, also=tables, colon=":")
    for table, keys in tables.items():
        value = given.get(table, {})
        if not isinstance(value, Mapping):
            raise ValueError(f"{name}: {table} is {value!r}; it must be a table, [{table}]")
        if not value and table in NEEDED[kind]:
            raise ValueError(f"{name}: a {kind} study needs a table [{table}]; modalax study --example {kind} shows it")
        found[table] = dict(value) if keys is None else _table(f"{name}: [{table}]", keys, value)
    return found


@contextmanager
def of_key(key: str) -> Iterator[None]:
    """Put the name of a key, as ``[system] inputs``, before the message of an error that its value leads to.

    Raises
    ------
    ValueError
        In place of every one raised inside.
    """
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{key}: {error}") from error


def _table(
    name: str, known: Mapping[str, Key], given: Mapping[str, Any], also: Any = (), colon: str = ""
) -> dict[str, Any]:
    """The values of a table by key, checked, with the defaults; ``colon`` parts its name from that of a key."""
    for key in given:
        if key not in known:
            near = difflib.get_close_matches(str(key), [*known, *also], 1)
            hint = f" (did you mean {near[0]}?)" if near else ""
            raise ValueError(
                f"{name} has the key {key!r}, which is not known{hint}; known are {', '.join([*known, *also])}"
            )
    return {key: _value(f"{name}{colon} {key}", spec, given.get(key, REQUIRED)) for key, spec in known.items()}


def _value(name: str, spec: Key, value: Any) -> Any:
    """One value, checked; the default where it is not given."""
    if value is REQUIRED:
        if spec.default is REQUIRED:
            words = f": one of {', '.join(spec.choices)}" if spec.choices else ""
            raise ValueError(f"{name} is missing; it is needed ({spec.meaning}{words})")
        return spec.default
    found = READ[spec.kind](value)
    if found is None:
        raise ValueError(f"{name} is {value!r}; it needs {WORDS[spec.kind]} ({spec.meaning})")
    for number in found if isinstance(found, list) else [found]:
        if isinstance(number, int | float) and number < spec.least:
            raise ValueError(f"{name} is {value!r}; it must be at least {spec.least:g} ({spec.meaning})")
    if spec.choices and found not in spec.choices:
        raise ValueError(f"{name} is {value!r}; it must be one of {', '.join(spec.choices)}")
    return found


def _whole(value: Any) -> int | None:
    return value if isinstance(value, int) and not isinstance(value, bool) else None


def _number(value: Any) -> float | None:
    right = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return float(value) if right else None


def _several(read: Callable[[Any], Any]) -> Callable[[Any], list[Any] | None]:
    def of(value: Any) -> list[Any] | None:
        found = [read(v) for v in value] if isinstance(value, list) else [read(value)]
        return None if not found or any(v is None for v in found) else found

    return of


def _text(value: Any) -> str | None:
    return value if isinstance(value, str) else None


def _band(value: Any) -> list[float] | None:
    found = _several(_number)(value)
    return found if found is not None and len(found) == 2 and 0 <= found[0] < found[1] else None


def _tables(value: Any) -> list[dict[str, Any]] | None:
    return value if isinstance(value, list) and all(isinstance(v, dict) for v in value) else None


READ: dict[str, Callable[[Any], Any]] = {
    "whole": _whole, "number": _number, "text": _text, "flag": lambda v: v if isinstance(v, bool) else None,
    "numbers": _several(_number), "texts": _several(_text), "band": _band, "tables": _tables, "value": lambda v: v,
}  # fmt: skip
WORDS = {
    "whole": "a whole number", "number": "a finite number", "text": "a text in quotes", "flag": "true or false",
    "numbers": "a list of numbers", "texts": "a list of names", "band": "two rising frequencies [LO, HI]",
    "tables": "a list of tables", "value": "a value",
}  # fmt: skip
