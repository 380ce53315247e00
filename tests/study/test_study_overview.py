from pathlib import Path

from modalax.study import Results

QUANTITY = {
    "name": "f_1", "draws": 4, "missing": 0, "mean": 10.01, "std": 0.02, "truth": 10.0, "bias": 0.01, "bias_std": 0.01,
    "stated_std": None, "coverage": None,
}  # fmt: skip


def test_results_print_the_statistics_of_each_group_and_why_draws_failed():
    group = {"where": {"sigma": 0.1}, "draws": 5, "failed": 1, "quantities": [QUANTITY]}
    told = {"draws": 5, "failed": 1, "reasons": {"no mode": 1}, "groups": [group]}
    assert str(Results(Path("out"), Path("out/rows.npz"), {}, told)).splitlines() == [
        "sigma = 0.1: 5 draws, 1 failed",
        "Quantity  True   Mean   Std          Bias",
        "--------  ----  -----  ----  ------------",
        "f_1         10  10.01  0.02  +0.01 ± 0.01",
        "1 failed: no mode",
        "all rows: out/rows.npz",
    ]
