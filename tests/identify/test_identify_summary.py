"""What ``print`` shows of a fit."""

import pytest

from modalax.identify.summary import summary

FIRST = {"frequency_hz": 26.0612, "frequency_std_hz": 0.0123, "damping_ratio": 0.02, "damping_ratio_std": 0.00041,
         "mpc": 0.99912, "flags": []}  # fmt: skip
SECOND = {"frequency_hz": 34.5, "frequency_std_hz": None, "damping_ratio": 0.015, "damping_ratio_std": None,
          "mpc": 0.71, "flags": ["complex shape", "no error bars"]}  # fmt: skip
ANSWER = {"modes": [FIRST, SECOND], "band_hz": [20.0, 70.0], "method": "plscf", "order": 24, "unexplained": 0.00123,
          "refined": True, "reason": "converged", "notes": ["lines at 0 Hz left out"]}  # fmt: skip


def test_modes_stand_in_a_table_with_error_bars_and_flags():
    assert summary(ANSWER).splitlines() == [
        "2 modes from 20 to 70 Hz, plscf of order 24, refined (± one standard deviation); unexplained part of the "
        "measured energy: 0.123 %",
        "Mode  Frequency [Hz]    Damping [%]    MPC",
        "----  --------------  -------------  -----",
        "   1  26.061 ± 0.012  2.000 ± 0.041  0.999",
        "   2            34.5            1.5  0.710",
        "mode 2: complex shape; no error bars",
        "note: lines at 0 Hz left out",
    ]


@pytest.mark.parametrize(
    ("reason", "words"), [(None, "not refined;"), ("60 steps", "refinement did not converge (60 steps);")]
)
def test_without_a_refinement_it_is_said(reason, words):
    told = summary({**ANSWER, "modes": [FIRST], "refined": False, "reason": reason, "notes": []})
    assert told.startswith("1 mode from 20 to 70 Hz") and words in told and "note:" not in told
