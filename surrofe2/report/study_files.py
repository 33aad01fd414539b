"""The files of a study: NAME.png, NAME.csv, NAME.json, NAME.md."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from surrofe2.io.files import is_there, write_json, write_text
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.figures import write_figure
from surrofe2.report.study import Study

SUFFIXES = ("png", "csv", "json", "md")


def study_is_there(
    out: Path, name: str, cell: CellParameters, preset: str, asked: Mapping[str, Any]
) -> bool:
    """Whether the study's numbers are there, computed of this cell as asked.

    Raises:
        MismatchError: they are there, by other settings.
    """
    return is_there(out / f"{name}.json", _identity(cell, preset, asked))


def study_paths(out: Path, name: str) -> list[Path]:
    """The files of a study that are there."""
    paths = [out / f"{name}.{suffix}" for suffix in SUFFIXES]
    return [path for path in paths if path.exists()]


def write_study(
    out: Path,
    study: Study,
    cell: CellParameters,
    preset: str,
    asked: Mapping[str, Any] = MappingProxyType({}),
) -> list[Path]:
    """Write figure, table and numbers of a study into `out`; their paths.

    The table for people is written where the study has one; the numbers come last.
    """
    paths = [out / f"{study.name}.{suffix}" for suffix in SUFFIXES]
    if study.shown:
        write_text(paths[3], to_markdown(study))
    write_text(paths[1], to_csv(study))
    write_figure(paths[0], study)
    write_json(paths[2], to_record(study, cell, preset) | _identity(cell, preset, asked))
    return paths if study.shown else paths[:3]


def _identity(cell: CellParameters, preset: str, asked: Mapping[str, Any]) -> dict[str, Any]:
    """What the numbers of a study depend on."""
    known = {"version": version("surrofe2"), "preset": preset, "cell": cell.to_dict()}
    return {**known, "asked": asked}


def to_record(study: Study, cell: CellParameters, preset: str) -> dict[str, Any]:
    """The numbers of a study with all that is needed to compute them again."""
    return {
        "study": study.name,
        "title": " ".join(study.title.split()),
        "version": version("surrofe2"),
        "preset": preset,
        "cell": cell.to_dict(),
        "fingerprint": cell.fingerprint,
        "settings": study.settings,
        "units": {"length": "µm", "time": "µs", "mass": "ng", **study.units},
        "results": study.results,
    }


def to_csv(study: Study) -> str:
    """The table with a heading; an empty field where there is no number."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(study.table)
    for row in zip(*study.table.values(), strict=True):
        writer.writerow([_field(value) for value in row])
    return text.getvalue()


def to_markdown(study: Study) -> str:
    """The table for people, its figures aligned to the right."""
    columns = list(study.shown)
    lines = [columns, [":--", *["--:"] * (len(columns) - 1)]]
    lines += [list(row) for row in zip(*study.shown.values(), strict=True)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _field(value: Any) -> str:
    if isinstance(value, float | np.floating):
        return repr(float(value)) if np.isfinite(value) else ""
    return str(value)
