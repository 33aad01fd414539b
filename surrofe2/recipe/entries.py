"""Entries of a recipe by their dotted names, the values that a text lists for one, and TOML."""

from __future__ import annotations

import hashlib
import json
import re
import tomllib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from surrofe2.base.errors import InputError, quoted
from surrofe2.base.settings import unknown
from surrofe2.base.units import with_micro_sign

# Sections whose entries users name: a name that is not there is a mistake, not a new entry.
_NAMED = ("cells", "conditions", "bodies", "watch")
# FIRST:LAST:COUNT or FIRST:LAST:COUNT:log.
_SPAN = re.compile(r"([^:]+):([^:]+):(\d{1,6})(:log)?")
# A part between two commas. Commas in quotes, brackets and braces do not count.
_PART = re.compile(r"""(?:"[^"]*"|'[^']*'|\[(?:\[[^\]]*\]|[^\]])*\]|\{[^}]*\}|[^,])+""")
# Tables and lists may be nested so deeply.
_DEEPEST = 50
# A key of so many parts, which takes tomllib seconds where there are thousands.
_DOTTED = re.compile(
    rf"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){{{_DEEPEST}}}"""
)
# Characters of a file's name, without its digest and its end.
_LONGEST = 120


def read_toml(text: str) -> dict[str, Any]:
    """Read the tables of a text in TOML.

    Raises:
        ValueError: the text is no TOML, or tables and lists in it are nested more than `_DEEPEST`
            times.
    """
    too_deep = f"tables or lists nested more than {_DEEPEST} times"
    if _DOTTED.search(text):
        raise ValueError(too_deep)
    try:
        table = tomllib.loads(text)
    except RecursionError:
        raise ValueError(too_deep) from None
    # level by level, for recursion would have a limit of its own
    level: list[Any] = [table]
    for _ in range(_DEEPEST):
        next_level: list[Any] = []
        for value in level:
            next_level.extend(_entries_of(value))
        level = next_level
    if level:
        raise ValueError(too_deep)
    return table


def _entries_of(value: Any) -> list[Any]:
    """Return the values in a table or a list; another value has none."""
    if isinstance(value, Mapping):
        return [*value.values()]
    if isinstance(value, list):
        return value
    return []


def with_micro_keys(entry: Any, where: str = "") -> Any:
    """Copy nested tables and lists, with keys spelt with the micro sign, as names are.

    Raises:
        InputError: two keys of a table are then the same.
    """
    if isinstance(entry, list):
        return [with_micro_keys(value, f"{where}[{k}]") for k, value in enumerate(entry)]
    if not isinstance(entry, Mapping):
        return entry
    table: dict[Any, Any] = {}
    for key, value in entry.items():
        name = with_micro_sign(key) if isinstance(key, str) else key
        place = f"{where}.{name}" if where else f"{name}"
        if name in table:
            raise InputError(place, "it is there twice, with Greek mu and with the micro sign")
        table[name] = with_micro_keys(value, place)
    return table


def with_changes(table: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the tables of a recipe with other entries, which are named by dotted names.

    An entry of a list, such as [[conditions]], is named by its number, from 0.

    Raises:
        InputError: a name leads to nothing that a recipe could have.
    """
    changed = with_micro_keys(table)
    for name, value in with_micro_keys(changes).items():
        *way, last = name.split(".")
        if not way or not all((*way, last)):
            raise InputError(f"{quoted(name)}: it must be an entry, such as cell.wall_stiffness")
        parent: Any = changed
        for k, part in enumerate(way):
            where = ".".join(way[: k + 1])
            if isinstance(parent, list):
                parent = _of_list(parent, where, part)
            elif part not in parent and way[0] in _NAMED and k == 1:
                raise unknown(where, part, f"name in [{way[0]}]", parent)
            else:  # a section that the recipe leaves out may be changed, too
                parent = parent.setdefault(part, {})
            if not isinstance(parent, dict | list):
                raise InputError(where, f"{quoted(parent)}; it has no entry {last}")
        if isinstance(parent, list):
            _of_list(parent, name, last)
            parent[int(last)] = value
        else:
            parent[last] = value
    return changed


def _of_list(entries: list[Any], where: str, part: str) -> Any:
    """Return the entry of a list whose number `part` is; `where` names it in errors."""
    if not (part.isdecimal() and int(part) < len(entries)):
        raise InputError(
            where, f"{quoted(part)}; it must be a number from 0 to {len(entries) - 1} of a list"
        )
    return entries[int(part)]


def listed_values(name: str, text: str) -> list[Any]:
    """Read the values that a text lists between commas, each as TOML has it, or a bare word.

    FIRST:LAST:COUNT stands for as many numbers at equal distances, FIRST:LAST:COUNT:log at equal
    ratios.

    Raises:
        InputError: there is no value, one is there twice, or a span is not of numbers.
    """
    parts = _PART.findall(text)
    if ",".join(parts) != text or not text:
        raise InputError(f"{name}: {quoted(text)}; nothing stands between two commas")
    values: list[Any] = []
    for part in parts:
        values.extend(_values(name, part.strip()))
    for k, value in enumerate(values):
        if value in values[:k]:
            raise InputError(f"{name}: {quoted(value)}; it is there twice")
    return values


def _values(name: str, part: str) -> list[Any]:
    """Read one part of a list: a span of numbers, a value of TOML, or else a bare word."""
    span = _SPAN.fullmatch(part)
    if span is not None:
        return _span(name, part, span)
    try:
        return [read_toml(f"value = {part}")["value"]]
    except ValueError:
        return [part]


def _span(name: str, part: str, span: re.Match[str]) -> list[Any]:
    """Return the numbers of a span; whole numbers where none is written with a point."""
    try:
        first = float(span[1])
        last = float(span[2])
    except ValueError:  # the check below has the message
        first = float("nan")
        last = float("nan")
    count = int(span[3])
    is_log = bool(span[4])
    is_finite = np.isfinite([first, last]).all()
    has_ratios = first * last > 0.0
    if not (is_finite and count > 1 and (has_ratios or not is_log)):
        raise InputError(
            f"{name}: {quoted(part)}; it must be FIRST:LAST:COUNT of two numbers and at least 2 "
            "values, or FIRST:LAST:COUNT:log of two numbers of one sign"
        )
    values = np.geomspace(first, last, count) if is_log else np.linspace(first, last, count)
    # 12 digits: 0.1:0.5:5 is to mean 0.3, not 0.30000000000000004
    rounded = [float(f"{value:.12g}") for value in values]
    is_whole = "." not in part and all(value.is_integer() for value in rounded)
    if is_whole:
        return [int(value) for value in rounded]
    return rounded


def name_of_values(changes: Mapping[str, Any], *first: str) -> str:
    """Make a name for files: the texts `first`, then KEY=VALUE of each change, with commas.

    Characters that no file's name should have are replaced, and then a digest of the whole text
    is added, so that different changes have different names.
    """
    settings = [f"{key}={text_of(value)}" for key, value in changes.items()]
    text = ",".join([*first, *settings])
    name = re.sub(r"[^\w.,=+-]+", "_", text.replace('"', ""))[:_LONGEST]
    if name == text:
        return name
    return f"{name}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"


def text_of(value: Any) -> str:
    """Write a value of an entry as text: a whole number without a point."""
    if isinstance(value, str):
        return value
    # from 1e15 on, digits of an integer would claim more than a float has
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e15:
        return str(int(value))
    return json.dumps(value, ensure_ascii=False)


def toml_text(tables: Mapping[str, Any]) -> str:
    """Write nested tables as TOML, which `read_toml` reads back.

    A table that has tables becomes a section, as do those beside it; others stand in one line.
    Entries that are None, and tables without entries, are left out.
    """
    return "".join(_sections(tables, ()))


def _sections(table: Mapping[str, Any], way: tuple[str, ...]) -> Iterator[str]:
    """Write a table and the tables in it, each a section.

    Args:
        way: the names that lead to the table, from the outermost one.
    """
    # either all tables in it are sections or none is, since the order of conditions counts
    has_sections = not way or any(
        isinstance(value, Mapping) and _has_tables(value) for value in table.values()
    )
    plain_entries = {}
    sections = {}
    for name, value in table.items():
        if value is None or value == {}:
            continue
        if has_sections and isinstance(value, Mapping):
            sections[name] = value
        else:
            plain_entries[name] = value
    if way and (plain_entries or not sections):
        yield f"[{'.'.join(_key(name) for name in way)}]\n"
        for name, value in plain_entries.items():
            yield f"{_key(name)} = {_toml_value(value)}\n"
        yield "\n"
    for name, value in sections.items():
        yield from _sections(value, (*way, name))


def _has_tables(table: Mapping[str, Any]) -> bool:
    """Return whether one of the entries of a table is a table."""
    return any(isinstance(value, Mapping) for value in table.values())


def _key(name: str) -> str:
    """Write a key, in quotes where it must be."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _toml_value(name)


def _toml_value(value: Any) -> str:
    """Write a value on one line."""
    if isinstance(value, Mapping):
        entries = []
        for name, entry in value.items():
            if entry is not None:
                entries.append(f"{_key(name)} = {_toml_value(entry)}")
        return f"{{ {', '.join(entries)} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_toml_value, value))}]"
    if value is None:  # a component of a displacement
        return '"free"'
    if isinstance(value, float):
        return repr(value)  # all digits; infinity is inf in both
    # JSON has TOML's integers, booleans and escapes, but for one control character
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
