"""The rooms of the diagnosis stand on one another: imports between them run one way, decisions are in one of them."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2] / "src" / "modalax" / "diagnose"
# What stands in an earlier row knows nothing of a later one; a file may import its own folder.
ROWS = (
    {"thresholds", "summary", "deadline"}, {"causes"}, {"setup"}, {"prediction"}, {"fitting"}, {"extend"},
    {"comparison"}, {"screening"}, {"decision"}, {"search"}, {"holdout", "joint_laws"}, {"result"}, {"modal_domain"},
    {"jointed"}, {"routes"}, {"pipeline"}, {"__init__"},
)  # fmt: skip
# The same within the modal domain, whose rooms are all but the last steps of an answer.
MODAL_ROWS = (
    {"structure"}, {"modes"}, {"causes"}, {"fitting"}, {"search", "on_lines"}, {"levels", "odd_channels"}, {"stage"},
    {"records", "judged", "claimed_modes"}, {"answer", "corrected"}, {"held_out", "table"}, {"diagnosis"},
)  # fmt: skip
RANK, MODAL_RANK = ({name: k for k, row in enumerate(rows) for name in row} for rows in (ROWS, MODAL_ROWS))
MODAL = ROOT / "modal_domain"
FILES = sorted(p for p in ROOT.rglob("*.py") if p.relative_to(ROOT).parts[0].removesuffix(".py") in RANK)


def room(parts):
    return parts[0].removesuffix(".py")


def imported(path, folder="modalax.diagnose"):
    found = re.findall(r"^ *from ([\w.]+) import", path.read_text(), re.MULTILINE)
    return {room(name.removeprefix(f"{folder}.").split(".")) for name in found if name.startswith(f"{folder}.")}


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_between_rooms_run_one_way(path):
    own = room(path.relative_to(ROOT).parts)
    assert all(other == own or RANK[other] < RANK[own] for other in imported(path) if other in RANK)


@pytest.mark.parametrize("path", sorted(MODAL.rglob("*.py")), ids=lambda p: str(p.relative_to(MODAL)))
def test_imports_between_rooms_of_the_modal_domain_run_one_way(path):
    own = room(path.relative_to(MODAL).parts)
    others = imported(path, "modalax.diagnose.modal_domain") - {own}
    assert all(MODAL_RANK[other] < MODAL_RANK.get(own, -1) for other in others)
    assert own in MODAL_RANK or path == MODAL / "__init__.py"


def test_every_known_room_stands():
    there = {room(p.relative_to(ROOT).parts) for p in ROOT.rglob("*.py")}
    assert set(RANK) <= there and len(FILES) > 40


def test_no_cause_is_asked_for_its_kind_by_a_word():
    """Hooks and attributes are declared; no ``hasattr``, and no word that stands for a stage."""
    for path in ROOT.rglob("*.py"):
        text = path.read_text()
        assert "hasattr(" not in text and ".stage ==" not in text, path
