"""The page of a recipe's keys is the one that the settings give, and every key says what it is."""

import importlib.util
from dataclasses import fields
from pathlib import Path

import pytest

from surrofe2.plant_cell.parameters import LivingTissue
from surrofe2.recipe.recipe import SECTIONS

SCRIPT = Path(__file__).parents[2] / "docs" / "recipe_reference.py"


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


@pytest.mark.parametrize("kind", [*SECTIONS.values(), LivingTissue])
def test_every_key_says_what_it_is(kind):
    for item in fields(kind):
        if item.metadata:
            assert item.metadata["about"], item.name
