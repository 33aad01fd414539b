"""Recipes: what they give, and the one sentence each mistake gets."""

from __future__ import annotations

import json
from dataclasses import FrozenInstanceError
from pathlib import Path

import pytest

from surrofe2.errors import FileError, InputError
from surrofe2.load_case import LoadCase
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.recipe import load_recipe, make_recipe

RECIPES = sorted((Path(__file__).parents[1] / "data").glob("*.toml"))


def message(error, path):
    with pytest.raises(error) as caught:
        load_recipe(path)
    return str(caught.value)


@pytest.mark.parametrize("path", RECIPES, ids=lambda path: path.name)
def test_shipped_recipes_load(path):
    recipe = load_recipe(path)
    assert recipe.data_path().parent == path.parent
    assert recipe.training_path().resolve().parent == path.parents[1] / "training"


def test_shipped_recipes_are_the_paper_s_bar():
    shipped = {path.stem: load_recipe(path) for path in RECIPES}
    printed = shipped["bending-bar"]
    assert printed.load == LoadCase()
    assert printed.cell == CellParameters.preset("printed")
    assert shipped["bending-bar-water"].cell == CellParameters.preset("water")
    triple = shipped["bending-bar-triple-load"]
    assert triple.load.body_force == pytest.approx((0.0, 3 * printed.load.body_force[1]))
    assert triple.data_path() == printed.data_path()
    assert triple.training_path() == printed.training_path()


def test_single_constants_change_a_preset():
    recipe = make_recipe(
        {
            "cell": {"preset": "water", "wall_stiffness": 1000},
            "range": {"stretch": [0.9, 1.1], "shear": 0.1, "rate": 0.01},
        }
    )
    assert recipe.cell == CellParameters.preset("water", wall_stiffness=1000.0)
    assert recipe.load == LoadCase()


def test_files_are_relative_to_the_recipe(recipe, recipe_path):
    assert recipe.data_path() == recipe_path.parent / "cells.h5"


def test_recipe_is_frozen(recipe):
    with pytest.raises(FrozenInstanceError):
        recipe.preset = "water"


def test_to_dict_is_strict_json_without_folders(recipe, recipe_path):
    text = json.dumps(recipe.to_dict(), allow_nan=False)
    assert str(recipe_path.parent) not in text
    assert json.loads(text) == recipe.to_dict()
    assert recipe.to_dict()["cell"]["wall_stiffness"] == 4000.0


def test_unknown_key(changed_recipe):
    path = changed_recipe('preset = "printed"', "wall_stifness = 4000.0")
    text = message(InputError, path)
    assert text.startswith(
        "recipe.toml: cell.wall_stifness: unknown key; did you mean wall_stiffness? "
        "known are arrangement, arrangement_seed, cell_side, cells, "
    )
    assert "\n" not in text


def test_unknown_section(changed_recipe):
    path = changed_recipe("[load]", "[lood]")
    assert message(InputError, path) == (
        "recipe.toml: lood: unknown section; did you mean load? "
        "known are bodies, cache, calibration, cell, cells, conditions, load, macro, mesh, range, "
        "rve, samples, surface, table, time, tissue, training, watch"
    )


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (
            'preset = "printed"',
            'wall_stiffness = "4000"',
            "cell.wall_stiffness: '4000'; it must be a number (µN/µm)",
        ),
        ("count = 40", "count = 40.5", "samples.count: 40.5; it must be an integer"),
        ("count = 40", "count = true", "samples.count: True; it must be an integer"),
        ('file = "cells.h5"', "file = 3", "samples.file: 3; it must be a text in quotes"),
        (
            "body_force = [0.0, -0.1]",
            'body_force = [0.0, "g"]',
            "load.body_force[1]: 'g'; it must be a number (µm/µs²)",
        ),
        (
            "body_force = [0.0, -0.1]",
            "body_force = -0.1",
            "load.body_force: -0.1; it must be a list of 2 (µm/µs²)",
        ),
        (
            "body_force = [0.0, -0.1]",
            "body_force = [0.0]",
            "load.body_force: [0.0]; it must be a list of 2 (µm/µs²)",
        ),
    ],
)
def test_wrong_type(changed_recipe, old, new, sentence):
    path = changed_recipe(old, new)
    assert message(InputError, path) == f"recipe.toml: {sentence}"


def test_value_in_place_of_a_section(recipe_path):
    recipe_path.write_text("samples = 5\n", encoding="utf-8")
    assert message(InputError, recipe_path) == (
        "recipe.toml: samples: 5; it must be a section [samples]"
    )


def test_missing_key(changed_recipe):
    path = changed_recipe("shear = 0.05\n", "")
    assert message(InputError, path) == "recipe.toml: range.shear: missing; it must be given"


def test_a_missing_range_is_told_by_the_command_that_needs_it(changed_recipe):
    path = changed_recipe("[range]\nstretch = [0.95, 1.05]\nshear = 0.05\nrate = 0.01\n", "")
    recipe = load_recipe(path)
    assert "range" not in recipe.to_dict()
    with pytest.raises(InputError) as caught:
        recipe.sampling_range()
    assert str(caught.value) == (
        "recipe.toml: range: missing; this command needs the section [range] with stretch, shear "
        "and rate (1/µs)"
    )


def test_missing_file_key_is_told_by_the_command_that_needs_it(changed_recipe):
    recipe = load_recipe(changed_recipe('file = "cells.h5"\n', ""))
    with pytest.raises(InputError) as caught:
        recipe.data_path()
    assert str(caught.value) == (
        "recipe.toml: samples.file: missing; this command needs the file of the data set (.h5), "
        "relative to the recipe"
    )


@pytest.mark.parametrize(
    ("key", "value"),
    [("wall_particle_mass", -0.5), ("fluid_particle_mass", 0.0), ("wall_stiffness", -4000.0)],
)
def test_mass_and_stiffness_must_be_positive(changed_recipe, key, value):
    path = changed_recipe('preset = "printed"', f"{key} = {value}")
    assert message(InputError, path) == (
        f"recipe.toml: cell.{key}: {value}; it must be positive and finite"
    )


def test_unknown_preset(changed_recipe):
    path = changed_recipe('"printed"', '"prinetd"')
    assert message(InputError, path) == (
        "recipe.toml: cell.preset: 'prinetd'; it must be one of printed, water, apple, potato"
    )


def test_unknown_initialisation(changed_recipe):
    path = changed_recipe("[range]", '[rve]\ninitialisation = "born"\n[range]')
    assert message(InputError, path) == (
        "recipe.toml: rve.initialisation: 'born'; it must be one of cauchy-born, elastic, "
        "constrained-runs, slow-manifold"
    )


def test_empty_range(changed_recipe):
    path = changed_recipe("[0.95, 1.05]", "[1.05, 0.95]")
    assert message(InputError, path) == (
        "recipe.toml: range.stretch: (1.05, 0.95); low must be below high, both positive"
    )


@pytest.mark.parametrize(("key", "value"), [("count", 0), ("seed", -1)])
def test_samples_out_of_bounds(changed_recipe, key, value):
    path = changed_recipe({"count": "count = 40", "seed": "seed = 3"}[key], f"{key} = {value}")
    least = {"count": 1, "seed": 0}[key]
    assert message(InputError, path) == (
        f"recipe.toml: samples.{key}: {value}; it must be an integer of at least {least}"
    )


def test_not_toml(recipe_path):
    recipe_path.write_text("[cell\n", encoding="utf-8")
    text = message(InputError, recipe_path)
    assert text.startswith("recipe.toml: not TOML: ")
    assert "\n" not in text


def test_no_such_recipe(tmp_path):
    path = tmp_path / "none.toml"
    assert message(FileError, path) == f"{path}: cannot be read: No such file or directory"
