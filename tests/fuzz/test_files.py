"""Damaged files: what was written, or one sentence that names the file."""

from __future__ import annotations

import os
from time import perf_counter

import numpy as np
import pytest
from hypothesis import given

from surrofe2.store.store import plain
from tests.fuzz.fuzzing import Content, answered, damaged_bytes, examples, few_and_all
from tests.fuzz.stored import KINDS, UNSEALED


@pytest.fixture(scope="module", params=KINDS)
def stored(request, tmp_path_factory):
    """Path of a whole file, what is in it, and what reads it."""
    write, read = KINDS[request.param]
    folder = tmp_path_factory.mktemp("stored")
    write(folder)
    path = folder / request.param
    return path, Content(path.read_bytes()), read


def check(path, content, read, whole=None):
    """Read other content; where `whole` is given, it is what must be read."""
    path.write_bytes(content)
    with np.errstate(all="ignore"), answered(path.name):
        found = read(path)
        if whole is not None and found is not None:
            assert repr(plain([found])) == whole


@few_and_all(30, 1000)
def test_changed_bytes(stored, number):
    path, content, read = stored
    path.write_bytes(content)
    whole = None if path.suffix in UNSEALED else repr(plain([read(path)]))

    @examples(number)
    @given(damaged_bytes(content))
    def changed(damaged):
        check(path, damaged, read, whole)

    changed()


@pytest.mark.parametrize("kind", ["device", "pipe", "sparse file"])
def test_a_file_without_end_is_refused_at_once(stored, kind):
    path, content, read = stored
    path.unlink()
    if kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "pipe":
        os.mkfifo(path)
    else:
        with path.open("wb") as file:
            file.write(bytes(content[:512]))
            file.truncate(60 * 10**9)
    begin = perf_counter()
    try:
        with answered(path.name, "cannot be read"):
            assert read(path) is None  # as a reference state does
        assert perf_counter() - begin < 1.0
    finally:
        path.unlink()
        path.write_bytes(bytes(content))
