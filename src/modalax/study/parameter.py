"""Parameter studies: noise studies over all combinations of some settings of the simulation and the fit."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from modalax.study import noise
from modalax.study.settings import checked
from modalax.study.work import Quantity, Row, Work, seed_of


@dataclass(frozen=True)
class ParameterWork(Work):
    """Noise studies one after the other, whose rows hold the settings that they differ in.

    Attributes
    ----------
    parts
        The study of each combination.
    values
        The settings of each combination.
    """

    parts: tuple[Work, ...]
    values: tuple[Row, ...]

    @property
    def chunks(self) -> int:
        """Number of chunks."""
        return sum(part.chunks for part in self.parts)

    def _place(self, k: int) -> tuple[int, int]:
        """Combination and chunk in it of chunk ``k``."""
        c = 0
        while k >= self.parts[c].chunks:
            k -= self.parts[c].chunks
            c += 1
        return c, k

    def items(self, k: int) -> range:
        """Numbers of the draws in chunk ``k``."""
        c, own = self._place(k)
        first = sum(part.count for part in self.parts[:c])
        found = self.parts[c].items(own)
        return range(first + found.start, first + found.stop)

    def rows(self, k: int) -> list[Row]:
        """The rows of chunk ``k``."""
        c, own = self._place(k)
        rows = self.parts[c].rows(own)
        return [{**row, "item": i, **self.values[c]} for i, row in zip(self.items(k), rows, strict=True)]


def prepare(settings: dict[str, Any], folder: Path) -> Work:
    """The work of a parameter study.

    Raises
    ------
    ValueError
        If a varied setting is none of those of the simulation or the fit, or its values are not allowed.
    """
    vary = settings["vary"]
    for name, values in vary.items():
        table, dot, key = str(name).partition(".")
        if not dot or table not in ("system", "fit") or key not in settings[table]:
            known = [f"{t}.{k}" for t in ("system", "fit") for k in settings[t]]
            raise ValueError(f"[vary] has the key {name!r}, which is not known; known are {', '.join(known)}")
        if not isinstance(values, list) or not values:
            raise ValueError(f"[vary] {name!r} is {values!r}; it needs a list of the values to take in turn")
    parts, rows = [], []
    for c, values in enumerate(itertools.product(*vary.values())):
        chosen = dict(zip(vary, values, strict=True))
        parts.append(noise.prepare(_with(settings, chosen, c), folder))
        rows.append(
            {name: value if isinstance(value, int | float | str) else str(value) for name, value in chosen.items()}
        )
    count = sum(part.count for part in parts)
    return ParameterWork(
        count, max(part.chunk for part in parts), settings["seed"], tuple(parts), tuple(rows),
        quantities=_all(parts), group=tuple(vary),
    )  # fmt: skip


def _all(parts: Sequence[Work]) -> list[Quantity]:
    """The quantities of all combinations, without true values where these differ."""
    found: dict[str, Quantity] = {}
    for q in itertools.chain.from_iterable(part.quantities for part in parts):
        old = found.get(q.column, q)
        found[q.column] = Quantity(q.column, q.std_column or old.std_column, q.truth if old.truth == q.truth else None)
    return list(found.values())


def _with(settings: dict[str, Any], chosen: dict[str, Any], c: int) -> dict[str, Any]:
    """The settings of combination ``c``, as those of a noise study with a seed of its own."""
    tables: dict[str, dict[str, Any]] = {"system": dict(settings["system"]), "fit": dict(settings["fit"])}
    for name, value in chosen.items():
        table, _, key = name.partition(".")
        tables[table][key] = value
    given = {name: {k: v for k, v in table.items() if v is not None} for name, table in tables.items()}
    top = {key: settings[key] for key in ("draws", "seed", "chunk", "memory_mb") if settings[key] is not None}
    found = checked({"kind": "noise", **top, **given}, "[vary]")
    return {**found, "seed": seed_of(settings["seed"], c)}
