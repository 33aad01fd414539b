"""What commands print: help, lines, tables, or nothing."""

import io
import itertools
import re
import runpy
import time
from importlib.metadata import version

import pytest
from rich.console import Console

from surrofe2.cli import COMMANDS as ALL
from surrofe2.cli import console as shown
from surrofe2.report.tables import Quantity, Table
from tests.cli.conftest import call
from tests.conftest import ROOT

COMMANDS = ("study", "generate", "train", "run", "tissue", "compare")


def test_help_names_workflow_and_units():
    told = call("--help").output
    places = [told.index(f"surrofe2 {command} ") for command in COMMANDS]
    assert places == sorted(places)
    assert "micrometre, microsecond, nanogram" in told


@pytest.mark.parametrize("name", ALL)
def test_help_of_each_command_fits_with_its_example_and_the_options_of_all(name):
    told = call(name, "--help", env={"COLUMNS": "80"}).output
    for words in (f"Example: surrofe2 {name}", "--quiet", "--traceback"):
        assert words in " ".join(told.split())
    assert "\x1b" not in told
    assert max(map(len, told.splitlines())) <= 80


@pytest.mark.parametrize(
    ("command", "section"),
    [("refine", "[cells.NAME]"), ("generate", "[samples]"), ("run", "surrofe2[mpi]")],
)
def test_sections_of_a_recipe_are_no_markup(command, section):
    assert section in call(command, "--help").output


def test_version():
    assert call("--version").output == f"surrofe2 {version('surrofe2')}\n"


@pytest.mark.parametrize("script", ["data/generate.py", "training/train.py"])
def test_a_script_is_its_command(script, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", [script, "--help"])
    with pytest.raises(SystemExit):
        runpy.run_path(str(ROOT / script), run_name="__main__")
    name = script.split("/")[1].removesuffix(".py")
    assert f"surrofe2 {name} data/bending-bar.toml" in " ".join(capsys.readouterr().out.split())


def test_quiet_says_nothing_but_errors(invoke, recipe_path, tmp_path):
    command = ("run", recipe_path, "--law", "rve", "--quiet", "--out", tmp_path / "a")
    assert invoke(*command).output == ""
    refused = invoke(*command, "--initialisation", "elastic", code=1)
    assert refused.stdout == ""
    assert refused.stderr.startswith("error: ")


def test_one_command_does_not_quieten_the_next(invoke, recipe_path):
    assert invoke("generate", recipe_path, "--quiet").output == ""
    assert "40 samples" in invoke("generate", recipe_path).stdout


@pytest.mark.parametrize("width", [40, 80, 120])
def test_tables_are_no_wider_than_the_terminal(monkeypatch, capsys, width):
    monkeypatch.setenv("COLUMNS", str(width))
    shown.begin("compare", quiet=False)
    quantities = [Quantity(f"quantity {k}", "µN/µm", ".6g", lambda row: row) for k in range(9)]
    shown.show_table("Numbers", Table(quantities, [1234.56, 0.1]))
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= width
    assert sum(line.count("1234.56") for line in lines) >= 9


def test_progress_in_a_terminal_says_what_how_far_rate_and_time_left(monkeypatch):
    for width in (60, 80, 120):
        file = io.StringIO()
        terminal = Console(file=file, force_terminal=True, width=width, no_color=True)
        monkeypatch.setattr(shown, "Console", lambda terminal=terminal, **_: terminal)
        moments = itertools.count(0.0, 0.6)
        monkeypatch.setattr(shown.time, "perf_counter", lambda moments=moments: next(moments))
        shown.begin("generate", quiet=False)
        with shown.progress("generate", 4096, "samples") as report:
            for done in (512, 1024, 2048):
                report(done, "3 failed")
            time.sleep(0.3)  # until it is drawn
        drawn = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", file.getvalue())
        last = [line for line in re.split(r"[\r\n]+", drawn) if "2,048" in line][-1]
        told = ["50 % 2,048 of 4,096 samples", r"[\d.]+ s left", r"[\d,]+ samples/s", "3 failed"]
        seen = {60: 1, 80: 3, 120: 4}[width]  # the least needed go first
        assert re.search(", ".join(told[:seen]) + "$", last.rstrip()), last
        assert len(last.rstrip()) <= width
        assert "…" not in drawn


def test_progress_elsewhere_is_a_line_now_and_then(monkeypatch, capsys):
    seconds = [0.0]
    monkeypatch.setattr(shown.time, "perf_counter", lambda: seconds[0])
    shown.begin("generate", quiet=False)
    with shown.progress("generate", 100, "samples") as report:
        for k in range(101):
            seconds[0] = 0.4 * k
            report(k, "0 failed")
    told = capsys.readouterr().err.splitlines()
    assert told == [
        "generate: 25 %, 30.0 s left, 2.5 samples/s, 0 failed",
        "generate: 50 %, 20.0 s left, 2.5 samples/s, 0 failed",
        "generate: 75 %, 10.0 s left, 2.5 samples/s, 0 failed",
        "generate: 100 %, 0.0 s left, 2.5 samples/s, 0 failed",
    ]


def test_no_colours_where_none_are_wanted(monkeypatch):
    text = io.StringIO()
    monkeypatch.setattr("sys.stderr", text)
    for wanted, coloured in (({"NO_COLOR": "1"}, False), ({}, True)):
        monkeypatch.delenv("NO_COLOR", raising=False)
        monkeypatch.setenv("FORCE_COLOR", "1")
        for name, value in wanted.items():
            monkeypatch.setenv(name, value)
        text.truncate(0)
        shown.print_warning("error: x")
        assert ("\x1b[31m" in text.getvalue()) == coloured


def test_completion_knows_commands_and_their_options():
    def complete(words):
        place = str(len(words.split(" ")) - 1)
        env = {"_SURROFE2_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": place}
        return call(prog_name="surrofe2", env=env).output.split()

    assert {"generate", "run", "compare"} <= set(complete("surrofe2 "))
    assert "--integrator" in complete("surrofe2 run --in")
