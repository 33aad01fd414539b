import errno
import fcntl
import json
import os
import signal
import stat
from contextlib import suppress

import pytest

from surrofe2.base import interruption
from surrofe2.base.errors import FileError
from surrofe2.store import disk, samples, store
from surrofe2.store.samples import read_data_set, writing_data_set
from surrofe2.store.store import (
    NO_DIGEST,
    SEAL,
    file_lock,
    keep,
    locked_file,
    read_json,
    remove,
    sealed,
    write_bytes,
    write_json,
    write_text,
)
from tests.faults import KINDS, each_fault
from tests.laws import SoftLaw
from tests.store.small_data_set import HEADER, append_chunk


@pytest.mark.parametrize("operation", ["create", "write", "sync", "move"])
def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch, operation):
    path = tmp_path / "a.txt"
    write_text(path, "old")

    def full(*arguments):
        if operation == "write":
            arguments[0].write(b"half")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(disk, operation, full)
    with pytest.raises(FileError) as caught:
        write_text(path, "new")
    assert str(caught.value) == f"{path}: cannot be written: No space left on device"
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("operation", ["open", "fsync"])
@pytest.mark.parametrize("number", [errno.EINVAL, errno.EIO, errno.ENOTSUP, errno.EACCES])
def test_a_folder_that_cannot_be_synchronised_takes_files(tmp_path, monkeypatch, operation, number):
    path, usual = tmp_path / "a.txt", getattr(os, operation)

    def refusing(file, *arguments):
        if _is_folder(file):
            raise OSError(number, os.strerror(number))
        return usual(file, *arguments)

    monkeypatch.setattr(os, operation, refusing)
    write_text(path, "text")
    monkeypatch.undo()
    assert path.read_text() == "text"
    assert [*tmp_path.iterdir()] == [path]


def _is_folder(file):
    """Whether a name or an open file is a folder."""
    try:
        return stat.S_ISDIR(os.stat(file).st_mode)
    except FileNotFoundError:
        return False


@pytest.mark.parametrize("number", [errno.EIO, errno.ENOSPC])
def test_a_file_that_cannot_be_synchronised_is_not_written(tmp_path, monkeypatch, number):
    def full(*_):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(FileError, match=os.strerror(number)):
        write_text(tmp_path / "a.txt", "text")
    assert not [*tmp_path.iterdir()]


def test_an_interruption_leaves_no_partial_file_as_it_is_created(tmp_path, monkeypatch):
    """As a signal does that comes when the file is there and nothing has been written yet."""
    create = disk.create

    def interrupted(partial):
        file = create(partial)
        interruption._raise_again(signal.SIGINT, None)
        return file

    monkeypatch.setattr(disk, "create", interrupted)
    with suppress(KeyboardInterrupt):
        write_text(tmp_path / "a.txt", "new")
    assert not [*tmp_path.glob(".*.partial")]


def test_nothing_is_written_through_a_link_or_into_a_file_that_is_there(tmp_path, monkeypatch):
    monkeypatch.setattr(store, "token_hex", lambda n: "01234567")
    mine, partial = tmp_path / "mine", tmp_path / ".a.txt.01234567.partial"
    mine.write_text("mine")
    for put in (partial.symlink_to, partial.hardlink_to):
        put(mine)
        with mine.open() as held:
            fcntl.flock(held, fcntl.LOCK_EX)  # else it is left by a killed process, and removed
            with pytest.raises(FileError):
                write_text(tmp_path / "a.txt", "text")
        assert mine.read_text() == "mine"
        partial.unlink()
    file_lock(tmp_path / "a.txt").symlink_to(mine)
    with pytest.raises(FileError), locked_file(tmp_path / "a.txt"):
        pass
    assert mine.read_text() == "mine"


def test_what_a_killed_process_was_writing_is_removed_and_nothing_else(tmp_path):
    path, names = tmp_path / "a.txt", (".a.txt.01234567.partial", ".a.txt.89abcdef.partial")
    others = [tmp_path / name for name in (".b.a.txt.01234567.partial", ".a.txt.mine.partial")]
    dead, alive = (tmp_path / name for name in names)
    for each in (dead, alive, *others):
        each.touch()
    with alive.open() as held:
        fcntl.flock(held, fcntl.LOCK_EX)  # as a process that writes it does
        write_text(path, "text")
        assert sorted(tmp_path.iterdir()) == sorted([path, alive, *others])
    remove(path)
    assert sorted(tmp_path.iterdir()) == sorted(others)


@pytest.mark.parametrize("content", [b"[cell]", b"{}", b"surrofe2-run"])
def test_starting_over_replaces_no_file_of_another_kind(tmp_path, content):
    path, made = tmp_path / "a.json", lambda: {"states": 1}
    path.write_bytes(content)
    with pytest.raises(FileError, match="so --fresh does not replace it"):
        keep(path, {"asked": 1}, made, fresh=True)
    assert path.read_bytes() == content
    path.unlink()
    keep(path, {"asked": 2}, made)
    assert keep(path, {"asked": 1}, made, fresh=True) == ({"asked": 1, "states": 1}, False)


def test_names_that_are_not_utf8_are_kept_as_escapes(tmp_path):
    path, name = tmp_path / "a.json", os.fsdecode(b"r\xff.toml")
    write_json(path, {name: name})
    assert read_json(path) == {"r\\udcff.toml": "r\\udcff.toml"}
    write_text(path, name)
    assert path.read_text() == "r\\udcff.toml"


@pytest.mark.parametrize(("text", "what"), [("{", "not a JSON file"), ("[]", "not a JSON object")])
def test_damaged_json(tmp_path, text, what):
    path = tmp_path / "a.json"
    path.write_text(text)
    with pytest.raises(FileError) as caught:
        read_json(path)
    assert str(caught.value) == f"{path}: {what}; it is damaged or foreign"


def test_json_comes_back_and_a_changed_one_is_refused(tmp_path):
    path = tmp_path / "a.json"
    write_json(path, {"b": 1.5, "names": ["µ"]})
    assert read_json(path) == {"b": 1.5, "names": ["µ"]}
    path.write_text(path.read_text().replace("1.5", "1.6"))
    with pytest.raises(FileError, match="changed since it was written"):
        read_json(path)


def test_json_whose_seal_stands_elsewhere_is_refused(tmp_path):
    path = tmp_path / "a.json"
    write_bytes(path, sealed(json.dumps({"inside": {SEAL: NO_DIGEST}}).encode()))
    with pytest.raises(FileError, match="no SHA-256 in it"):
        read_json(path)


def fill(folder):
    with writing_data_set(folder / "cells.h5", HEADER) as data:
        while data.completed < HEADER.count:
            append_chunk(data, SoftLaw(fails_above=1.03))
        return data.finish()


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_data_set_loses_no_row(tmp_path, kind, monkeypatch):
    monkeypatch.setattr(samples, "INTERVAL", 0.0)
    whole = fill(tmp_path / "whole")
    met = 0
    for folder in each_fault(kind, tmp_path, fill):
        met += 1
        assert fill(folder).fingerprint == whole.fingerprint
        assert read_data_set(folder / "cells.h5").fingerprint == whole.fingerprint
        assert [path.name for path in folder.iterdir()] == ["cells.h5"]
    assert met >= 25


@pytest.mark.parametrize("kind", KINDS)
def test_a_file_is_the_former_or_the_new_one(tmp_path, kind):
    def write_twice(folder):
        write_text(folder / "a.txt", "former")
        write_text(folder / "a.txt", "new")

    for folder in each_fault(kind, tmp_path, write_twice):
        path = folder / "a.txt"
        assert not path.exists() or path.read_text() in ("former", "new")
