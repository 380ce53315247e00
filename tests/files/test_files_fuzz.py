"""Some hundreds of damaged and hostile files of every format, by the script that tries many more."""

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest

SCRIPTS = Path(__file__).parents[2] / "experiments" / "files"
sys.path.insert(0, str(SCRIPTS))
import fuzz  # noqa: E402

sys.path.remove(str(SCRIPTS))

pytestmark = pytest.mark.filterwarnings("ignore")
COUNT = 20


@pytest.mark.skipif(
    not hasattr(__import__("signal"), "alarm"), reason="time is limited by a signal that this system lacks"
)
@pytest.mark.parametrize("which", fuzz.KINDS)
def test_a_damaged_file_is_refused_in_one_line_or_sound(which):
    ends = [(end, words) for _, end, words in fuzz.run(range(COUNT), 7, [which])]
    bad = [(end, words) for end, words in ends if end not in ("refused", "sound")]
    assert not bad, bad[:3]
    assert any(end == "refused" for end, _ in ends)  # the damage is such that some of it must be seen


def test_the_fuzz_sees_what_it_looks_for(tmp_path, monkeypatch):
    """Each kind of failure, brought about on purpose, is counted as one."""
    sound = fuzz.sound_files(tmp_path, ["npz"])["npz"]
    kind = fuzz.KINDS["npz"]

    def read_by(what):
        monkeypatch.setitem(fuzz.KINDS, "npz", dataclasses.replace(kind, read=lambda path, sound: what(path)))
        return fuzz.tried("npz", sound, sound)[0]

    def raises(error):
        def read(path):
            raise error

        return read

    found = kind.read(sound, sound)
    assert read_by(lambda path: found) == "sound"
    assert read_by(lambda path: found.replace(H=found.H * 1e40)) == "accepted"
    assert read_by(raises(KeyError("x"))) == "foreign"
    assert read_by(raises(ValueError("no file named"))) == "unclear"
    assert read_by(raises(ValueError(f"{sound}: two\nlines"))) == "unclear"
    assert read_by(raises(ValueError(f"{sound}: one line"))) == "refused"
    assert read_by(raises(TimeoutError("late"))) == "hang"
    monkeypatch.setattr(fuzz, "BYTES", 5e7)
    assert read_by(lambda path: np.ones(2 * 10**7).sum() and found) == ("memory" if fuzz.Peak().begin else "sound")


def test_parts_of_the_files_are_those_of_the_whole(tmp_path, capsys):
    """Two parts and their sum are told as one run is."""
    kinds = ["npz", "csv", "joints"]
    fuzz.main([*kinds, "--files", "30", "--seed", "1"])
    whole = capsys.readouterr().out.splitlines()
    for part in ("1/2", "2/2"):
        fuzz.main([*kinds, "--files", "30", "--seed", "1", "--part", part, "--tally", str(tmp_path / "sum.json")])
    parts = capsys.readouterr().out.splitlines()
    assert whole[-1].split(";")[0] == parts[-1].split(";")[0]
    assert whole[-1].startswith("30 files: ") and " 0 failures" in whole[-1]
