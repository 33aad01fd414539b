"""Tissue of several cell types: its recipes, their mistakes, and runs by all laws."""

import json
from functools import partial

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.law.regional_law import RegionalLaw
from surrofe2.macro import simulate
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.recipe.recipe import load_recipe
from surrofe2.rve import RveLaw
from surrofe2.store.run_folder import read_record, read_run
from surrofe2.store.samples import read_harvest
from surrofe2.store.tables import read_table
from surrofe2.workflow.rest import rest_study
from surrofe2.workflow.run import run_study
from tests.conftest import BAR, CELLS, LEARNING, WITHOUT_FILES, changed
from tests.laws import SoftCell, SquareLaw, StoppingLaw

ONE = '[cell]\npreset = "water"\n' + WITHOUT_FILES + BAR


@pytest.fixture
def invoke(invoke):
    return partial(invoke, law=SoftCell)


def test_each_cell_has_its_own_parameters_range_and_files(written):
    recipe = load_recipe(written(CELLS))
    skin, flesh = recipe.studies().values()
    assert skin.cell.parameters == CellParameters.preset("printed", wall_stiffness=8000.0)
    assert flesh.cell.parameters == CellParameters.preset("water")
    assert (skin.cell.range.rate, flesh.cell.range.rate) == (0.01, 0.02)
    assert (skin.cell.samples.seed, flesh.cell.samples.seed) == (2, 3)
    assert flesh.cell.samples.count == 40
    assert flesh.training_path().name == "flesh-surrogate.h5"
    assert recipe.fingerprint.split() == [
        skin.cell.parameters.fingerprint,
        flesh.cell.parameters.fingerprint,
    ]
    assert list(recipe.studies("flesh")) == ["flesh"]


def test_points_of_a_cell_are_those_of_its_regions(written):
    recipe = load_recipe(written(CELLS))
    points = recipe.points_of_cells(recipe.problem().mesh)
    # Elements are numbered along y, then x; each has five points.
    assert points["skin"].tolist() == [*range(5, 10), *range(15, 20)]
    rest = load_recipe(written(CELLS.replace('["inside"]', '["rest"]')))
    assert (rest.points_of_cells(rest.problem().mesh)["flesh"] == points["flesh"]).all()


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('["inside"]', '["insied"]', "cells.flesh.regions: insied; no such region; did you mean "),
        ('["inside"]', '["inside", "skin"]', "cells: element 1 at (25, 75) µm is in 2 of skin, "),
        ("0.0, 100.0, 50.0]", "0.0, 50.0, 50.0]", "cells: element 2 at (75, 25) µm is in 0"),
        ('["inside"]', '"inside"', "cells.flesh.regions: 'inside'; it must be a list"),
        ("[mesh]", "[cell]\n[mesh]", "cell: [cell] fills the tissue with one cell, [cells.NAME] "),
        ("wall_stiffness", "wall_stifness", "cells.skin.wall_stifness: unknown key; did you mean "),
        ("rate = 0.02", "rate = -1", "cells.flesh.range.rate: -1; it must be at least 0"),
        ("count = 40", 'file = "a.h5"', "samples.file: 'a.h5'; each cell has its own: give cells."),
        ("flesh.h5", "skin.h5", "cells.flesh.samples.file: 'skin.h5'; that is skin's"),
        ("[cells.skin]", '[cells."a b"]', "cells.a b: 'a b'; a name must be of letters, digits"),
    ],
)  # fmt: skip
def test_wrong_recipes_get_a_sentence(written, old, new, told):
    with pytest.raises(InputError) as caught:
        load_recipe(written(changed(CELLS, old, new))).problem()
    assert str(caught.value).startswith(f"recipe.toml: {told}")
    assert "\n" not in str(caught.value)


def test_each_cell_has_its_table(invoke, written, tmp_path):
    path = written(changed(CELLS, "duration = 4.0", "duration = 12.0", "-0.1]", "-0.5]"))
    command = "run", path, "--law", "table", "--out"
    invoke(*command, tmp_path / "first", law=SquareLaw)
    files = [tmp_path / "first" / f"table-{name}.h5" for name in ("skin", "flesh")]
    first = read_record(tmp_path / "first").counts
    tables = [read_table(file) for file in files]
    cells = load_recipe(path).cells.values()
    assert [table.cell for table in tables] == [cell.parameters for cell in cells]
    sizes = [len(table.records.centre) for table in tables]
    assert sum(sizes) == first["table_records"] == first["table_added"]
    assert min(sizes) > 1  # each begins with the undeformed state
    # Files are told apart by the cells that they are of, in whatever order they come.
    given = [entry for file in files[::-1] for entry in ("--table", file)]
    invoke(*command, tmp_path / "second", *given, law=SquareLaw)
    second = read_record(tmp_path / "second").counts
    assert second["table_records"] - second["table_added"] == sum(sizes)
    assert second["fallbacks"] < 0.85 * first["fallbacks"]
    moved = [displacement(tmp_path / name) for name in ("first", "second")]
    np.testing.assert_allclose(*moved, atol=1e-3 * abs(moved[0]).max())
    other = written(path.read_text().replace("8000.0", "7000.0"), "other.toml")
    refused = invoke("run", other, "--law", "table", "--out", tmp_path / "x", *given, code=1)
    assert f"error: --table: {files[0]}; cell parameters " in refused.stderr
    assert refused.stderr.endswith("are of none of the cells skin, flesh\n")


@pytest.fixture
def trained(invoke, written):
    """The recipe, with data set and surrogate of each cell."""
    path = written(CELLS)
    for command in ("generate", "train"):
        invoke(command, path)
    return path


def test_a_grid_learns_the_cells_that_it_changes(invoke, trained, tmp_path):
    out = tmp_path / "grid"
    stiffness = "cells.skin.wall_stiffness=8000,9000"
    invoke("grid", trained, "--out", out, "--law", "cached", "--set", stiffness)
    (made,) = out.glob("*-surrogate.h5")
    assert made.name == "cells.skin.wall_stiffness=9000-skin-surrogate.h5"
    records = [read_record(each.parent) for each in sorted(out.glob("*/run.json"))]
    used = [record.surrogate["fingerprint"].split() for record in records]
    names = [*records[0].recipe["cells"]]
    assert [a == b for a, b in zip(*used, strict=True)] == [name != "skin" for name in names]


@pytest.mark.slow
def test_refine_teaches_each_cell_until_it_knows(invoke, trained, written, tmp_path):
    path = written(changed(CELLS, "duration = 4.0", "duration = 8.0", "-0.1]", "-0.6]"))
    out = tmp_path / "refined"
    done = invoke("refine", path, "--out", out)
    rows = json.loads((out / "refine.json").read_text(encoding="utf-8"))["rounds"]
    by_cell = {name: [row for row in rows if row["cell"] == name] for name in ("skin", "flesh")}
    for name, own in by_cell.items():
        assert [row["round"] for row in own] == list(range(len(own)))
        assert own[0]["unknown"] > 0
        assert own[-1]["unknown"] == 0
        assert own[1]["samples"] == own[0]["samples"] + own[0]["added"]
        assert f"round 0: {name}: " in done.stdout
    assert by_cell["skin"][0]["added"] != by_cell["flesh"][0]["added"]
    files = [out / f"surrogate-{name}.h5" for name in by_cell]
    given = [entry for file in files[::-1] for entry in ("--surrogate", file)]
    run = "run", path, "--law", "cached", "--out"
    invoke(*run, tmp_path / "run", *given)
    record = read_record(tmp_path / "run")
    assert record.surrogate["file"] == ", ".join(file.name for file in files)
    assert record.counts["fallbacks"] < 0.1 * record.counts["hits"]
    twice = invoke(*run, tmp_path / "x", "--surrogate", files[0], "--surrogate", files[0], code=1)
    told = f"{files[0]} and {files[0]}; both are of cell skin, give one"
    assert twice.stderr == f"error: --surrogate: {told}\n"

    only = tmp_path / "only"
    done = invoke("refine", path, "--out", only, "--cell", "flesh", "--rounds", 1, code=1)
    assert "states still unknown after 1 rounds" in done.stderr
    assert not (only / "round-0" / "surrogate-skin.h5").exists()
    refused = invoke("refine", path, "--out", only, code=1)
    assert "--cell: this call has ['skin', 'flesh'], what is there ['flesh']" in refused.stderr


def displacement(folder):
    return read_run(folder).curve.displacement


@pytest.mark.parametrize("law", ["rve", "cached"])
def test_two_regions_of_one_cell_move_as_one_cell_does(invoke, written, tmp_path, law):
    two = changed(
        CELLS, '"water"', '"printed"', "8000.0", "4000.0", "seed = 2", "seed = 3", "rate = 0.02",
        "rate = 0.01",
    )  # fmt: skip
    one = '[cell]\npreset = "printed"\n' + LEARNING.replace("runs = 9", "runs = 0") + BAR
    folders = []
    for name, text in (("one", one), ("two", two)):
        path = written(text, f"{name}.toml")
        for command in ("generate", "train") if law == "cached" else ():
            invoke(command, path)
        folders.append(tmp_path / name)
        invoke("run", path, "--law", law, "--out", folders[-1])
    alone, both = map(displacement, folders)
    np.testing.assert_allclose(both, alone, rtol=0, atol=1e-6 * abs(alone).max())


@pytest.mark.slow
def test_cached_runs_learn_audit_and_go_on_by_cell(invoke, written, tmp_path, monkeypatch):
    path = written(CELLS)
    for command in ("generate", "train"):
        invoke(command, path, "--cell", "skin")
        assert not (tmp_path / "flesh-surrogate.h5").exists()
        done = invoke(command, path)
        assert "(already " in done.output
        assert "flesh" in done.output
    monkeypatch.setattr("surrofe2.workflow.run.CHECKPOINT_INTERVAL", 0.0)

    def run(folder, **more):
        command = ("run", path, "--law", "cached", "--out", tmp_path / folder, "--audit", "0.5")
        return invoke(*command, "--tolerance", "0.1", **more)

    done = run("whole")
    whole = read_record(tmp_path / "whole")
    assert list(whole.cache["cells"]) == ["skin", "flesh"]
    for name, cache in whole.cache["cells"].items():
        assert f"{name}: audit: {cache['audit']['audited']} of " in done.output
        assert cache["audit"]["audited"] > 10
        harvest = read_harvest(tmp_path / "whole" / f"harvest-{name}.h5")
        assert harvest.cell == load_recipe(path).cells[name].parameters
    assert whole.surrogate["file"] == "skin-surrogate.h5, flesh-surrogate.h5"

    class Stopping(SoftCell, StoppingLaw):
        def __init__(self):
            StoppingLaw.__init__(self, 12)

    run("stopped", law=Stopping, code=130)
    before = read_record(tmp_path / "stopped").cache["cells"]
    assert all(cache["audit"]["audited"] for cache in before.values())
    run("stopped")
    stopped = read_record(tmp_path / "stopped")
    np.testing.assert_array_equal(*map(displacement, (tmp_path / "whole", tmp_path / "stopped")))
    for name, cache in stopped.cache["cells"].items():
        of_whole = whole.cache["cells"][name]
        assert cache["audit"]["audited"] == of_whole["audit"]["audited"]
        assert cache["accepted"] == of_whole["accepted"]
    folders = [tmp_path / "whole", tmp_path / "stopped"]
    invoke("compare", *folders, "--out", tmp_path / "c")

    (tmp_path / "flesh-surrogate.h5").write_bytes((tmp_path / "skin-surrogate.h5").read_bytes())
    refused = run("other", code=1)
    told = "flesh-surrogate.h5: trained for cell.fluid_particle_mass = 2.7, not 0.27; "
    assert told in refused.stderr


def test_two_cells_of_true_particles(written, tmp_path):
    """The run is that of each cell's RVEs at the points of its regions, put together by hand."""
    path = written(CELLS.replace("duration = 4.0", "duration = 1.0"))
    recipe = load_recipe(path)
    record = run_study(recipe, "rve", tmp_path / "two")
    problem = recipe.problem()
    upper = problem.mesh.p.T[problem.mesh.t.T].mean(axis=1)[:, 1] > 50.0
    of_skin = np.repeat(upper, 5)
    law = RegionalLaw(
        {"skin": RveLaw(CellParameters.preset("printed", wall_stiffness=8000.0), recipe.rve),
         "flesh": RveLaw(CellParameters.preset("water"), recipe.rve)},
        {"skin": np.flatnonzero(of_skin), "flesh": np.flatnonzero(~of_skin)},
    )  # fmt: skip
    assert (law.density[of_skin] > 2.0 * law.density[~of_skin][0]).all()
    by_hand = simulate(problem, law, recipe.macro)
    expected = by_hand.curve.displacement  # of a reference settled anew: the same but for rounding
    np.testing.assert_allclose(displacement(tmp_path / "two"), expected, rtol=1e-9, atol=1e-12)
    assert record.counts["rve_solves"] == by_hand.effort["rve_solves"]
    alone = simulate(problem, law.laws["flesh"], recipe.macro).curve.displacement
    assert abs(alone - by_hand.curve.displacement).max() > 1e-3 * abs(alone).max()


def test_rest_asks_each_cell(written, tmp_path):
    same = CELLS.replace("wall_stiffness = 8000.0", 'preset = "water"')
    ends = {}
    for name, text in (("both", CELLS), ("same", same), ("one", ONE)):
        study = load_recipe(written(text, f"{name}.toml"))
        ends[name] = np.array(rest_study(study, tmp_path / name, load_steps=2).met["watched"])
    np.testing.assert_allclose(ends["same"], ends["one"], rtol=1e-6)
    assert np.linalg.norm(ends["both"] - ends["one"]) > 0.02 * np.linalg.norm(ends["one"])
