"""What the command line says without computing anything."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import version

import pytest
from typer.testing import CliRunner

from surrofe2.cli import app

COMMANDS = ("study", "generate", "train", "run", "tissue", "compare")
HEAVY = ("torch", "numba", "skfem", "numpy", "scipy", "h5py", "matplotlib", "pydantic")


def test_nothing_heavy_is_imported_for_help():
    code = f"import sys, surrofe2.cli; print(*[name for name in {HEAVY} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


def test_help_names_workflow_and_units():
    shown = CliRunner().invoke(app, ["--help"])
    assert shown.exit_code == 0
    places = [shown.output.index(f"surrofe2 {command} ") for command in COMMANDS]
    assert places == sorted(places)
    assert "micrometre, microsecond, nanogram" in shown.output


@pytest.mark.parametrize("command", [*COMMANDS, "check"])
@pytest.mark.parametrize("width", ["30", "100"])
def test_help_of_each_command_has_an_example(command, width):
    shown = CliRunner().invoke(app, [command, "--help"], env={"COLUMNS": width})
    assert shown.exit_code == 0
    assert f"Example: surrofe2 {command}" in " ".join(shown.output.split())
    assert "\x1b" not in shown.output


@pytest.mark.parametrize(
    ("command", "section"),
    [("refine", "[cells.NAME]"), ("generate", "[samples]"), ("check", "[range]")],
)
def test_sections_of_a_recipe_are_no_markup(command, section):
    shown = CliRunner().invoke(app, [command, "--help"], env={"COLUMNS": "100"})
    assert section in shown.output


def test_version():
    shown = CliRunner().invoke(app, ["--version"])
    assert shown.output == f"surrofe2 {version('surrofe2')}\n"


@pytest.mark.parametrize("arguments", [["run"], ["generate", "a", "b"], ["nonsense"]])
def test_wrong_usage(arguments):
    assert CliRunner().invoke(app, arguments).exit_code == 2
