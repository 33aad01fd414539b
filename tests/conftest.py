"""Fixtures of all tests."""

import os
import re
import signal
from collections import Counter
from pathlib import Path

import numba
import numpy as np
import pytest

from surrofe2.base.environment import take_process

ROOT = Path(__file__).parents[1]
RANGE = """
[range]
stretch = [0.95, 1.05]
shear = 0.05
rate = 0.01
"""
LEARNING = f"""{RANGE}
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
"""
RECIPE = f"""
[cell]
preset = "printed"
{LEARNING}
[load]
width = 100.0
height = 100.0
body_force = [0.0, -0.1]
duration = 4.0
watched = [100.0, 50.0]

[macro]
elements = [2, 2]
"""
BAR = """
[mesh]
width = 100.0
height = 100.0
elements = [2, 2]
[conditions]
clamp = { kind = "fixed", on = "left" }
load = { kind = "body_force", acceleration = [0.0, -0.1] }
[watch]
tip = [100.0, 50.0]
[time]
duration = 4.0
output_interval = 0.5
"""
"""The problem of `RECIPE` by its mesh, conditions and times."""


def changed(text, *pairs):
    """changed(text, old, new, …): a text with parts of it replaced."""
    for old, new in zip(pairs[::2], pairs[1::2], strict=True):
        assert old in text, old
        text = text.replace(old, new)
    return text


WITHOUT_FILES = changed(
    LEARNING, 'file = "cells.h5"', "", 'file = "cells-surrogate.h5"', "", "runs = 9", "runs = 0"
)
CELLS = f"""{WITHOUT_FILES}{BAR}
[mesh.regions]
skin = {{ box = [0.0, 50.0, 100.0, 100.0] }}
inside = {{ box = [0.0, 0.0, 100.0, 50.0] }}
[cells.skin]
wall_stiffness = 8000.0
samples = {{ file = "skin.h5", seed = 2 }}
training = {{ file = "skin-surrogate.h5" }}
[cells.flesh]
preset = "water"
regions = ["inside"]
range = {{ rate = 0.02 }}
samples = {{ file = "flesh.h5" }}
training = {{ file = "flesh-surrogate.h5" }}
"""
"""Its upper half is of stiff plant cells, the lower of soft ones."""

FIRST = ("test_rve_law", "test_tabulated_surface")
NEXT = ("test_slow_manifold", "test_bound_of_plant_cells", "test_arranged_cells", "test_pipeline",
        "test_memory")  # fmt: skip
"""Files that take long though they have few tests, or compile the kernels of RVEs, each others."""


def pytest_configure(config):
    """Of several workers each has its share of the cores, and takes files in the order below."""
    config.option.loadscopereorder = False
    # Shells let commands in their background ignore SIGINT, and nohup SIGHUP; those of tests would.
    for number in (signal.SIGINT, signal.SIGHUP):
        if signal.getsignal(number) == signal.SIG_IGN:
            signal.signal(number, signal.SIG_DFL)
    take_process()
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
    """Nothing divides by zero or overflows unseen; tests/test_callers_settings.py lets what
    underflows raise, too."""
    with np.errstate(all="raise", under="ignore"):
        yield


@pytest.fixture
def rng():
    return np.random.default_rng(20090550)


@pytest.fixture
def written(tmp_path):
    """written(text, name): the path of a recipe."""

    def write(text, name="recipe.toml"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.fixture
def recipe_path(written):
    """A small recipe in a folder of its own."""
    return written(RECIPE)


@pytest.fixture
def changed_recipe(recipe_path, written):
    """changed_recipe(old, new, …): the path of the small recipe with parts replaced."""
    return lambda *pairs: written(changed(recipe_path.read_text(encoding="utf-8"), *pairs))


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


@pytest.fixture(scope="session")
def forks():
    """forks(module, arguments, said): its `main` in a process that need not import anything."""
    from tests.processes import server

    with server() as start:
        yield start


@pytest.fixture
def unwritable(tmp_path):
    """A folder nobody can write to, not even root: below a regular file."""
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    return tmp_path / "file" / "below"
