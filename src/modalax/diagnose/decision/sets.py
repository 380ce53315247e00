"""How sure the names and the places of a set of causes are, by the probabilities of all sets that were fitted."""

from collections.abc import Collection, Sequence
from typing import Any, Protocol, TypeVar, runtime_checkable

from modalax.diagnose.thresholds import THRESHOLDS, Thresholds


@runtime_checkable
class WeighedSet(Protocol):
    """A set of causes with its probability; ``names`` holds a pair of slug and place for each cause."""

    @property
    def names(self) -> Collection[tuple[str, tuple[Any, ...]]]:
        """Slug and place of each cause."""
        ...

    @property
    def probability(self) -> float:
        """Probability among all sets that were fitted."""
        ...


S = TypeVar("S", bound=WeighedSet)


def of_the_same_names(sets: Sequence[S]) -> list[S]:
    """Sets with the same causes as the leading (first) one, wherever they sit."""
    own = _slugs(sets[0])
    return [s for s in sets if _slugs(s) == own]


def certainty(sets: Sequence[WeighedSet]) -> float:
    """Probability of the causes of the leading set, wherever they sit."""
    return sum(s.probability for s in of_the_same_names(sets))


def unplaced(sets: Sequence[WeighedSet], thresholds: Thresholds = THRESHOLDS) -> list[str]:
    """Causes of the leading set of which no place is sure among all."""
    alike = of_the_same_names(sets)
    by_place = {one: sum(s.probability for s in alike if one in s.names) for one in sets[0].names}
    return sorted(slug for (slug, _), p in by_place.items() if p < thresholds.placed)


def many_kinds(leading: WeighedSet, thresholds: Thresholds = THRESHOLDS) -> str | None:
    """Why several unlike causes at once are not named; None where they are few."""
    kinds = sorted({slug for slug, _ in leading.names})
    return None if len(kinds) <= thresholds.kinds else (
        f"{len(kinds)} unlike causes at once ({', '.join(kinds)}) are no likelier than one thing that is not listed"
    )  # fmt: skip


def as_stated(word: str, causes: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The causes of an answer, none with a greater probability than its verdict leaves room for.

    Weighed against one another are only causes that were looked for. Where something else speaks against a name
    (``ambiguous``) they are less sure than a name must be; where something is left that none of them explains
    (``unknown``), something else is likelier.
    """
    most = {"ambiguous": THRESHOLDS.certain, "unknown": THRESHOLDS.nameless}.get(word, 1.0)
    return [{**c, "probability": min(c["probability"], most)} for c in causes]


def rivals(word: str, sets: Sequence[S]) -> list[S]:
    """Choose the sets that are reported beside the leading one.

    Of a named set these are its other places; of any other verdict the rivals, the next best at least.

    Parameters
    ----------
    word
        The verdict.
    sets
        Sets of causes, the leading one first, the others by falling probability.
    """
    if word == "named":
        return [s for s in sets[1:] if s.probability >= THRESHOLDS.elsewhere]
    return [s for s in sets[1:] if s.probability >= THRESHOLDS.rival] or list(sets[1:2])


def _slugs(s: WeighedSet) -> list[str]:
    return sorted(slug for slug, _ in s.names)
