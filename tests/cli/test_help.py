"""What the command line says without computing anything."""

import runpy
from importlib.metadata import version

import pytest
from typer.testing import CliRunner

from surrofe2.cli import COMMANDS as ALL
from surrofe2.cli import app
from tests.conftest import ROOT

COMMANDS = ("study", "generate", "train", "run", "tissue", "compare")


def test_help_names_workflow_and_units():
    shown = CliRunner().invoke(app, ["--help"])
    assert shown.exit_code == 0
    places = [shown.output.index(f"surrofe2 {command} ") for command in COMMANDS]
    assert places == sorted(places)
    assert "micrometre, microsecond, nanogram" in shown.output


@pytest.mark.parametrize("name", ALL)
def test_help_of_each_command_fits_with_its_example_and_the_options_of_all(name):
    shown = CliRunner().invoke(app, [name, "--help"], env={"COLUMNS": "80"})
    assert shown.exit_code == 0, shown.output
    for words in (f"Example: surrofe2 {name}", "--quiet", "--traceback"):
        assert words in " ".join(shown.output.split())
    assert "\x1b" not in shown.output
    assert max(map(len, shown.output.splitlines())) <= 80


@pytest.mark.parametrize(
    ("command", "section"),
    [("refine", "[cells.NAME]"), ("generate", "[samples]"), ("run", "surrofe2[mpi]")],
)
def test_sections_of_a_recipe_are_no_markup(command, section):
    shown = CliRunner().invoke(app, [command, "--help"], env={"COLUMNS": "100"})
    assert section in shown.output


def test_version():
    shown = CliRunner().invoke(app, ["--version"])
    assert shown.output == f"surrofe2 {version('surrofe2')}\n"


@pytest.mark.parametrize("script", ["data/generate.py", "training/train.py"])
def test_a_script_is_its_command(script, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", [script, "--help"])
    with pytest.raises(SystemExit):
        runpy.run_path(str(ROOT / script), run_name="__main__")
    name = script.split("/")[1].removesuffix(".py")
    assert f"surrofe2 {name} data/bending-bar.toml" in " ".join(capsys.readouterr().out.split())
