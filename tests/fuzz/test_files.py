"""Damaged files: what was written, or one sentence that names the file."""

from __future__ import annotations

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
