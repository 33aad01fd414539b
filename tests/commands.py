"""Commands on short recipes over laws without cells, each with all that it leaves in its folder."""

import os
import sys
import traceback
from contextlib import ExitStack, contextmanager
from pathlib import Path
from unittest import mock

import numba
from matplotlib.figure import Figure

from surrofe2.base.interruption import begin_work, exit_code, watch
from surrofe2.recipe import recipe as recipes
from surrofe2.recipe.recipe import load_recipe
from surrofe2.store import samples
from surrofe2.workflow import laws, rest, run, tissue
from surrofe2.workflow.generate import generate_data_set
from surrofe2.workflow.rest import rest_study
from surrofe2.workflow.run import run_study
from surrofe2.workflow.tissue import run_tissue
from tests.conftest import RECIPE, changed
from tests.laws import SoftLaw, SquareLaw

STRONG = changed(RECIPE, "-0.1]", "-0.9]", "stretch = [0.95, 1.05]", "stretch = [0.98, 1.02]")
SHORT = changed(STRONG, "duration = 4.0", "duration = 2.0")
CACHED = SHORT + "[cache]\ntolerance = 0.5\naudit = 0.3\n[table]\ntolerance = 1e-2\n"
SMALL = changed(RECIPE, "= 100.0\n", "= 50.0\n", "[100.0, 50.0]", "[50.0, 25.0]")
TISSUE = changed(SMALL, "duration = 4.0", "duration = 0.3\noutput_interval = 0.1")
LEAVING = changed(
    RECIPE, "-0.1]", "-8.0]", "duration = 4.0", "duration = 0.5", "runs = 9", "runs = 0"
)
GROWING = changed(SHORT, "count = 40\n", "", "= 40\n", "= 40\nbound = 1e-12\n")
BRIEF = changed(CACHED, "duration = 2.0", "duration = 0.3", "runs = 9", "runs = 0")


def by(law, **changes):
    def work(recipe, folder):
        run_study(recipe, law, folder / "out", **changes)

    return work


def train(recipe, folder):
    from surrofe2.workflow.train import train_surrogate  # here and below: torch is heavy

    generate_data_set(recipe.study())
    train_surrogate(recipe.study())


def refine(recipe, folder):
    from surrofe2.workflow.refine import refine_surrogate

    refine_surrogate(recipe, folder / "out")


def grid(recipe, folder):
    from surrofe2.workflow.grid import run_grid

    values = {"cell.wall_stiffness": (3000.0,), "cache.tolerance": (0.5, 0.1)}
    run_grid(recipe.path, values, folder / "out", laws=("rve", "cached"))


COMMANDS = {
    "generate": (SHORT, lambda recipe, folder: generate_data_set(recipe.study())),
    "train": (SHORT, train),
    "train on more and more": (GROWING, train),
    "rve": (SHORT, by("rve")),
    "surrogate": (RECIPE, by("surrogate")),
    "cached": (CACHED, by("cached")),
    "table": (CACHED, by("table")),
    "implicit": (SHORT + 'integrator = "implicit"\n', by("rve")),
    "rest": (RECIPE, lambda recipe, folder: rest_study(recipe, folder / "out")),
    "tissue": (TISSUE, lambda recipe, folder: run_tissue(recipe, folder / "out")),
    "refine": (LEAVING, refine),
    "grid": (BRIEF, grid),
}
"""By name: recipe, and the command on it in a folder."""
NEED_NO_SURROGATE = ("generate", "train", "train on more and more", "rve", "table", "implicit",
                     "rest", "tissue", "refine", "grid")  # fmt: skip
NEED_TANGENTS = ("table", "implicit", "rest")


@contextmanager
def checkpointed(name):
    """Laws stand in for RVEs, a checkpoint follows every step, and pictures are not drawn."""
    soft = SquareLaw() if name in NEED_TANGENTS else SoftLaw()
    with ExitStack() as patches:

        def patch(module, entry, value):
            patches.enter_context(mock.patch.object(module, entry, value))

        patch(laws, "true_law", lambda study: soft.of(study.cell.parameters, study.recipe.rve))
        for module in (run, rest, tissue):
            patch(module, "CHECKPOINT_INTERVAL", 0.0)
        patch(samples, "INTERVAL", 0.0)
        patch(recipes, "FIRST_COUNT", 40)
        patch(recipes, "MOST_COUNT", 160)
        patches.enter_context(mock.patch.dict(generate_data_set.__kwdefaults__, chunk=8))
        patch(Figure, "savefig", lambda self, target, **_: target.write(b"drawn"))
        yield


def prepare(name, folder, learnt):
    """The recipe of a command in a folder, and what it needs from the folder `learnt`."""
    folder.mkdir(parents=True)
    (folder / "recipe.toml").write_text(COMMANDS[name][0], encoding="utf-8")
    if name not in NEED_NO_SURROGATE:
        for file in ("cells.h5", "cells-surrogate.h5"):
            (folder / file).write_bytes((learnt / file).read_bytes())


def execute(name, folder):
    """Run a command in its folder, or go on with it, by as many threads as a new process has."""
    numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
    with checkpointed(name):
        COMMANDS[name][1](load_recipe(folder / "recipe.toml"), folder)


def main():
    """A command and its folder, as the command line of a process names them."""
    watch()
    begin_work()
    code = 1
    try:
        execute(sys.argv[1], Path(sys.argv[2]))
        code = 0
    except KeyboardInterrupt:
        code = exit_code()
    except Exception:
        traceback.print_exc()
    os._exit(code)
