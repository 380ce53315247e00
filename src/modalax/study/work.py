"""What a study computes: draws that depend on the seed of the study and their number alone, in chunks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

Row = dict[str, Any]
CHUNKS = 64  # chunks that a study of few draws is cut into, so that workers share it and little is lost


@dataclass(frozen=True)
class Quantity:
    """A number that every draw gives, with what the summary needs of it.

    Attributes
    ----------
    column
        Column of the rows that holds it.
    std_column
        Column that holds its standard deviation as each draw states it; None if there is none.
    truth
        Its true value, or the column that holds it; None where that is not known.
    """

    column: str
    std_column: str | None = None
    truth: float | str | None = None


@dataclass(frozen=True)
class Work:
    """The draws of one study; it is sent to the workers as it is.

    Attributes
    ----------
    count
        Number of draws.
    chunk
        Number of draws in a chunk; it does not depend on the number of workers.
    seed
        Seed of the study.
    quantities
        What the summary is about; found from the rows if empty.
    group
        Columns whose values tell the groups of draws that are summed up apart.
    """

    count: int
    chunk: int
    seed: int
    quantities: Sequence[Quantity] = field(default=(), kw_only=True)
    group: tuple[str, ...] = field(default=(), kw_only=True)

    @property
    def chunks(self) -> int:
        """Number of chunks."""
        return -(-self.count // self.chunk)

    def items(self, k: int) -> range:
        """Numbers of the draws in chunk ``k``."""
        return range(k * self.chunk, min((k + 1) * self.chunk, self.count))

    def rows(self, k: int) -> list[Row]:
        """The rows of chunk ``k``: each with its number ``item``, its values, ``failed`` and the ``reason``."""
        return [attempt(self.item, i, self.labels(i)) for i in self.items(k)]

    def labels(self, index: int) -> Row:
        """What is known of a draw before it is computed: the columns of ``group``."""
        return {}

    def item(self, index: int) -> Row:
        """The values of one draw."""
        raise NotImplementedError(f"{type(self).__name__} needs item(index)")


def attempt(compute: Callable[[int], Row], index: int, labels: Row) -> Row:
    """The row of one draw; a draw that fails is a row with the reason."""
    try:
        return {"item": index, **labels, **compute(index), "failed": False, "reason": ""}
    except Exception as error:  # whatever goes wrong in one draw must not end the others
        return {"item": index, **labels, "failed": True, "reason": reason_of(error)}


def reason_of(error: BaseException) -> str:
    """Why a draw failed, in one line."""
    text = " ".join(str(error).split())
    return text if isinstance(error, ValueError) and text else f"{type(error).__name__}: {text}".rstrip(": ")


def seed_of(seed: int, index: int) -> int:
    """The seed of one draw, 63 bits, from the seed of the study and the number of the draw."""
    return int(np.random.SeedSequence(seed, spawn_key=(index,)).generate_state(1, np.uint64)[0] >> np.uint64(1))


def key_of(seed: int, index: Any) -> Any:
    """The same as a JAX key, for code that is compiled."""
    import jax

    return jax.random.fold_in(jax.random.key(seed), index)


def draws_of(seed: int, index: int) -> np.random.Generator:
    """Random numbers of one draw, a stream of its own for each seed and number."""
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence(seed, spawn_key=(index,))))


def chunk_for(count: int, wanted: int | None, most: int) -> int:
    """Draws in a chunk: as asked for, or at most ``most`` and at least ``CHUNKS`` chunks where there are enough."""
    return min(count, wanted or max(1, min(most, -(-count // CHUNKS))))
