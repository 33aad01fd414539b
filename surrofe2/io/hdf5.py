"""HDF5 files that are whole or absent and prove themselves; they are made and read in memory.

An interruption waits meanwhile: HDF5 calls Python, and takes one for an error of its own.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from itertools import count
from pathlib import Path

import h5py
import numpy as np

from surrofe2.errors import FileError, Surrofe2Error, shortened
from surrofe2.interruption import held
from surrofe2.io.files import NO_DIGEST, SEAL, check_seal, read_bytes, sealed, write_bytes
from surrofe2.units import NONE

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
CHECKPOINT = "surrofe2-checkpoint"
Shape = tuple[int | None, ...]
DAMAGED = (
    OSError, RuntimeError, KeyError, TypeError, ValueError, AttributeError, OverflowError,
    MemoryError,
)  # fmt: skip
"""What reading damaged entries of a file raises."""
_numbers = count()


@contextmanager
def writing_hdf5(path: Path) -> Iterator[h5py.File]:
    """A file in memory, which is written when the block ends well."""
    # A name of its own: one whose making was interrupted stays open, and HDF5 makes no second one.
    name = f"{next(_numbers)} {path.name}"
    with held(), h5py.File(name, "w", driver="core", backing_store=False) as file:
        yield file
        file.attrs["sha256"] = f"{SEAL}: {NO_DIGEST}"
        file.flush()
        image = file.id.get_file_image()
    write_bytes(path, sealed(image))


@contextmanager
def reading_hdf5(path: Path) -> Iterator[h5py.File]:
    """A file that was written so; one sentence where it is missing, foreign or damaged.

    Raises:
        FileError: in the block, too, where an entry cannot be read.
    """
    content = read_bytes(path)
    if not content.startswith(_SIGNATURE):
        raise FileError(f"{path}: not an HDF5 file")
    check_seal(path, content)
    try:
        with held(), h5py.File(BytesIO(content), "r") as file:
            yield file
    except Surrofe2Error:
        raise
    except DAMAGED as error:
        told = shortened(" ".join(str(error).split()), 80)
        raise FileError(f"{path}: cannot be read as HDF5: {told}") from None


def stored_array(file: h5py.File, name: str, shape: Shape, kind: type = np.float64) -> np.ndarray:
    """An array of a file as it must be; None in the shape stands for any length.

    Raises:
        ValueError: it is missing, or of another kind or shape.
    """
    entry = file.get(name)
    if not isinstance(entry, h5py.Dataset):
        raise ValueError(f"{name}: missing")
    whole = len(entry.shape or ()) == len(shape) and entry.nbytes <= file.id.get_filesize()
    if not whole or any(n not in (None, m) for n, m in zip(shape, entry.shape, strict=True)):
        raise ValueError(f"{name}: shape {entry.shape}; it must be {shape}")
    if entry.dtype != np.dtype(kind):
        raise ValueError(f"{name}: {entry.dtype}; it must be {np.dtype(kind)}")
    return np.asarray(entry[()])


def stored_number(file: h5py.File, name: str) -> float:
    """A number among the attributes of a file.

    Raises:
        ValueError: it is missing or not one finite number.
    """
    value = np.asarray(file.attrs.get(name))
    if value.shape or value.dtype.kind not in "iuf" or not np.isfinite(value):
        raise ValueError(f"{name}: missing, or not a finite number")
    return value.item()


@dataclass(frozen=True, slots=True)
class Column:
    """An array of rows: shape of a row, type, unit, and what its codes mean (or one sentence)."""

    shape: tuple[int, ...] = ()
    kind: type = np.float64
    unit: str = NONE
    meaning: Mapping[int, str] | str | None = None


def store_columns(
    file: h5py.File, columns: Mapping[str, Column], rows: Mapping[str, np.ndarray]
) -> None:
    """Write an array (n, …) of each column that has rows, with its unit and meaning."""
    for name, column in columns.items():
        if name not in rows:
            continue
        made = file.create_dataset(name, data=rows[name], dtype=column.kind)
        made.attrs["unit"] = column.unit
        if column.meaning is not None:
            told = column.meaning
            made.attrs["meaning"] = told if isinstance(told, str) else json.dumps(told)


def stored_rows(file: h5py.File, columns: Mapping[str, Column]) -> dict[str, np.ndarray]:
    """The array (n, …) of each column, all of one length.

    Raises:
        ValueError: one is missing, or not what it must be.
    """
    found = {
        name: stored_array(file, name, (None, *column.shape), column.kind)
        for name, column in columns.items()
    }
    for name, values in found.items():
        first = next(iter(found.values()))
        if len(values) != len(first):
            raise ValueError(f"{name}: {len(values)} rows; it must have {len(first)}")
    return found


def write_checkpoint(path: Path, arrays: Mapping[str, np.ndarray], of: str) -> None:
    """Write the arrays of a state; `of` identifies what it is a state of."""
    with writing_hdf5(path) as file:
        file.attrs.update(schema=CHECKPOINT, of=of)
        for name, values in arrays.items():
            file[name] = values


def read_checkpoint(path: Path, of: str) -> dict[str, np.ndarray]:
    """The arrays of a checkpoint of `of`, or a FileError."""
    with reading_hdf5(path) as file:
        if file.attrs.get("schema") != CHECKPOINT:
            raise FileError(f"{path}: an HDF5 file, but not a surrofe2 checkpoint")
        there = file.attrs.get("of")
        if there != of:
            raise FileError(f"{path}: a checkpoint of {shortened(str(there), 60)}, not of {of}")
        found: dict[str, np.ndarray] = {}

        def collect(name: str, item: object) -> None:
            if isinstance(item, h5py.Dataset):
                if item.dtype.kind not in "biuf":
                    raise ValueError(f"{name}: {item.dtype}; it must be numbers")
                found[name] = stored_array(file, name, item.shape, item.dtype)

        file.visititems(collect)
    return found
