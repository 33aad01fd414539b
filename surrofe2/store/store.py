"""Files that are whole or absent and carry a checksum, and the locks of their writers.

In a file, behind the word `SEAL`, stands the SHA-256 of the whole file, computed with zeros where
the digest stands. Any changed byte is seen.

One process at a time writes an output. It holds a lock file beside or in it by `flock`, which the
kernel drops when the process ends, however it ends. The text in the lock tells people who holds
it. A process that ends well removes it, so one that is there without a holder says that the
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
# The digits that stand in a file until it is sealed.
NO_DIGEST = "0" * 64
_WORD = SEAL.encode()
# Bytes of a file that are searched at a time.
_BLOCK = 2**24
# A digest in JSON ("sha256_of_this_file": "…") or in an attribute of HDF5.
_DIGEST = re.compile(rb"(?<=[\"\0])" + _WORD + rb"\W{1,12}([0-9a-f]{64})")

# Pattern of texts in files that may go into sources and names of files.
WORD = re.compile(r"[A-Za-z0-9_.+-]{0,64}")

# Beginnings of texts in these encodings: a byte order mark, or a letter of ASCII. UTF-32 comes
# first, for its mark begins with that of UTF-16.
_WIDE = {
    "UTF-32": re.compile(rb"\xff\xfe\0\0|\0\0\xfe\xff|[\t-~]\0\0\0|\0\0\0[\t-~]"),
    "UTF-16": re.compile(rb"\xff\xfe|\xfe\xff|[\t-~]\0|\0[\t-~]"),
}

# The end of error messages that refuse output of other settings.
START_OVER = "change it back, write elsewhere or start over with --fresh"


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
    """Return the partial files of `path` that killed processes have left behind.

    A process that is still writing holds the lock of its own, which is not listed. On a file
    system without locks the two cannot be told apart, and none is listed.
    """
    abandoned = []
    for partial in sorted(path.parent.glob(f".{escape(path.name)}.{'[0-9a-f]' * 8}.partial")):
        # "r+b", since NFS locks only what is open for writing
        with suppress(OSError), partial.open("r+b") as file:
            if disk.lock(file, partial):
                abandoned.append(partial)
    return abandoned


def write_bytes(path: Path, content: bytes | memoryview) -> None:
    """Write a file whole, or leave what was there."""
    partial = path.with_name(f".{path.name}.{token_hex(4)}.partial")
    with reported(path, "written"):
        disk.make_folder(path.parent)
        for abandoned in leftovers(path):
            disk.remove(abandoned)
        is_created = False
        try:
            # an interruption in here would leave a file of which nobody knows
            with held():
                file = disk.create(partial)
                is_created = True
            with file:
                disk.write(file, content)
                disk.sync(partial)
                disk.move(partial, path)
                disk.sync(path.parent)
        finally:
            if is_created:
                disk.remove(partial)


def write_text(path: Path, text: str) -> None:
    """Write a text file whole; bytes of files' names that are no UTF-8 are written as escapes."""
    write_bytes(path, text.encode("utf-8", "backslashreplace"))


def read_bytes(path: Path, most: int = 2**30, begin: bytes = b"") -> bytes:
    """Read a regular file of at most `most` bytes whole.

    A device, a pipe or a file that is too large is not read at all. If a file does not begin with
    `begin`, as many of its bytes are returned and no more are read. Memory is taken for the file's
    own size.

    Raises:
        FileError: the file is not there, not a regular one, or too large.
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
    """Return the message that rejects a file of `size` bytes."""
    return f"{path}: cannot be read: {size / 1e9:.3g} GB; it must have at most {most / 1e9:.3g}"


@contextmanager
def _opened(path: Path) -> Iterator[io.BufferedReader]:
    """Open a regular file for reading; a FileError at anything else."""
    try:  # a pipe without a writer would wait for one, but for O_NONBLOCK
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except ValueError:  # a name with a zero in it
        raise FileError(f"{path}: cannot be read: no such file") from None
    with os.fdopen(descriptor, "rb") as file:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise FileError(f"{path}: cannot be read: not a regular file")
        yield file


def read_text(path: Path, most: int = 2**30) -> str:
    """Read a file as text, with newlines of one kind and without a byte order mark.

    Raises:
        FileError: `read_bytes` cannot read it, or it is not UTF-8; the message names its encoding,
            or the line.
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
    """Reject text of two or four bytes for each letter, by a FileError that names the encoding."""
    for name, beginning in _WIDE.items():
        if beginning.match(content):
            raise FileError(f"{path}: this is {name} text; save it as UTF-8")


def remove(path: Path) -> None:
    """Remove a file where it is there, and partial files that killed processes have left."""
    with reported(path, "removed"):
        if path.exists():
            disk.remove(path)
        for abandoned in leftovers(path):
            disk.remove(abandoned)


def remove_tree(folder: Path) -> None:
    """Remove a folder and all that is in it; links are removed and not followed."""
    with reported(folder, "removed"):
        # in reverse, what is in a folder comes before the folder
        for path in sorted(folder.rglob("*"), reverse=True):
            if path.is_dir() and not path.is_symlink():
                disk.remove_folder(path)
            else:
                disk.remove(path)
        disk.remove_folder(folder)


def sealed(content: bytes) -> bytes:
    """Return content with its digest instead of `NO_DIGEST`, which it must have once."""
    begin, end = _place(content)
    if content[begin:end] != NO_DIGEST.encode():
        raise ValueError("no place for the digest")
    digest = hashlib.sha256(content).hexdigest().encode()
    return b"".join((content[:begin], digest, content[end:]))


def seal(content: bytearray) -> None:
    """Put its digest into content, like `sealed` but in place: large content is not copied."""
    begin, end = _place(content)
    if content[begin:end] != NO_DIGEST.encode():
        raise ValueError("no place for the digest")
    content[begin:end] = hashlib.sha256(content).hexdigest().encode()


def check_seal(path: Path, content: bytes) -> None:
    """Check the digest that content has of itself.

    Raises:
        FileError: there is none, or it is that of other content.
    """
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
    """Return where the digest begins and ends; a ValueError where there is not just one."""
    places = []
    position = content.find(_WORD)  # 50 times as fast as to let the pattern search
    while position >= 0:
        match = _DIGEST.match(content, position)
        if match is not None:
            places.append(match.span(1))
        position = content.find(_WORD, position + 1)
    if len(places) != 1:
        raise ValueError(f"{len(places)} digests instead of one")
    return places[0]


def digest(path: Path, most: float = math.inf) -> str:
    """Compute the SHA-256 of a file of at most `most` bytes, in hexadecimal digits.

    Its first 16 digits are the file's fingerprint.
    """
    with reported(path, "read"), _opened(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > most:
            raise FileError(_too_large(path, size, most))
        return hashlib.file_digest(file, "sha256").hexdigest()


def plain(value: Any) -> Any:
    """Return a value as strict JSON can hold it: dataclasses and arrays opened, "inf" as text."""
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
    """Read the entries of a sealed JSON object.

    Raises:
        FileError: `write_json` has not written it, or it was changed since.
    """
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
    """Read the columns (m,) of a CSV file by their headings; a FileError where it is no table."""
    names: list[str] = []
    try:
        names, *rows = csv.reader(read_text(path).splitlines() or [""])
        table = np.array([[float(entry) for entry in row] for row in rows])
        return dict(zip(names, table.reshape(len(rows), len(names)).T, strict=True))
    except (ValueError, csv.Error):
        columns = shortened(",".join(names[:3]), 80)
        raise FileError(f"{path}: not a table of {columns or 'names and numbers'}") from None


def flat(settings: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return the entries of nested tables by their dotted names, as `plain` values."""
    entries: dict[str, Any] = {}
    for name, value in settings.items():
        if isinstance(value, Mapping):
            entries |= flat(value, f"{prefix}{name}.")
        else:
            entries[f"{prefix}{name}"] = plain(value)
    return entries


def check_same(
    place: Path,
    settings: Mapping[str, Any],
    stored_settings: Mapping[str, Any],
    advice: str = START_OVER,
) -> None:
    """Check that output was made by the settings of this call.

    Args:
        place: the output.
        settings: those of this call, nested by section.
        stored_settings: those by which the output was made; those that only it has are ignored.
        advice: end of the error message.

    Raises:
        MismatchError: naming the first setting that differs.
    """
    stored = flat(stored_settings)
    for name, value in flat(settings).items():
        before = stored.get(name)
        if before != value:
            mine = "nothing" if value is None else value
            theirs = "nothing" if before is None else before
            raise MismatchError(
                f"{place}: {name}: this call has {mine}, what is there {theirs}; {advice}"
            )


def check_replaceable(path: Path, kind: str, *marks: str) -> None:
    """Check, before starting over, that a file is of the kind that is written there.

    Args:
        path: the file; one that is missing or empty may be written.
        kind: name of the kind, for the error message.
        marks: texts that every file of this kind has.

    Raises:
        FileError: it lacks one of these texts, so it may be somebody's own.
    """
    if path.exists() and path.stat().st_size and _missing(path, marks):
        raise FileError(
            f"{path}: not a {kind}, so --fresh does not replace it; write elsewhere or remove it "
            "first"
        )


def _missing(path: Path, texts: Iterable[str]) -> set[bytes]:
    """Return those of some texts that are not in a file, which is read block by block."""
    missing = {text.encode() for text in texts}
    overlap = max(map(len, missing), default=0)  # a text may lie across two blocks
    end_of_last = b""
    with reported(path, "read"), _opened(path) as file:
        while missing:
            block = file.read(_BLOCK)
            if not block:
                break
            content = end_of_last + block
            missing = {text for text in missing if text not in content}
            end_of_last = content[-overlap:]
    return missing


def keep(
    path: Path,
    identity: Mapping[str, Any],
    make: Callable[[], Mapping[str, Any]],
    *,
    fresh: bool = False,
) -> tuple[dict[str, Any], bool]:
    """Read a JSON file of these settings where it is there; else make and write it.

    Args:
        identity: the settings, which are entries of the file.
        make: returns the other entries, after it has written the files that belong to them.
        fresh: make it, whatever of this kind is there.

    Returns:
        The entries of the file, and whether it was there.

    Raises:
        MismatchError: it is there, by other settings, and not `fresh`.
        FileError: it is damaged or foreign, or another process is making it.
    """
    if fresh:
        check_replaceable(path, f"file of {', '.join(identity)}", SEAL, *identity)

    def stored() -> dict[str, Any] | None:
        """Return the entries of the file; None where it is to be made."""
        if fresh or not path.exists():
            return None
        entries = read_json(path)
        check_same(path, identity, entries)
        return entries

    # without a writer, a file that is there can be read without the lock
    entries = None if file_lock(path).exists() else stored()
    if entries is not None:
        return entries, True
    with locked_file(path):
        entries = stored()  # another process may have made it meanwhile
        if entries is not None:
            return entries, True
        entries = {**identity, **make()}
        write_json(path, entries)
        return entries, False


def folder_lock(folder: Path) -> Path:
    """Return the path of the lock for the content of a folder."""
    return folder / ".lock"


def file_lock(path: Path) -> Path:
    """Return the path of the lock of a file."""
    return path.with_name(f".{path.name}.lock")


def locked_folder(folder: Path) -> AbstractContextManager[None]:
    """Let only this call write into a folder, which is made where it is missing.

    Raises:
        FileError: another call does, which the message names, or the folder is not writable.
    """
    return _locked(folder_lock(folder), folder)


def locked_file(path: Path) -> AbstractContextManager[None]:
    """Let only this call write a file; see `locked_folder`."""
    return _locked(file_lock(path), path)


@contextmanager
def _locked(lock: Path, output: Path) -> Iterator[None]:
    """Hold a lock while a block runs; `output` is what it guards, for messages."""
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
    """Open, lock and sign a lock file; None where its holder removed it meanwhile."""
    flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW
    with ExitStack() as closing:
        file = closing.enter_context(io.FileIO(os.open(lock, flags, 0o666), "r+b"))
        try:
            is_locked = disk.lock(file, lock)
        except BlockingIOError:
            holder = _signature(file)
            if holder.startswith(_this_process()):
                user = "another call of this process"
            else:
                user = f"{holder}; wait for it or end it"
            raise FileError(f"{output}: in use by {user}") from None
        opened = os.fstat(file.fileno())
        is_still_there = lock.exists() and os.path.samestat(opened, lock.stat())
        if not is_still_there:
            return None
        if opened.st_size:  # signed, and not removed: its process did not end well
            state = "was killed" if is_locked else "was killed or is still at work"
            log.warning("%s: %s %s; this process resumes", output, _signature(file), state)
        now = datetime.now().astimezone().isoformat(timespec="seconds")
        command = " ".join([Path(sys.argv[0]).name, *sys.argv[1:]])[:100]
        signature = f"{_this_process()}since {now} ({command})"
        try:
            disk.write(file, signature.encode("utf-8", "backslashreplace"))
        except OSError:
            with suppress(OSError):
                disk.remove(lock)
            raise
        closing.pop_all()  # it stays open
        return file


def _this_process() -> str:
    """Return the beginning of this process's signature."""
    return f"process {os.getpid()} on {platform.node()} "


def _signature(file: io.FileIO) -> str:
    """Read who signed a lock; its content may be damaged or empty."""
    file.seek(0)
    signature = " ".join(file.read(10_000).decode("utf-8", "replace").split())[:200]
    if signature.startswith("process ") and signature.isprintable():
        return signature
    return "a process that did not say its name"
