"""After a fault of the disk at any operation, going on gives what it would have given."""

from __future__ import annotations

import pytest

from surrofe2.store import samples
from surrofe2.store.samples import read_data_set, writing_data_set
from surrofe2.store.store import write_text
from tests.faults import KINDS, each_fault
from tests.laws import SoftLaw
from tests.store.small_data_set import HEADER, append_chunk


def fill(folder):
    with writing_data_set(folder / "cells.h5", HEADER) as data:
        while data.completed < HEADER.count:
            append_chunk(data, SoftLaw(fails_above=1.03))
        return data.finish()


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
