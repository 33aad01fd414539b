"""The command line: parse, call a workflow, print what came of it.

output (what is printed), progress and console (shared options) serve all commands: new, check,
generate, train, run, rest, tissue, compare, study, grid, zoom, moduli and export.

`GROUPS` names the commands. The module of a command has its name, or stands in `MODULES`; it is
imported when the command is called. `surrofe2 --help` takes the first line and the example of each
command from the source of its module, so it imports nothing heavy.
"""

from __future__ import annotations

import ast
import atexit
import errno
import gc
import logging
import shlex
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup, TyperOption

from surrofe2.base.errors import Surrofe2Error, shortened
from surrofe2.base.interruption import begin_work, end_work, exit_code
from surrofe2.cli import output
from surrofe2.cli.console import InterruptedWork
from surrofe2.cli.output import leave, note_errors

GROUPS = {
    "Study": (
        "new", "check", "study", "generate", "train", "run", "refine", "tissue", "grid",
    ),
    "Look": ("compare", "report", "zoom", "export"),
    "Physics": ("rest", "modes", "moduli"),
}  # fmt: skip
"""Commands by their group in help, in its order."""
COMMANDS = {name: group for group, names in GROUPS.items() for name in names}

MODULES = {"refine": "train", "modes": "rest", "report": "compare"}

_HELP = """
FE² for plant tissue, true or through a learnt stress cache.

A study is one TOML recipe, which all commands take. Called again, a command keeps what is finished
and resumes what was interrupted; [bold]--fresh[/bold] starts over.

Units: micrometre, microsecond, nanogram; so force is µN, 2D stress µN/µm, Ḟ 1/µs.
"""


class Commands(TyperGroup):
    """Commands from `COMMANDS`, each of which ends with one line instead of a traceback."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Their names in the order of help."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """A command as help shows it, without its module."""
        if cmd_name not in COMMANDS:
            return None
        docstring = _docstring(cmd_name)
        example = docstring.partition("Example: [bold]")[2].partition("[/bold]")[0]
        summary = f"{docstring.splitlines()[0]}\n[dim]{' '.join(example.split())}[/dim]"
        return TyperCommand(
            cmd_name, help=summary, short_help=summary, rich_help_panel=COMMANDS[cmd_name]
        )

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command that is called, from its module."""
        name, shown, rest = super().resolve_command(ctx, args)
        if name is None or shown is None:
            return name, shown, rest
        function = getattr(import_module(f"surrofe2.cli.{MODULES.get(name, name)}"), name)
        if isinstance(function, typer.Typer):
            command: Any = typer.main.get_command(function)
        else:
            single = typer.Typer(rich_markup_mode="rich", add_completion=False)
            single.command(name, help=_flowing(function.__doc__))(function)
            command = typer.main.get_command(single)
        command.name = name
        command.params += _shared_options(command, ctx)
        begin_work()
        return name, command, rest

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Take the options of all commands wherever they stand, before or after the command."""
        shared = [entry for entry in args if entry in SHARED]
        args = [*shared, *(entry for entry in args if entry not in SHARED)]
        ctx.meta["arguments"] = list(args)
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run the chosen command and turn known failures into an exit code."""
        try:
            return super().invoke(ctx)
        except Surrofe2Error as error:
            if ctx.params.get("traceback"):
                raise
            raise _ended(f"error: {error}", 1) from None
        except OSError as error:
            if error.errno != errno.ENAMETOOLONG:
                raise
            message = shortened(f"{error.filename}: {error.strerror}")
            raise _ended(f"error: {message}", 1) from None
        except InterruptedWork as work:
            message = f"interrupted: {work}; go on with: {_again(ctx, work.has_begun)}"
            raise _ended(message, exit_code()) from None
        except KeyboardInterrupt:
            message = "interrupted: nothing was changed"
            raise _ended(message, exit_code()) from None


def _docstring(command: str) -> str:
    """The docstring of a command, without importing its module."""
    source = Path(__file__).with_name(f"{MODULES.get(command, command)}.py")
    functions = ast.parse(source.read_text(encoding="utf-8")).body
    (function,) = (f for f in functions if isinstance(f, ast.FunctionDef) and f.name == command)
    return ast.get_docstring(function) or ""


def _ended(message: str, code: int) -> typer.Exit:
    """Say how a command ended that did not finish."""
    output.print_warning(message)
    return typer.Exit(code)


def _again(ctx: Any, has_begun: bool) -> str:
    """The command that resumes this one."""
    arguments = ctx.meta["arguments"]
    return shlex.join(["surrofe2", *(a for a in arguments if a != "--fresh" or not has_begun)])


def _flowing(docstring: str | None) -> str:
    """A docstring whose paragraphs flow to the width of the terminal."""
    paragraphs = (docstring or "").split("\n\n")
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)


app = typer.Typer(
    cls=Commands,
    help=_flowing(_HELP),
    rich_markup_mode="rich",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"surrofe2 {version('surrofe2')}")
        raise typer.Exit


SHARED = {
    "--quiet": "Say nothing but warnings and errors.",
    "--traceback": "Show where an error came from, not only its sentence.",
}
"""Options of all commands, which the group takes before a command sees them."""
Quiet = Annotated[bool, typer.Option("--quiet", help=SHARED["--quiet"])]
Traceback = Annotated[
    bool, typer.Option("--traceback", envvar="SURROFE2_TRACEBACK", help=SHARED["--traceback"])
]


def _shared_options(command: Any, ctx: Any) -> list[TyperOption]:
    """Those options for the help and the completion of a command, and of what it consists of."""
    for name in command.list_commands(ctx) if isinstance(command, TyperGroup) else ():
        inner = command.get_command(ctx, name)
        inner.params += _shared_options(inner, ctx)
    return [
        TyperOption(
            param_decls=[name], is_flag=True, expose_value=False, help=line,
            rich_help_panel="Options of all commands",
        )
        for name, line in SHARED.items()
    ]  # fmt: skip


@app.callback()
def options(
    ctx: typer.Context,
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Say the version."),
    ] = False,
    quiet: Quiet = False,
    traceback: Traceback = False,
) -> None:
    """Options before the command."""
    output.begin(ctx.invoked_subcommand or "", quiet=quiet)
    package = logging.getLogger("surrofe2")
    if not package.handlers:
        package.addHandler(output.PrintHandler())
        logging.getLogger("surrofe2.store").setLevel(logging.INFO)


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
