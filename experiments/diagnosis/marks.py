"""What an answer is worth against the truth, and the sums over many."""

import json
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.stats

# Effects drawn as outside the catalogue that are in it by now, by their names there
INSIDE = {
    "outside:maxwell": "maxwell_joint", "outside:fractional_joint": "fractional_joint",
    "outside:crosstalk": "crosstalk",
}  # fmt: skip
ALARM = 0.01  # nominal rate of false alarms
Z_ALARM = float(scipy.stats.norm.isf(ALARM / 2))


def oracle(d):
    """Power of a perfect two-sided test at distance ``d``: Phi(d - z) + Phi(-d - z)."""
    return scipy.stats.norm.cdf(np.asarray(d) - Z_ALARM) + scipy.stats.norm.cdf(-np.asarray(d) - Z_ALARM)


def placed(cause: dict[str, Any]) -> tuple[str, frozenset[str]]:
    """A cause with its place; the order of both ends does not matter."""
    return cause["name"], frozenset(str(w) for w in cause["where"])


def same_names(a: Iterable[dict], b: Iterable[dict]) -> bool:
    return sorted(c["name"] for c in a) == sorted(c["name"] for c in b)


def renamed(truth: dict[str, Any]) -> dict[str, Any]:
    """The truth by the names that its effects have in the catalogue."""
    slugs = "+".join(INSIDE.get(slug, slug) for slug in truth["cause"].split("+"))
    return {
        **truth,
        "cause": slugs,
        "causes": [{**c, "name": INSIDE.get(c["name"], c["name"])} for c in truth["causes"]],
    }


def told(parameters: dict[str, Any]) -> dict[str, Any]:
    """Parameters of the truth as an answer tells them: of a bilinear spring which side is the stiffer is not."""
    sides = sorted(
        (parameters[k] for k in ("stiffness_positive", "stiffness_negative") if k in parameters),
        key=lambda p: p["value"],
    )
    return {**parameters, **dict(zip(("stiffness_softer_side", "stiffness_stiffer_side"), sides, strict=False))}


@dataclass(frozen=True)
class Mark:
    """One case: what was hidden, what was said, and whether that is right."""

    name: str
    truth: dict[str, Any]
    said: dict[str, Any]

    @property
    def cause(self) -> str:
        """Slugs of what was hidden, joined by +."""
        return self.truth["cause"]

    @property
    def kind(self) -> str:
        """clean, single, pair or outside."""
        if self.cause == "clean":
            return "clean"
        if "outside:" in self.cause:
            return "outside"
        return "pair" if "+" in self.cause else "single"

    @property
    def verdict(self) -> str:
        """What was answered."""
        return self.said["verdict"]

    @property
    def detected(self) -> bool:
        """Whether anything was said to be wrong."""
        return self.verdict in ("named", "ambiguous", "unknown")

    @property
    def name_right(self) -> bool:
        """Whether the answer's names are the truth's."""
        return same_names(self.said["causes"], self.truth["causes"])

    @property
    def place_right(self) -> bool:
        """Whether names and places are the truth's."""
        return {placed(c) for c in self.said["causes"]} == {placed(c) for c in self.truth["causes"]}

    @property
    def named(self) -> bool:
        """Whether one set was named with confidence."""
        return self.verdict == "named"

    @property
    def named_right(self) -> bool:
        """Whether that was right."""
        return self.named and self.name_right

    @property
    def within(self) -> bool:
        """Whether the truth's names are the answer or one of its rivals."""
        sets = [self.said["causes"], *self.said.get("alternatives", [])]
        return any(same_names(s, self.truth["causes"]) for s in sets)

    @property
    def outcome(self) -> str:
        """Column of the confusion matrix."""
        if self.verdict == "named":
            return "+".join(sorted(c["name"] for c in self.said["causes"]))
        if self.verdict == "ambiguous":
            return "set with truth" if self.within else "set without truth"
        return self.verdict

    @property
    def probability(self) -> float:
        """The stated probability of the leading set."""
        p = [c.get("probability") for c in self.said["causes"]]
        return float(min((x for x in p if x is not None), default=float("nan")))

    def parameters(self) -> list[tuple[str, float, float, float]]:
        """``(cause.parameter, truth, value, std)`` where cause and place are right and both sides have it."""
        found = []
        true = {placed(c): c for c in self.truth["causes"]}
        for cause in self.said["causes"]:
            hidden = true.get(placed(cause), {"parameters": {}, "where": cause["where"]})
            turned = [str(w) for w in hidden["where"]] != [str(w) for w in cause["where"]]
            for name, p in cause.get("parameters", {}).items():
                aim = told(hidden["parameters"]).get(name)
                if aim is None or p.get("std") is None or aim["unit"] != p["unit"]:
                    continue
                sign = -1.0 if turned and cause["name"] == "gyroscopic" else 1.0
                found.append((f"{cause['name']}.{name}", sign * aim["value"], p["value"], p["std"]))
        return found


def load(folder: Path, answers: str = "answers") -> list[Mark]:
    """Marks of all cases that have an answer."""
    marks = []
    for answer in sorted((folder / answers).glob("*.json")):
        truth = json.loads((folder / "truth" / answer.name).read_text())
        marks.append(Mark(answer.stem, renamed(truth), json.loads(answer.read_text())))
    return marks


@dataclass(frozen=True)
class Share:
    """``hits`` of ``count``, with Clopper-Pearson limits at 95 %."""

    hits: int
    count: int

    @classmethod
    def of(cls, marks: Iterable[Mark], hit: Callable[[Mark], bool]) -> "Share":
        """Of marks, those that ``hit``."""
        values = [bool(hit(m)) for m in marks]
        return cls(sum(values), len(values))

    @property
    def value(self) -> float:
        """The share."""
        return self.hits / self.count if self.count else float("nan")

    @property
    def limits(self) -> tuple[float, float]:
        """Clopper-Pearson limits at 95 %."""
        k, n = self.hits, self.count
        if n == 0:
            return 0.0, 1.0
        low = 0.0 if k == 0 else float(scipy.stats.beta.ppf(0.025, k, n - k + 1))
        high = 1.0 if k == n else float(scipy.stats.beta.ppf(0.975, k + 1, n - k))
        return low, high

    def __str__(self) -> str:
        if not self.count:
            return "no cases"
        low, high = self.limits
        return f"{100 * self.value:.1f} % ({self.hits}/{self.count}; {100 * low:.1f}-{100 * high:.1f})"


def distance(mark: Mark) -> float:
    """Distance in standard deviations of the whole effect."""
    return float(mark.truth["d"])


def near(marks: list[Mark], low: float, high: float = math.inf) -> list[Mark]:
    """Marks with ``low`` <= d < ``high``; sizes are solved to 3 %, which a bound allows for."""
    return [m for m in marks if 0.97 * low <= distance(m) < 0.97 * high]


def coverage(marks: list[Mark], width: float = 1.96) -> dict[str, Share]:
    """Share of stated intervals that hold the truth, by parameter and in all."""
    hits: dict[str, list[bool]] = {"all": []}
    for mark in marks:
        for name, aim, value, std in mark.parameters():
            inside = abs(value - aim) <= width * std
            hits.setdefault(name, []).append(inside)
            hits["all"].append(inside)
    return {k: Share(sum(v), len(v)) for k, v in hits.items()}


def reliability(marks: list[Mark], edges=(0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 0.99, 1.0 + 1e-9)):
    """``(low, high, mean stated probability, share right)`` by bins of the leading set's stated probability."""
    rows = []
    known = [m for m in marks if m.verdict in ("named", "ambiguous") and np.isfinite(m.probability)]
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        inside = [m for m in known if low <= m.probability < high]
        if inside:
            rows.append((low, high, float(np.mean([m.probability for m in inside])), Share.of(inside, right)))
    return rows


def right(mark: Mark) -> bool:
    """Name and place."""
    return mark.name_right and mark.place_right
