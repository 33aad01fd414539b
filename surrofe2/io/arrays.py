"""Arrays in HDF5: checkpoints, written whole, and tables that are filled row by row.

Such a table can be continued after a kill at any moment. Every array has a fixed place in the file,
and a counter says how many rows count. Rows are flushed before the counter that covers them. Full
arrays are copied into a file with more room, which then takes the old one's place.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from surrofe2.errors import FileError
from surrofe2.io.files import opened_hdf5, replacing, reported
from surrofe2.units import NONE

CHECKPOINT = "surrofe2-checkpoint"


def write_checkpoint(path: Path, arrays: Mapping[str, np.ndarray], of: str) -> None:
    """Write the arrays of a state; `of` identifies what it is a state of."""
    with replacing(path) as partial, h5py.File(partial, "w") as file:
        file.attrs.update(schema=CHECKPOINT, of=of)
        for name, values in arrays.items():
            file[name] = values


def read_checkpoint(path: Path, of: str) -> dict[str, np.ndarray]:
    """The arrays of a checkpoint of `of`, or a FileError."""
    with opened_hdf5(path, "r") as file:
        if file.attrs.get("schema") != CHECKPOINT:
            raise FileError(f"{path}: an HDF5 file, but not a surrofe2 checkpoint")
        if file.attrs["of"] != of:
            raise FileError(f"{path}: a checkpoint of {file.attrs['of']}, not of {of}")
        found: dict[str, np.ndarray] = {}

        def collect(name: str, item: object) -> None:
            if isinstance(item, h5py.Dataset):
                found[name] = np.asarray(item[()])

        file.visititems(collect)
    return found


@dataclass(frozen=True, slots=True)
class Column:
    """An array: shape of a row, type, unit, and what its codes mean (or one sentence)."""

    shape: tuple[int, ...] = ()
    kind: type = np.float64
    unit: str = NONE
    meaning: Mapping[int, str] | str | None = None


def create_arrays(
    path: Path,
    columns: Mapping[str, Column],
    room: int,
    attributes: Mapping[str, Any],
    fixed: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Lay out arrays without rows, and arrays that stay as they are, whole or not at all."""
    with replacing(path) as partial, h5py.File(partial, "w") as file:
        for name, column in columns.items():
            made = _lay_out(file, name, (room, *column.shape), column.kind)
            made.attrs["unit"] = column.unit
            if column.meaning is not None:
                told = column.meaning
                made.attrs["meaning"] = told if isinstance(told, str) else json.dumps(told)
        for name, values in (fixed or {}).items():
            file[name] = values
        file["completed"] = np.int64(0)
        file.attrs.update(attributes)


def completed(file: h5py.File) -> int:
    """How many rows are safely in the file."""
    return int(file["completed"][()])


def append_rows(path: Path, file: h5py.File, rows: Mapping[str, np.ndarray]) -> None:
    """Write the next rows of each array, then count them."""
    begin = completed(file)
    end = begin + len(next(iter(rows.values())))
    with reported(path, "written"):
        for name, values in rows.items():
            file[name][begin:end] = values
        file.flush()
        file["completed"][()] = end
        file.flush()


def grow(path: Path, columns: Mapping[str, Column], room: int) -> None:
    """Give the arrays room for so many rows."""
    with opened_hdf5(path, "r") as old:
        rows = {name: old[name][: completed(old)] for name in columns}
        attributes = dict(old.attrs)
    with replacing(path) as partial:
        create_arrays(partial, columns, room, attributes)
        with h5py.File(partial, "r+") as new:
            append_rows(partial, new, rows)


def _lay_out(file: h5py.File, name: str, shape: tuple[int, ...], dtype: type) -> h5py.Dataset:
    """A contiguous array whose place in the file is fixed now, so a kill cannot move it."""
    plan = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plan.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    kind = h5py.h5t.py_create(np.dtype(dtype))
    h5py.h5d.create(file.id, name.encode(), kind, h5py.h5s.create_simple(shape), dcpl=plan)
    return file[name]
