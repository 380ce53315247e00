"""False alarms on clean sets: ``python experiments/diagnosis/alarms.py FOLDER``.

Only the first question is asked of each case called ``clean-*`` of a draw, whether anything is wrong at all: an answer
other than ``clean`` needs a chance below ``Thresholds.alarm`` under noise. That takes seconds a case, so a thousand are
within reach. ``FOLDER/alarms.csv`` keeps the chances by kind of test; cases that are in it are not asked again.
"""

import argparse
import csv
import json
from pathlib import Path

from answer import prepare
from marks import Share
from rich.progress import track

COLUMNS = ("case", "variance", "noise", "spread", "p", "scores", "patterns", "hum", "lengths", "omnibus")


def chances(case: Path) -> dict[str, float]:
    """Chance of what each kind of test saw, and of all together."""
    from modalax.diagnose.causes import catalogue
    from modalax.diagnose.comparison import causes_of, make_comparison, with_noise_beside
    from modalax.diagnose.search.look import look
    from modalax.files import load

    comparison = with_noise_beside(make_comparison(load(case / "measurement.npz"), load(case / "simulation.npz")))
    causes = causes_of(None, comparison, catalogue(comparison.problem.data.shape[0]))
    found = look(comparison, causes).detection
    return {"p": found.p_value, **found.p_values}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    prepare()
    kept = folder / "alarms.csv"
    rows = list(csv.DictReader(kept.open())) if kept.exists() else []
    known = {r["case"] for r in rows}
    todo = [c for c in sorted((folder / "cases").glob("clean-*")) if c.name not in known]
    with kept.open("a", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        if not rows:
            writer.writeheader()
        for case in track(todo, "asking"):
            truth = json.loads((folder / "truth" / f"{case.name}.json").read_text())
            row = {
                "case": case.name, "variance": truth["noise"]["variance"], "noise": truth["noise"]["kind"],
                "spread": truth["frequency_std"] > 0, **chances(case),
            }  # fmt: skip
            writer.writerow(row)
            file.flush()
            rows.append({k: str(v) for k, v in row.items()})
    for key in ("variance", "noise", "spread"):
        for value in sorted({r[key] for r in rows}):
            print(f"{key} {value}: {Share.of([r for r in rows if r[key] == value], alarmed)}")
    print(f"all: {Share.of(rows, alarmed)}")


def alarmed(row: dict[str, str]) -> bool:
    """Whether anything was said to be wrong."""
    from modalax.diagnose.thresholds import THRESHOLDS

    return float(row["p"]) < THRESHOLDS.alarm


if __name__ == "__main__":
    main()
