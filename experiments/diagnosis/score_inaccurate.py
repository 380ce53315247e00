"""Score the answers of a draw: ``python experiments/diagnosis/score_inaccurate.py FOLDER [--by spread]``.

Opens ``FOLDER/truth`` and prints each mark beside its target, then where name or place were wrong. Cases drawn with
``--invariance`` are compared with each other.
"""

import argparse
import json
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from answer import answered
from draw_inaccurate import BANDS, LINES
from marks import Share
from score import table

SURE = 0.99


@dataclass(frozen=True)
class Mark:
    """One case: what was hidden, what was said."""

    name: str
    truth: dict[str, Any]
    said: dict[str, Any]

    @property
    def gross(self) -> dict[str, Any] | None:
        """The gross error, if there is one."""
        return self.truth["causes"][0] if self.truth["causes"] else None

    @property
    def named(self) -> bool:
        """Whether one set was named with confidence."""
        return self.said["verdict"] == "named" and bool(self.said["causes"])

    @property
    def leading_right(self) -> bool:
        """Whether the leading answer has name and place, named or not; nothing at all where nothing is wrong."""
        causes = self.said["causes"]
        if self.gross is None:
            return self.said["verdict"] == "clean"
        places = [sorted(p) for p in self.gross["accepted"]]
        return (
            len(causes) == 1
            and causes[0]["name"] == self.gross["name"]
            and sorted(map(str, causes[0]["where"])) in places
        )

    @property
    def right(self) -> bool:
        """Named alone, with name and place; or clean where nothing is wrong."""
        return self.leading_right and (self.named or self.gross is None)

    @property
    def clear(self) -> bool:
        """Whether a perfect namer is right in 99 of 100 redraws."""
        return self.truth["perfect_right"] >= SURE

    @property
    def identity(self) -> tuple:
        """Verdict, names and places."""
        causes = ((c["name"], *sorted(map(str, c["where"]))) for c in self.said["causes"])
        return self.said["verdict"], tuple(sorted(causes))

    def intervals(self) -> list[tuple[str, bool]]:
        """Whether each stated 95 % interval of a rightly placed cause holds the truth."""
        if self.gross is None or not self.leading_right:
            return []
        found = []
        for name, aim in self.gross["parameters"].items():
            p = self.said["causes"][0].get("parameters", {}).get(name)
            factor = 1.0 if name == "gain" else 0.0  # the truth holds the factor, the answer its change
            if p is not None and p.get("std") is not None and p["unit"] == aim["unit"]:
                found.append(
                    (f"{self.gross['name']}.{name}", abs(p["value"] + factor - aim["value"]) <= 1.96 * p["std"])
                )
        return found

    def inaccuracy(self) -> list[tuple[str, str, bool]]:
        """``(what, measure, whether the stated interval holds it)``."""
        said = self.said.get("inaccuracy") or {}
        return [
            (what, measure, entry["interval"][0] <= value <= entry["interval"][1])
            for what, entry in said.items()
            if entry and entry.get("interval") and what in self.truth["inaccuracy"]
            for measure, value in self.truth["inaccuracy"][what].items()
        ]


def load(folder: Path) -> list[Mark]:
    """Marks of all cases that have an answer."""
    found = []
    for said in answered(folder / "answers"):
        truth = json.loads((folder / "truth" / f"{said['name']}.json").read_text())
        found.append(Mark(said["name"], truth, said))
    return found


def marks_table(marks: list[Mark]) -> str:
    """The marks that count, each beside its target."""
    gross = [m for m in marks if m.gross]
    none = [m for m in marks if not m.gross]
    clear = [m for m in gross if m.clear]
    held = [hit for m in marks for _, hit in m.intervals()]
    size = [hit for m in marks for what, measure, hit in m.inaccuracy() if (what, measure) == ("stiffness", "drawn")]
    seconds = np.array([m.said["seconds"] for m in marks])
    spent = ", ".join(f"{q:.1f}" for q in np.quantile(seconds, (0.5, 0.95, 1.0)))
    rows = [
        ["right name and place, a perfect namer right in 99 %", "at least 90 %", Share.of(clear, lambda m: m.right)],
        ["... or only leading a set", "", Share.of(clear, lambda m: m.leading_right)],
        ["right name and place, all with a gross error", "", Share.of(gross, lambda m: m.right)],
        ["confident wrong, all with a gross error", "at most 3 %", Share.of(gross, lambda m: m.named and not m.right)],
        ["false names without a gross error", "at most 2 %", Share.of(none, lambda m: m.named)],
        ["... anything but clean", "", Share.of(none, lambda m: m.said["verdict"] != "clean")],
        ["intervals that hold the truth (95 %)", "90-98 %", Share(sum(held), len(held))],
        ["general stiffness error (modal, as drawn) in its interval", "90-98 %", Share(sum(size), len(size))],
        ["seconds: median, 95 %, longest", "", spent],
        ["errors", "0", sum(m.said["verdict"] == "error" for m in marks)],
        ["no answer in time", "0", sum(m.said["verdict"] == "no answer" for m in marks)],
    ]  # fmt: skip
    return table(["mark", "target", "got (hits/cases; 95 % limits)"], rows)


def parts(marks: list[Mark], by: str) -> str:
    """Right, wrong and false names by one entry of the truth; numbers in bins of about equal count."""
    values = [m.truth[by] for m in marks]
    if len(set(values)) > 8 and all(isinstance(v, int | float) for v in values):
        edges = np.unique(np.quantile(values, (0, 0.25, 0.5, 0.75)))
        values = [f">= {edges[np.searchsorted(edges, v, side='right') - 1]:.3g}" for v in values]
    groups = defaultdict(list)
    for value, mark in zip(values, marks, strict=True):
        groups[str(value)].append(mark)
    rows = []
    for value, mine in sorted(groups.items()):
        gross, none = [m for m in mine if m.gross], [m for m in mine if not m.gross]
        clear = [m for m in gross if m.clear]
        rows.append(
            [value, Share.of(clear, lambda m: m.right), Share.of(gross, lambda m: m.named and not m.right),
             Share.of(none, lambda m: m.named)]
        )  # fmt: skip
    return table([by, "right where it can be told", "confident wrong", "false names in none"], rows)


def sizes(marks: list[Mark]) -> str:
    """Which measure of the general inaccuracy the stated intervals hold."""
    groups = defaultdict(list)
    for mark in marks:
        for what, measure, hit in mark.inaccuracy():
            groups[what, measure].append(hit)
    rows = [[what, measure, Share(sum(hits), len(hits))] for (what, measure), hits in sorted(groups.items())]
    return table(["general inaccuracy of", "measure", "in its interval"], rows)


def wrong(marks: list[Mark]) -> str:
    """Each case whose answer is not right though a perfect namer's is."""
    rows = []
    for m in sorted(marks, key=lambda m: m.name):
        if not m.right and (m.clear or m.named):
            hidden = f"{m.gross['name']} {'-'.join(m.gross['where'])}" if m.gross else "none"
            said = "; ".join(f"{c['name']} {'-'.join(map(str, c['where']))}" for c in m.said["causes"])
            t = m.truth
            rows.append(
                [m.name, t["variant"], t["spread"], t["claim"], f"{t['d']:.0f}", hidden, m.said["verdict"],
                 said or m.said.get("error", "")[:60]]
            )  # fmt: skip
    return table(["case", "structure", "spread", "claim", "d", "hidden", "verdict", "said"], rows)


def grids(marks: list[Mark]) -> list[list[tuple[str, tuple, Mark, tuple, Mark, bool]]]:
    """Of each test its steps to more data (finer or wider), with whether the answer is the same or the right one."""
    same: dict[str, dict[tuple[float, float], Mark]] = defaultdict(dict)
    for m in marks:
        base, lines, widen = m.name.rsplit("-", 2)
        same[base][float(lines[1:]), float(widen[1:])] = m
    found = []
    for base, grid in sorted(same.items()):
        mine = []
        for (lines, widen), m in grid.items():
            finer = [(b, widen) for a, b in zip(LINES[:-1], LINES[1:], strict=True) if a == lines]
            wider = [(lines, b) for a, b in zip(BANDS[:-1], BANDS[1:], strict=True) if a == widen]
            for key in finer + wider:
                if key in grid:
                    more = grid[key]
                    mine.append((base, (lines, widen), m, key, more, more.identity == m.identity or more.right))
        found.append(mine)
    return found


def invariance(marks: list[Mark]) -> str:
    """Steps to more data: the same answer or a more certain one, or not."""
    every = [mine for mine in grids(marks) if mine]
    steps = [kept for mine in every for *_, kept in mine]
    whole = [all(kept for *_, kept in mine) for mine in every]
    broken = [
        [base, "{:g}, {:g}".format(*first), m.identity, "{:g}, {:g}".format(*then), more.identity]
        for mine in every for base, first, m, then, more, kept in mine if not kept
    ]  # fmt: skip
    rows = [
        ["tests whose answer never got worse with more data", "at least 95 %", Share(sum(whole), len(whole))],
        ["steps to more data: the same answer or the right one", "", Share(sum(steps), len(steps))],
        ["right answers of all", "", Share.of(marks, lambda m: m.right)],
    ]
    return "\n\n".join(
        [table(["mark", "target", "got (hits/cases; 95 % limits)"], rows),
         table(["test", "lines, band", "said", "lines, band", "then said"], broken)]
    )  # fmt: skip


def in_one_line(single: list[Mark], again: list[Mark]) -> str:
    """The marks in one line."""
    gross, none = [m for m in single if m.gross], [m for m in single if not m.gross]
    hits = lambda found: f"{sum(found)}/{len(found)}"
    said = [
        ("right", hits([m.right for m in gross if m.clear])),
        ("confident wrong", hits([m.named and not m.right for m in gross])),
        ("false names in none", hits([m.named for m in none])),
        ("intervals", hits([hit for m in single for _, hit in m.intervals()])),
        ("inaccuracy in its interval", hits([h for m in single for w, how, h in m.inaccuracy() if how == "drawn"])),
        ("steps to more data without a worse answer", hits([kept for m in grids(again) for *_, kept in m])),
        ("CPU seconds of all", f"{sum(m.said.get('cpu_seconds', 0.0) for m in single + again):.0f}"),
    ]
    return "summary: " + ", ".join(f"{name} {value}" for name, value in said if not value.endswith("/0"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--by", nargs="*", default=["kind", "cause", "spread", "claim", "variance", "lines", "widen"])
    args = parser.parse_args()
    marks = load(args.folder)
    if not marks:
        raise SystemExit(f"no answers in {args.folder / 'answers'}; answer.py writes them")
    again = [m for m in marks if m.name.startswith("same-")]
    single = [m for m in marks if not m.name.startswith("same-")]
    text = []
    if single:
        text += [f"# {len(single)} cases", marks_table(single), *(parts(single, by) for by in args.by)]
        text += ["## General inaccuracy", sizes(single), "## Not right", wrong(single)]
    if again:
        text += ["# Measured more finely and more widely", invariance(again)]
    text.append(in_one_line(single, again))
    print("\n\n".join(text))


if __name__ == "__main__":
    main()
