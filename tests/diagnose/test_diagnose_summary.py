"""What ``print`` shows of a diagnosis."""

from modalax.diagnose.summary import parameters_text, summary

GAIN = {"held_out": "run 3", "chi2_before": 7.52, "chi2_after": 1.012, "log_likelihood_gain": 512.0,
        "log_likelihood_gain_std": 4.0}  # fmt: skip
SPRING = {
    "name": "joint_stiffness", "where": ["3", "5"], "probability": 0.9871,
    "parameters": {"stiffness": {"value": 2501.0, "std": 12.0, "unit": "N/m"}},
}  # fmt: skip
SIGN = {"name": "channel_sign", "where": ["4"], "probability": 0.9871, "parameters": {}}


def test_a_named_diagnosis_is_told_in_a_table_and_its_gain():
    told = summary({"verdict": "named", "causes": [SPRING, SIGN], "alternatives": [], "advice": None, "gain": GAIN})
    assert told.splitlines() == [
        "named: the simulation lacks the causes listed here",
        "Cause            Where  Probability  Parameters",
        "---------------  -----  -----------  -------------------------",
        "joint_stiffness  3 - 5        0.987  stiffness = 2501 ± 12 N/m",
        "channel_sign     4            0.987",
        "on data left out of the fit (run 3): chi-square per real sample 7.52 before, 1.01 after (1 is noise alone); "
        "log-likelihood gain 512.0 ± 4.0 nats",
    ]


def test_what_the_data_does_not_determine_has_no_number():
    p = {"upper": {"value": 1.003, "std": 0.071, "unit": "-"}, "at": {"value": 1e7, "std": 1e15, "unit": "Hz"}}
    assert parameters_text(p) == "upper = 1.003 ± 0.071, at is not determined by this data"
    assert parameters_text({"a": {"value": 0.0, "std": 0.5, "unit": "m"}}) == "a = 0.00 ± 0.50 m"
    assert parameters_text({"a": {"value": 2.0, "std": None, "unit": "m"}}) == "a = 2 m"


def test_rivals_reasons_and_advice_are_told():
    told = summary(
        {
            "verdict": "ambiguous", "causes": [SPRING], "alternatives": [[SIGN, {"name": "units", "where": []}]],
            "advice": "measure DoF 4", "gain": None, "reasons": ["two sets fit alike"],
        }
    ).splitlines()  # fmt: skip
    assert told[0].startswith("ambiguous: several explanations fit")
    assert told[-3:] == [
        "or: channel_sign at 4 and units",
        "because: two sets fit alike",
        "to tell them apart: measure DoF 4",
    ]


def test_a_clean_one_is_one_line():
    told = summary({"verdict": "clean", "causes": [], "alternatives": [], "advice": None, "gain": None})
    assert told == "clean: this data shows nothing wrong with the simulation"


def test_a_clean_one_of_a_simulation_that_is_off_in_general_does_not_say_that_nothing_is_wrong():
    off = {"stiffness": {"value": 0.02, "interval": [0.01, 0.04]}}
    told = summary(
        {"verdict": "clean", "causes": [], "alternatives": [], "advice": None, "gain": None, "inaccuracy": off}
    )
    assert told == "clean: nothing stands out beyond what is usual for such a simulation"


def test_an_unknown_one_claims_no_probability_and_says_how_far_it_goes():
    gain = {**GAIN, "chi2_before": 401.0, "chi2_after": 65.0}
    told = summary({"verdict": "unknown", "causes": [SPRING], "alternatives": [], "advice": None, "gain": gain})
    assert "0.987" not in told
    assert (
        "best attempt, not an explanation: on data left out of the fit it explains 84 % of the misfit and leaves a "
        "chi-square of 65 per real sample (1 is noise alone)"
    ) in told.splitlines()
