"""The command line: parse, call, write. Only here are laws, macro scale and files wired together.

Modules of the numerics are imported inside the commands, so that `surrofe2 --help` is quick.
"""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from surrofe2.cli.compare import compare
from surrofe2.cli.console import CarefulGroup
from surrofe2.cli.demo import demo
from surrofe2.cli.generate import generate
from surrofe2.cli.memory import memory
from surrofe2.cli.modes import modes
from surrofe2.cli.moduli import moduli
from surrofe2.cli.refine import refine
from surrofe2.cli.reproduce import reproduce
from surrofe2.cli.rest import rest
from surrofe2.cli.run import run
from surrofe2.cli.sweep import sweep
from surrofe2.cli.table import table
from surrofe2.cli.tissue import tissue
from surrofe2.cli.train import train

_HELP = """
FE² for plant tissue, true or through a learnt stress cache.

A study is one TOML recipe; data/bending-bar.toml is one with comments. Its steps:

[bold]surrofe2 generate RECIPE[/bold]
  stresses of plant cells over a range of (F, Ḟ): a data set
[bold]surrofe2 train RECIPE[/bold]
  a surrogate of the stress from the data set
[bold]surrofe2 run RECIPE --law rve --out out/rve[/bold]
  the tissue by true FE²
[bold]surrofe2 run RECIPE --law cached --out out/cached[/bold]
  the same through the surrogate, true where it does not hold
[bold]surrofe2 run RECIPE --law table --out out/table[/bold]
  the same through a table that learns as it goes, without any training
[bold]surrofe2 refine RECIPE[/bold]
  run, harvest what the surrogate did not know and train again, until it knows enough
[bold]surrofe2 tissue RECIPE --out out/tissue[/bold]
  the same with every particle of every plant cell, nothing homogenised
[bold]surrofe2 compare out/rve out/cached --out out/comparison[/bold]
  difference and speed-up
[bold]surrofe2 sweep RECIPE --out out/sweep[/bold]
  what a stress tolerance buys: error, hits and speed over tolerances

[bold]surrofe2 rest[/bold] finds the tissue at rest under its load, [bold]surrofe2 modes[/bold] its
small oscillations. [bold]surrofe2 demo[/bold] does all steps above. [bold]surrofe2
reproduce[/bold] draws the paper's figures; [bold]surrofe2 moduli[/bold] and [bold]surrofe2
memory[/bold] characterise a plant cell.

Units: micrometre, microsecond, nanogram; so force is µN, 2D stress µN/µm, Ḟ 1/µs.
"""


def _flowing(docstring: str | None) -> str:
    """A docstring whose paragraphs flow to the width of the terminal."""
    paragraphs = (docstring or "").split("\n\n")
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)


app = typer.Typer(
    cls=CarefulGroup,
    help=_HELP,
    rich_markup_mode="rich",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _show_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"surrofe2 {version('surrofe2')}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Say the version."),
    ] = False,
    traceback: Annotated[
        bool,
        typer.Option(
            "--traceback",
            envvar="SURROFE2_TRACEBACK",
            help="Show where an error came from, not only its sentence.",
        ),
    ] = False,
) -> None:
    """Options before the command."""


_COMMANDS = (
    generate, train, run, refine, tissue, compare, sweep, rest, modes, demo, reproduce, moduli,
    memory,
)  # fmt: skip
for _command in _COMMANDS:
    app.command(help=_flowing(_command.__doc__))(_command)
app.add_typer(table, name="table")


def main() -> None:
    """Run the command line."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    app()
