import tomllib

import pytest

from modalax.cli import main
from modalax.study.examples import EXAMPLES
from modalax.study.run import study
from modalax.study.settings import KINDS, checked, read_settings


@pytest.mark.parametrize("kind", KINDS)
def test_every_example_is_a_study(kind, capsys):
    assert main(["study", "--example", kind]) == 0
    printed = capsys.readouterr().out
    assert printed == EXAMPLES[kind]
    assert checked(tomllib.loads(printed))["kind"] == kind


def test_help_shows_a_complete_study(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    assert main(["study", "--help"]) == 0
    shown = [line.strip() for line in capsys.readouterr().out.splitlines()]
    for line in filter(None, EXAMPLES["noise"].splitlines()):
        assert line.strip() in shown


SOUND = """
kind = "noise"
draws = 10
[system]
simulation = "five_dof"
band = [20, 70]
step = 0.5
"""


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("draws = 10", "drws = 10"), r"study.toml has the key 'drws', which is not known \(did you mean draws\?\)"),
        (("draws = 10", ""), r"study.toml: draws is missing; it is needed"),
        (("draws = 10", "draws = 2.5"), "study.toml: draws is 2.5; it needs a whole number"),
        (("draws = 10", "draws = true"), "draws is True; it needs a whole number"),
        (("draws = 10", "draws = 0"), "draws is 0; it must be at least 1"),
        (('"noise"', '"nois"'), "kind is 'nois'; it must be one of noise, bootstrap, parameter, diagnosis, function"),
        (('kind = "noise"', ""), "kind is missing; it is needed .kind of study: one of noise, bootstrap"),
        (("step = 0.5", "step = 0.5\nstp = 1"), r"\[system\] has the key 'stp'.*known are simulation, band, step"),
        (("[20, 70]", "[70, 20]"), r"\[system\] band is \[70, 20\]; it needs two rising frequencies"),
        (("step = 0.5", 'step = "fine"'), r"study.toml: \[system\] step is 'fine'; it needs a finite number"),
        (("step = 0.5", "step = 0.5\nform = 'x'"), "form is 'x'; it must be one of receptance, mobility"),
        (("[system]", "[sytem]"), r"key 'sytem', which is not known \(did you mean system\?\)"),
        (("[system]", "system = 3\n[fit]"), r"system is 3; it must be a table, \[system\]"),
        (("[20, 70]", "[20, 70"), "is no TOML file"),
    ],
)
def test_a_mistake_is_told_with_what_is_known(tmp_path, change, message):
    path = tmp_path / "study.toml"
    path.write_text(SOUND.replace(*change))
    with pytest.raises(ValueError, match=message):
        read_settings(path)


JOINT = '[[system.joint]]\nlaw = "gap"\nwhere = ["3", "88"]\nk = 1\ngap = 1'


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("five_dof", "nofile.npz"), r"\[system\] simulation: .*nofile.npz: no such file"),
        (("five_dof", "study.toml"), r"\[system\] simulation: "),
        (
            ("step = 0.5", 'step = 0.5\ninputs = ["77"]'),
            r"\[system\] inputs: no DoF named '77'; the structure has 1, 2",
        ),
        (("step = 0.5", 'step = 0.5\noutputs = ["1", "78"]'), r"\[system\] outputs: no DoF named '78'"),
        (("step = 0.5", "step = 1e-9"), r"\[system\] step 1e-09: makes 5e\+10 lines"),
        (("step = 0.5", f"step = 0.5\nforce = [1]\n{JOINT}"), r"\[\[system.joint\]\] 1 where: no DoF named '88'"),
        (
            ('"noise"', '"diagnosis"\nhidden = {cause = "added_mass", where = ["99"], sizes = [1]}'),
            r"\[hidden\] where: no DoF named '99'",
        ),
    ],
)
def test_what_is_not_there_is_told_with_the_file_and_the_key_that_names_it(tmp_path, change, words):
    path = tmp_path / "study.toml"
    path.write_text(SOUND.replace(*change))
    with pytest.raises((ValueError, FileNotFoundError), match=rf"study.toml: {words}"):
        study(path, workers=0)
    assert not (tmp_path / "study-results").exists()


def test_a_study_needs_its_table():
    with pytest.raises(ValueError, match=r"a diagnosis study needs a table \[hidden\]"):
        checked({"kind": "diagnosis", "draws": 1, "system": {"simulation": "five_dof", "band": [20, 70], "step": 1}})


def test_mistakes_end_the_command_with_one_line(tmp_path, capsys):
    path = tmp_path / "study.toml"
    path.write_text(SOUND.replace("draws = 10", "drws = 10"))
    assert main(["study", str(path)]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert main(["study", str(tmp_path / "none.toml")]) == 2
    assert "none.toml: no such file" in capsys.readouterr().err
    assert main(["study"]) == 2
    assert main(["study", "--example", "bootstraps"]) == 2
