"""The documentation does what it says: every command and example of its pages is run as a reader would run it.

Blocks of a page run in their order, in one empty folder: ``python`` in one session, ``sh`` line by line as arguments of
the command, and ``toml`` is saved under the name in its first line. ``<!-- not run -->`` above a block leaves it out,
and ``<!-- slow -->`` marks a page that takes long.
"""

import dataclasses
import inspect
import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from modalax.cli import main
from modalax.files import load
from modalax.files.arrays import to_arrays
from modalax.model.examples import five_dof

DOCS = Path(__file__).parents[2] / ".github" / "docs"
BLOCK = re.compile(r"^(?P<out><!-- not run -->\n)?```(?P<kind>sh|python|toml)\n(?P<code>.*?)^```$", re.M | re.S)
PAGES = sorted(p for p in DOCS.rglob("*.md") if BLOCK.search(p.read_text(encoding="utf-8")))
SLOW = "<!-- slow -->"


def blocks(page: Path) -> list[tuple[str, str]]:
    """Kind and code of what is to be run."""
    found = BLOCK.finditer(page.read_text(encoding="utf-8"))
    return [(m["kind"], m["code"]) for m in found if not m["out"]]


def follow(page: Path) -> None:
    """Do all that a page says, in the current folder."""
    session: dict = {"__name__": "__main__"}
    for kind, code in blocks(page):
        if kind == "python":
            exec(compile(code, page.name, "exec"), session)
        elif kind == "toml":
            name = re.match(r"# (\S+\.toml)\n", code)
            assert name, f"{page.name}: a toml block begins with its name as a comment"
            Path(name[1]).write_text(code, encoding="utf-8")
        else:
            for line in code.replace("\\\n", " ").splitlines():
                words = shlex.split(line, comments=True)
                assert not words or words[0] == "modalax", f"{page.name}: {line!r} is no command of modalax"
                assert not words or main(words[1:]) == 0, f"{page.name}: {line!r} fails"


def marked(page: Path):
    slow = SLOW in page.read_text(encoding="utf-8")
    return pytest.param(page, id=str(page.relative_to(DOCS)), marks=pytest.mark.slow if slow else ())


@pytest.mark.filterwarnings("ignore::UserWarning")  # what a reader is told as a note
@pytest.mark.parametrize("page", [marked(p) for p in PAGES])
def test_a_page_can_be_followed(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    follow(page)
    formats = (DOCS / "formats.md").read_text(encoding="utf-8")
    for file in tmp_path.glob("*.json"):
        answer = json.loads(file.read_text(encoding="utf-8"))
        keys = set(answer) | {key for mode in answer.get("modes", ()) for key in mode} | set(answer.get("gain") or ())
        assert [key for key in sorted(keys) if f"`{key}`" not in formats] == []


def test_the_keys_of_a_diagnosis_stand_in_its_table():
    from modalax.diagnose.modal_domain.answer import ModalDiagnosis
    from modalax.diagnose.result import Diagnosis

    text = (DOCS / "formats.md").read_text(encoding="utf-8").split("## `diagnose --json`")[1].split("\n## ")[0]
    for kind in (Diagnosis, ModalDiagnosis):
        keys = re.findall(r'^ {12}"(\w+)":', inspect.getsource(kind.to_dict), re.M)
        assert len(keys) > 9 and [key for key in keys if f"`{key}`" not in text] == []


def test_how_to_pages_are_followed():
    assert len([p for p in PAGES if p.parent.name == "howto" and blocks(p)]) >= 7


def test_links_between_pages_lead_somewhere():
    for page in DOCS.rglob("*.md"):
        for target in re.findall(r"\]\(([^)#]+\.md)\)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists() and target != "causes.md", f"{page.name}: {target}"


def test_every_page_is_linked_from_the_first_one_where_toctrees_are_not_shown():
    shown = re.sub(r"```.*?```", "", (DOCS / "index.md").read_text(encoding="utf-8"), flags=re.S)
    pages = {str(p.relative_to(DOCS)) for p in DOCS.rglob("*.md")} - {"index.md", "causes.md", "api.md"}
    assert sorted(p for p in pages if not p.startswith(("api/", "_build/")) and f"]({p})" not in shown) == []


def test_words_of_a_check_and_laws_of_joints_stand_in_their_tables():
    from modalax.check import WORDS
    from modalax.simulate.joints import CATALOGUE

    text = (DOCS / "words.md").read_text(encoding="utf-8")
    check, laws = text.split("\n## ")[1], text.split("\n## Laws")[1]
    assert re.findall(r"^\| `(\w+)` \|", check, re.M) == list(WORDS)
    found = dict(re.findall(r"^\| `(\w+)` \| .+ \| (.+) \|$", laws, re.M))
    assert list(found) == list(CATALOGUE)
    for slug, law in CATALOGUE.items():
        whole = [f.name for f in dataclasses.fields(law) if f.metadata.get("static")]
        assert re.findall(r"`(\w+)`", found[slug]) == [*law.units, *whole], slug
        assert set(re.findall(r"\[(.+?)\]", found[slug])) == set(law.units.values()), slug


def test_every_cause_stands_in_the_table(monkeypatch):
    monkeypatch.syspath_prepend(str(DOCS))
    import causes_table

    from modalax.diagnose import catalogue

    rows = re.findall(r"^\| `(\w+)` \| (.+) \| (.+) \| (.+) \| (.+) \|$", causes_table.page(), re.M)
    assert [row[0] for row in rows] == list(dict.fromkeys(c.slug for c in catalogue()))
    assert all(cell.strip() for row in rows for cell in row)
    told = {row[0]: re.findall(r"`(\w+)` \[", row[2]) for row in rows}
    assert told["elasto_slip"] == ["stiffness", "slip_force"]  # as an answer gives them, not as they are fitted
    assert told["leakage"] == ["record_length"] and told["sensor_filter"][:2] == ["high_pass_corner", "low_pass_corner"]


def test_arrays_of_the_files_stand_in_their_table():
    from modalax.files.arrays import MEASUREMENT_KEYS, MODEL_KEYS, STRUCTURE_KEYS

    formats = (DOCS / "formats.md").read_text(encoding="utf-8")
    known = {*MEASUREMENT_KEYS, *STRUCTURE_KEYS, *MODEL_KEYS} - {"axes"}
    assert sorted(key for key in known if f"`{key}`" not in formats) == []


def row(kind: str) -> tuple[list[str], list[str]]:
    """Names of the arrays that a file of a kind needs, and of those that may be left out, by the page of formats."""
    table = (DOCS / "formats.md").read_text(encoding="utf-8")
    cells = re.search(rf"^\| {kind} \|(.*)\|$", table, re.M)
    assert cells
    needed, others = (re.findall(r"`(\w+)`", part) for part in cells[1].split(";", 1))
    return needed, others


@pytest.mark.parametrize("kind", ["measurement", "structure"])
def test_a_file_needs_what_the_page_of_formats_says_and_no_more(kind, tmp_path):
    structure = five_dof()
    whole = to_arrays(structure if kind == "structure" else structure.frf(np.arange(20.0, 60.0), inputs=["1"]))
    needed, others = row(kind)
    assert set(whole) <= {*needed, *others}
    path = tmp_path / "a.npz"
    np.savez(path, **{name: whole[name] for name in needed})
    with pytest.warns(UserWarning, match="have no names"):
        load(path)
    for name in needed:
        np.savez(path, **{key: value for key, value in whole.items() if key != name})
        with pytest.raises(ValueError, match=rf"no {name} in it; a {kind} file needs {', '.join(needed)}"):
            load(path)
