"""Tables of numbers in CSV files."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from surrofe2.errors import FileError, shortened
from surrofe2.io.files import read_bytes, write_text


def write_columns(path: Path, header: list[str], columns: list[np.ndarray]) -> None:
    """Write columns (m,) and their names."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(header)
    table.writerows([repr(float(value)) for value in row] for row in zip(*columns, strict=True))
    write_text(path, text.getvalue())


def read_columns(path: Path) -> tuple[list[str], np.ndarray]:
    """Names of columns and (m, columns) numbers.

    Raises:
        FileError: missing or damaged.
    """
    content = read_bytes(path)
    names: list[str] = []
    try:
        names, *rows = csv.reader(content.decode().splitlines() or [""])
        table = np.array([[float(entry) for entry in row] for row in rows])
        return names, table.reshape(len(rows), len(names))
    except (ValueError, csv.Error):
        told = shortened(",".join(names[:3]), 80)
        raise FileError(f"{path}: not a table of {told or 'names and numbers'}") from None
