"""The command line: parse, call a workflow, print what came of it.

`COMMANDS` names each command with its line of help. The module of a command has its name, or stands
in `MODULES`; it is imported when the command is called, so `surrofe2 --help` imports nothing heavy.
"""

from __future__ import annotations

import atexit
import errno
import gc
import logging
import shlex
from importlib import import_module
from importlib.metadata import version
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from surrofe2.cli.console import InterruptedWork, PrintHandler, print_error
from surrofe2.cli.streams import leave, note_errors
from surrofe2.errors import Surrofe2Error, shortened
from surrofe2.interruption import begin_work, end_work, exit_code

COMMANDS = {
    "study": "All of a recipe: what is missing of data set, training, runs and comparison.",
    "range": "Propose the range of (F, Ḟ) that the recipe's problem needs, by a dry run.",
    "generate": "Compute plant-cell stresses over a range of (F, Ḟ) into a data set.",
    "train": "Fit a surrogate of the plant-cell stress to the recipe's data set.",
    "export": "A surrogate as C source, for other programs.",
    "run": "Run the recipe's load case by true, learnt or cached stresses.",
    "refine": "Teach the surrogate what the recipe's own run meets.",
    "tissue": "Run the recipe's load case on all particles of the tissue.",
    "compare": "Compare displacement curves and costs of runs of one load case.",
    "grid": "Run the recipe with all combinations of values: a parameter study.",
    "zoom": "Look into the plant cells of a run: the RVE at a point over time.",
    "rest": "Find the tissue at rest under the recipe's loads.",
    "modes": "Period and damping of the bar's small oscillations.",
    "demo": "The bending bar by true and by cached FE²: all steps and their comparison.",
    "reproduce": "A figure of the paper, its data as CSV and its numbers as JSON.",
    "moduli": "Elastic and viscous moduli of a plant cell at rest.",
    "memory": "Whether a cache on (F, Ḟ) is sound: does stress depend on the past?",
    "table": "Show and merge the tables that runs by --law table leave behind.",
}

MODULES = {"refine": "train"}

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
[bold]surrofe2 zoom out/cached --point X,Y[/bold]
  the plant cells at a point over time: picture, animation, table, particles
[bold]surrofe2 grid RECIPE --set cell.wall_stiffness=3000:5000:8[/bold]
  a parameter study: the recipe with other entries, one table and one picture

Called again, a command keeps what is finished and goes on with what was interrupted;
[bold]--fresh[/bold] starts over. [bold]surrofe2 study RECIPE[/bold] does the main steps in one go.

Units: micrometre, microsecond, nanogram; so force is µN, 2D stress µN/µm, Ḟ 1/µs.
"""


class Commands(TyperGroup):
    """Commands from `COMMANDS`, each of which ends with one line instead of a traceback."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Their names in the order of help."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """A command as help shows it, without its module."""
        line = COMMANDS.get(cmd_name)
        return None if line is None else TyperCommand(cmd_name, help=line)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command that is called, from its module."""
        name, shown, rest = super().resolve_command(ctx, args)
        if name is None or shown is None:
            return name, shown, rest
        found = getattr(import_module(f"surrofe2.cli.{MODULES.get(name, name)}"), name)
        if isinstance(found, typer.Typer):
            command: Any = typer.main.get_command(found)
        else:
            single = typer.Typer(rich_markup_mode="rich", add_completion=False)
            single.command(name, help=_flowing(found.__doc__))(found)
            command = typer.main.get_command(single)
        command.name = name
        begin_work()
        return name, command, rest

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Take --traceback wherever it stands, before or after the command."""
        if "--traceback" in args:
            args = ["--traceback", *(entry for entry in args if entry != "--traceback")]
        ctx.meta["arguments"] = list(args)
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run the chosen command and turn known failures into an exit code."""
        try:
            return super().invoke(ctx)
        except Surrofe2Error as error:
            if ctx.params.get("traceback"):
                raise
            print_error(f"error: {error}")
            raise typer.Exit(1) from None
        except OSError as error:
            if error.errno != errno.ENAMETOOLONG:
                raise
            print_error(f"error: {shortened(f'{error.filename}: {error.strerror}')}")
            raise typer.Exit(1) from None
        except InterruptedWork as work:
            print_error(f"interrupted: {work}; go on with: {_again(ctx, work.has_begun)}")
            raise typer.Exit(exit_code()) from None
        except KeyboardInterrupt:
            print_error("interrupted: nothing was changed")
            raise typer.Exit(exit_code()) from None


def _again(ctx: Any, has_begun: bool) -> str:
    """The command that goes on where this one was interrupted."""
    arguments = ctx.meta["arguments"]
    return shlex.join(["surrofe2", *(a for a in arguments if a != "--fresh" or not has_begun)])


def _flowing(docstring: str | None) -> str:
    """A docstring whose paragraphs flow to the width of the terminal."""
    paragraphs = (docstring or "").split("\n\n")
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)


app = typer.Typer(
    cls=Commands,
    help=_HELP,
    rich_markup_mode="rich",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _show_version(wanted: bool) -> None:
    if wanted:
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
    package = logging.getLogger("surrofe2")
    if not package.handlers:
        package.addHandler(PrintHandler())
        logging.getLogger("surrofe2.workflow").setLevel(logging.INFO)


def main() -> None:
    """Run the command line.

    Libraries and kernels are a million objects that stay: to look for garbage among them over and
    over, and to take them apart at the end, would take a tenth of a short command.
    """
    gc.set_threshold(500_000)
    code: list[Any] = [1]
    atexit.register(lambda: leave(code[0] or 0))  # the first to register is the last to be called
    note_errors()
    try:
        app()
    except SystemExit as end:
        code[0] = end.code
        raise
    finally:
        end_work()
