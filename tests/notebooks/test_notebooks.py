"""Every notebook runs from top to bottom without an error, in an empty folder."""

import ast
import os
from importlib import import_module
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

ROOT = Path(__file__).parents[2]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
DATA = Path(os.environ.get("MODALAX_DATA", ROOT.parent / "shared" / "data"))
SECONDS = 900


def needs_measured_data(notebook: nbformat.NotebookNode) -> bool:
    """Notebooks say so in their metadata: ``{"modalax": {"measured": true}}``."""
    return bool(notebook.metadata.get("modalax", {}).get("measured", False))


@pytest.mark.slow
@pytest.mark.measured
# The kernel's client opens sockets and event loops of its own; what they leave behind is not ours to mend.
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_notebook_runs(path, tmp_path, monkeypatch):
    notebook = nbformat.read(path, as_version=4)
    if needs_measured_data(notebook) and not DATA.is_dir():
        pytest.skip(f"{path.name} needs the measured data; name its folder in MODALAX_DATA")
    if DATA.is_dir():
        monkeypatch.setenv("MODALAX_DATA", str(DATA))
    NotebookClient(notebook, timeout=SECONDS, resources={"metadata": {"path": str(tmp_path)}}).execute()


@pytest.mark.filterwarnings("ignore")
def test_a_notebook_runs_in_a_kernel_up_to_its_structure(tmp_path):
    """Its first two cells of code: what it imports, and the model that all else is about."""
    notebook = nbformat.read(ROOT / "notebooks" / "02_joint_at_rising_force.ipynb", as_version=4)
    second = [k for k, cell in enumerate(notebook.cells) if cell.cell_type == "code"][1]
    notebook.cells = notebook.cells[: second + 1]
    NotebookClient(notebook, timeout=SECONDS, resources={"metadata": {"path": str(tmp_path)}}).execute()
    assert "first modes with the interface stuck" in notebook.cells[-1].outputs[0].text


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_what_a_notebook_imports_is_there(path):
    cells = [
        "\n".join(line for line in cell.source.splitlines() if not line.startswith(("%", "!")))  # no Python
        for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"
    ]  # fmt: skip
    asked = [
        (node.module, name.name) for source in cells for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.ImportFrom) and node.module for name in node.names
    ]  # fmt: skip
    assert any(module.startswith("modalax") for module, _ in asked)
    assert [(m, n) for m, n in asked if m.startswith("modalax") and not hasattr(import_module(m), n)] == []


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_notebook_is_written_to_be_read(path):
    """It starts with a title, explains itself between the code, and no cell was stored with an error."""
    notebook = nbformat.read(path, as_version=4)
    first = notebook.cells[0]
    assert first.cell_type == "markdown" and first.source.startswith("# ")
    assert sum(cell.cell_type == "markdown" for cell in notebook.cells) >= 3
    stored = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert not [output for output in stored if output.output_type == "error" or output.get("name") == "stderr"]
    codes = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in codes] == list(range(1, len(codes) + 1)), "not stored as run from the top"
    assert any("image/png" in output.get("data", {}) for output in stored) and notebook.cells[-1].cell_type == "markdown"


def test_real_structures_are_told_of():
    """At least four stories need measured data, and the README leads to each notebook."""
    measured = [p for p in NOTEBOOKS if needs_measured_data(nbformat.read(p, as_version=4))]
    assert len(measured) >= 4
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert [p.name for p in NOTEBOOKS if f"(notebooks/{p.name})" not in readme] == []
