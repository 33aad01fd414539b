"""Files that are whole or absent: written beside their place, then moved into it."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from surrofe2.errors import FileError, MismatchError

START_OVER = "change it back, write elsewhere or start over with --fresh"
"""The end of sentences that refuse output of other settings."""


@contextmanager
def reported(path: Path, action: str) -> Iterator[None]:
    """Turn an operating-system error on `path` into one sentence."""
    try:
        yield
    except FileError:
        raise
    except OSError as error:
        raise FileError(f"{path}: cannot be {action}: {error.strerror or error}") from None


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path in the same folder that becomes `path` when the block ends well."""
    partial = path.with_name(f".{path.name}.partial")
    with reported(path, "written"):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            yield partial
            os.replace(partial, path)
        finally:
            partial.unlink(missing_ok=True)


def check_same(place: Path, here: Mapping[str, Any], there: Mapping[str, Any]) -> None:
    """Refuse to keep or go on with what was made by other settings.

    Args:
        place: what was made.
        here, there: settings now and then, nested by section; what only `there` has is ignored.

    Raises:
        MismatchError: naming the first that differs.
    """
    known = flat(there)
    for name, value in flat(here).items():
        if known.get(name) != value:
            raise MismatchError(
                f"{place}: {name}: this call has {value}, what is there {known.get(name)}; "
                + START_OVER
            )


def is_there(path: Path, wanted: Mapping[str, Any]) -> bool:
    """Whether a JSON file is there that was made by the wanted settings, its entries by name.

    Raises:
        MismatchError: it is there, by other settings.
        FileError: it is damaged or foreign.
    """
    if path.exists():
        check_same(path, wanted, read_json(path))
    return path.exists()


def flat(settings: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Plain entries by their dotted names."""
    entries: dict[str, Any] = {}
    for name, value in settings.items():
        nested = isinstance(value, Mapping)
        entries |= flat(value, f"{prefix}{name}.") if nested else {f"{prefix}{name}": plain(value)}
    return entries


def write_text(path: Path, text: str) -> None:
    """Write a text file whole."""
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")


def plain(value: Any) -> Any:
    """`value` as strict JSON can hold it: dataclasses and arrays opened, "inf" for infinity."""
    if is_dataclass(value) and not isinstance(value, type):
        value = asdict(value)
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value


def write_json(path: Path, value: Any) -> None:
    """Write JSON that people read too."""
    write_text(path, json.dumps(plain(value), indent=2, ensure_ascii=False) + "\n")


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object from a file, or a FileError."""
    try:
        with reported(path, "read"):
            value = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        raise FileError(f"{path}: not a JSON file; it is damaged or foreign") from None
    if not isinstance(value, dict):
        raise FileError(f"{path}: not a JSON object; it is damaged or foreign")
    return value


@contextmanager
def opened_hdf5(path: Path, mode: str) -> Iterator[h5py.File]:
    """An open HDF5 file; one sentence where it is missing, truncated, foreign or locked."""
    with reported(path, "read"):
        path.open("rb").close()
    try:
        file = h5py.File(path, mode)
    except OSError as error:
        raise FileError(f"{path}: {_why_not(error)}") from None
    try:
        yield file
    finally:
        file.close()


def _why_not(error: OSError) -> str:
    text = str(error)
    if "truncated" in text:
        return "truncated HDF5 file; write it anew"
    if "signature" in text:
        return "not an HDF5 file"
    if "lock" in text:
        return "in use by another process"
    return "cannot be opened as HDF5; it is damaged or not writable"
