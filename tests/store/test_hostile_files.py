"""Files made to harm: what they name is not read, what they say does not run, nothing hangs."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from surrofe2 import load_recipe
from surrofe2.base.errors import FileError, InputError
from surrofe2.store.c_source import c_source
from surrofe2.store.meshes import read_mesh
from surrofe2.store.samples import read_data_set
from surrofe2.store.store import read_bytes
from surrofe2.store.surrogates import read_surrogate, write_surrogate
from tests.store.gmsh_files import QUADS
from tests.surrogate.networks import make_law

CODE = "x */\n__attribute__((constructor)) static void run(void) { *(int *)0 = 0; } /*"


@pytest.mark.parametrize("name", ["version", "data_fingerprint", "initialisation"])
def test_no_text_of_a_forged_surrogate_gets_into_c(tmp_path, name):
    path = tmp_path / "forged.h5"
    write_surrogate(replace(make_law(), **{name: CODE}), path)
    with pytest.raises((FileError, InputError), match=name):
        c_source(read_surrogate(path))


@pytest.fixture
def endless(tmp_path):
    """A pipe that nobody writes to, a device without end, a file of 60 GB that takes no room."""
    os.mkfifo(tmp_path / "pipe")
    with (tmp_path / "large").open("wb") as file:
        file.write(b"\x89HDF\r\n\x1a\n")
        file.truncate(60 << 30)
    with (tmp_path / "text").open("wb") as file:
        file.truncate(60 << 30)
    return [tmp_path / "pipe", "/dev/zero", tmp_path / "large", tmp_path / "text"]


def test_what_has_no_end_is_refused_at_once(endless):
    for path in endless:
        for read in (read_data_set, read_surrogate, load_recipe):
            with pytest.raises(FileError, match=r"a pipe or a device|bytes"):
                read(path)


def test_a_file_that_states_another_size_is_refused_before_it_is_read(tmp_path):
    path = tmp_path / "law.h5"
    write_surrogate(make_law(), path)
    path.write_bytes(read_bytes(path) + b"more")
    with pytest.raises(FileError, match="it says"):
        read_surrogate(path)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("cut.off", "OFF\n4 2 0\n0 0 0\n", "must be one of .msh"),
        ("far.msh", QUADS.replace("1 3 0\n0 0 0", "1 3 0\n0 0 0"), ""),
        ("tag.msh", QUADS.replace("\n12\n0 0 0", "\n1000000000\n0 0 0"), "takes more|not a mesh"),
        ("cells.vtk", "# vtk DataFile Version 3.0\nx\nASCII\nDATASET UNSTRUCTURED_GRID\n"
         "POINTS 3 double\n0 0 0 1 0 0 0 1 0\nCELLS 1 4\n3 0 1 7\nCELL_TYPES 1\n5\n",
         "points that are not in the file"),
    ],
)  # fmt: skip
def test_a_damaged_mesh_is_refused_within_limits(tmp_path, name, content, message):
    path = tmp_path / name
    path.write_text(content)
    if not message:
        assert read_mesh(path).nelements
        return
    with pytest.raises((FileError, InputError), match=message):
        read_mesh(path)


def test_bytes_of_a_mesh_changed_at_random_are_read_or_refused(tmp_path):
    rng, content = np.random.default_rng(1), QUADS.encode()
    for k in range(12):
        changed = bytearray(content)
        changed[rng.integers(len(content))] = rng.integers(256)
        path = tmp_path / f"{k}.msh"
        path.write_bytes(changed[: rng.integers(len(content) // 2, len(content) + 1)])
        with suppress(FileError, InputError):
            read_mesh(path)
