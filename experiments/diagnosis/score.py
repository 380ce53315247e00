"""Score a draw: ``python experiments/diagnosis/score.py FOLDER [--out RESULTS]``.

Diagnoses what has no answer yet (``answer.py``), then opens the truth and writes ``marks.md`` with figures beside it:
confusion matrix, power against the oracle, false alarms with limits, reliability and coverage.
"""

import argparse
from collections import Counter
from pathlib import Path

import answer
import figures
import numpy as np
from held_out import ASKED, excesses
from marks import Mark, Share, coverage, load, near, oracle, reliability, right

BANDS = (3.0, 5.0, 6.5, 8.0, 12.0, 20.0, 30.0, 50.0, np.inf)


def table(header: list[str], rows: list[list]) -> str:
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    return "\n".join([*lines, *("| " + " | ".join(str(c) for c in row) + " |" for row in rows)])


def held_out(folder: Path, marks: list[Mark]) -> str:
    """Chi-square on what was held out, after the extension, over the true model's there."""
    rows = []
    for kind, ratio in excesses(folder, marks).items():
        share = Share(int((ratio <= ASKED).sum()), len(ratio))
        spent = ", ".join(f"{q:.3f}" for q in np.quantile(ratio, (0.5, 0.9, 1.0)))
        rows.append([kind, share, spent])
    return table(["variance", f"at most {ASKED:g} times the true model's", "median, 90 %, largest"], rows)


def averaged(marks: list[Mark]) -> str:
    """Power averaged over causes, each of which counts alike."""
    found = [np.mean([m.detected for m in marks if m.cause == cause]) for cause in {m.cause for m in marks}]
    return f"{100 * np.mean(found):.1f} % ({len(found)} causes)" if found else "no cases"


def reliable(marks: list[Mark]) -> str:
    """Stated probability against the share right, by bins."""
    rows = [[f"{a:g}-{b:.3g}", f"{p:.3f}", s] for a, b, p, s in reliability(marks)]
    return table(["stated", "mean", "right"], rows)


def must_show(marks: list[Mark]) -> str:
    """The marks that count, each beside its target."""
    clean = [m for m in marks if m.kind == "clean"]
    six = [m for m in clean if m.truth["noise"]["variance"] == "6"]
    missing = [m for m in clean if m.truth["noise"]["variance"] == "missing"]
    single = [m for m in marks if m.kind == "single"]
    outside = near([m for m in marks if m.kind == "outside"], 30)
    pairs = [m for m in marks if m.kind == "pair"]
    named = [m for m in single if m.named]
    answered = [m for m in single if m.verdict in ("named", "ambiguous")]
    strong = [m for m in near(single, 20) if m.truth["separable"]]
    sure = [m for m in strong if m.truth.get("namable", 0) > 0.99]
    joint = [m for m in answered if m.name_right and m.truth["causes"][0]["where"]]
    told = [m for m in joint if m.named]
    level = {d: Share.of(near(single, d, 1.15 * d), lambda m: m.detected) for d in (6.5, 8.0, 12.0)}
    seconds = np.array([m.said["seconds"] for m in marks])
    spent = np.quantile(seconds, (0.5, 0.95, 1.0))
    humble = Share.of(outside, lambda m: m.verdict in ("unknown", "ambiguous"))
    rows = [
        ["false alarms", "at most 2 %", Share.of(clean, lambda m: m.detected)],
        ["... with variances from 6 repeats", "at most 2 %", Share.of(six, lambda m: m.detected)],
        ["... with variances missing", "at most 2 %", Share.of(missing, lambda m: m.detected)],
        ["power at d = 6.5", "at least 90 %", level[6.5]],
        ["... averaged over causes", "at least 90 %", averaged(near(single, 6.5, 1.15 * 6.5))],
        ["power at d = 8", f"{100 * (oracle(8.0) - 0.05):.0f} %", level[8.0]],
        ["power at d = 12", f"{100 * (oracle(12.0) - 0.05):.0f} %", level[12.0]],
        ["single name right, of all named", "at least 95 %", Share.of(named, lambda m: m.name_right)],
        ["place right, of right names given", "at least 90 %", Share.of(told, lambda m: m.place_right)],
        ["... or only leading a set", "", Share.of(joint, lambda m: m.place_right)],
        ["truth within the set, of all answered", "at least 95 %", Share.of(answered, lambda m: m.within)],
        ["right single name, d >= 20, separable", "at least 95 %", Share.of(strong, lambda m: m.named_right)],
        ["... where a perfect namer is right in 99 %", "at least 95 %", Share.of(sure, lambda m: m.named_right)],
        ["outside, d >= 30: unknown or a set", "at least 90 %", humble],
        ["outside, d >= 30: confident wrong name", "at most 5 %", Share.of(outside, lambda m: m.named)],
        ["pairs: both named, d >= 20 each", "at least 80 %", Share.of(pairs, lambda m: m.named_right)],
        ["pairs: both within the set", "", Share.of(pairs, lambda m: m.within)],
        ["intervals that hold the truth (95 %)", "90-98 %", coverage(marks)["all"]],
        ["seconds: median, 95 %, longest", "5 warm", ", ".join(f"{q:.1f}" for q in spent)],
        ["errors", "0", sum(m.verdict == "error" for m in marks)],
    ]  # fmt: skip
    return table(["mark", "target", "got (hits/cases; 95 % limits)"], rows)


NONLINEAR = (
    "coulomb_friction", "elasto_slip", "cubic_stiffness", "gap", "quadratic_damping", "time_varying"
)  # fmt: skip
LINEAR = (
    "modal_damping", "local_damper", "joint_stiffness", "bilinear_stiffness", "added_mass", "tuned_mass",
    "missing_mode", "out_of_band",
)  # fmt: skip


def free_marks(marks: list[Mark]) -> str:
    """The question FREE: what differs from level to level is found and named; what another linear model has is not."""
    bent = near([m for m in marks if m.cause in NONLINEAR and m.truth["separable"]], 20)
    straight = near([m for m in marks if m.cause in LINEAR], 20)
    names = Share.of([m for m in bent if m.named], lambda m: m.name_right)
    rows = [
        ["non-linear or drifting, d >= 20 against the simulation: found", Share.of(bent, lambda m: m.detected)],
        ["... named rightly", Share.of(bent, lambda m: m.named_right)],
        ["... the truth is the name or in the set", Share.of(bent, lambda m: m.detected and m.within)],
        ["name right, of all named", names],
        ["another linear structure, d >= 20: nothing found", Share.of(straight, lambda m: not m.detected)],
        ["errors", sum(m.verdict == "error" for m in marks)],
    ]
    return table(["mark", "got (hits/cases; 95 % limits)"], rows)


OUTCOMES = {
    "found %": lambda m: m.detected,
    "named %": lambda m: m.named_right,
    "and placed %": lambda m: m.named and right(m),
    "set with %": lambda m: m.verdict == "ambiguous" and m.within,
    "set without %": lambda m: m.verdict == "ambiguous" and not m.within,
    "unknown %": lambda m: m.verdict == "unknown",
}


def by_cause(marks: list[Mark]) -> str:
    """One row a cause: how often found, named, placed, by what else it was called."""
    rows = []
    for cause in sorted({m.cause for m in marks if m.kind in ("single", "outside")}):
        mine = near([m for m in marks if m.cause == cause], 8)
        if mine:
            wrong = Counter(m.outcome for m in mine if m.named and not m.name_right)
            shares = [f"{100 * Share.of(mine, hit).value:.0f}" for hit in OUTCOMES.values()]
            rows.append([cause, len(mine), *shares, ", ".join(f"{k} {n}" for k, n in wrong.most_common(3))])
    return table(["cause, d >= 8", "cases", *OUTCOMES, "called"], rows)


def by_size(marks: list[Mark]) -> str:
    rows = []
    single = [m for m in marks if m.kind == "single"]
    for low, high in zip(BANDS[:-1], BANDS[1:], strict=True):
        mine = near(single, low, high)
        if mine:
            d = np.array([m.truth["d"] for m in mine])
            named = Share.of(mine, lambda m: m.named_right)
            rows.append(
                [f"{low:g}-{high:g}", Share.of(mine, lambda m: m.detected), f"{100 * oracle(d).mean():.1f} %", named]
            )
    return table(["d", "found", "oracle", "right single name"], rows)


def wrong_names(marks: list[Mark]) -> str:
    """Every confident wrong name, to be looked at one by one."""
    rows = []
    for m in marks:
        if m.named and not m.name_right and m.kind != "clean":
            t = m.truth
            rows.append([m.name, t["kind"], f"{t['d']:.1f}", m.outcome, f"{m.probability:.3f}", t["noise"]["kind"]])
    return table(["case", "structure", "d", "called", "p", "noise"], rows[:80])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, help="folder of the results; FOLDER/results by default")
    parser.add_argument("--only", default="")
    parser.add_argument("--no-run", action="store_true", help="score the answers that are there")
    parser.add_argument("--question", default="auto", choices=("auto", "fixed", "free"))
    args = parser.parse_args()
    if not args.no_run:
        answer.run(args.folder, only=args.only, question=args.question)
    marks = [m for m in load(args.folder, answer.answers_to(args.question)) if args.only in m.name]
    if args.question == "free":
        print(free_marks(marks))
        return
    if not marks:
        raise SystemExit(f"no answers in {args.folder / 'answers'}")
    out = args.out or args.folder / "results"
    out.mkdir(parents=True, exist_ok=True)
    drawn = figures.draw_all(marks, out)
    parts = [
        f"# Hidden effects: {len(marks)} cases", must_show(marks), "## By size", by_size(marks), "## By cause",
        by_cause(marks), "## Stated probability against share right",
        reliable(marks), "Of causes of the catalogue that the data could tell from others:",
        reliable([m for m in marks if m.kind != "outside" and m.truth["separable"]]),
        "## Intervals", table(["parameter", "holds the truth"], [[k, s] for k, s in sorted(coverage(marks).items())]),
        "## Held-out chi-square of what was named right", held_out(args.folder, marks),
        "## Confident wrong names", wrong_names(marks), *(f"![{f.stem}]({f.name})" for f in drawn),
    ]  # fmt: skip
    (out / "marks.md").write_text("\n\n".join(parts) + "\n")
    print(must_show(marks))
    print(f"\n{out / 'marks.md'}")


if __name__ == "__main__":
    main()
