"""Docstrings as numpydoc wants them: sections `Args:` underlined, settings with their fields.

The package's docstrings have Google's sections, which are shorter in the source. numpydoc makes
tables of them.
"""

import inspect
import re
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass

from surrofe2.base.settings import allowed_numbers
from surrofe2.base.units import NONE

SECTIONS = {
    "Args": "Parameters",
    "Attributes": "Attributes",
    "Examples": "Examples",
    "Raises": "Raises",
    "Returns": "Returns",
    "Yields": "Yields",
}
ENTRY = re.compile(r"(\*{0,2}\w[\w, *]*): (.*)")


def numpy_sections(lines: list[str], result: str = "result") -> list[str]:
    """Docstring lines with underlined sections instead of indented ones.

    `result` is the type of what is returned, which numpydoc prints above its meaning.
    """
    made: list[str] = []
    at = 0
    while at < len(lines):
        title = lines[at].rstrip().removesuffix(":")
        if lines[at].rstrip() != f"{title}:" or title not in SECTIONS:
            made.append(lines[at])
            at += 1
            continue
        at += 1
        block = []
        while at < len(lines) and (not lines[at].strip() or lines[at].startswith("    ")):
            block.append(lines[at][4:].rstrip())
            at += 1
        name = SECTIONS[title]
        made += ["", name, "-" * len(name)]
        if name == "Examples":
            made += block
        elif name in ("Returns", "Yields"):
            made += [result, *(f"    {line}" for line in with_parts(block))]
        else:
            made += entries(block)
        made.append("")
    return made


def with_parts(block: list[str]) -> list[str]:
    """What is returned: a text, and after a blank line its parts, where they have names."""
    end = block.index("") if "" in block else len(block)
    parts = block[end + 1 :]
    if any(ENTRY.fullmatch(line) for line in parts):
        return [*block[: end + 1], *entries(parts)]
    return block


def entries(block: list[str]) -> list[str]:
    """Entries `name: text` as a line with the name and indented text below it."""
    made = []
    for line in block:
        found = None if line.startswith(" ") else ENTRY.fullmatch(line)
        if found:
            made += [found[1], f"    {found[2]}"]
        else:
            made.append(f"    {line.strip()}" if line.strip() else "")
    return made


def fields_of(kind: type) -> list[str]:
    """A section of parameters from what the settings say of themselves."""
    made = []
    for item in fields(kind):
        about = item.metadata.get("about")
        if not about:
            continue
        bounds = allowed(item)
        unit = item.metadata.get("unit") or ""
        default = "" if item.default is MISSING else f", default {item.default!r}"
        notes = "; ".join(part for part in (unit if unit != NONE else "", bounds) if part)
        made += [f"{item.name} : {type_of(item)}{default}".rstrip(), f"    {without_bars(about)}"]
        if notes:
            made[-1] += f" ({notes})"
    return ["", "Parameters", "----------", *made, ""] if made else []


def type_of(item) -> str:
    """The annotation in words."""
    return (
        item.type if isinstance(item.type, str) else getattr(item.type, "__name__", str(item.type))
    )


def allowed(item) -> str:
    """Bounds of a number, or the texts that are allowed."""
    given: Mapping = item.metadata
    if given.get("one_of"):
        return "one of " + ", ".join(given["one_of"])
    if any(key in given for key in ("least", "most", "above", "below")):
        return allowed_numbers(float, given).removesuffix(" and finite")
    return ""


def without_bars(line: str) -> str:
    """A line whose bars stand for moduli, not for substitutions."""
    parts = line.split("`")
    return "`".join(part if k % 2 else part.replace("|", "\\|") for k, part in enumerate(parts))


def result_of(obj) -> str:
    """The annotation of what a function returns, as the source has it."""
    annotations = getattr(getattr(obj, "fget", obj), "__annotations__", {})
    return str(annotations.get("return", "result")).replace("|", "or")


def process(app, what, name, obj, options, lines):
    """Before numpydoc reads them."""
    told = numpy_sections([without_bars(line) for line in lines], result_of(obj))
    if inspect.isclass(obj) and is_dataclass(obj) and "Parameters" not in told:
        told += fields_of(obj)
    lines[:] = told


def setup(app):
    """What Sphinx calls."""
    app.connect("autodoc-process-docstring", process, priority=100)
    return {"parallel_read_safe": True}
