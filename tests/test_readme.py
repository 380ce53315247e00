"""The README's two commands stand where tools look for them, and name what the package really has."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import modalax

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def block(marker: str) -> str:
    """The fenced block right after the line that holds only the marker."""
    found = re.search(rf"^<!-- {re.escape(marker)} -->\n```\w*\n(.*?)^```$", README, re.M | re.S)
    assert found, f"README.md has no fenced block right after <!-- {marker} -->"
    return found.group(1)


@pytest.mark.parametrize("marker", ["main job", "tests"])
def test_command_is_one_line_that_makes_its_own_environment(marker):
    lines = block(marker).splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("python3 -m venv .venv && .venv/bin/")
    extras = re.findall(r"\.\[([\w,]+)\]", lines[0])
    assert extras and set(extras[0].split(",")) <= set(PROJECT["optional-dependencies"])


def test_first_screen_holds_both_commands():
    """Sixty lines are about one screen."""
    head = README.splitlines()[:60]
    assert "<!-- main job -->" in head and "<!-- tests -->" in head


def test_links_into_the_project_lead_somewhere():
    targets = [t.split("#")[0] for t in re.findall(r"\]\(([^)]+)\)", README) if "://" not in t]
    missing = [t for t in targets if t and not (ROOT / t).exists()]
    assert targets and not missing


def test_every_extra_named_in_the_readme_exists():
    named = {e for group in re.findall(r"'\.\[([\w,]+)\]'", README) for e in group.split(",")}
    assert {"report", "test", "all"} <= named <= set(PROJECT["optional-dependencies"])


def test_on_a_package_index_every_link_leads_to_the_repository():
    """There the text stands alone: a relative path, of the picture above all, would lead nowhere."""
    build = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["metadata"]["hooks"]
    text = README
    for change in build["fancy-pypi-readme"]["substitutions"]:
        text = re.sub(change["pattern"], change["replacement"], text)
    here, there = (re.findall(r"\]\(([^)]+)\)", t) for t in (README, text))
    assert len(here) == len(there) and all("://" in target for target in there)
    home = PROJECT["urls"]["Homepage"].removeprefix("https://github.com/")
    moved = [(a, b) for a, b in zip(here, there, strict=True) if a != b]
    assert all(home in b and b.endswith(a) and (ROOT / a).exists() for a, b in moved)
    assert [b.startswith("https://raw.") for a, b in moved] == [a.endswith(".png") for a, b in moved]
    assert any(a.endswith(".png") for a, _ in moved)


def test_the_version_is_one_everywhere():
    cited = (ROOT / ".github" / "CITATION.cff").read_text()
    assert f"version: {PROJECT['version']}\n" in cited and PROJECT["version"] == modalax.__version__


@pytest.mark.slow
def test_the_first_example_in_python_runs():
    """As it stands, in a fresh interpreter; it prints five modes with standard deviations."""
    code = re.findall(r"^```python\n(.*?)^```$", README, re.M | re.S)[0]
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    modes = re.findall(r"^ +\d +(\d+\.\d+) ± (\d\.\d+) +(\d\.\d+) ± (\d\.\d+) +[01]\.\d{3}$", done.stdout, re.M)
    assert len(modes) == 5 and 25 < float(modes[0][0]) < 27 and 1.5 < float(modes[0][2]) < 2.5, done.stdout
