"""A few hundred damaged and hostile files of every format, by the script that tries many more."""

import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[2] / "experiments" / "files"
sys.path.insert(0, str(SCRIPTS))
import fuzz  # noqa: E402

sys.path.remove(str(SCRIPTS))

pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.mark.skipif(
    not hasattr(__import__("signal"), "alarm"), reason="time is limited by a signal that this system lacks"
)
@pytest.mark.parametrize("which", fuzz.FORMATS)
def test_a_damaged_file_is_refused_in_one_line_or_sound(which):
    ends = [(end, words) for _, end, words in fuzz.run(50, 7, [which])]
    bad = [(end, words) for end, words in ends if end not in ("refused", "sound")]
    assert not bad, bad[:3]
    assert sum(end == "refused" for end, _ in ends) > 15  # the damage is such that much of it must be seen


def test_the_fuzz_sees_what_it_looks_for(tmp_path, monkeypatch):
    """Each kind of failure, brought about on purpose, is counted as one."""
    sound = fuzz.sound_files(tmp_path)["npz"]

    def load_as(what):
        monkeypatch.setattr(fuzz.modalax, "load", what)
        return fuzz.tried(sound)[0]

    def raises(error):
        def load(path):
            raise error

        return load

    found = fuzz.modalax.load(sound)
    assert load_as(lambda path: found) == "sound"
    assert load_as(lambda path: found.replace(H=found.H * 1e40)) == "accepted"
    assert load_as(raises(KeyError("x"))) == "foreign"
    assert load_as(raises(ValueError("no file named"))) == "unclear"
    assert load_as(raises(ValueError(f"{sound}: two\nlines"))) == "unclear"
    assert load_as(raises(ValueError(f"{sound}: one line"))) == "refused"
    assert load_as(raises(TimeoutError("late"))) == "hang"
