"""Pictures and report of a diagnosis."""

import json
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from modalax.data import Measurement
from modalax.diagnose.summary import causes_text
from modalax.model import Structure
from modalax.model.examples import five_dof
from modalax.show.diagnosis import MOST_ROWS, residual_rows, run_names
from modalax.show.report.diagnosis import cause_rows, gain_rows, interval, smallest_sections
from modalax.show.report.evidence import evidence_sections


def made_up(runs, outputs, inputs, lines=20, seed=0):
    """A measurement, and residuals of noise alone but for one channel, 30 times as large in the last run."""
    rng = np.random.default_rng(seed)
    shape = (runs, lines, outputs, inputs)
    before, after = (rng.normal(size=shape) + 1j * rng.normal(size=shape) for _ in range(2))
    before[-1, :, 2, 0] *= 30
    names = {"outputs": [f"o{k}" for k in range(outputs)], "inputs": [f"i{k}" for k in range(inputs)]}
    data = Measurement(np.arange(1.0, lines + 1), before, level=np.arange(1.0, runs + 1), **names)
    return data, before, after


def test_runs_are_named_by_force_where_it_is_known():
    assert run_names(np.array([1.0, np.nan, 2.5])) == ["1 N", "run 2", "2.5 N"]


def test_rows_stand_for_their_channels():
    data, first, second = made_up(2, 3, 2)
    names, before, after = residual_rows(data, first, second)
    assert len(names) == len(before) == len(after) == 12
    k = names.index("o2 from i0, 2 N")
    np.testing.assert_array_equal(before[k], first[1, :, 2, 0])
    np.testing.assert_array_equal(after[k], second[1, :, 2, 0])


def test_of_very_many_rows_the_worst_are_kept():
    names, before, _ = residual_rows(*made_up(1, 100, 2))
    assert len(names) == len(before) == MOST_ROWS and "o2 from i0" in names


def test_answers_as_tables():
    causes = [
        {
            "name": "elasto_slip", "where": ["3", "5"], "probability": 0.987,
            "parameters": {"stiffness": {"value": 2e4, "std": 10.0, "unit": "N/m"},
                           "slip_force": {"value": 4.0, "std": None, "unit": "N"}},
        },
        {"name": "time_delay", "where": [], "probability": 0.987, "parameters": {}},
    ]  # fmt: skip
    rows = cause_rows({"verdict": "named", "causes": causes}).rows
    assert len(rows) == 3
    assert rows[0] == ["elasto_slip", "3 - 5", "0.987", "stiffness [N/m]", "20000 ± 10", "19980 to 20020"]
    assert rows[1][3:] == ["slip_force [N]", "4", "not known"]
    assert rows[2][:2] == ["time_delay", "everywhere"]
    assert causes_text(causes) == "elasto_slip at 3 - 5 and time_delay"
    assert interval(1.0, float("nan")) == "not known"
    gain = {"held_out": "run 3", "chi2_before": 7.5, "chi2_after": 1.01, "log_likelihood_gain": 50.0,
            "log_likelihood_gain_std": 4.0}  # fmt: skip
    table = gain_rows(gain)
    assert "run 3" in table.caption and table.rows[0][1:] == ["7.5", "1.01"]
    assert table.rows[1][2] == "50.0 ± 4.0"


def test_smallest_effects_have_a_section_where_they_are_told():
    diagnosis = SimpleNamespace(strength_parameters={"added_mass": SimpleNamespace(name="mass", unit="kg")})
    (section,) = smallest_sections(diagnosis, {"smallest_detectable": {"added_mass": 0.01234}})
    assert section.parts[0].rows == [["added_mass", "mass [kg]", "0.0123"]]
    assert smallest_sections(diagnosis, {"smallest_detectable": {}}) == []


def test_what_the_data_show_as_tables():
    chance = {"chi2": 3.0, "freedom": 2, "p_value": 0.223}
    mode = {"frequency_hz": 20.5, "damping_ratio": 0.012, "chi2_before": 90.0, "chi2_after": None}
    mode |= {f"{name}_{when}": value for when, value in (("before", 0.021), ("after", None))
             for name in ("frequency_error", "damping_error", "peak_error_db")}  # fmt: skip
    evidence = {
        "tests": {"reciprocity": chance, "level_homogeneity": None, "band": {"before": chance, "after": None},
                  "whiteness": {"before": {"p_value": 0.0}, "after": {"p_value": 0.4}}},
        "by_mode": [mode],
        "by_channel": [{"output": "a", "input": "b", "chi2_before": 7.0, "chi2_after": 1.0, "frac_before": 0.5,
                        "frac_after": 0.999}],
        "by_level": [{"run": 1, "level": None, "chi2_before": 7.0, "chi2_after": 1.0, "hilbert_measured": None,
                      "hilbert_extended": 0.01}],
    }  # fmt: skip
    assert evidence_sections(None) == []
    tests, modes, levels, channels = evidence_sections(evidence)[0].parts
    assert [row[1:] for row in tests.rows] == [["0.223", ""], ["0.223", ""], ["< 1e-300", "0.4"]]
    assert modes.rows == [["20.5", "1.2", "+2.1 / -", "+2.1 / -", "+0.021 / -", "90 / -"]]
    assert levels.rows == [["1", "", "7 / 1", "", "0.01"]]
    assert channels.rows == [["a", "b", "7 / 1", "0.5 / 0.999"]]


@pytest.mark.slow
def test_a_real_diagnosis_from_the_command_line(tmp_path, capsys):
    """A mass of 50 g on DoF 4, twenty times what the data would show: named, told, reported and drawn."""
    from modalax.cli import main
    from modalax.files import save

    simulation = five_dof()
    heavier = Structure(simulation.M.at[3, 3].add(0.05), simulation.C, simulation.K, simulation.dofs)
    frf = heavier.frf(np.linspace(20, 70, 201), inputs=["1"]).add_noise(jax.random.key(0), 0.02)
    save(Measurement.from_frfs([frf]), tmp_path / "test.npz")
    save(simulation, tmp_path / "simulation.npz")
    out = [str(tmp_path / name) for name in ("d.json", "d.html", "pictures")]
    arguments = ["diagnose", str(tmp_path / "test.npz"), "--simulation", str(tmp_path / "simulation.npz")]
    assert main([*arguments, "--json", out[0], "--report", out[1], "--out", out[2]]) == 0
    printed = capsys.readouterr().out
    answer = json.loads((tmp_path / "d.json").read_text())
    assert answer["verdict"] == "named" and answer["causes"][0]["name"] == "added_mass"
    assert "added_mass" in printed and "named" in printed
    report = (tmp_path / "d.html").read_text()
    assert "added_mass at 4" in report and report.count('class="plot"') >= 3
    assert {p.name for p in (tmp_path / "pictures").iterdir()} == {
        "residuals.png", "comparison.png", "nyquist.png"
    }  # fmt: skip
    assert "Missed by the Hilbert transform" in report and "FRAC" in report
    assert answer["evidence"]["tests"]["whiteness"]["before"]["p_value"] < 0.01
