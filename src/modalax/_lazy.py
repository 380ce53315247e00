"""Names that a package loads when they are first asked for, so that importing it costs nothing (PEP 562)."""

import importlib
import sys
from collections.abc import Callable, Mapping
from typing import Any


def lazily(package: str, homes: Mapping[str, str]) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """The functions ``__getattr__`` and ``__dir__`` of a package whose names live in other modules.

    Listed are the names that the package offers, by its ``__all__``, and no helpers.

    Parameters
    ----------
    package
        The package's ``__name__``.
    homes
        The module that holds each name; a name that is itself a module has its own path as home.

    Raises
    ------
    AttributeError
        By ``__getattr__``, if the package has no such name.
    """

    def get(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module = importlib.import_module(homes[name])
        value = module if homes[name] == f"{package}.{name}" else getattr(module, name)
        setattr(sys.modules[package], name, value)
        return value

    def names() -> list[str]:
        module = sys.modules[package]
        return sorted({*module.__all__, *homes, *(name for name in vars(module) if name.startswith("__"))})

    return get, names
