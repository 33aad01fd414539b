"""HDF5 files with one header that are whole or absent and prove themselves.

Files are made and read in memory, while an interruption waits: HDF5 calls Python, and takes one
for an error of its own.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import version
from io import BytesIO
from itertools import count
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from surrofe2.base.errors import FileError, MismatchError, Surrofe2Error, quoted, shortened
from surrofe2.base.interruption import held
from surrofe2.base.sampling import SamplingRange
from surrofe2.base.units import NONE
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.store.store import (
    NO_DIGEST,
    SEAL,
    WORD,
    check_seal,
    plain,
    read_bytes,
    sealed,
    write_bytes,
)

Arrays = Mapping[str, NDArray[Any]]
Shape = tuple[int | None, ...]
_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_DAMAGED = (
    OSError, RuntimeError, KeyError, TypeError, ValueError, AttributeError, OverflowError,
    MemoryError, SystemError,
)  # fmt: skip
"""What reading damaged entries of a file raises; the last is h5py's for names not in UTF-8."""
_numbers = count()


@dataclass(frozen=True, slots=True)
class Column:
    """An array of a file: its shape (None: any length), type, unit, and what its codes mean.

    All arrays whose shape begins with None have as many rows. `optional`: it may be missing.
    """

    shape: Shape = (None,)
    kind: type = np.float64
    unit: str = NONE
    meaning: str = ""
    optional: bool = False


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of file: its name, the version of its schema, and its arrays by name.

    `advice`: what to do about a file that cannot be read, at the end of error messages.
    """

    name: str
    version: int
    columns: Mapping[str, Column] = field(default_factory=dict)
    advice: str = ""

    @property
    def schema(self) -> str:
        return f"surrofe2-{self.name.replace(' ', '-')}"

    @property
    def title(self) -> str:
        return f"surrofe2 {self.name}"


ANY = Kind("file", 0)
CHECKPOINT = Kind("checkpoint", 1)


def origin(cell: CellParameters, initialisation: str, **more: Any) -> dict[str, Any]:
    """Entries of a header: of which plant cells, how initialised, the answers in a file are."""
    of_cell = {"cell": cell.to_dict(), "cell_fingerprint": cell.fingerprint}
    return {**more, **of_cell, "initialisation": initialisation}


def write(path: Path, kind: Kind, header: Mapping[str, Any], arrays: Arrays) -> None:
    """Write a file of a kind, whole or not at all: header, and arrays by name; a/b is b in the
    group a."""
    with writing(path, kind, header) as file:
        for name, values in arrays.items():
            store_array(file, name, values)
            if name in kind.columns:
                column = kind.columns[name]
                file[name].attrs["unit"] = column.unit
                if column.meaning:
                    file[name].attrs["meaning"] = column.meaning


@contextmanager
def writing(path: Path, kind: Kind, header: Mapping[str, Any]) -> Iterator[h5py.File]:
    """A file of a kind with its header, in memory; it is written when the block ends well."""
    known = {
        "schema": kind.schema,
        "schema_version": kind.version,
        "package_version": version("surrofe2"),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    # A name of its own: one whose making was interrupted stays open, and HDF5 makes no second one.
    name = f"{next(_numbers)} {path.name}"
    with held(), h5py.File(name, "w", driver="core", backing_store=False) as file:
        for entry, value in (known | dict(header)).items():
            is_plain = isinstance(value, str | int | float | np.generic)
            file.attrs[entry] = value if is_plain else json.dumps(plain(value))
        yield file
        file.attrs["sha256"] = f"{SEAL}: {NO_DIGEST}"
        file.flush()
        image = file.id.get_file_image()
    write_bytes(path, sealed(image))


def store_array(file: h5py.File, name: str, values: NDArray[Any]) -> None:
    """As file[name] = values, in 0.05 ms instead of 0.13: a run stores a thousand of them."""
    values = np.asarray(values)
    links = h5py.h5p.create(h5py.h5p.LINK_CREATE)
    links.set_create_intermediate_group(True)
    kind = h5py.h5t.py_create(values.dtype, logical=True)
    space = h5py.h5s.create_simple(values.shape)
    stored = h5py.h5d.create(file.id, name.encode(), kind, space, None, links)
    stored.write(h5py.h5s.ALL, h5py.h5s.ALL, np.ascontiguousarray(values))


@contextmanager
def reading(path: Path, kind: Kind | None = None) -> Iterator[Stored]:
    """What is in a file of a kind, default: of any; the block takes from it what it needs.

    Raises:
        FileError: missing, foreign, of another schema or version, or an entry is missing or wrong;
            in the block, too.
    """
    of = kind or ANY
    advice = f"; {of.advice}" if of.advice else ""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    content = read_bytes(path, memory // 2, _SIGNATURE)
    try:
        if not content.startswith(_SIGNATURE):
            raise FileError(f"{path}: not an HDF5 file")
        check_seal(path, content)
        with held(), h5py.File(BytesIO(content)) as file:
            stored = Stored(file, of)
            file.visititems_links(_check_link)
            file.visititems(_check_place)
            if kind is not None:
                _check_schema(path, stored)
            yield stored
    except FileError as error:
        if not advice:
            raise
        raise FileError(f"{error}{advice}") from None
    except _DAMAGED as error:
        if isinstance(error, Surrofe2Error) and str(path) in str(error):
            raise
        reason = shortened(" ".join(str(error).split()), 120)
        raise FileError(f"{path}: not a whole {of.title}: {reason}{advice}") from None


def _check_link(name: str, link: object) -> None:
    if not isinstance(link, h5py.HardLink):
        raise ValueError(f"{name}: a link, maybe to another file; it must be in this one")


def _check_place(name: str, item: object) -> None:
    if isinstance(item, h5py.Dataset) and (item.is_virtual or item.external):
        raise ValueError(f"{name}: its numbers are in other files; they must be in this one")


def _check_schema(path: Path, stored: Stored) -> None:
    kind, header = stored.kind, stored.file.attrs
    if str(header.get("schema")) != kind.schema:
        raise FileError(f"{path}: an HDF5 file, but not a {kind.title}")
    there = str(header.get("schema_version", kind.version))
    if there != str(kind.version):
        there = shortened(there, 20)
        raise FileError(f"{path}: {kind.name} schema {there}; this surrofe2 reads {kind.version}")


@dataclass(frozen=True, slots=True)
class Stored:
    """An open file. Its methods raise a ValueError where an entry is missing or not as it must."""

    file: h5py.File
    kind: Kind

    def text(self, name: str) -> str:
        """A text of the header."""
        value = self.file.attrs.get(name)
        if not isinstance(value, str):
            raise ValueError(f"{name}: missing, or no text")
        return value

    def word(self, name: str) -> str:
        """A text of the header that may go into sources and names of files."""
        value = self.text(name)
        if not WORD.fullmatch(value):
            raise ValueError(f"{name}: {quoted(value)}; it must be a word of {WORD.pattern}")
        return value

    def number(self, name: str) -> float:
        """A finite number of the header."""
        value = np.asarray(self.file.attrs.get(name))
        if value.shape or value.dtype.kind not in "iuf" or not np.isfinite(value):
            raise ValueError(f"{name}: missing, or not a finite number")
        return value.item()

    def table(self, name: str) -> dict[str, Any]:
        """A JSON object of the header."""
        value = json.loads(self.text(name))
        if not isinstance(value, dict):
            raise ValueError(f"{name}: not a JSON object")
        return value

    def optional(self, name: str) -> float | None:
        """A number of the header, or None."""
        return self.number(name) if name in self.file.attrs else None

    @property
    def whose(self) -> dict[str, Any]:
        """`cell` and `initialisation` of the RVEs that answered."""
        cell = CellParameters(**self.table("cell"))
        if cell.fingerprint != self.text("cell_fingerprint"):
            raise ValueError("cell: its parameters are not those that the answers are of")
        return {"cell": cell, "initialisation": self.word("initialisation")}

    @property
    def range(self) -> SamplingRange:
        return SamplingRange(**self.table("range"))

    def array(self, name: str, shape: Shape, kind: type = np.float64) -> NDArray[Any]:
        """An array as it must be; None in the shape stands for any length."""
        entry = self.file.get(name)
        if not isinstance(entry, h5py.Dataset):
            raise ValueError(f"{name}: missing")
        whole = len(entry.shape or ()) == len(shape) and entry.nbytes <= self.file.id.get_filesize()
        if not whole or any(n not in (None, m) for n, m in zip(shape, entry.shape, strict=True)):
            raise ValueError(f"{name}: shape {entry.shape}; it must be {shape}")
        if entry.dtype != np.dtype(kind):
            raise ValueError(f"{name}: {entry.dtype}; it must be {np.dtype(kind)}")
        return np.asarray(entry[()])

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The arrays of its kind by name, those with rows of one length."""
        arrays: dict[str, NDArray[Any]] = {}
        rows: int | None = None
        for name, column in self.kind.columns.items():
            if name in self.file or not column.optional:
                shape = (rows, *column.shape[1:]) if column.shape[0] is None else column.shape
                arrays[name] = self.array(name, shape, column.kind)
                check_units(name, self.file[name].attrs.get("unit"), column.unit)
                rows = len(arrays[name]) if column.shape[0] is None else rows
        return arrays

    def all_arrays(self, group: str = "/") -> dict[str, NDArray[Any]]:
        """All arrays of numbers in a group."""
        found: dict[str, NDArray[Any]] = {}

        def collect(name: str, item: object) -> None:
            if isinstance(item, h5py.Dataset):
                if item.dtype.kind not in "biuf":
                    raise ValueError(f"{name}: {item.dtype}; it must be numbers")
                found[name] = self.array(f"{group}/{name}", item.shape, item.dtype)

        if group in self.file:
            self.file[group].visititems(collect)
        return found


def check_finite(name: str, values: NDArray[Any]) -> None:
    """Refuse NaN and infinity."""
    if not np.isfinite(values).all():
        raise ValueError(f"{name}: not finite")


def check_units(name: str, units: Any, wanted: Any) -> None:
    """Refuse numbers that were stored in other units."""
    if units != wanted:
        raise ValueError(f"{name}: in units {quoted(units)}; they must be {quoted(wanted)}")


def read_seconds(path: Path) -> float | None:
    """Seconds that the answers in a file took to make; None where it does not say.

    Raises:
        FileError: it cannot be read.
    """
    with reading(path) as stored:
        return stored.optional("seconds")


def write_checkpoint(path: Path, arrays: Mapping[str, NDArray[Any]], of: str) -> None:
    """Write the arrays of a state; `of` identifies what it is a state of."""
    write(path, CHECKPOINT, {"of": of}, arrays)


def read_checkpoint(path: Path, of: str) -> dict[str, NDArray[Any]]:
    """The arrays of a checkpoint of `of`, or a FileError."""
    with reading(path, CHECKPOINT) as stored:
        there = str(stored.file.attrs.get("of"))
        if there != of:
            raise FileError(f"{path}: a checkpoint of {shortened(there, 60)}, not of {of}")
        return stored.all_arrays()


def check_same_rve(
    made: str,
    advice: str,
    path: Path,
    there: Any,
    cell: CellParameters,
    initialisation: str,
    *,
    wall: bool = False,
) -> None:
    """A MismatchError at answers of other cell parameters or another initialisation.

    Args:
        made: the message between the path and what the answers are for.
        there: answers that were read, with their `cell` and `initialisation`.
        advice: the message's end; "{}" stands for "these parameters" or "this initialisation".
        wall: whether the outer wall, which is not of the RVE, counts too.
    """
    known = there.cell.to_dict()
    pairs = {
        f"cell.{name} =": (known.get(name), value, "these parameters")
        for name, value in cell.to_dict().items()
        if name != "outer_wall" or wall
    }
    pairs["initialisation"] = (there.initialisation, initialisation, "this initialisation")
    for name, (old, new, which) in pairs.items():
        if old != new:
            end = advice.format(which)
            raise MismatchError(f"{path}: {made} for {name} {old}, not {new}; {end}")
