"""Damaged files: what was written, or one error message that names the file.

All HDF5 and JSON files are read by `store.hdf5.reading` and `store.read_json`, which check their
digests first; so one file of each stands for them.
"""

import json
import os
from dataclasses import asdict
from time import perf_counter

import numpy as np
import pytest
from hypothesis import given

from surrofe2.base.errors import FileError
from surrofe2.recipe.recipe import load_recipe
from surrofe2.report.comparison import compare
from surrofe2.run.displacement_curve import DisplacementCurve
from surrofe2.store.meshes import load_mesh
from surrofe2.store.run_folder import read_run, write_curves, write_record
from surrofe2.store.samples import read_data_set
from surrofe2.store.store import plain
from tests.fuzz.fuzzing import LONGEST, Content, answered, damaged_bytes, examples, few_and_all
from tests.fuzz.test_recipes import ROOT
from tests.run_records import finished_record
from tests.store.gmsh_files import QUADS
from tests.store.small_data_set import write_all


def data_set(folder):
    write_all(folder / "set.h5")


def run(folder):
    recipe, t = load_recipe(ROOT / "data" / "bending-bar.toml"), np.arange(5.0)
    curves = {"tip": DisplacementCurve(t, np.stack([t, -t], axis=1))}
    write_curves(folder, curves, {"force hold x": t, "force hold y": -t}, {})
    record = finished_record(recipe, "rve", {"total": 3.0, "law": 2.0}, {"steps": 80})
    write_record(folder, record)


def compared_run(path):
    found = read_run(path.parent)
    json.dumps(asdict(compare([found, found])))
    return found.record, found.curve.displacement, found.history, found.record.compared()


def mesh(folder):
    (folder / "mesh.msh").write_text(QUADS, encoding="utf-8")


KINDS = {
    "set.h5": (data_set, read_data_set),
    "run.json": (run, compared_run),
    "curve.csv": (run, compared_run),
    "mesh.msh": (mesh, load_mesh),
}
"""How a file is written into a folder, and what reads it, by its name."""
UNSEALED = "mesh.msh"
"""Has no digest of its own."""


@pytest.fixture(scope="module", params=KINDS)
def stored(request, tmp_path_factory):
    """Path of a whole file, what is in it, and what reads it."""
    write, read = KINDS[request.param]
    folder = tmp_path_factory.mktemp("stored")
    write(folder)
    path = folder / request.param
    return path, Content(path.read_bytes()), read


@few_and_all(8, 1000)
def test_changed_bytes(stored, number):
    path, content, read = stored
    path.write_bytes(content)
    whole = None if path.name == UNSEALED else repr(plain([read(path)]))

    @examples(number)
    @given(damaged_bytes(content))
    def changed(damaged):
        path.write_bytes(damaged)
        with np.errstate(all="ignore"), answered(path.name):
            found = read(path)
            assert whole is None or repr(plain([found])) == whole

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
        with pytest.raises(FileError) as caught:
            read(path)
        assert "cannot be read" in str(caught.value)
        assert len(str(caught.value)) <= LONGEST
        assert perf_counter() - begin < 1.0
    finally:
        path.unlink()
        path.write_bytes(bytes(content))
