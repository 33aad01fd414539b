"""What a study hands over: panels of one figure, one table, its numbers, and their files.

Plain data, so that a study draws nothing and a drawing computes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import InputError
from surrofe2.io.files import is_there, write_json, write_text
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.figures import Panel, write_figure
from surrofe2.report.tables import Table, to_csv


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """A finished study.

    Attributes:
        name: stem of its files.
        title: of the figure, with the preset.
        panels: row by row; `columns` of them in a row.
        table: what people read; also in JSON as "rows".
        series: what the figure draws, column heading with unit to values, all of one length; for
            the CSV, which has the table where there is none.
        results: further numbers for JSON.
    """

    name: str
    title: str
    panels: tuple[Panel, ...]
    columns: int = 1
    table: Table[Any]
    series: Mapping[str, Sequence[Any] | NDArray[np.float64]] = field(default_factory=dict)
    results: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        lengths = {len(column) for column in self.series.values()}
        if len(lengths) > 1:
            raise InputError(f"study {self.name}: columns of {sorted(lengths)} rows; must be one")

    def to_csv(self) -> str:
        """The series, else the table."""
        if not self.series:
            return self.table.to_csv()
        return to_csv(self.series, zip(*self.series.values(), strict=True))

    def to_record(self) -> dict[str, Any]:
        """The numbers with their units."""
        return {
            "study": self.name,
            "title": " ".join(self.title.split()),
            "units": {"length": "µm", "time": "µs", "mass": "ng", **self.table.units},
            "results": {**self.results, "rows": self.table.to_records()},
        }


def study_is_there(
    out: Path, name: str, cell: CellParameters, preset: str, asked: Mapping[str, Any]
) -> bool:
    """Whether the study's numbers are there, computed of this cell as asked.

    Raises:
        MismatchError: they are there, by other settings.
    """
    return is_there(out / f"{name}.json", _identity(cell, preset, asked))


def study_paths(out: Path, name: str) -> list[Path]:
    """The files of a study."""
    return [out / f"{name}.{suffix}" for suffix in ("png", "csv", "md", "json")]


def write_study(
    out: Path, study: Study, cell: CellParameters, preset: str, asked: Mapping[str, Any]
) -> list[Path]:
    """Write figure, series, table and at last the numbers of a study into `out`; the files.

    Args:
        asked: what the study was told besides the cell, for `study_is_there`.
    """
    png, csv, md, json = paths = study_paths(out, study.name)
    write_text(md, study.table.to_markdown())
    write_text(csv, study.to_csv())
    write_figure(png, study.title, study.panels, study.columns)
    write_json(json, study.to_record() | _identity(cell, preset, asked))
    return paths


def _identity(cell: CellParameters, preset: str, asked: Mapping[str, Any]) -> dict[str, Any]:
    """What the numbers of a study depend on."""
    known = {"version": version("surrofe2"), "preset": preset, "cell": cell.to_dict()}
    return {**known, "fingerprint": cell.fingerprint, "asked": asked}
