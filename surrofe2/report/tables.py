"""Tables: from one list of quantities come the columns for console, CSV, JSON and Markdown."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from surrofe2.base.errors import quoted
from surrofe2.base.settings import unknown
from surrofe2.base.units import number

Row = TypeVar("Row")
NONE = "–"  # instead of a value that is not there
# A format of so many significant digits.
_ROUNDED = re.compile(r"\.(\d)g")
# Sizes from and up to which such a number is written without an exponent: 1470 and not 1.47e+03.
_LEAST_PLAIN = 1e-4
_MOST_PLAIN = 1e7


@dataclass(frozen=True, slots=True)
class Quantity(Generic[Row]):
    """One column of a table.

    Attributes:
        name: name in words; in JSON with underscores.
        unit: "" for names, counts and ratios.
        format: format of a value for people, as `format` takes it, or a function; None: the column
            is in files alone.
        read: returns the value of a row: a number, a text, or None where there is none. Without it
            rows are mappings and have the value by the column's name.
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
        """Return the value of a row."""
        return self.read(row) if self.read else row.get(self.name)  # type: ignore[attr-defined]

    def text(self, row: Row) -> str:
        """Return the value of a row for people."""
        value = self.get(row)
        if is_missing(value):
            return NONE
        if callable(self.format):
            return self.format(value)
        rounded = _ROUNDED.fullmatch(self.format or "")
        if rounded and (value == 0.0 or _LEAST_PLAIN <= abs(value) < _MOST_PLAIN):
            return number(value, int(rounded[1]))
        return format(value, self.format or "")


@dataclass(frozen=True, slots=True)
class Table(Generic[Row]):
    """Rows and the quantities that are read from each.

    Attributes:
        names: number of the first columns that name the row.
    """

    quantities: Sequence[Quantity[Row]]
    rows: Sequence[Row]
    names: int = 1

    def for_people(self) -> tuple[list[str], list[list[str]]]:
        """Return (headings, texts row by row) of the columns that are shown and have any value."""
        shown = [
            quantity
            for quantity in self.quantities
            if quantity.format is not None
            and not all(is_missing(quantity.get(row)) for row in self.rows)
        ]
        texts = [[quantity.text(row) for quantity in shown] for row in self.rows]
        return [quantity.heading for quantity in shown], texts

    def to_markdown(self) -> str:
        """Return the table for people in Markdown, with figures aligned to the right."""
        headings, texts = self.for_people()
        lines = [headings, [":--", *["--:"] * (len(headings) - 1)], *texts]
        return "".join(f"| {' | '.join(line)} |\n" for line in lines)

    def to_csv(self) -> str:
        """Return all quantities as CSV; a field is empty where there is no value."""
        rows = ([quantity.get(row) for quantity in self.quantities] for row in self.rows)
        return to_csv([quantity.heading for quantity in self.quantities], rows)

    def to_records(self) -> list[dict[str, Any]]:
        """Return each row by the keys of the quantities, for JSON."""
        return [
            {quantity.key: quantity.get(row) for quantity in self.quantities} for row in self.rows
        ]

    @property
    def units(self) -> dict[str, str]:
        """Unit by key, of the quantities that have one."""
        return {quantity.key: quantity.unit for quantity in self.quantities if quantity.unit}


def to_csv(headings: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    """Return a table with headings as CSV; a field is empty where there is no finite number."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(headings)
    for row in rows:
        fields = []
        for value in row:
            is_empty = is_missing(value) or value in (np.inf, -np.inf)
            fields.append("" if is_empty else value)
        writer.writerow(fields)
    return text.getvalue()


def is_missing(value: Any) -> bool:
    """Return whether there is no value: None or not a number."""
    return value is None or (isinstance(value, float | np.floating) and bool(np.isnan(value)))


def percent(digits: int) -> Callable[[float], str]:
    """Make a format of fractions: percent(2)(0.123) is "12 %"; rounding errors are "0 %"."""

    def text(fraction: float) -> str:
        """Write a fraction as a percentage."""
        # digits of anything smaller would be noise: of a solver, or below 1e-12 of rounding
        if 1e-12 < abs(fraction) < 1e-7:
            return "< 0.00001 %"
        percents = 100.0 * fraction if abs(fraction) > 1e-12 else 0.0  # below, it is rounding
        return f"{number(percents, digits)} %"

    return text


# Formats of pictures, by the ends of their names.
PICTURE_FORMATS = ("png", "pdf", "svg")


def check_form(form: str) -> None:
    """Reject a format that pictures are not written in.

    Raises:
        InputError: naming those that there are.
    """
    if form not in PICTURE_FORMATS:
        raise unknown(f"format: {quoted(form)}", form, "format of pictures", PICTURE_FORMATS)
