"""Tables: from one list of quantities come the columns for console, CSV, JSON and Markdown."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from surrofe2.base.units import number

Row = TypeVar("Row")
NONE = "–"
_ROUNDED, _PLAIN = re.compile(r"\.(\d)g"), (1e-4, 1e7)
"""Formats of so many significant digits, and sizes that are written without an exponent."""


@dataclass(frozen=True, slots=True)
class Quantity(Generic[Row]):
    """One column of a table.

    Attributes:
        name: what it is, in words; in JSON with underscores.
        unit: "" for names, counts and ratios.
        format: of a value for people, as `format` takes it, or a function; None: in files alone.
        read: the value of a row: a number, a text, or None where there is none; not given, rows are
            mappings and have it by its name.
    """

    name: str
    unit: str
    format: str | Callable[[Any], str] | None
    read: Callable[[Row], Any] | None = None

    @property
    def heading(self) -> str:
        """Name and unit."""
        return f"{self.name} ({self.unit})" if self.unit else self.name

    @property
    def key(self) -> str:
        """The name in JSON."""
        return re.sub(r"\W+", "_", self.name).strip("_")

    def get(self, row: Row) -> Any:
        """The value of a row."""
        return self.read(row) if self.read else row.get(self.name)  # type: ignore[attr-defined]

    def text(self, row: Row) -> str:
        """The value of a row for people."""
        value = self.get(row)
        if is_missing(value):
            return NONE
        if callable(self.format):
            return self.format(value)
        rounded = _ROUNDED.fullmatch(self.format or "")
        if rounded and (value == 0.0 or _PLAIN[0] <= abs(value) < _PLAIN[1]):
            return number(value, int(rounded[1]))  # 1470 and not 1.47e+03
        return format(value, self.format or "")


@dataclass(frozen=True, slots=True)
class Table(Generic[Row]):
    """Rows and the quantities that are read off each, so many `names` of the row first."""

    quantities: Sequence[Quantity[Row]]
    rows: Sequence[Row]
    names: int = 1

    def for_people(self) -> tuple[list[str], list[list[str]]]:
        """(headings, texts row by row) of the columns that are shown and have any value."""
        shown = [
            quantity
            for quantity in self.quantities
            if quantity.format is not None
            and not all(is_missing(quantity.get(row)) for row in self.rows)
        ]
        texts = [[quantity.text(row) for quantity in shown] for row in self.rows]
        return [quantity.heading for quantity in shown], texts

    def to_markdown(self) -> str:
        """What people are shown, figures aligned to the right."""
        headings, texts = self.for_people()
        lines = [headings, [":--", *["--:"] * (len(headings) - 1)], *texts]
        return "".join(f"| {' | '.join(line)} |\n" for line in lines)

    def to_csv(self) -> str:
        """All quantities; an empty field where there is no value."""
        rows = ([quantity.get(row) for quantity in self.quantities] for row in self.rows)
        return to_csv([quantity.heading for quantity in self.quantities], rows)

    def to_records(self) -> list[dict[str, Any]]:
        """Each row by the keys of the quantities, for JSON."""
        return [
            {quantity.key: quantity.get(row) for quantity in self.quantities} for row in self.rows
        ]

    @property
    def units(self) -> dict[str, str]:
        """Unit by key, of the quantities that have one."""
        return {quantity.key: quantity.unit for quantity in self.quantities if quantity.unit}


def to_csv(headings: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    """A table with a heading; an empty field where there is no number."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(headings)
    for row in rows:
        writer.writerow(["" if is_missing(v) or v in (np.inf, -np.inf) else v for v in row])
    return text.getvalue()


def is_missing(value: Any) -> bool:
    """Whether there is no value: None or not a number."""
    return value is None or (isinstance(value, float | np.floating) and bool(np.isnan(value)))


def percent(digits: int) -> Callable[[float], str]:
    """A format of fractions: percent(2)(0.123) is "12 %"; rounding errors are "0 %"."""

    def text(fraction: float) -> str:
        if 1e-12 < abs(fraction) < 1e-7:
            return "< 0.00001 %"
        return f"{number(100.0 * fraction if abs(fraction) > 1e-12 else 0.0, digits)} %"

    return text
