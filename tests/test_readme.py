"""The README's two commands stand where tools look for them, and name what the package really has."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

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


@pytest.mark.slow
def test_the_first_example_in_python_runs():
    """As it stands, in a fresh interpreter; it prints five frequencies and their standard deviations."""
    code = re.findall(r"^```python\n(.*?)^```$", README, re.M | re.S)[0]
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    numbers = [float(n) for n in re.findall(r"\d+\.\d*(?:e-\d+)?", done.stdout)]
    assert len(numbers) == 10 and 25 < numbers[0] < 27
