"""Commands on short recipes over laws without cells, each with all that it leaves in its folder.

`python -m tests.commands` starts processes and ends them: of each line NAME FOLDER SECONDS SIGNAL
that it reads once it is "ready" it makes one, sends it the signal after so long, and tells its exit
code when it has ended. As in `checkpointed`, a checkpoint follows every step.
"""

from __future__ import annotations

import os
import sys
import time
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
from surrofe2.workflow.run import run_study
from surrofe2.workflow.tissue import run_tissue
from tests.conftest import RECIPE
from tests.laws import SoftLaw, SquareLaw

SHORT = RECIPE.replace("-0.1]", "-0.9]").replace("duration = 4.0", "duration = 2.0")
SHORT = SHORT.replace("stretch = [0.95, 1.05]", "stretch = [0.98, 1.02]")
CACHED = SHORT + "[cache]\ntolerance = 0.5\naudit = 0.3\n[table]\ntolerance = 1e-2\n"
SMALL = RECIPE.replace("= 100.0\n", "= 50.0\n").replace("[100.0, 50.0]", "[50.0, 25.0]")
TISSUE = SMALL.replace("duration = 4.0", "duration = 0.3\noutput_interval = 0.1")
LEAVING = RECIPE.replace("-0.1]", "-8.0]").replace("duration = 4.0", "duration = 0.5")
LEAVING = LEAVING.replace("runs = 9", "runs = 0")
GROWING = SHORT.replace("count = 40\n", "").replace("= 40\n", "= 40\nbound = 1e-12\n")
BRIEF = CACHED.replace("duration = 2.0", "duration = 0.3").replace("runs = 9", "runs = 0")


def by(law, **changes):
    def work(recipe, folder):
        run_study(recipe, law, folder / "out", **changes)

    return work


def train(recipe, folder):
    from surrofe2.workflow.train import train_surrogate  # here and below: torch is heavy

    generate_data_set(recipe)
    train_surrogate(recipe)


def refine(recipe, folder):
    from surrofe2.workflow.refine import refine_surrogate

    refine_surrogate(recipe, folder / "out")


def grid(recipe, folder):
    from surrofe2.workflow.grid import run_grid

    values = {"cell.wall_stiffness": (3000.0,), "cache.tolerance": (0.5, 0.1)}
    run_grid(recipe.path, values, folder / "out", laws=("rve", "cached"))


COMMANDS = {
    "generate": (SHORT, lambda recipe, folder: generate_data_set(recipe)),
    "train": (SHORT, train),
    "train on more and more": (GROWING, train),
    "rve": (SHORT, by("rve")),
    "surrogate": (RECIPE, by("surrogate")),
    "cached": (CACHED, by("cached")),
    "table": (CACHED, by("table")),
    "implicit": (SHORT + 'integrator = "implicit"\n', by("rve")),
    "tissue": (TISSUE, lambda recipe, folder: run_tissue(recipe, folder / "out")),
    "refine": (LEAVING, refine),
    "grid": (BRIEF, grid),
}
"""By name: recipe, and the command on it in a folder."""
NEED_NO_SURROGATE = ("generate", "train", "train on more and more", "rve", "table", "implicit",
                     "tissue", "refine", "grid")  # fmt: skip
NEED_TANGENTS = ("table", "implicit")


@contextmanager
def checkpointed(name):
    """Laws stand in for RVEs, a checkpoint follows every step, and pictures are not drawn."""
    soft = SquareLaw() if name in NEED_TANGENTS else SoftLaw()
    with ExitStack() as patches:

        def patch(module, entry, value):
            patches.enter_context(mock.patch.object(module, entry, value))

        patch(laws, "true_law", lambda recipe, *_: soft.of(recipe.cell, recipe.rve))
        for module in (run, rest, tissue):
            patch(module, "CHECKPOINT_INTERVAL", 0.0)
        patch(samples, "INTERVAL", 0.0)
        patch(recipes, "FIRST_COUNT", 40)
        patch(recipes, "MOST_COUNT", 160)
        patch(generate_data_set, "__kwdefaults__", generate_data_set.__kwdefaults__ | {"chunk": 8})
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


def _has_ended(process):
    how = os.WEXITED | os.WNOHANG | os.WNOWAIT
    return os.waitid(os.P_PID, process, how) is not None


def serve():
    """Start processes as the docstring of this file says; all is imported once, before them."""
    from surrofe2.workflow import refine  # noqa: F401 - torch too

    sys.stdout.write("ready\n")
    sys.stdout.flush()
    for line in sys.stdin:
        name, folder, seconds, number = line.rstrip("\n").split("\t")
        process = os.fork()
        if process == 0:
            try:
                watch()
                begin_work()
                execute(name, Path(folder))
            except KeyboardInterrupt:
                os._exit(exit_code())
            except BaseException:
                traceback.print_exc()
                os._exit(1)
            os._exit(0)
        until = time.perf_counter() + float(seconds)
        while time.perf_counter() < until and not _has_ended(process):
            time.sleep(0.002)
        os.kill(process, int(number))  # nobody else has its number until it is waited for
        _, status = os.waitpid(process, 0)
        sys.stdout.write(f"{os.waitstatus_to_exitcode(status)}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    serve()
