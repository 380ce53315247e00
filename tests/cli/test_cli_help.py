"""The help of every command, as a terminal shows it."""

import pytest
import typer

from modalax.cli import app, main

COMMANDS = sorted(typer.main.get_command(app).commands)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_shows_every_word_that_was_written(command, capsys, monkeypatch):
    """Square brackets around a small letter, as in a unit, are markup to the terminal and vanish."""
    monkeypatch.setenv("COLUMNS", "400")
    assert main([command, "--help"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    entry = typer.main.get_command(app).commands[command]
    for option in entry.params:
        text = getattr(option, "help", None)
        assert text and " ".join(text.split()) in shown, option.name
        assert text[0].isupper() or text.startswith(("fixed:", "hits")), text
        assert text.endswith((".", "...", "?")), text
