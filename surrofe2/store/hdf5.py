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
from typing import Any, get_args

import h5py
import numpy as np
from numpy.typing import NDArray

from surrofe2.base.errors import FileError, MismatchError, quoted, shortened
from surrofe2.base.interruption import held
from surrofe2.base.units import NONE
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.store.store import (
    NO_DIGEST,
    SEAL,
    WORD,
    check_seal,
    plain,
    read_bytes,
    seal,
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
    """A kind of file, from which writing, reading and checking follow.

    Attributes:
        version: of its schema.
        header: entries that are read, by name: float and int, finite numbers; str; `WORD`, a text
            that may go into sources and names of files; dict and dataclasses, by a JSON object.
            With `| None` an entry may be missing.
        columns: its arrays by name; without them it may hold any arrays of numbers.
        finite: whether NaN and infinity are refused in them.
        advice: what to do about a file that cannot be read, at the end of error messages.
    """

    name: str
    version: int
    header: Mapping[str, Any] = field(default_factory=dict)
    columns: Mapping[str, Column] = field(default_factory=dict)
    finite: bool = False
    advice: str = ""

    @property
    def schema(self) -> str:
        return f"surrofe2-{self.name.replace(' ', '-')}"

    @property
    def title(self) -> str:
        return f"surrofe2 {self.name}"


ANY = Kind("file", 0, {"seconds": float | None})
"""Of whichever schema."""
ORIGIN = {"cell": CellParameters, "initialisation": WORD}
"""What is read of `origin`."""


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
    """A file of a kind with its header, in memory; it is written when the block ends well. Entries
    that are None are left out."""
    with _in_memory(path.name, kind, header) as file:
        yield file
        image = _image(file)
    write_bytes(path, sealed(image))


@contextmanager
def _in_memory(name: str, kind: Kind, header: Mapping[str, Any]) -> Iterator[h5py.File]:
    known = {
        "schema": kind.schema,
        "schema_version": kind.version,
        "package_version": version("surrofe2"),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    # A name of its own: one whose making was interrupted stays open, and HDF5 makes no second one.
    name = f"{next(_numbers)} {name}"
    with held(), h5py.File(name, "w", driver="core", backing_store=False) as file:
        for entry, value in (known | dict(header)).items():
            is_plain = isinstance(value, str | int | float | np.generic)
            if value is not None:
                file.attrs[entry] = value if is_plain else json.dumps(plain(value))
        yield file


def _image(file: h5py.File) -> bytes:
    """The bytes of a file in memory, with a place for the digest."""
    file.attrs["sha256"] = f"{SEAL}: {NO_DIGEST}"
    file.flush()
    image: bytes = file.id.get_file_image()
    return image


class Template:
    """A file of a kind whose arrays keep their shapes: it is made once, and for each further file
    only its numbers are replaced, which takes a small part of the time.

    Args:
        arrays: by name, not empty.
    """

    def __init__(self, kind: Kind, header: Mapping[str, Any], arrays: Arrays) -> None:
        self.shapes = {name: (values.shape, values.dtype) for name, values in arrays.items()}
        with _in_memory("template", kind, header) as file:
            for name, values in arrays.items():
                store_array(file, name, values)
            self._image = _image(file)
            # numbers lie in one piece, where the file says
            self._places = {name: file[name].id.get_offset() for name in arrays}

    def fits(self, arrays: Arrays) -> bool:
        """Whether the arrays have the names, shapes and types of this file's."""
        return self.shapes == {name: (each.shape, each.dtype) for name, each in arrays.items()}

    def filled(self, arrays: Arrays) -> bytearray:
        """The whole file with these numbers, sealed."""
        image = bytearray(self._image)
        for name, values in arrays.items():
            part = np.frombuffer(image, values.dtype, values.size, self._places[name])
            part[:] = values.ravel()
        seal(image)
        return image


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
def reading(path: Path, kind: Kind) -> Iterator[Stored]:
    """What is in a file of a kind; the block takes from it what it needs.

    Raises:
        FileError: missing, foreign, of another schema or version, or an entry is missing or wrong;
            in the block, too.
    """
    advice = f"; {kind.advice}" if kind.advice else ""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    content = read_bytes(path, memory // 2, _SIGNATURE)
    try:
        if not content.startswith(_SIGNATURE):
            raise FileError(f"{path}: not an HDF5 file")
        check_seal(path, content)
        with held(), h5py.File(BytesIO(content)) as file:
            _check_own(file)
            if kind is not ANY:
                if str(file.attrs.get("schema")) != kind.schema:
                    raise FileError(f"{path}: an HDF5 file, but not a {kind.title}")
                there = shortened(str(file.attrs.get("schema_version", kind.version)), 20)
                if there != str(kind.version):
                    raise FileError(
                        f"{path}: {kind.name} schema {there}; this surrofe2 reads {kind.version}"
                    )
            yield Stored(file, kind)
    except FileError as error:
        raise FileError(f"{error}{advice}") from None
    except _DAMAGED as error:
        reason = shortened(" ".join(str(error).split()), 120)
        raise FileError(f"{path}: not a whole {kind.title}: {reason}{advice}") from None


def _check_own(file: h5py.File) -> None:
    """Refuse links, and numbers in other files."""
    links: list[tuple[str, object]] = []
    file.visititems_links(lambda *link: links.append(link))  # where an error would be lost
    for name, link in links:
        if not isinstance(link, h5py.HardLink):
            raise ValueError(f"{name}: a link, maybe to another file; it must be in this one")
        item = file[name]
        if isinstance(item, h5py.Dataset) and (item.is_virtual or item.external):
            raise ValueError(f"{name}: its numbers are in other files; they must be in this one")


def read(path: Path, kind: Kind) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Header and arrays of a file of a kind, or a FileError."""
    with reading(path, kind) as stored:
        return stored.header(), stored.arrays()


def read_header(path: Path, kind: Kind) -> dict[str, Any]:
    """The header of a file of a kind, or a FileError."""
    with reading(path, kind) as stored:
        return stored.header()


def read_seconds(path: Path) -> float | None:
    """Seconds that the answers in a file took to make; None where it does not say."""
    seconds: float | None = read_header(path, ANY)["seconds"]
    return seconds


@dataclass(frozen=True, slots=True)
class Stored:
    """An open file. Its methods raise a ValueError where an entry is missing or not as it must."""

    file: h5py.File
    kind: Kind

    def header(self) -> dict[str, Any]:
        """The entries of its kind by name; None for one that is not there, but may be missing."""
        attributes = self.file.attrs
        entries = {
            name: _entry(name, attributes.get(name), of) for name, of in self.kind.header.items()
        }
        if "cell" in entries and entries["cell"].fingerprint != attributes.get("cell_fingerprint"):
            raise ValueError("cell: its parameters are not those that the answers are of")
        return entries

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
        values = np.asarray(entry[()])
        if self.kind.finite and not np.isfinite(values).all():
            raise ValueError(f"{name}: not finite")
        return values

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The arrays of its kind by name, those with rows of one length; all where it has none."""
        arrays: dict[str, NDArray[Any]] = {}
        rows: int | None = None
        for name, column in self.kind.columns.items():
            if name in self.file or not column.optional:
                shape = (rows, *column.shape[1:]) if column.shape[0] is None else column.shape
                arrays[name] = self.array(name, shape, column.kind)
                check_units(name, self.file[name].attrs.get("unit"), column.unit)
                rows = len(arrays[name]) if column.shape[0] is None else rows

        def collect(name: str, item: object) -> None:
            if isinstance(item, h5py.Dataset):
                if item.dtype.kind not in "biuf":
                    raise ValueError(f"{name}: {item.dtype}; it must be numbers")
                arrays[name] = self.array(name, item.shape, item.dtype)

        if not self.kind.columns:
            self.file.visititems(collect)
        return arrays


def _entry(name: str, value: Any, kind: Any) -> Any:
    """An entry of a header as `Kind.header` has it."""
    if get_args(kind):  # this or None
        return None if value is None else _entry(name, value, get_args(kind)[0])
    if kind in (int, float):
        number = np.asarray(value)
        if number.shape or number.dtype.kind not in "iuf" or not np.isfinite(number):
            raise ValueError(f"{name}: missing, or not a finite number")
        return kind(number)
    if not isinstance(value, str):
        raise ValueError(f"{name}: missing, or no text")
    if kind is WORD and not WORD.fullmatch(value):
        raise ValueError(f"{name}: {quoted(value)}; it must be a word of {WORD.pattern}")
    if kind in (str, WORD):
        return value
    table = json.loads(value)
    if not isinstance(table, dict):
        raise ValueError(f"{name}: not a JSON object")
    return kind(**table)


def check_units(name: str, units: Any, wanted: Any) -> None:
    """Refuse numbers that were stored in other units."""
    if units != wanted:
        raise ValueError(f"{name}: in units {quoted(units)}; they must be {quoted(wanted)}")


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
