"""HDF5 files that are whole or absent and prove themselves; they are made and read in memory."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import h5py
import numpy as np

from surrofe2.errors import FileError, Surrofe2Error
from surrofe2.io.files import read_bytes, write_bytes
from surrofe2.io.seal import NO_DIGEST, SEAL, check_seal, sealed
from surrofe2.units import NONE

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
CHECKPOINT = "surrofe2-checkpoint"


@contextmanager
def writing_hdf5(path: Path) -> Iterator[h5py.File]:
    """A file in memory, which is written when the block ends well."""
    with h5py.File(path.name, "w", driver="core", backing_store=False) as file:
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
        with h5py.File(BytesIO(content), "r") as file:
            yield file
    except Surrofe2Error:
        raise
    except (OSError, RuntimeError) as error:
        raise FileError(f"{path}: cannot be read as HDF5: {str(error)[:80]}") from None


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
        if file.attrs["of"] != of:
            raise FileError(f"{path}: a checkpoint of {file.attrs['of']}, not of {of}")
        found: dict[str, np.ndarray] = {}

        def collect(name: str, item: object) -> None:
            if isinstance(item, h5py.Dataset):
                found[name] = np.asarray(item[()])

        file.visititems(collect)
    return found
