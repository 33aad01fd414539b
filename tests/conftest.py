"""Fixtures of all tests."""

from __future__ import annotations

import os
import re
from collections import Counter
from pathlib import Path

import numba
import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
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
file = "cells-surrogate.h5"
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


FIRST = ("test_rve_law", "test_tabulated_surface")
NEXT = ("test_slow_manifold", "test_bound_of_plant_cells", "test_arranged_cells", "test_pipeline",
        "test_memory", "test_bar")  # fmt: skip
"""Files that take long though they have few tests, or compile the kernels of RVEs, each others."""


def pytest_configure(config):
    """Of several workers each has its share of the cores, and takes files in the order below."""
    config.option.loadscopereorder = False
    workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    numba.set_num_threads(max(1, numba.config.NUMBA_NUM_THREADS // workers))


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """What is nightly is slow, too. One worker begins to compile the kernels of RVEs while the
    others test what has none.
    """
    for item in items:
        if item.get_closest_marker("nightly"):
            item.add_marker(pytest.mark.slow)
    sizes = Counter(item.path for item in items)
    solving = re.compile(r"\brve\b|Rve|CliRunner|[Tt]issue")

    def place(path):
        for rank, files in ((0, FIRST), (2, NEXT)):
            if path.stem in files:
                return rank, files.index(path.stem)
        return 3 if solving.search(path.read_text(encoding="utf-8")) else 1, -sizes[path]

    places = {path: (*place(path), str(path)) for path in sizes}
    items.sort(key=lambda item: places[item.path])


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
    from surrofe2.recipe.recipe import load_recipe

    return load_recipe(recipe_path)


@pytest.fixture(scope="session")
def learnt(tmp_path_factory):
    """A folder with a data set and a surrogate, as the commands of `tests.commands` need it."""
    from tests import commands

    folder = tmp_path_factory.mktemp("learnt") / "train"
    commands.prepare("train", folder, None)
    commands.execute("train", folder)
    return folder


@pytest.fixture
def unwritable(tmp_path):
    """A folder nobody can write to, not even root: below a regular file."""
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    return tmp_path / "file" / "below"
