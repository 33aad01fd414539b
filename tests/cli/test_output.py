"""What commands print: lines, tables, or nothing."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

from surrofe2.cli import app
from surrofe2.cli import console as shown
from surrofe2.report.tables import Quantity, Table


def test_quiet_says_nothing_but_errors(invoke, recipe_path, tmp_path):
    command = ("run", recipe_path, "--law", "rve", "--quiet", "--out", tmp_path / "a")
    done = invoke(*command)
    assert (done.exit_code, done.output) == (0, "")
    refused = invoke(*command, "--initialisation", "elastic")
    assert refused.exit_code == 1
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


def test_completion_knows_commands_and_their_options():
    def complete(words):
        environment = {
            "_SURROFE2_COMPLETE": "complete_bash",
            "COMP_WORDS": words,
            "COMP_CWORD": str(len(words.split(" ")) - 1),
        }
        done = CliRunner().invoke(app, [], prog_name="surrofe2", env=environment)
        return done.output.split()

    assert {"generate", "run", "compare"} <= set(complete("surrofe2 "))
    assert "--integrator" in complete("surrofe2 run --in")
