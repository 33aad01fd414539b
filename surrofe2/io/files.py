"""Files that are whole or absent; JSON files that prove themselves, and CSV tables of numbers.

Somewhere in a file stands the SHA-256 of the whole file, computed with zeros where the digest
stands. In every format it follows the word `SEAL`: in an attribute, a JSON entry or a header. Any
changed byte is seen.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from surrofe2.errors import FileError, MismatchError, shortened
from surrofe2.io import disk

SEAL = "sha256_of_this_file"
NO_DIGEST = "0" * 64
"""What stands in a file before it is sealed."""
_WORD = SEAL.encode()
_DIGEST = re.compile(rb"(?<=[\"\0])" + _WORD + rb"\W{1,12}([0-9a-f]{64})")

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


def sealed(content: bytes) -> bytes:
    """`content` with its digest in the place of `NO_DIGEST`, which stands in it once."""
    begin, end = _place(content)
    if content[begin:end] != NO_DIGEST.encode():
        raise ValueError("no place for the digest")
    digest = hashlib.sha256(content).hexdigest().encode()
    return b"".join((content[:begin], digest, content[end:]))


def check_seal(path: Path, content: bytes) -> None:
    """Refuse content that is not what was sealed.

    Raises:
        FileError: there is no digest, or it is that of other content.
    """
    try:
        begin, end = _place(content)
    except ValueError:
        raise FileError(f"{path}: no SHA-256 in it; it is damaged, foreign or older") from None
    digest = hashlib.sha256(content[:begin])
    digest.update(NO_DIGEST.encode())
    digest.update(memoryview(content)[end:])
    if digest.hexdigest().encode() != content[begin:end]:
        raise FileError(f"{path}: damaged, or changed since it was written: see its SHA-256")


def _place(content: bytes) -> tuple[int, int]:
    """Where the digest stands."""
    found, at = [], content.find(_WORD)  # 50 times as fast as to let the pattern search
    while at >= 0:
        match = _DIGEST.match(content, at)
        found += [match.span(1)] if match else []
        at = content.find(_WORD, at + 1)
    if len(found) != 1:
        raise ValueError(f"{len(found)} digests instead of one")
    return found[0]


def write_columns(path: Path, header: list[str], columns: list[np.ndarray]) -> None:
    """Write columns (m,) and their names."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(header)
    table.writerows([repr(float(value)) for value in row] for row in zip(*columns, strict=True))
    write_text(path, text.getvalue())


def read_columns(path: Path) -> tuple[list[str], np.ndarray]:
    """Names of columns and (m, columns) numbers.

    Raises:
        FileError: missing or damaged.
    """
    content = read_bytes(path)
    names: list[str] = []
    try:
        names, *rows = csv.reader(content.decode().splitlines() or [""])
        table = np.array([[float(entry) for entry in row] for row in rows])
        return names, table.reshape(len(rows), len(names))
    except (ValueError, csv.Error):
        told = shortened(",".join(names[:3]), 80)
        raise FileError(f"{path}: not a table of {told or 'names and numbers'}") from None
