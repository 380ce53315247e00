"""The rooms of the diagnosis stand on one another: imports between them run one way, decisions are in one of them."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2] / "src" / "modalax" / "diagnose"
# What stands in an earlier row knows nothing of a later one; a file may import its own folder.
ROWS = (
    {"thresholds", "summary", "deadline"}, {"causes"}, {"setup"}, {"prediction"}, {"fitting"}, {"extend"},
    {"comparison"}, {"screening"}, {"decision"}, {"search"}, {"holdout", "joint_laws"}, {"result"}, {"modal_domain"},
    {"jointed"}, {"routes"}, {"pipeline"}, {"__init__"},
)  # fmt: skip
RANK = {name: k for k, row in enumerate(ROWS) for name in row}
FILES = sorted(p for p in ROOT.rglob("*.py") if p.relative_to(ROOT).parts[0].removesuffix(".py") in RANK)


def room(parts):
    return parts[0].removesuffix(".py")


def imported(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("modalax.diagnose."):
            yield room(node.module.split(".")[2:])


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_between_rooms_run_one_way(path):
    own = room(path.relative_to(ROOT).parts)
    assert all(other == own or RANK[other] < RANK[own] for other in imported(path) if other in RANK)


def test_every_known_room_stands():
    there = {room(p.relative_to(ROOT).parts) for p in ROOT.rglob("*.py")}
    assert set(RANK) <= there and len(FILES) > 40


def test_no_cause_is_asked_for_its_kind_by_a_word():
    """Hooks and attributes are declared; no ``hasattr``, and no word that stands for a stage."""
    for path in ROOT.rglob("*.py"):
        text = path.read_text()
        assert "hasattr(" not in text and ".stage ==" not in text, path
