"""Entries of a recipe by their dotted names, and the values that a text lists for one of them."""

from __future__ import annotations

import hashlib
import json
import re
import tomllib
from collections.abc import Mapping
from typing import Any

import numpy as np

from surrofe2.base.errors import InputError, quoted
from surrofe2.base.settings import unknown
from surrofe2.base.units import with_micro_sign

_NAMED = ("cells", "conditions", "bodies", "watch")
"""Sections in which users name what there is."""
_SPAN = re.compile(r"([^:]+):([^:]+):(\d{1,6})(:log)?")
_PART = re.compile(r"""(?:"[^"]*"|'[^']*'|\[(?:\[[^\]]*\]|[^\]])*\]|\{[^}]*\}|[^,])+""")
"""What stands between commas that are in no quotes and brackets."""
_DEEPEST = 50
"""Tables and lists in one another."""
_DOTTED = re.compile(
    rf"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){{{_DEEPEST}}}"""
)
"""A key of so many parts, which takes tomllib seconds where there are thousands."""
_LONGEST = 120
"""Characters of a name of a file, but for its digest and its end."""


def read_toml(text: str) -> dict[str, Any]:
    """The tables of a text in TOML.

    Raises:
        ValueError: it is none, or tables and lists in it are nested more than `_DEEPEST` times.
    """
    too_deep = f"tables or lists nested more than {_DEEPEST} times"
    if _DOTTED.search(text):
        raise ValueError(too_deep)
    try:
        table = tomllib.loads(text)
    except RecursionError:
        raise ValueError(too_deep) from None
    level: list[Any] = [table]
    for _ in range(_DEEPEST):
        level = [entry for each in level for entry in _entries_of(each)]
    if level:
        raise ValueError(too_deep)
    return table


def _entries_of(value: Any) -> list[Any]:
    """What stands in a table or a list; of another value nothing."""
    if isinstance(value, Mapping):
        return [*value.values()]
    return value if isinstance(value, list) else []


def with_micro_keys(entry: Any, where: str = "") -> Any:
    """A copy of nested tables and lists whose keys are spelt with the micro sign, as names are.

    Raises:
        InputError: two keys of a table are then the same.
    """
    if isinstance(entry, list):
        return [with_micro_keys(each, f"{where}[{k}]") for k, each in enumerate(entry)]
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
    """The tables of a recipe with other entries, by their dotted names.

    What stands in a list, as [[conditions]] do, is named by its number, from 0. A name that leads
    to nothing is an InputError."""
    changed = with_micro_keys(table)
    for name, value in with_micro_keys(changes).items():
        *way, last = name.split(".")
        if not way or not all((*way, last)):
            raise InputError(f"{quoted(name)}: it must be an entry, such as cell.wall_stiffness")
        at: Any = changed
        for k, part in enumerate(way):
            where = ".".join(way[: k + 1])
            if isinstance(at, list):
                at = _of_list(at, where, part)
            elif part not in at and way[0] in _NAMED and k == 1:
                raise unknown(where, part, f"name in [{way[0]}]", at)
            else:
                at = at.setdefault(part, {})
            if not isinstance(at, dict | list):
                raise InputError(where, f"{quoted(at)}; it has no entry {last}")
        if isinstance(at, list):
            _of_list(at, name, last)
            at[int(last)] = value
        else:
            at[last] = value
    return changed


def _of_list(entries: list[Any], where: str, part: str) -> Any:
    if not (part.isdecimal() and int(part) < len(entries)):
        raise InputError(
            where, f"{quoted(part)}; it must be a number from 0 to {len(entries) - 1} of a list"
        )
    return entries[int(part)]


def listed_values(name: str, text: str) -> list[Any]:
    """The values that a text lists between commas, each as TOML has it, or a bare word.

    FIRST:LAST:COUNT stands for as many numbers at equal distances, FIRST:LAST:COUNT:log at equal
    ratios.

    Raises:
        InputError: there is none, one is there twice, or a span is not of numbers.
    """
    parts = _PART.findall(text)
    if ",".join(parts) != text or not text:
        raise InputError(f"{name}: {quoted(text)}; nothing stands between two commas")
    values = [value for part in parts for value in _values(name, part.strip())]
    for k, value in enumerate(values):
        if value in values[:k]:
            raise InputError(f"{name}: {quoted(value)}; it is there twice")
    return values


def _values(name: str, part: str) -> list[Any]:
    if span := _SPAN.fullmatch(part):
        return _span(name, part, span)
    try:
        return [read_toml(f"value = {part}")["value"]]
    except ValueError:
        return [part]


def _span(name: str, part: str, span: re.Match[str]) -> list[Any]:
    try:
        first, last = float(span[1]), float(span[2])
    except ValueError:
        first = last = float("nan")
    count, is_log = int(span[3]), bool(span[4])
    if not (np.isfinite([first, last]).all() and count > 1 and (not is_log or first * last > 0.0)):
        raise InputError(
            f"{name}: {quoted(part)}; it must be FIRST:LAST:COUNT of two numbers and at least 2 "
            "values, or FIRST:LAST:COUNT:log of two numbers of one sign"
        )
    values = np.geomspace(first, last, count) if is_log else np.linspace(first, last, count)
    plain = [float(f"{value:.12g}") for value in values]
    whole = "." not in part and all(value.is_integer() for value in plain)
    return [int(value) if whole else value for value in plain]


def name_of_values(changes: Mapping[str, Any], *first: str) -> str:
    """A name for files: KEY=VALUE and so on with commas; what comes `first` begins it.

    What no file should be called is left out, and a digest of all of it tells such names apart.
    """
    plainly = ",".join([*first, *(f"{key}={text_of(changes[key])}" for key in changes)])
    name = re.sub(r"[^\w.,=+-]+", "_", plainly.replace('"', ""))[:_LONGEST]
    if name == plainly:
        return name
    return f"{name}-{hashlib.sha256(plainly.encode()).hexdigest()[:8]}"


def text_of(value: Any) -> str:
    """A value of an entry as people write it; a number that is whole without a point."""
    if isinstance(value, str):
        return value
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e15:
        return str(int(value))
    return json.dumps(value, ensure_ascii=False)
