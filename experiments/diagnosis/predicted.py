"""Names that predict held-out data worse than the simulation alone: ``python predicted.py RESULTS.jsonl ...``.

Reads kept answers of hidden effects (``results/exact_*.jsonl``), counts the names and lists those with which the block
that was held out is less likely than without them by more than a nat. A case is called by what is hidden.
"""

import argparse
import json
from pathlib import Path

NAT = 1.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("files", type=Path, nargs="+")
    answers = [json.loads(line) for path in parser.parse_args().files for line in path.read_text().splitlines()]
    named = [a for a in answers if a["verdict"] == "named" and a["gain"]]
    worse = [a for a in named if a["gain"]["log_likelihood_gain"] < -NAT]
    print(f"{len(named)} names, {len(worse)} of them with a held-out block that is less likely with them:")
    for a in worse:
        print(
            f"  {a['name']}: {', '.join(c['name'] for c in a['causes'])}, {a['gain']['log_likelihood_gain']:.1f} nats"
        )


if __name__ == "__main__":
    main()
