"""HDF5 files with one header that are whole or absent and carry a checksum.

Files are made and read in memory, and an interruption waits meanwhile: HDF5 calls Python, and would
take the interruption for an error of its own.
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
# The first bytes of an HDF5 file.
_SIGNATURE = b"\x89HDF\r\n\x1a\n"
# Errors of reading damaged entries of a file; the last is h5py's for names not in UTF-8.
_DAMAGED = (
    OSError, RuntimeError, KeyError, TypeError, ValueError, AttributeError, OverflowError,
    MemoryError, SystemError,
)  # fmt: skip
# Numbers for names of files in memory, see `_in_memory`.
_numbers = count()


@dataclass(frozen=True, slots=True)
class Column:
    """An array of a file.

    Attributes:
        shape: sizes; None stands for any length. All arrays of a file whose shape begins with None
            have as many rows.
        kind: type of its numbers.
        unit: unit of its numbers.
        meaning: what its codes mean, where it has codes.
        optional: whether it may be missing.
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
        name: name of the kind, such as "data set".
        version: version of its schema.
        header: types of the entries that are read, by name: float and int, finite numbers; str;
            `WORD`, a text that may go into sources and names of files; dict and dataclasses, by a
            JSON object. With `| None` an entry may be missing.
        columns: its arrays by name; without them it may hold any arrays of numbers.
        finite: whether NaN and infinity are rejected in its arrays.
        advice: remedy for a file that cannot be read, at the end of error messages.
    """

    name: str
    version: int
    header: Mapping[str, Any] = field(default_factory=dict)
    columns: Mapping[str, Column] = field(default_factory=dict)
    finite: bool = False
    advice: str = ""

    @property
    def schema(self) -> str:
        """The name of the schema in the header of a file."""
        return f"surrofe2-{self.name.replace(' ', '-')}"

    @property
    def title(self) -> str:
        """The name of the kind in error messages."""
        return f"surrofe2 {self.name}"


# A file of whichever schema, of which only the seconds are read.
ANY = Kind("file", 0, {"seconds": float | None})
# The entries of `origin` that are read.
ORIGIN = {"cell": CellParameters, "initialisation": WORD}


def origin(cell: CellParameters, initialisation: str, **more: Any) -> dict[str, Any]:
    """Return the entries of a header that say of which RVE the numbers in a file are."""
    return {
        **more,
        "cell": cell.to_dict(),
        "cell_fingerprint": cell.fingerprint,
        "initialisation": initialisation,
    }


def write(path: Path, kind: Kind, header: Mapping[str, Any], arrays: Arrays) -> None:
    """Write a file of a kind, whole or not at all.

    Args:
        header: entries by name; those that are None are left out.
        arrays: arrays by name; a/b is the array b in the group a.
    """
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
    """Make a file of a kind with its header in memory; it is written when the block ends well.

    Entries of the header that are None are left out.
    """
    with _in_memory(path.name, kind, header) as file:
        yield file
        image = _image(file)
    write_bytes(path, sealed(image))


@contextmanager
def _in_memory(name: str, kind: Kind, header: Mapping[str, Any]) -> Iterator[h5py.File]:
    """Make a file of a kind with its header in memory, which nothing else writes to the disk."""
    entries = {
        "schema": kind.schema,
        "schema_version": kind.version,
        "package_version": version("surrofe2"),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        **header,
    }
    # A name of its own: one whose making was interrupted stays open, and HDF5 makes no second one.
    name = f"{next(_numbers)} {name}"
    with held(), h5py.File(name, "w", driver="core", backing_store=False) as file:
        for entry, value in entries.items():
            if value is None:
                continue
            is_plain = isinstance(value, str | int | float | np.generic)
            file.attrs[entry] = value if is_plain else json.dumps(plain(value))
        yield file


def _image(file: h5py.File) -> bytes:
    """Return the bytes of a file in memory, with a place for the digest."""
    file.attrs["sha256"] = f"{SEAL}: {NO_DIGEST}"
    file.flush()
    image: bytes = file.id.get_file_image()
    return image


class Template:
    """A file of a kind whose arrays keep their shapes.

    It is made once, and for each further file only its numbers are replaced, which takes a small
    part of the time.

    Args:
        header: entries of the header, which all files share.
        arrays: arrays by name; none may be empty, for an empty one has no place in the file.
    """

    def __init__(self, kind: Kind, header: Mapping[str, Any], arrays: Arrays) -> None:
        self.shapes = _shapes_and_types(arrays)
        with _in_memory("template", kind, header) as file:
            for name, values in arrays.items():
                store_array(file, name, values)
            self._image = _image(file)
            # numbers lie in one piece, where the file says
            self._places = {name: file[name].id.get_offset() for name in arrays}

    def fits(self, arrays: Arrays) -> bool:
        """Return whether the arrays have the names, shapes and types of this file's."""
        return self.shapes == _shapes_and_types(arrays)

    def filled(self, arrays: Arrays) -> bytearray:
        """Return the whole file with these numbers, sealed."""
        image = bytearray(self._image)
        for name, values in arrays.items():
            part = np.frombuffer(image, values.dtype, values.size, self._places[name])
            part[:] = values.ravel()
        seal(image)
        return image


def _shapes_and_types(arrays: Arrays) -> dict[str, tuple[tuple[int, ...], np.dtype[Any]]]:
    """Return shape and type of each array by name."""
    return {name: (values.shape, values.dtype) for name, values in arrays.items()}


def store_array(file: h5py.File, name: str, values: NDArray[Any]) -> None:
    """Store an array like file[name] = values does, in 0.05 ms instead of 0.13.

    A run stores a thousand of them.
    """
    values = np.asarray(values)
    links = h5py.h5p.create(h5py.h5p.LINK_CREATE)
    links.set_create_intermediate_group(True)
    kind = h5py.h5t.py_create(values.dtype, logical=True)
    space = h5py.h5s.create_simple(values.shape)
    stored = h5py.h5d.create(file.id, name.encode(), kind, space, None, links)
    stored.write(h5py.h5s.ALL, h5py.h5s.ALL, np.ascontiguousarray(values))


@contextmanager
def reading(path: Path, kind: Kind) -> Iterator[Stored]:
    """Open a file of a kind, of which the block reads what it needs.

    Raises:
        FileError: the file is missing, foreign, of another schema or version, or an entry is
            missing or wrong. An error of reading in the block becomes one, too.
    """
    advice = f"; {kind.advice}" if kind.advice else ""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    # half of the memory: the other half is for what is made of the content
    content = read_bytes(path, memory // 2, _SIGNATURE)
    try:
        if not content.startswith(_SIGNATURE):
            raise FileError(f"{path}: not an HDF5 file")
        check_seal(path, content)
        with held(), h5py.File(BytesIO(content)) as file:
            _check_own(file)
            if kind is not ANY:
                _check_schema(path, file, kind)
            yield Stored(file, kind)
    except FileError as error:
        raise FileError(f"{error}{advice}") from None
    except _DAMAGED as error:
        reason = shortened(" ".join(str(error).split()), 120)
        raise FileError(f"{path}: not a whole {kind.title}: {reason}{advice}") from None


def _check_schema(path: Path, file: h5py.File, kind: Kind) -> None:
    """Reject a file of another kind, or of another version of its schema."""
    if str(file.attrs.get("schema")) != kind.schema:
        raise FileError(f"{path}: an HDF5 file, but not a {kind.title}")
    stored_version = shortened(str(file.attrs.get("schema_version", kind.version)), 20)
    if stored_version != str(kind.version):
        raise FileError(
            f"{path}: {kind.name} schema {stored_version}; this surrofe2 reads {kind.version}"
        )


def _check_own(file: h5py.File) -> None:
    """Reject links, and numbers in other files: a stranger's file could read any other by them."""
    links: list[tuple[str, object]] = []
    file.visititems_links(lambda *link: links.append(link))  # where an error would be lost
    for name, link in links:
        if not isinstance(link, h5py.HardLink):
            raise ValueError(f"{name}: a link, maybe to another file; it must be in this one")
        item = file[name]
        if isinstance(item, h5py.Dataset) and (item.is_virtual or item.external):
            raise ValueError(f"{name}: its numbers are in other files; they must be in this one")


def read(path: Path, kind: Kind) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read header and arrays of a file of a kind, or raise a FileError."""
    with reading(path, kind) as stored:
        return stored.header(), stored.arrays()


def read_header(path: Path, kind: Kind) -> dict[str, Any]:
    """Read the header of a file of a kind, or raise a FileError."""
    with reading(path, kind) as stored:
        return stored.header()


def read_seconds(path: Path) -> float | None:
    """Read the seconds that the numbers in a file took to make; None where it does not say."""
    seconds: float | None = read_header(path, ANY)["seconds"]
    return seconds


@dataclass(frozen=True, slots=True)
class Stored:
    """An open file. Its methods raise a ValueError where an entry is missing or not as it must."""

    file: h5py.File
    kind: Kind

    def header(self) -> dict[str, Any]:
        """Read the entries of its kind by name; an entry that may be missing, and is, is None."""
        attributes = self.file.attrs
        entries = {
            name: _entry(name, attributes.get(name), entry_type)
            for name, entry_type in self.kind.header.items()
        }
        if "cell" in entries and entries["cell"].fingerprint != attributes.get("cell_fingerprint"):
            raise ValueError("cell: its parameters are not those that the answers are of")
        return entries

    def array(self, name: str, shape: Shape, kind: type = np.float64) -> NDArray[Any]:
        """Read an array that must have this shape and type; None stands for any length."""
        entry = self.file.get(name)
        if not isinstance(entry, h5py.Dataset):
            raise ValueError(f"{name}: missing")
        # a damaged shape may claim more numbers than the file has, and more than the memory
        is_plausible = entry.nbytes <= self.file.id.get_filesize()
        has_dimensions = len(entry.shape or ()) == len(shape)
        if not (has_dimensions and is_plausible and _is_of_shape(entry.shape, shape)):
            raise ValueError(f"{name}: shape {entry.shape}; it must be {shape}")
        if entry.dtype != np.dtype(kind):
            raise ValueError(f"{name}: {entry.dtype}; it must be {np.dtype(kind)}")
        values = np.asarray(entry[()])
        if self.kind.finite and not np.isfinite(values).all():
            raise ValueError(f"{name}: not finite")
        return values

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Read the arrays by name: those of its kind, or all where the kind states none."""
        if self.kind.columns:
            return self._columns()
        arrays: dict[str, NDArray[Any]] = {}

        def collect(name: str, item: object) -> None:
            """Read an array of the file, and keep it by its name."""
            if isinstance(item, h5py.Dataset):
                if item.dtype.kind not in "biuf":
                    raise ValueError(f"{name}: {item.dtype}; it must be numbers")
                arrays[name] = self.array(name, item.shape, item.dtype)

        self.file.visititems(collect)
        return arrays

    def _columns(self) -> dict[str, NDArray[Any]]:
        """Read the columns of its kind; those of any length must have as many rows as the first."""
        arrays: dict[str, NDArray[Any]] = {}
        rows: int | None = None
        for name, column in self.kind.columns.items():
            if column.optional and name not in self.file:
                continue
            has_rows = column.shape[0] is None
            shape = (rows, *column.shape[1:]) if has_rows else column.shape
            arrays[name] = self.array(name, shape, column.kind)
            check_units(name, self.file[name].attrs.get("unit"), column.unit)
            if has_rows:
                rows = len(arrays[name])
        return arrays


def _is_of_shape(sizes: tuple[int, ...], shape: Shape) -> bool:
    """Return whether sizes are those of a shape, in which None stands for any length."""
    return all(wanted is None or wanted == size for wanted, size in zip(shape, sizes, strict=True))


def _entry(name: str, value: Any, kind: Any) -> Any:
    """Return an entry of a header in the type that `Kind.header` states, or raise a ValueError."""
    if get_args(kind):  # of this type, or None
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
    """Reject numbers that were stored in other units."""
    if units != wanted:
        raise ValueError(f"{name}: in units {quoted(units)}; they must be {quoted(wanted)}")


def check_same_rve(
    verb: str,
    advice: str,
    path: Path,
    numbers: Any,
    cell: CellParameters,
    initialisation: str,
    *,
    wall: bool = False,
) -> None:
    """Check that numbers in a file are those of an RVE.

    Args:
        verb: verb or noun of the message, between the path and the setting that differs.
        advice: end of the message; "{}" stands for "these parameters" or "this initialisation".
        numbers: the numbers that were read, with their `cell` and `initialisation`.
        cell: plant cell of the RVE.
        initialisation: initialisation of the RVE.
        wall: whether the outer wall, which is no part of an RVE, counts too.

    Raises:
        MismatchError: naming the first setting that differs.
    """
    stored = numbers.cell.to_dict()
    for name, value in cell.to_dict().items():
        if name == "outer_wall" and not wall:
            continue
        if stored.get(name) != value:
            raise MismatchError(
                f"{path}: {verb} for cell.{name} = {stored.get(name)}, not {value}; "
                f"{advice.format('these parameters')}"
            )
    if numbers.initialisation != initialisation:
        raise MismatchError(
            f"{path}: {verb} for initialisation {numbers.initialisation}, not {initialisation}; "
            f"{advice.format('this initialisation')}"
        )
