from __future__ import annotations

import errno
import json
import os

import numpy as np
import pytest

from surrofe2.base.errors import FileError
from surrofe2.store import disk
from surrofe2.store.store import (
    NO_DIGEST,
    SEAL,
    partial_of,
    plain,
    read_json,
    sealed,
    write_bytes,
    write_json,
    write_text,
)


@pytest.mark.parametrize("operation", ["write", "sync", "move"])
def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch, operation):
    path = tmp_path / "a.txt"
    write_text(path, "old")

    def full(*arguments):
        if operation == "write":
            arguments[0].write_bytes(b"half")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(disk, operation, full)
    with pytest.raises(FileError) as caught:
        write_text(path, "new")
    assert str(caught.value) == f"{path}: cannot be written: No space left on device"
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_nothing_is_written_through_a_link(tmp_path):
    (tmp_path / "mine").write_text("mine")
    partial_of(tmp_path / "a.txt").symlink_to(tmp_path / "mine")
    with pytest.raises(FileError):
        write_text(tmp_path / "a.txt", "text")
    assert (tmp_path / "mine").read_text() == "mine"


def test_no_write_permission(unwritable):
    path = unwritable / "a.json"
    with pytest.raises(FileError) as caught:
        write_json(path, {})
    assert str(caught.value) == f"{path}: cannot be written: Not a directory"


def test_plain_values_are_strict_json():
    value = {"a": np.float64(1.5), 2: (np.arange(2), float("inf")), "n": None, "b": True}
    assert json.loads(json.dumps(plain(value), allow_nan=False)) == {
        "a": 1.5,
        "2": [[0, 1], "inf"],
        "n": None,
        "b": True,
    }


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


def test_json_without_a_seal_is_refused(tmp_path):
    path = tmp_path / "a.json"
    path.write_text("{}")
    with pytest.raises(FileError) as caught:
        read_json(path)
    assert str(caught.value) == f"{path}: no SHA-256 in it; it is damaged, foreign or older"


def test_json_whose_seal_stands_elsewhere_is_refused(tmp_path):
    path = tmp_path / "a.json"
    write_bytes(path, sealed(json.dumps({"inside": {SEAL: NO_DIGEST}}).encode()))
    with pytest.raises(FileError, match="no SHA-256 in it"):
        read_json(path)
