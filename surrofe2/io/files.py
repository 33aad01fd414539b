"""Files that are whole or absent, and JSON files that prove themselves."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from surrofe2.errors import FileError, MismatchError
from surrofe2.io import disk
from surrofe2.io.seal import NO_DIGEST, SEAL, check_seal, sealed

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


def write_bytes(path: Path, content: bytes | memoryview) -> None:
    """Write a file whole, or leave what was there."""
    partial = partial_of(path)
    with reported(path, "written"):
        disk.make_folder(path.parent)
        try:
            disk.write(partial, content)
            disk.sync(partial)
            disk.move(partial, path)
            disk.sync(path.parent)
        finally:
            disk.remove(partial)


def partial_of(path: Path) -> Path:
    """The name under which a file is written; a process that was killed leaves it behind."""
    return path.with_name(f".{path.name}.partial")


def remove(path: Path) -> None:
    """Remove a file, and what a process that was killed left of it, where they are there."""
    with reported(path, "removed"):
        for each in (path, partial_of(path)):
            if each.exists():
                disk.remove(each)


def remove_tree(folder: Path) -> None:
    """Remove a folder and all that is in it."""
    with reported(folder, "removed"):
        for path in sorted(folder.rglob("*"), reverse=True):
            is_folder = path.is_dir() and not path.is_symlink()
            (disk.remove_folder if is_folder else disk.remove)(path)
        disk.remove_folder(folder)


def make_folder(path: Path) -> None:
    """Make a folder, and those that it is in, where they are not there."""
    with reported(path, "written"):
        disk.make_folder(path)


def read_bytes(path: Path) -> bytes:
    """What is in a file, or a FileError."""
    with reported(path, "read"):
        return path.read_bytes()


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
            mine, theirs = ("nothing" if v is None else v for v in (value, known.get(name)))
            raise MismatchError(
                f"{place}: {name}: this call has {mine}, what is there {theirs}; {START_OVER}"
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
    write_bytes(path, text.encode())


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


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Write a sealed JSON object that people read too."""
    entries = {SEAL: NO_DIGEST, **plain(value)}
    text = json.dumps(entries, indent=2, ensure_ascii=False) + "\n"
    write_bytes(path, sealed(text.encode()))


def read_json(path: Path) -> dict[str, Any]:
    """What `write_json` wrote, or a FileError."""
    content = read_bytes(path)
    try:
        value = json.loads(content)
    except (ValueError, RecursionError):
        raise FileError(f"{path}: not a JSON file; it is damaged or foreign") from None
    if not isinstance(value, dict):
        raise FileError(f"{path}: not a JSON object; it is damaged or foreign")
    check_seal(path, content)
    if SEAL not in value:
        raise FileError(f"{path}: no SHA-256 in it; it is damaged, foreign or older")
    del value[SEAL]
    return value
