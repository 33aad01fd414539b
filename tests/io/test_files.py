from __future__ import annotations

import json

import numpy as np
import pytest

from surrofe2.errors import FileError
from surrofe2.io.files import plain, read_json, replacing, write_json, write_text


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "a.txt"
    write_text(path, "old")

    def write_half():
        with replacing(path) as partial:
            partial.write_text("half")
            raise InterruptedError

    with pytest.raises(FileError):
        write_half()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


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
