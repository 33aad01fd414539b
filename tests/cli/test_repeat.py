"""A run folder that runs again elsewhere, from the recipe, mesh and surrogates that it keeps."""

import re
import shutil
from dataclasses import replace

import numpy as np
import pytest

from surrofe2.base.errors import FileError
from surrofe2.recipe.recipe import load_recipe
from surrofe2.store.run_folder import RunFolder, read_record, read_run, write_record
from tests.conftest import BAR, RANGE, ROOT, changed
from tests.laws import SoftLaw, SquareLaw
from tests.store.gmsh_files import TRIANGLES

MESH = changed(
    TRIANGLES,
    "0 0 5\n2 0 5\n2 2 5\n0 2 5\n1 1 5",
    "0 0 5\n100 0 5\n100 100 5\n0 100 5\n50 50 5",
)
RECTANGLE = "width = 100.0\nheight = 100.0\nelements = [2, 2]\n"
LEAF = RANGE + changed(
    BAR,
    RECTANGLE,
    'file = "leaf.msh"\n',
    '"left"',
    '"base"',
    "[watch]\ntip = [100.0, 50.0]",
    "",
    "duration = 4.0",
    "duration = 0.5",
)


def moved_away(folder, path, *others):
    """The run folder at another place, where the recipe and other files are gone."""
    place = folder.with_name("elsewhere") / folder.name
    place.parent.mkdir()
    shutil.move(folder, place)
    for each in (path, *others):
        each.unlink()
    return place


def test_a_folder_runs_again_without_recipe_and_mesh(invoke, written, tmp_path):
    mesh = written(MESH, "leaf.msh")
    path = written(LEAF)
    first = tmp_path / "first"
    invoke("run", path, "--law", "rve", "--initialisation", "elastic", "--out", first)
    first = moved_away(first, path, mesh)
    again = invoke("run", first, "--out", tmp_path / "again")
    columns = len(read_run(first).series())
    assert f"repeated: all {columns} columns are the same to the bit" in again.stdout
    record = read_record(tmp_path / "again")
    assert record.initialisation == "elastic"
    assert record.met == read_record(first).met
    # the repetition can be repeated in its turn, and is kept when asked for again
    kept = invoke("run", first, "--out", tmp_path / "again")
    assert f"all {columns} columns" in kept.stdout
    assert (
        "same to the bit" in invoke("run", tmp_path / "again", "--out", tmp_path / "third").stdout
    )


def test_the_largest_difference_is_named(invoke, recipe_path, tmp_path):
    first = tmp_path / "first"
    again = tmp_path / "again"
    invoke("run", recipe_path, "--law", "rve", "--out", first)
    done = invoke("run", first, "--out", again, law=SoftLaw(a=45.0))
    found = re.search(r"largest difference (\S+) (\S+) in (.+?), (\S+) of the largest", done.stdout)
    before = read_run(first).series()
    after = read_run(again).series()
    name = found[3]
    assert found[2] == before[name].unit
    largest = abs(after[name].values - before[name].values).max()
    assert float(found[1]) == pytest.approx(largest, rel=0.06)  # two digits


@pytest.mark.usefixtures("trained")
def test_a_cached_run_keeps_its_surrogate(stand_in, invoke, recipe_path, surrogate_path, tmp_path):
    first = tmp_path / "cached"
    invoke("run", recipe_path, "--law", "cached", "--audit", 0.5, "--out", first)
    first = moved_away(first, recipe_path, surrogate_path)
    done = invoke("run", first, "--out", tmp_path / "again")
    assert "same to the bit" in done.stdout
    before = read_record(first)
    after = read_record(tmp_path / "again")
    assert after.recipe["cache"]["audit"] == 0.5
    assert after.surrogate["fingerprint"] == before.surrogate["fingerprint"]


def test_a_table_is_taken_from_where_it_began(invoke, recipe_path, tmp_path):
    learn = ("run", recipe_path, "--law", "table")
    invoke(*learn, "--out", tmp_path / "learnt", law=SquareLaw)
    table = tmp_path / "learnt" / "table.h5"
    invoke(*learn, "--table", table, "--out", tmp_path / "first", law=SquareLaw)
    first = moved_away(tmp_path / "first", table)
    done = invoke("run", first, "--out", tmp_path / "again", law=SquareLaw)
    assert "same to the bit" in done.stdout


@pytest.fixture
def first(invoke, recipe_path, tmp_path):
    folder = tmp_path / "first"
    invoke("rest", recipe_path, "--load-steps", 2, "--out", folder, law=SquareLaw)
    return folder


def test_a_rest_is_repeated_at_rest(invoke, first, tmp_path):
    done = invoke("run", first, "--out", tmp_path / "again", law=SquareLaw)
    assert "same to the bit" in done.stdout
    assert read_record(tmp_path / "again").counts["load_steps"] == 2


def test_what_cannot_be_repeated_is_one_line(invoke, first, tmp_path):
    out = tmp_path / "again"
    recipe = first / "input" / "recipe.toml"

    def refusal(*options):
        done = invoke("run", first, *options, code=1)
        assert not out.exists()
        return done.stderr

    assert "--law: not with a run folder, which states it" in refusal("--law", "rve", "--out", out)
    assert "that is the run to be repeated; write elsewhere" in refusal("--out", first)
    assert "not a run; make one" in invoke("run", tmp_path, "--out", out, code=1).stderr
    text = recipe.read_text(encoding="utf-8")
    recipe.write_text(text.replace("width = 100.0", "width = 90.0"), encoding="utf-8")
    assert f"{recipe}: damaged, or changed since the run was recorded" in refusal("--out", out)
    recipe.unlink()
    assert f"{recipe}: cannot be read: No such file" in refusal("--out", out)
    write_record(first, replace(read_record(first), inputs={}))
    assert "it keeps no input/recipe.toml, as runs saved from Python" in refusal("--out", out)
    write_record(first, replace(read_record(first), status="interrupted"))
    assert "the run is interrupted, and only a finished one is repeated; its command" in refusal(
        "--out", out
    )
    missing = invoke("run", ROOT / "data" / "bending-bar.toml", "--out", out, code=1)
    assert "--law: missing; it must be one of rve, surrogate, cached, table" in missing.stderr
    nowhere = invoke("run", tmp_path / "nowhere", "--out", out, code=1)
    assert "nowhere: cannot be read: No such file" in nowhere.stderr


def test_commands_that_take_no_folder_say_what_does(invoke, first, tmp_path):
    for command in (("check",), ("rest", "--out", tmp_path / "out")):
        refused = invoke(*command, first, code=1)
        text = refused.stdout + refused.stderr
        assert f"{first}: a folder; a recipe is a TOML file, such as {first / 'input'}" in text
        assert "`surrofe2 run` repeats the run" in text
    assert not (tmp_path / "out").exists()


def test_a_repeated_run_has_cell_fields_when_asked_for(invoke, recipe_path, tmp_path):
    again = tmp_path / "again"
    invoke("run", recipe_path, "--law", "rve", "--out", tmp_path / "first")
    done = invoke("run", tmp_path / "first", "--out", again, "--cell-fields")
    assert "cell fields of" in done.stdout
    assert "largest_wall_stretch" in (again / "fields.xdmf").read_text(encoding="utf-8")


def test_inputs_of_a_former_run_are_removed_alone(first):
    (first / "input" / "notes.txt").write_text("mine")
    record = replace(read_record(first), status="running")
    inputs = {"mesh.msh": b"new"}
    with RunFolder.open(first, record, lambda record, _: record, inputs=inputs, fresh=True):
        pass
    there = {path.name for path in (first / "input").iterdir()}
    assert there == {"mesh.msh", "notes.txt"}
    (first / "run.json").unlink()
    with (
        pytest.raises(FileError, match=r"has input/mesh\.msh but no run"),
        RunFolder.open(first, record, lambda record, _: record, fresh=True),
    ):
        pass


SHIPPED = sorted(path for name in ("data", "examples") for path in (ROOT / name).glob("*.toml"))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_the_text_of_a_recipe_states_the_same(written, path):
    recipe = load_recipe(path)
    mesh_file = None
    if recipe.mesh.file is not None:
        mesh_file = "mesh.msh"
        shutil.copy(path.parent / recipe.mesh.file, written("", mesh_file))
    again = load_recipe(written(recipe.to_toml(mesh_file, {}), "again.toml"))
    stated = again.to_dict()
    for name, entries in recipe.to_dict().items():
        if name not in ("recipe", "mesh", "time", "samples", "training", "cells"):
            assert stated[name] == entries
    assert again.macro == recipe.macro
    np.testing.assert_array_equal(again.problem().output_times(), recipe.problem().output_times())
    assert again.conditions == recipe.conditions
    assert again.fingerprint == recipe.fingerprint
    assert again.mesh == replace(recipe.mesh, file=mesh_file)
