"""Entries of a recipe by their names, and values that a text lists."""

import re

import pytest

from surrofe2 import load_recipe
from surrofe2.base.errors import InputError
from surrofe2.recipe.entries import listed_values, name_of_values, with_changes


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("3000:5000:5", [3000, 3500, 4000, 4500, 5000]),
        ("0.0:0.3:4", [0.0, 0.1, 0.2, 0.3]),
        ("1e-4:1e-1:4:log", [1e-4, 1e-3, 1e-2, 1e-1]),
        ("1:2:3, 7", [1.0, 1.5, 2.0, 7]),
        ('printed, "water, salt"', ["printed", "water, salt"]),
        ("[4, 4],[8, 8]", [[4, 4], [8, 8]]),
        ('{ kind = "ramp", end = 5.0 },1', [{"kind": "ramp", "end": 5.0}, 1]),
        ("true,inf,-1", [True, float("inf"), -1]),
    ],
)
def test_values_of_a_text(text, values):
    found = listed_values("key", text)
    assert found == values
    assert [type(value) for value in found] == [type(value) for value in values]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "key: ''; nothing stands between two commas"),
        ("1:2:1", "key: '1:2:1'; it must be FIRST:LAST:COUNT of two numbers and at least 2"),
        ("-1:1:3:log", "key: '-1:1:3:log'; it must be FIRST:LAST:COUNT"),
        ("3,1:3:3", "key: 3; it is there twice"),
    ],
)
def test_texts_that_list_no_values(text, message):
    with pytest.raises(InputError, match=re.escape(message)):
        listed_values("key", text)


def test_entries_are_changed_wherever_they_stand():
    table = {"cell": {"preset": "water"}, "conditions": [{"kind": "fixed"}, {"traction": [0, 1]}]}
    names = {"cell.wall_stiffness": 3.0, "macro.elements": [2, 2], "conditions.1.traction.0": 5}
    changed = with_changes(table, names)
    assert changed["cell"] == {"preset": "water", "wall_stiffness": 3.0}
    assert changed["macro"] == {"elements": [2, 2]}
    assert changed["conditions"] == [{"kind": "fixed"}, {"traction": [5, 1]}]
    assert table["conditions"][1] == {"traction": [0, 1]}


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("cell.wal_stiffness", "recipe.toml: cell.wal_stiffness: unknown key; did you mean wall_"),
        ("cel.wall_stiffness", "recipe.toml: cel: unknown section; did you mean cell?"),
        ("cell", "recipe.toml: 'cell': it must be an entry, such as cell.wall_stiffness"),
        ("cell.preset.name", "recipe.toml: cell.preset: 'printed'; it has no entry name"),
        ("load.body_force.2", "recipe.toml: load.body_force.2: '2'; it must be a number from 0 to"),
        ("bodies.plate.mass", "recipe.toml: bodies.plate: unknown name in [bodies]"),
        ("macro.elements", "recipe.toml: macro.elements: 3; it must be a list of 2"),
    ],
)
def test_entries_that_a_recipe_has_not(recipe_path, name, message):
    with pytest.raises(InputError, match=re.escape(message)):
        load_recipe(recipe_path, {name: 3})


def test_names_of_files():
    assert name_of_values({"a.b": 3000.0, "a.c": 0.1}, "rve") == "rve,a.b=3000,a.c=0.1"
    assert name_of_values({}, "rve") == "rve"
    names = [name_of_values({"a.b": value}) for value in ("x/y", "x?y", [1, 2], ["1", "2"], "../z")]
    assert all(re.fullmatch(r"a\.b=[\w.,=+-]+-[0-9a-f]{8}", name) for name in names)
    assert len(set(names)) == len(names)
    assert len(name_of_values({"a.b": "x" * 500})) < 200
