"""Recipes: what they give, and the one sentence each mistake gets."""

import json
from pathlib import Path

import pytest

from surrofe2 import LoadCase
from surrofe2.base.errors import FileError, InputError
from surrofe2.plant_cell.measurements import living_cell
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.recipe.recipe import PROBLEM_SECTIONS, load_recipe, make_recipe
from surrofe2.workflow.check import lines_of_cells
from surrofe2.workflow.laws import recipe_notes

MESH = {"width": 300.0, "height": 300.0, "elements": [1, 1]}
HELD = {"foot": {"kind": "fixed", "on": "left"}}
RECIPES = sorted((Path(__file__).parents[2] / "data").glob("*.toml"))


def message(error, path):
    with pytest.raises(error) as caught:
        load_recipe(path)
    return str(caught.value)


@pytest.mark.parametrize("path", RECIPES, ids=lambda path: path.name)
def test_shipped_recipes_load(path):
    recipe = load_recipe(path)
    if recipe.study().cell.samples.file is None:  # a press at rest, by RVEs
        assert path.name.startswith("apple-press")
        return
    assert recipe.study().data_path().parent == path.parent
    assert recipe.study().training_path().resolve().parent == path.parents[1] / "training"


def test_shipped_recipes_are_the_paper_s_bar():
    shipped = {path.stem: load_recipe(path) for path in RECIPES}
    printed = shipped["bending-bar"]
    empty = make_recipe({})
    assert all(getattr(printed, name) == getattr(empty, name) for name in PROBLEM_SECTIONS)
    assert printed.study().cell.parameters == CellParameters.preset("printed")
    assert shipped["bending-bar-water"].study().cell.parameters == CellParameters.preset("water")
    triple = shipped["bending-bar-triple-load"]
    weights = [each.conditions[-1].acceleration for each in (printed, triple)]
    assert weights[1] == pytest.approx((0.0, 3 * weights[0][1]))
    assert triple.study().data_path() == printed.study().data_path()
    assert triple.study().training_path() == printed.study().training_path()


def test_single_constants_change_a_preset():
    recipe = make_recipe(
        {
            "cell": {"preset": "water", "wall_stiffness": 1000},
            "range": {"stretch": [0.9, 1.1], "shear": 0.1, "rate": 0.01},
        }
    )
    assert recipe.study().cell.parameters == CellParameters.preset("water", wall_stiffness=1000.0)
    assert recipe.problem().conditions == LoadCase().conditions
    by_paper = make_recipe({"cell": {"preset": "ghysels2009-light", "wall_stiffness": 1000}})
    assert (by_paper.study().cell.preset, by_paper.study().cell.parameters) == (
        "water",
        recipe.study().cell.parameters,
    )


def test_files_are_relative_to_the_recipe(recipe, recipe_path):
    assert recipe.study().data_path() == recipe_path.parent / "cells.h5"


def test_to_dict_is_strict_json_without_folders(recipe, recipe_path):
    text = json.dumps(recipe.to_dict(), allow_nan=False)
    assert str(recipe_path.parent) not in text
    assert json.loads(text) == recipe.to_dict()
    assert recipe.to_dict()["cell"]["wall_stiffness"] == 4000.0


SECTIONS = (
    "known are bodies, cache, calibration, cell, cells, conditions, image, load, macro, mesh, "
    "range, rest, rve, sam"  # long lists are shortened in the middle
)
FORCE = "body_force = [0.0, -0.1]"


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('preset = "printed"', "wall_stifness = 4000.0", "cell.wall_stifness: unknown key; did you "
         "mean wall_stiffness? known are area_variation, arrangement, arrangement_seed, "),
        ("[load]", "[lood]", f"lood: unknown section; did you mean load? {SECTIONS}"),
        ('"printed"', '"prinetd"',
         "cell.preset: 'prinetd'; it must be one of printed, water, apple, potato"),
        ("count = 40", "count = 40.5", "samples.count: 40.5; it must be an integer"),
        ("count = 40", "count = 0", "samples.count: 0; it must be an integer of at least 1"),
        (FORCE, 'body_force = [0.0, "g"]', "load.body_force[1]: 'g'; it must be a number (µm/µs²)"),
        (FORCE, "body_force = [0.0]", "load.body_force: [0.0]; it must be a list of 2 (µm/µs²)"),
        ("[0.95, 1.05]", "[1.05, 0.95]",
         "range.stretch: (1.05, 0.95); low must be below high, both positive"),
        ("[range]", '[rve]\ninitialisation = "born"\n[range]', "rve.initialisation: 'born'; it "
         "must be one of cauchy-born, elastic, constrained-runs, slow-manifold"),
        ("[cell]", "[cell", "not TOML: "),
    ],
)  # fmt: skip
def test_a_mistake_gets_one_sentence(changed_recipe, old, new, sentence):
    told = message(InputError, changed_recipe(old, new))
    assert told.startswith(f"recipe.toml: {sentence}")
    assert "\n" not in told


@pytest.mark.parametrize(
    ("part", "ask", "sentence"),
    [
        ("[range]\nstretch = [0.95, 1.05]\nshear = 0.05\nrate = 0.01\n", "sampling_range",
         "range: missing; this command needs the section [range] with stretch, shear and rate "),
        ('file = "cells.h5"\n', "data_path",
         "samples.file: missing; this command needs the file of the data set (.h5), relative to"),
    ],
)  # fmt: skip
def test_what_is_missing_is_told_by_the_command_that_needs_it(changed_recipe, part, ask, sentence):
    study = load_recipe(changed_recipe(part, "")).study()
    with pytest.raises(InputError) as caught:
        getattr(study, ask)()
    assert str(caught.value).startswith(f"recipe.toml: {sentence}")


def test_no_such_recipe(tmp_path):
    path = tmp_path / "none.toml"
    assert message(FileError, path) == f"{path}: cannot be read: No such file or directory"


@pytest.mark.parametrize(
    ("cell", "named"),
    [
        ({}, None),
        ({"preset": "apple"}, "apple, square"),
        ({"preset": "apple", "fluid": "uniform"}, None),
        ({"preset": "apple", "fluid": "sph"}, None),
        ({"arrangement": "hexagon"}, "printed, hexagon"),
        ({"fluid": "uniform"}, None),
    ],
)
def test_a_note_says_where_a_fluid_that_is_not_named_is_another_than_before(cell, named):
    notes = list(recipe_notes(make_recipe({"cell": cell})))
    assert len(notes) == (named is not None)
    for text, is_warning in notes:
        assert f"default of {named}; earlier versions" in text
        assert not is_warning


def test_measurements_stand_in_a_cell_beside_its_preset():
    entries = {"preset": "apple", "turgor": 0.8, "wall_modulus": 400, "arrangement": "hexagon"}
    changes = {key: value for key, value in entries.items() if key != "preset"}
    expected = living_cell("apple", **changes)
    assert make_recipe({"cell": entries}).study().cell.parameters == expected
    section = {
        "mesh": MESH,
        "conditions": HELD,
        "cells": {"pith": {**entries, "regions": ["rest"]}},
    }
    assert make_recipe(section).cells["pith"].parameters == expected


def test_measurements_can_be_changed_as_a_grid_does(changed_recipe):
    path = changed_recipe('preset = "printed"', 'preset = "apple"')
    cells = [
        load_recipe(path, {"cell.turgor": value}).study().cell.parameters for value in (0.2, 0.4)
    ]
    assert cells == [living_cell("apple", turgor=value) for value in (0.2, 0.4)]
    assert cells[0].fingerprint != cells[1].fingerprint


@pytest.mark.parametrize(
    ("entries", "sentence"),
    [
        ({"preset": "apple", "turgor": 0}, "cell.turgor: 0; walls here do not resist bending"),
        (
            {"preset": "apple", "turgor": -1},
            "cell.turgor: -1; it must be positive and finite",
        ),
        ({"preset": "apple", "turgr": 1}, "cell.turgr: unknown key; did you mean turgor?"),
        ({"turgor": 0.4}, "cell.turgor: 0.4; preset printed is made of constants: take apple or"),
        ({"preset": "apple", "density": "high"}, "cell.density: 'high'; it must be a number"),
    ],
)
def test_a_measurement_that_cannot_be_gets_one_sentence(entries, sentence):
    with pytest.raises(InputError) as caught:
        make_recipe({"cell": entries})
    assert str(caught.value).startswith(sentence)


def test_a_constant_that_a_measurement_determines_is_named():
    entries = {"preset": "apple", "fluid": "uniform", "turgor": 0.8, "sound_speed": 20.0}
    assert list(recipe_notes(make_recipe({"cell": entries}))) == [
        ("cell.sound_speed: not taken, as cell.turgor determines it", True)
    ]


def test_a_check_says_measurements_and_constants():
    lines = lines_of_cells(make_recipe({"cell": {"preset": "apple", "turgor": 0.8}}))
    assert lines[0].startswith("plant cell: cell_size 150 µm, turgor 0.8 MPa, wall_modulus 300 MPa")
    assert lines[1].startswith("  as constants: cell_side 150 µm, sound_speed ")
    assert "turgor by `surrofe2 moduli`" in lines_of_cells(make_recipe({}))[0]
