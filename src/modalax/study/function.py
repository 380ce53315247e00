"""Studies of a user's own function of a seed."""

import importlib
import inspect
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from modalax._numerics.devices import over_devices
from modalax.study.work import Row, Work, attempt, chunk_for, reason_of, seed_of

DRAWS = 64  # most draws in a chunk of a function of which nothing is known
TAKEN = ("item", "failed", "reason")


@dataclass(frozen=True)
class FunctionWork(Work):
    """Calls of a function, with the seed of each draw as its first argument.

    Attributes
    ----------
    function
        ``function(seed, **parameters)`` gives a number, an array, or a dictionary of such; with ``vmap`` it is called
        with a JAX key instead of the seed, and must be one that ``jax.vmap`` can run. Where it has a parameter
        ``number`` that the settings do not give, that is the number of the draw, from 0.
    parameters
        Further arguments.
    vmap
        Whether the draws of a chunk run as one compiled program.
    """

    function: Callable[..., Any]
    parameters: dict[str, Any]
    vmap: bool

    def rows(self, k: int) -> list[Row]:
        """The rows of chunk ``k``."""
        return self._together(k) if self.vmap else super().rows(k)

    def item(self, index: int) -> Row:
        """The numbers that the function gives for one draw."""
        return flat(self.function(seed_of(self.seed, index), **self.parameters, **self._number(index)))

    def _number(self, index: Any) -> dict[str, Any]:
        """The number of the draw, for a function that asks for it."""
        return {"number": index} if numbered(self.function, self.parameters) else {}

    def _together(self, k: int) -> list[Row]:
        """All draws of a chunk in one program, which is not compiled anew for a last chunk of fewer draws."""
        import jax

        try:
            numbers = np.arange(k * self.chunk, (k + 1) * self.chunk)
            key = jax.random.key(self.seed)
            call = lambda n: self.function(jax.random.fold_in(key, n), **self.parameters, **self._number(n))
            found = jax.tree.map(np.asarray, jax.jit(jax.vmap(call))(over_devices(numbers)))
        except Exception as error:  # the whole chunk fails; each of its draws tells why
            return [{"item": i, "failed": True, "reason": reason_of(error)} for i in self.items(k)]
        return [
            attempt(lambda _, j=j: flat(jax.tree.map(lambda a: a[j], found)), i, {})
            for j, i in enumerate(self.items(k))
        ]


def numbered(function: Callable[..., Any], parameters: Mapping[str, Any]) -> bool:
    """Whether a function asks for the number of the draw."""
    return "number" in inspect.signature(function).parameters and "number" not in parameters


def flat(value: Any) -> Row:
    """What a function gave as columns: ``value``, ``name``, or ``name_1``, ``name_2``, ... for an array.

    Raises
    ------
    TypeError
        If it is neither a number, a text, an array nor a dictionary of such.
    ValueError
        If a column has a name that the study itself uses.
    """
    named = value if isinstance(value, Mapping) else {"value": value}
    row: Row = {}
    for name, entry in named.items():
        if name in TAKEN:
            raise ValueError(f"the function gave a column {name!r}, a name that the study itself uses")
        if isinstance(entry, str | bool | int | float):
            row[str(name)] = entry
            continue
        array = np.asarray(entry)
        if array.dtype.kind not in "biufc":
            raise TypeError(f"the function gave {name} = {entry!r}; numbers, texts and arrays of numbers can be kept")
        parts = {"": array} if array.dtype.kind != "c" else {"_real": array.real, "_imag": array.imag}
        for ending, part in parts.items():
            if part.ndim == 0:
                row[f"{name}{ending}"] = part.item()
            else:
                row |= {f"{name}{ending}_{j}": v.item() for j, v in enumerate(part.ravel(), 1)}
    return row


def prepare(settings: dict[str, Any], folder: Path) -> Work:
    """The work of a study of a function, given as ``module:function`` or as itself.

    Raises
    ------
    ValueError
        If there is no such module or function, or it does not take the parameters.
    """
    given = settings["function"]
    function = given if callable(given) else imported(str(given), folder)
    try:
        number = {"number": 0} if numbered(function, settings["parameters"]) else {}
        inspect.signature(function).bind(0, **settings["parameters"], **number)
    except TypeError as error:
        names = ", ".join(settings["parameters"]) or "none"
        raise ValueError(f"function {given!r} does not take a seed and the parameters ({names}): {error}") from error
    chunk = chunk_for(settings["draws"], settings["chunk"], DRAWS)
    return FunctionWork(
        settings["draws"], chunk, settings["seed"], function, dict(settings["parameters"]), settings["vmap"]
    )


def imported(name: str, folder: Path) -> Callable[..., Any]:
    """A function by the name ``module:function``; modules in ``folder`` come first.

    Raises
    ------
    ValueError
        If the name is of another form, or there is no such module or function.
    """
    module, colon, function = name.partition(":")
    if not colon or not module or not function:
        raise ValueError(f"function is {name!r}; it needs module:function, such as my_fits:one_fit")
    place = str(folder.resolve())
    if place not in sys.path:
        sys.path.insert(0, place)
    try:
        found = getattr(importlib.import_module(module), function, None)
    except ImportError as error:
        raise ValueError(
            f"function {name!r}: the module cannot be imported: {error}; it is looked for in {place}"
        ) from error
    if not callable(found):
        raise ValueError(f"function {name!r}: the module {module} has no function {function}")
    return found
