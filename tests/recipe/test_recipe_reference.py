"""The page of a recipe's keys is the one that the settings give, and every key says what it is."""

import importlib.util
import json
import tomllib
from pathlib import Path

import pytest
from jsonschema import Draft7Validator

from surrofe2.base.errors import InputError
from surrofe2.recipe.recipe import make_recipe
from surrofe2.recipe.schema import TEMPLATES, recipe_schema, write_recipe
from tests.recipe.test_problem_recipes import RECIPE

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "docs" / "recipe_reference.py"
RECIPES = sorted(path for folder in ("data", "examples") for path in ROOT.glob(f"{folder}/*.toml"))


@pytest.fixture(scope="module")
def reference():
    spec = importlib.util.spec_from_file_location("recipe_reference", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_page_is_what_the_settings_say(reference):
    assert reference.PAGE.read_text(encoding="utf-8") == reference.page(), (
        "python docs/recipe_reference.py"
    )


@pytest.fixture(scope="module")
def schema():
    Draft7Validator.check_schema(recipe_schema())
    return Draft7Validator(recipe_schema())


@pytest.mark.parametrize("path", RECIPES, ids=lambda path: path.name)
def test_the_schema_takes_shipped_recipes(schema, path):
    schema.validate(tomllib.loads(path.read_text(encoding="utf-8")))


@pytest.mark.parametrize("kind", TEMPLATES)
def test_a_new_recipe_names_the_schema_beside_it(tmp_path, kind):
    path = tmp_path / "mine.toml"
    write_recipe(path, kind)
    text = path.read_text(encoding="utf-8")
    first = text.splitlines()[0]
    beside = json.loads((tmp_path / first.removeprefix("#:schema ./")).read_text(encoding="utf-8"))
    Draft7Validator(beside).validate(tomllib.loads(text))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("width = 200.0", "wdith = 200.0"),
        ("elements = [4, 2]", "elements = [4, 0]"),
        ("box = [0.0, 100.0, 100.0, 100.0]", "box = [0.0, 1.0, 2.0]"),
        ("radius = 40.0", "radius = -1"),
        ('kind = "traction"', 'kind = "tracton"'),
        ('4.0, "free"]', '4.0, "loose"]'),
        ('kind = "ramp"', 'kind = "rampe"'),
        ('[6, 0]]', '[6, "0"]]'),
        ("angle = 30.0", "angle = 200.0"),
        ("[watch]\n", "[wacth]\n"),
        ("", ""),
    ],
)  # fmt: skip
def test_the_schema_refuses_what_the_program_refuses(schema, old, new):
    table = tomllib.loads(RECIPE.replace(old, new, 1))
    try:
        make_recipe(table)
    except InputError:
        assert not schema.is_valid(table)
    else:
        assert schema.is_valid(table)
