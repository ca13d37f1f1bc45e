"""Width, title, font and labels of every command that draws figures."""

import re

import pytest
import typer
from commands import call_command

from testbed.cli.main import app

OPTIONS = {"--width", "--no-title", "--font", "--labels"}
FILES = {"--plot", "--figure", "--figures"}  # options that ask for a figure
DRAWING = {
    "law", "margins", "delay", "frequency-response", "network", "air", "report", "compare",
    "study-report", "respond", "check", "new aircraft",
}  # fmt: skip


def test_every_command_that_draws_has_the_options():
    group = typer.main.get_command(app)
    found = {}
    for name, command in group.full_commands():
        options = {option for each in command.params for option in each.opts}
        found[name] = (bool(options & FILES), OPTIONS & options)
    assert {name for name, (draws, _) in found.items() if draws} == DRAWING
    assert all(options == (OPTIONS if draws else set()) for draws, options in found.values())


def test_figure_has_width_font_and_labels(tmp_path):
    """In points, with the letters of the font, and a name of the user's in TeX.

    Without the options they have other letters: see test_command_writes_figures_1_and_2.
    """
    (tmp_path / "labels.yaml").write_text("example 2: Beispiel 2\n'μ(z)': $\\mu(z)$\n")
    words = ("law", "--figures", "g", "--format", "svg", "--labels", "labels.yaml")
    words = (*words, "--width", "3.5", "--no-title", "--font", "STIXGeneral")
    assert call_command(*words, cwd=tmp_path, code=0, columns=100).stderr == ""
    drawn = (tmp_path / "g" / "barriers.svg").read_text("utf-8")
    assert float(re.search(r'width="([\d.]+)pt"', drawn)[1]) == pytest.approx(3.5 * 72, abs=0.5)
    text = (tmp_path / "g" / "control-functions.svg").read_text("utf-8")
    assert "Beispiel 2 -->" in text and "example 2 -->" not in text
    assert "STIX" in text


def test_missing_font_is_an_error_with_those_there(tmp_path):
    words = ("law", "--figures", "f", "--font", "Nonsense Roman")
    error = call_command(*words, cwd=tmp_path, code=2, columns=200).stderr
    assert "--font Nonsense Roman: is not installed" in error and "DejaVu Serif" in error
    assert list(tmp_path.iterdir()) == []
