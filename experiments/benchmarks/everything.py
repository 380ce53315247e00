"""All benchmarks with one command: ``python experiments/benchmarks/everything.py --out FOLDER [NAME ...]``.

Each runs in a process of its own, one after the other, some hours in all. ``results.md`` holds their tables under the
machine and its versions; ``results.csv`` every number in one table: benchmark, machine, row, quantity, value.
"""

import argparse
import csv
import subprocess
import sys
from pathlib import Path

CASES = ["--cases", "five", "small", "aeroplane", "large", "diagram"]
RUNS: dict[str, list[str]] = {  # script, then its options
    "identification": ["identification"], "fit_speed": ["fit_speed", *CASES], "diagnosis": ["diagnosis"],
    "off_everywhere": ["diagnosis", "--off-everywhere"], "harmonic_balance": ["harmonic_balance"], "batch": ["batch"],
    "large": ["large"], "curves": ["curves"], "scheduler": ["scheduler"], "startup": ["startup"],
    "devices": ["devices"],
}  # fmt: skip


def cells_of(line: str) -> list[str]:
    """The cells of a row of a Markdown table."""
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def numbers_of(text: str) -> list[list[str]]:
    """Row, quantity and value of every number in the tables of a text; words in the first cells name a row."""
    found: list[list[str]] = []
    head: list[str] = []
    lines = text.splitlines()
    for line, following in zip(lines, [*lines[1:], ""], strict=True):
        if not line.startswith("|"):
            head = []
        elif following.startswith(("| ---", "|---")):
            head = cells_of(line)
        elif head and not line.startswith(("| ---", "|---")):
            row = cells_of(line)
            named = 1 + max((k for k, cell in enumerate(row[:3]) if not _is_number(cell)), default=0)
            found += [[", ".join(row[:named]), q, v] for q, v in zip(head[named:], row[named:], strict=False) if v]
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(RUNS)}; all if none is given")
    parser.add_argument("--out", type=Path, required=True, help="folder for results.md and results.csv")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    told, numbers = [], [["benchmark", "machine", "row", "quantity", "value"]]
    for name in args.names or RUNS:
        script, *options = RUNS[name]
        command = [sys.executable, Path(__file__).with_name(f"{script}.py"), *options]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        text = done.stdout if not done.returncode else f"{done.stdout}\nfails: {done.stderr.strip()[-300:]}"
        told.append(f"## {name}\n{text.strip()}\n")
        machine = next((line for line in text.splitlines() if " cores, load " in line), "")
        numbers += [[name, machine, *row] for row in numbers_of(text)]
        print(told[-1], flush=True)
        (args.out / "results.md").write_text("\n".join(told), encoding="utf-8")
        with (args.out / "results.csv").open("w", newline="", encoding="utf-8") as f:
            csv.writer(f).writerows(numbers)


if __name__ == "__main__":
    main()
