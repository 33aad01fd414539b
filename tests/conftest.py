"""Fixtures of all tests."""

from __future__ import annotations

import numpy as np
import pytest

RECIPE = """
[cell]
preset = "printed"

[range]
stretch = [0.95, 1.05]
shear = 0.05
rate = 0.01

[samples]
count = 40
seed = 3
file = "cells.h5"

[training]
file = "cells.safetensors"
hidden = [4]
baseline_degree = 2
iterations = 40
checkpoint_interval = 20

[calibration]
walks = 9
runs = 9
length = 6
alpha = 0.1

[load]
width = 100.0
height = 100.0
body_force = [0.0, -0.1]
duration = 4.0
watched = [100.0, 50.0]

[macro]
elements = [2, 2]
"""


@pytest.fixture(autouse=True)
def _strict_floating_point():
    """Nothing divides by zero or overflows unseen."""
    with np.errstate(all="raise", under="ignore"):
        yield


@pytest.fixture
def recipe_path(tmp_path):
    """A small recipe in a folder of its own; `change` rewrites parts of it."""
    path = tmp_path / "recipe.toml"
    path.write_text(RECIPE, encoding="utf-8")
    return path


@pytest.fixture
def changed_recipe(recipe_path):
    """changed_recipe(old, new): the path of the small recipe with a part replaced."""

    def change(old, new):
        text = recipe_path.read_text(encoding="utf-8")
        assert old in text
        recipe_path.write_text(text.replace(old, new, 1), encoding="utf-8")
        return recipe_path

    return change


@pytest.fixture
def recipe(recipe_path):
    """The small recipe, loaded."""
    from surrofe2.recipe import load_recipe

    return load_recipe(recipe_path)


@pytest.fixture
def unwritable(tmp_path):
    """A folder nobody can write to, not even root: below a regular file."""
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    return tmp_path / "file" / "below"
