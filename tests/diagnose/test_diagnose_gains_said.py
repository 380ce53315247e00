import math

import pytest

from modalax.diagnose.gains_said import gains_said


def told(factor, where=(), name="force_gain", std=1e-5):
    return {"name": name, "where": list(where), "parameters": {"gain": {"value": factor - 1, "std": std, "unit": "-"}}}


@pytest.mark.parametrize(("factor", "unit"), [
    (9.80665, "g and m/s^2"), (1 / 9.81, "g and m/s^2"), (4.45, "lbf and N"), (1e-3, "m and mm"), (25.4, "inch and mm"),
    (math.sqrt(0.5), "amplitude and rms"), (-1000.0, "m and mm"),
])  # fmt: skip
def test_a_unit_taken_for_another_is_guessed_from_the_factor(factor, unit):
    (sentence,) = gains_said([told(factor)])
    assert sentence.startswith("all measured FRFs are") and f"({unit}" in sentence
    assert ("turned in sign" in sentence) == (factor < 0)


def test_a_sensor_that_points_the_other_way_is_told_with_its_name():
    (sentence,) = gains_said([told(-1.003, ["3:+Z"], "channel_gain")])
    assert "FRFs of 3:+Z" in sentence and "points the other way" in sentence and "unit" not in sentence


def test_errors_of_calibration_and_factors_of_no_unit_are_not_explained():
    assert gains_said([told(1.1), told(0.9, ["a"], "channel_gain"), {"name": "added_mass", "where": ["a"]}]) == []
    (sentence,) = gains_said([told(1.7)])
    assert sentence == "all measured FRFs are 1.7 times what was expected"


def test_a_dead_channel_is_told():
    (sentence,) = gains_said([told(0.002, ["9:+Z"], "channel_gain", 1e-3)])
    assert sentence.startswith("measured FRFs of 9:+Z hold nothing") and "dead" in sentence
