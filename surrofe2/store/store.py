"""Files that are whole or absent and prove themselves, and the locks of their writers.

In a file, behind the word `SEAL`, stands the SHA-256 of the whole file, computed with zeros where
the digest stands. Any changed byte is seen.

One process at a time writes an output. It holds a lock file beside or in it by `flock`, which the
kernel drops when the process ends, however it ends. What stands in the lock is for people: who
holds it. A process that ends well removes it, so one that is there without a holder says that the
last process was killed. On a file system without locks work continues after one warning.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import logging
import math
import os
import platform
import re
import stat
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import asdict, is_dataclass
from datetime import datetime
from glob import escape
from pathlib import Path
from secrets import token_hex
from typing import Any

import numpy as np

from surrofe2.base.errors import FileError, MismatchError, shortened
from surrofe2.base.interruption import held
from surrofe2.store import disk

log = logging.getLogger(__name__)

SEAL = "sha256_of_this_file"
NO_DIGEST = "0" * 64
"""What stands in a file before it is sealed."""
_WORD = SEAL.encode()
_BLOCK = 2**24
"""Bytes that are read at a time of a file of which little is wanted."""
_DIGEST = re.compile(rb"(?<=[\"\0])" + _WORD + rb"\W{1,12}([0-9a-f]{64})")

WORD = re.compile(r"[A-Za-z0-9_.+-]{0,64}")
"""Texts of files that may go into sources and names of files."""

_WIDE = {
    "UTF-32": re.compile(rb"\xff\xfe\0\0|\0\0\xfe\xff|[\t-~]\0\0\0|\0\0\0[\t-~]"),
    "UTF-16": re.compile(rb"\xff\xfe|\xfe\xff|[\t-~]\0|\0[\t-~]"),
}
"""How texts of these encodings begin: with a byte order mark, or with a letter of ASCII."""

START_OVER = "change it back, write elsewhere or start over with --fresh"
"""The end of error messages that refuse output of other settings."""


@contextmanager
def reported(path: Path, action: str) -> Iterator[None]:
    """Turn an operating-system error on `path` into one error message."""
    try:
        yield
    except FileError:
        raise
    except OSError as error:
        raise FileError(f"{path}: cannot be {action}: {error.strerror or error}") from None


def leftovers(path: Path) -> list[Path]:
    """Files in which processes that were killed were writing `path`; others still hold theirs.

    Without locks there is no difference between the two, and none is listed.
    """
    abandoned = []
    for each in sorted(path.parent.glob(f".{escape(path.name)}.{'[0-9a-f]' * 8}.partial")):
        # "r+b", since NFS locks only what is open for writing
        with suppress(OSError), each.open("r+b") as file:
            if disk.lock(file, each):
                abandoned.append(each)
    return abandoned


def write_bytes(path: Path, content: bytes | memoryview) -> None:
    """Write a file whole, or leave what was there."""
    partial = path.with_name(f".{path.name}.{token_hex(4)}.partial")
    with reported(path, "written"):
        disk.make_folder(path.parent)
        for each in leftovers(path):
            disk.remove(each)
        with disk.create(partial) as file:
            try:
                disk.write(file, content)
                disk.sync(partial)
                disk.move(partial, path)
                disk.sync(path.parent)
            finally:
                disk.remove(partial)


def write_text(path: Path, text: str) -> None:
    """Write a text file whole; of names of files that are no UTF-8, the bytes as escapes."""
    write_bytes(path, text.encode("utf-8", "backslashreplace"))


def read_bytes(path: Path, most: int = 2**30, begin: bytes = b"") -> bytes:
    """Read a regular file of at most `most` bytes whole, or raise a FileError.

    Of a device, a pipe or a file that is too large nothing is read. Of one that does not begin with
    `begin` only as many bytes are. Memory is taken for the file's own size.
    """
    with reported(path, "read"), _opened(path) as file:
        size = os.fstat(file.fileno()).st_size
        head = file.read(len(begin))
        if head != begin:
            return head
        if size > most:
            raise FileError(_too_large(path, size, most))
        file.seek(0)
        try:
            # A buffered file reads until it has all: one call of the system gives 2 GiB at most.
            return file.read(size)
        except MemoryError:
            raise FileError(
                f"{path}: cannot be read: {size / 1e9:.3g} GB; this process has less memory free"
            ) from None


def _too_large(path: Path, size: int, most: float) -> str:
    return f"{path}: cannot be read: {size / 1e9:.3g} GB; it must have at most {most / 1e9:.3g}"


@contextmanager
def _opened(path: Path) -> Iterator[io.BufferedReader]:
    """A regular file that is open for reading; a FileError at anything else."""
    try:  # a pipe without a writer would wait for one, but for O_NONBLOCK
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except ValueError:  # a name with a zero in it
        raise FileError(f"{path}: cannot be read: no such file") from None
    with os.fdopen(descriptor, "rb") as file:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise FileError(f"{path}: cannot be read: not a regular file")
        yield file


def read_text(path: Path, most: int = 2**30) -> str:
    """As `read_bytes`, as text with newlines of one kind and without a byte order mark.

    Raises:
        FileError: it cannot be read, or is not UTF-8; the message names its encoding, or the line.
    """
    content = read_bytes(path, most)
    check_not_wide(path, content)
    try:
        return content.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise FileError(
            f"{path}: not UTF-8: byte 0x{content[error.start]:02x} in line {line}; save it as UTF-8"
        ) from None


def check_not_wide(path: Path, content: bytes) -> None:
    """Refuse text of two or four bytes for each letter, by a FileError that names the encoding."""
    for name, begins in _WIDE.items():
        if begins.match(content):
            raise FileError(f"{path}: this is {name} text; save it as UTF-8")


def remove(path: Path) -> None:
    """Remove a file, and what a process that was killed left of it, where they are there."""
    with reported(path, "removed"):
        for each in ([path] if path.exists() else []) + leftovers(path):
            disk.remove(each)


def remove_tree(folder: Path) -> None:
    """Remove a folder and all that is in it."""
    with reported(folder, "removed"):
        for path in sorted(folder.rglob("*"), reverse=True):
            is_folder = path.is_dir() and not path.is_symlink()
            (disk.remove_folder if is_folder else disk.remove)(path)
        disk.remove_folder(folder)


def sealed(content: bytes) -> bytes:
    """`content` with its digest instead of `NO_DIGEST`, which stands in it once."""
    begin, end = _place(content)
    if content[begin:end] != NO_DIGEST.encode():
        raise ValueError("no place for the digest")
    digest = hashlib.sha256(content).hexdigest().encode()
    return b"".join((content[:begin], digest, content[end:]))


def seal(content: bytearray) -> None:
    """As `sealed`, in place: of large content there is no room for copies."""
    begin, end = _place(content)
    if content[begin:end] != NO_DIGEST.encode():
        raise ValueError("no place for the digest")
    content[begin:end] = hashlib.sha256(content).hexdigest().encode()


def check_seal(path: Path, content: bytes) -> None:
    """A FileError at content that has no digest, or that of other content."""
    try:
        begin, end = _place(content)
    except ValueError:
        raise FileError(f"{path}: no SHA-256 in it; it is damaged, foreign or older") from None
    whole = memoryview(content)  # its parts are no copies, which may be of some GB
    computed = hashlib.sha256(whole[:begin])
    computed.update(NO_DIGEST.encode())
    computed.update(whole[end:])
    if computed.hexdigest().encode() != content[begin:end]:
        raise FileError(f"{path}: damaged, or changed since it was written: see its SHA-256")


def _place(content: bytes | bytearray) -> tuple[int, int]:
    """Where the digest stands."""
    found, at = [], content.find(_WORD)  # 50 times as fast as to let the pattern search
    while at >= 0:
        match = _DIGEST.match(content, at)
        found += [match.span(1)] if match else []
        at = content.find(_WORD, at + 1)
    if len(found) != 1:
        raise ValueError(f"{len(found)} digests instead of one")
    return found[0]


def digest(path: Path, most: float = math.inf) -> str:
    """SHA-256 of a file of at most `most` bytes; its first 16 digits are its fingerprint."""
    with reported(path, "read"), _opened(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > most:
            raise FileError(_too_large(path, size, most))
        return hashlib.file_digest(file, "sha256").hexdigest()


def plain(value: Any) -> Any:
    """`value` as strict JSON can hold it: dataclasses and arrays opened, "inf" for infinity."""
    if is_dataclass(value) and not isinstance(value, type):
        value = asdict(value)
    if isinstance(value, Mapping):
        return {plain(str(key)): plain(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, str) and not value.isascii():  # names of files may be no UTF-8
        return value.encode("utf-8", "backslashreplace").decode()
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


def write_columns(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write columns (m,) by their headings as CSV."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(columns)
    rows = zip(*columns.values(), strict=True)
    table.writerows([repr(float(value)) for value in row] for row in rows)
    write_text(path, text.getvalue())


def read_columns(path: Path) -> dict[str, np.ndarray]:
    """Columns (m,) by their headings; a FileError where it is no such table."""
    names: list[str] = []
    try:
        names, *rows = csv.reader(read_text(path).splitlines() or [""])
        table = np.array([[float(entry) for entry in row] for row in rows])
        return dict(zip(names, table.reshape(len(rows), len(names)).T, strict=True))
    except (ValueError, csv.Error):
        columns = shortened(",".join(names[:3]), 80)
        raise FileError(f"{path}: not a table of {columns or 'names and numbers'}") from None


def flat(settings: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Plain entries by their dotted names."""
    entries: dict[str, Any] = {}
    for name, value in settings.items():
        nested = isinstance(value, Mapping)
        entries |= flat(value, f"{prefix}{name}.") if nested else {f"{prefix}{name}": plain(value)}
    return entries


def check_same(
    place: Path, here: Mapping[str, Any], there: Mapping[str, Any], advice: str = START_OVER
) -> None:
    """A MismatchError that names the first setting `here`, nested by section, that differs from
    those `there`, by which `place` was made; what only `there` has is ignored."""
    known = flat(there)
    for name, value in flat(here).items():
        if known.get(name) != value:
            mine, theirs = ("nothing" if v is None else v for v in (value, known.get(name)))
            raise MismatchError(
                f"{place}: {name}: this call has {mine}, what is there {theirs}; {advice}"
            )


def check_replaceable(path: Path, kind: str, *marks: str) -> None:
    """A FileError, before starting over, at a file that is not of this kind or lacks one of these
    texts."""
    if path.exists() and path.stat().st_size and _missing(path, marks):
        raise FileError(
            f"{path}: not a {kind}, so --fresh does not replace it; write elsewhere or remove it "
            "first"
        )


def _missing(path: Path, texts: Iterable[str]) -> set[bytes]:
    """Return those of some texts that are not in a file, which is read block by block."""
    missing = {text.encode() for text in texts}
    overlap = max(map(len, missing), default=0)  # a text may lie across two blocks
    end = b""
    with reported(path, "read"), _opened(path) as file:
        while missing and (block := file.read(_BLOCK)):
            content = end + block
            missing = {text for text in missing if text not in content}
            end = content[-overlap:]
    return missing


def keep(
    path: Path,
    identity: Mapping[str, Any],
    make: Callable[[], Mapping[str, Any]],
    *,
    fresh: bool = False,
) -> tuple[dict[str, Any], bool]:
    """A JSON file of these settings: read where it is there, else made and written.

    Args:
        identity: the settings, which are entries of the file.
        make: gives the other entries, after it has written what belongs to them.
        fresh: make it, whatever of this kind is there.

    Returns:
        Its entries, and whether it was there.

    Raises:
        MismatchError: it is there, by other settings, and not `fresh`.
        FileError: it is damaged or foreign, or another process makes it.
    """
    if fresh:
        check_replaceable(path, f"file of {', '.join(identity)}", SEAL, *identity)

    def stored() -> dict[str, Any] | None:
        if fresh or not path.exists():
            return None
        entries = read_json(path)
        check_same(path, identity, entries)
        return entries

    there = None if file_lock(path).exists() else stored()
    if there is None:
        with locked_file(path):
            there = stored()
            if there is None:
                entries = {**identity, **make()}
                write_json(path, entries)
                return entries, False
    return there, True


def folder_lock(folder: Path) -> Path:
    """The lock of what a folder holds."""
    return folder / ".lock"


def file_lock(path: Path) -> Path:
    """The lock of a file."""
    return path.with_name(f".{path.name}.lock")


def locked_folder(folder: Path) -> AbstractContextManager[None]:
    """Only this call writes into a folder, which is made where it is missing.

    Raises:
        FileError: another call does, which the message names, or the folder is not writable.
    """
    return _locked(folder_lock(folder), folder)


def locked_file(path: Path) -> AbstractContextManager[None]:
    """As `locked_folder`, of one file."""
    return _locked(file_lock(path), path)


@contextmanager
def _locked(lock: Path, output: Path) -> Iterator[None]:
    with reported(output, "written"), held():
        disk.make_folder(lock.parent)
        file = None
        while file is None:
            file = _taken(lock, output)
    try:
        yield
    finally:
        with file, suppress(OSError):  # where it cannot be removed, the next process takes it over
            try:
                disk.remove(lock)
            except OSError:  # the disk may fail once
                disk.remove(lock)


def _taken(lock: Path, output: Path) -> io.FileIO | None:
    """The open lock file, held and signed; None where its holder removed it meanwhile."""
    flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW
    with ExitStack() as closing:
        file = closing.enter_context(io.FileIO(os.open(lock, flags, 0o666), "r+b"))
        try:
            is_locked = disk.lock(file, lock)
        except BlockingIOError:
            holder = _signature(file)
            is_me = holder.startswith(_this_process())
            who = "another call of this process" if is_me else f"{holder}; wait for it or end it"
            raise FileError(f"{output}: in use by {who}") from None
        here = os.fstat(file.fileno())
        if not (lock.exists() and os.path.samestat(here, lock.stat())):
            return None
        if here.st_size:
            state = "was killed" if is_locked else "was killed or is still at work"
            log.warning("%s: %s %s; this process resumes", output, _signature(file), state)
        now = datetime.now().astimezone().isoformat(timespec="seconds")
        command = " ".join([Path(sys.argv[0]).name, *sys.argv[1:]])[:100]
        me = f"{_this_process()}since {now} ({command})"
        try:
            disk.write(file, me.encode("utf-8", "backslashreplace"))
        except OSError:
            with suppress(OSError):
                disk.remove(lock)
            raise
        closing.pop_all()  # it stays open
        return file


def _this_process() -> str:
    return f"process {os.getpid()} on {platform.node()} "


def _signature(file: io.FileIO) -> str:
    """Who signed a lock; its content is damaged or empty at times."""
    file.seek(0)
    who = " ".join(file.read(10_000).decode("utf-8", "replace").split())[:200]
    is_one = who.startswith("process ") and who.isprintable()
    return who if is_one else "a process that did not say its name"
