"""The directive `commands`: every command of surrofe2 with its options, from the command line."""

import re

import typer
from docutils import nodes
from docutils.statemachine import StringList
from sphinx.util.docutils import SphinxDirective

from surrofe2.base.interruption import end_work
from surrofe2.cli import app as command_line

EXAMPLE = re.compile(r"([^\[]*)\[bold\](surrofe2 [^\[]*)\[/bold\]")


def all_commands():
    """(name, command) of each command and of commands within commands."""
    root = typer.main.get_command(command_line)
    context = root.make_context("surrofe2", [], resilient_parsing=True)
    for name in root.list_commands(context):
        _, command, _ = root.resolve_command(context, [name])
        end_work()
        inner = getattr(command, "commands", None)
        if inner:
            yield name, command
            for below, one in inner.items():
                yield f"{name} {below}", one
        else:
            yield name, command


def text_of(name, command) -> list[str]:
    """A command as reStructuredText."""
    arguments = [each for each in command.params if each.param_type_name == "argument"]
    options = [each for each in command.params if each.param_type_name == "option"]
    call = " ".join(["surrofe2", name, *(metavar(each) for each in arguments)])
    lines = [".. code-block:: none", "", f"   {call}{' [OPTIONS]' if options else ''}", ""]
    for paragraph in (command.help or "").split("\n\n"):
        found = EXAMPLE.fullmatch(" ".join(paragraph.split()))
        lines += example(*found.groups()) if found else [escaped(paragraph), ""]
    rows = [
        (", ".join([*each.opts, *each.secondary_opts]), each)
        for each in options
        if not each.hidden and each.name != "help"
    ]
    for flags, each in rows:
        value = "" if each.is_flag else f" {metavar(each)}"
        required = " *Required.*" if each.required else ""
        lines += [f"``{flags}{value}``", f"   {escaped(each.help or '')}{required}", ""]
    return lines


def metavar(parameter) -> str:
    """What stands for a value."""
    choices = getattr(parameter.type, "choices", None)
    if choices:
        return "|".join(str(getattr(each, "value", each)) for each in choices)
    return parameter.metavar or parameter.name.upper()


def escaped(text: str) -> str:
    """A sentence in which nothing is markup."""
    plain = " ".join(text.split()).replace("[bold]", "").replace("[/bold]", "")
    plain = plain.replace("\\[", "[")
    return "".join(f"\\{sign}" if sign in "\\*`|_" else sign for sign in plain)


def example(head: str, call: str) -> list[str]:
    """A command to copy, with the words before it."""
    return [escaped(head), "", ".. code-block:: sh", "", f"   {call}", ""]


class Commands(SphinxDirective):
    """All commands."""

    def run(self) -> list[nodes.Node]:
        """Their nodes."""
        made: list[nodes.Node] = []
        for name, command in all_commands():
            section = nodes.section(ids=[f"command-{name.replace(' ', '-')}"])
            section += nodes.title(name, name)
            lines = text_of(name, command)
            self.state.nested_parse(StringList(lines, source=name), 0, section)
            made.append(section)
        return made


def setup(app):
    """What Sphinx calls."""
    app.add_directive("commands", Commands)
    return {"parallel_read_safe": True}
