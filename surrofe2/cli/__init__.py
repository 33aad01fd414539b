"""The command line: parse, call a workflow, print its results.

console (printing, progress, shared options) serves all commands: study (new, check, study, grid),
learn (generate, train, refine, export), run, tissue, rest (and modes), compare, cells (moduli,
cells, zoom).

`COMMANDS` names the commands, their modules and their group in help. A module is imported when its
command is called. `surrofe2 --help` takes the first line and the example of each command from the
source of its module, so it imports nothing heavy. Docstrings of commands are their help, as plain
text: here brackets are escaped, and commands made bold.
"""

from __future__ import annotations

import atexit
import errno
import gc
import logging
import re
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup, TyperOption

from surrofe2.base.environment import LONG_SPIN, SPIN, take_process
from surrofe2.base.errors import InputError, Surrofe2Error, printable, shortened
from surrofe2.base.interruption import begin_work, cause, end_work, exit_code, interruptible
from surrofe2.base.launcher import ALONE, ENOUGH, rank, world_size
from surrofe2.cli import console

# Module and group of each command, in the order of help.
COMMANDS = {
    "new": ("study", "Study"),
    "check": ("study", "Study"),
    "study": ("study", "Study"),
    "generate": ("learn", "Study"),
    "train": ("learn", "Study"),
    "run": ("run", "Study"),
    "refine": ("learn", "Study"),
    "tissue": ("tissue", "Study"),
    "grid": ("study", "Study"),
    "compare": ("compare", "Look"),
    "zoom": ("cells", "Look"),
    "export": ("learn", "Look"),
    "rest": ("rest", "Physics"),
    "modes": ("rest", "Physics"),
    "moduli": ("cells", "Physics"),
    "cells": ("cells", "Physics"),
}

# Commands whose work MPI ranks share.
ON_RANKS = ("run",)

# Options of all commands, which the group takes before a command sees them.
SHARED = {
    "--quiet": "Print nothing but warnings and errors.",
    "--traceback": "Show where an error came from, not only its message.",
}

_USAGE_ERROR: Any = typer.BadParameter.__mro__[1]  # UsageError, which typer does not export

_HELP = """
FE² for plant tissue, in full or through a learnt stress cache.

A study is one TOML recipe, which all commands take. Called again, a command keeps what is finished
and resumes what was interrupted; --fresh starts over.

Units: micrometre, microsecond, nanogram; so force is µN, 2D stress µN/µm, Ḟ 1/µs.
"""


class Commands(TyperGroup):
    """Commands from `COMMANDS`, each of which ends with one line instead of a traceback."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of the commands in the order of help."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command as help shows it, without its module."""
        if cmd_name not in COMMANDS:
            return None
        module, group = COMMANDS[cmd_name]
        source = Path(__file__).with_name(f"{module}.py").read_text(encoding="utf-8")
        docstring = source.partition(f"\ndef {cmd_name}(")[2].split('"""', 2)[1]
        example = docstring.partition("Example: ")[2].partition("\n\n")[0]
        summary = f"{docstring.splitlines()[0]}\n[dim]{' '.join(example.split())}[/dim]"
        return TyperCommand(cmd_name, help=summary, short_help=summary, rich_help_panel=group)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the command that is called, from its module."""
        name, shown, rest = super().resolve_command(ctx, args)
        if name is None or shown is None:
            return name, shown, rest
        _check_ranks(name, rest)
        take_process(LONG_SPIN if name == "tissue" else SPIN)
        function = getattr(import_module(f"surrofe2.cli.{COMMANDS[name][0]}"), name)
        single = typer.Typer(rich_markup_mode="rich", add_completion=False)
        single.command(name, help=_as_help(function.__doc__))(function)
        command: Any = typer.main.get_command(single)
        command.name = name
        for parameter in command.params:
            parameter.help = _escaped(parameter.help or "")
        command.params += [
            TyperOption(
                param_decls=[option],
                is_flag=True,
                expose_value=False,
                help=line,
                rich_help_panel="Options of all commands",
            )
            for option, line in SHARED.items()
        ]
        begin_work()
        return name, command, rest

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Take the options of all commands wherever they stand, before or after the command."""
        shared = [entry for entry in args if entry in SHARED]
        args = [*shared, *(entry for entry in args if entry not in SHARED)]
        ctx.meta["arguments"] = list(args)
        with _printable_usage():
            return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run the chosen command and turn known failures into an exit code."""
        try:
            with interruptible(), _printable_usage():
                return super().invoke(ctx)
        except Surrofe2Error as error:
            if ctx.params.get("traceback"):
                raise
            message = f"error: {error}"
            code = 1
        except OSError as error:
            if error.errno != errno.ENAMETOOLONG:
                raise
            message = f"error: {shortened(f'{error.filename}: {error.strerror}')}"
            code = 1
        except console.InterruptedWork as work:
            kept, has_begun = work.args
            words = [word for word in ctx.meta["arguments"] if word != "--fresh" or not has_begun]
            again = console.command_line(words)
            message = f"{cause()}: {kept}; resume with: {again}"
            code = exit_code()
        except KeyboardInterrupt:
            message = f"{cause()}: nothing was changed"
            code = exit_code()
        console.print_warning(message)
        raise typer.Exit(code)


def _check_ranks(command: str, arguments: Iterable[str]) -> None:
    """Refuse to do the same work several times where a launcher started this process with others.

    Raises:
        InputError: the command does not share its work among ranks. Other ranks than 0 exit.
    """
    if world_size() < 2 or command in ON_RANKS or {"-h", "--help"} & {*arguments}:
        return
    if rank() > 0:
        time.sleep(ENOUGH)  # a launcher may end all ranks with the first that fails
        raise typer.Exit(1)
    raise InputError(
        f"{command}: {world_size()} ranks were started, and only {', '.join(ON_RANKS)} shares its "
        f"work among them; call it without mpiexec or srun, or with {ALONE}=1 in the environment, "
        "which lets each rank work for itself on a recipe and output of its own"
    )


@contextmanager
def _printable_usage() -> Iterator[None]:
    """Escape what arguments hold in the message of an error of usage, which typer prints."""
    try:
        yield
    except _USAGE_ERROR as error:
        error.message = printable(error.message)
        raise


def _as_help(docstring: str | None) -> str:
    """Return a docstring whose paragraphs flow to the width of the terminal, commands in bold."""
    paragraphs = []
    for paragraph in _escaped(docstring or "").split("\n\n"):
        line = " ".join(paragraph.split())
        paragraphs.append(re.sub(r"^(.*: )(surrofe2 .*)$", r"\1[bold]\2[/bold]", line))
    return "\n\n".join(paragraphs)


def _escaped(text: str) -> str:
    """Return a plain text whose brackets rich prints as they are."""
    return text.replace("[", "\\[")


app = typer.Typer(
    cls=Commands,
    help=_as_help(_HELP),
    rich_markup_mode="rich",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _show_version(wanted: bool) -> None:
    """Print the version and end."""
    if wanted:
        typer.echo(f"surrofe2 {version('surrofe2')}")
        raise typer.Exit


def _show_versions(wanted: bool) -> None:
    """Print the versions of all that is used and end."""
    if wanted:
        from surrofe2.base.versions import report_versions  # late: it loads numba

        typer.echo(report_versions())
        raise typer.Exit


@app.callback()
def options(
    ctx: typer.Context,
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version."),
    ] = False,
    versions: Annotated[
        bool,
        typer.Option(
            "--versions",
            callback=_show_versions,
            is_eager=True,
            help="Print the versions of all that is used, the machine and threads: for an issue.",
        ),
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help=SHARED["--quiet"])] = False,
    traceback: Annotated[
        bool, typer.Option("--traceback", envvar="SURROFE2_TRACEBACK", help=SHARED["--traceback"])
    ] = False,
) -> None:
    """Options before the command."""
    console.begin(ctx.invoked_subcommand or "", quiet=quiet)
    package = logging.getLogger("surrofe2")
    if not package.handlers:
        package.addHandler(console.PrintHandler())
        logging.getLogger("surrofe2.store").setLevel(logging.INFO)


def main() -> None:
    """Run the command line.

    Libraries and kernels are a million objects that stay: to look for garbage among them over and
    over, and to take them apart at the end, would take a tenth of a short command.
    """
    gc.set_threshold(500_000)
    code: list[Any] = [1]
    # the first to register is the last to be called
    atexit.register(lambda: console.leave(code[0] or 0))
    console.note_errors()
    try:
        app()
    except SystemExit as end:
        code[0] = end.code
        raise
    finally:
        end_work()
