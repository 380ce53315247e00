"""How likely a user holds causes to be before the data, relative to what each is by itself.

Causes are weighed in many places, each with the prior of its kind: a factor holds in all of them while a diagnosis
runs, rather than being handed through everything on the way.
"""

import math
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from types import MappingProxyType

_FACTORS: ContextVar[Mapping[str, float]] = ContextVar("factors by cause", default=MappingProxyType({}))


def believed(slug: str) -> float:
    """Logarithm of the factor by which the user holds a cause to be likelier before the data than it is by itself."""
    return math.log(_FACTORS.get().get(slug, 1.0))


@contextmanager
def beliefs(factors: Mapping[str, float] | None, known: Collection[str]) -> Iterator[None]:
    """Let ``factors`` by name of the cause hold for all that is weighed inside.

    Raises
    ------
    ValueError
        If a name is not among the ``known`` ones, or a factor is not above 0 and finite.
    """
    for name, factor in (factors or {}).items():
        if name not in known:
            raise ValueError(f"prior names {name!r}; causes are {', '.join(sorted(known))}")
        if not (math.isfinite(factor) and factor > 0):
            raise ValueError(f"the prior of {name} is {factor:g}; it must be above 0, and 1 changes nothing")
    token = _FACTORS.set(dict(factors or {}))
    try:
        yield
    finally:
        _FACTORS.reset(token)
