"""Runs by all ranks that mpiexec starts of `python -m tests.on_ranks HOME OUT CASE…`.

A case is a name of `tests.test_going_on`; after `stop:` it is interrupted after three steps, after
`cut:` four times within random steps, after `go:` it resumes. Few points are shared too.
"""

import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from surrofe2.ranks import DistributedLaw, Driver, distributed_law, serve
from surrofe2.recipe.recipe import load_recipe
from surrofe2.store.run_folder import read_record
from surrofe2.workflow.run import run_study
from tests import test_going_on as cases


def recipe_of(home, name):
    """The recipe of a case, and its law; an own file for each, as several processes read them."""
    law, text = (cases.CASES | cases.LONG_CASES)[name]
    path = home / f"{name}.toml"
    if not path.exists():
        path.write_text(text, encoding="utf-8")
    return load_recipe(path), law


def cut(recipe, law, out):
    """Interrupt a run four times at random calls of the RVEs."""
    random = np.random.default_rng(7)
    for _ in range(4):
        with pytest.MonkeyPatch.context() as patched, suppress(cases.Stop):
            cases.stop_at(patched, int(random.integers(2, 18)), DistributedLaw)
            run_study(recipe, law, out)
    assert read_record(out).status == "interrupted"


def main():
    home, out, *names = sys.argv[1:]
    for entry in names:
        how, _, name = entry.rpartition(":")
        recipe, law = recipe_of(Path(home), name)
        if how == "stop":
            cases.interrupted(recipe, law, Path(out) / name, 3)
        elif how == "cut":
            cut(recipe, law, Path(out) / name)
        else:
            run_study(recipe, law, Path(out) / name)


if __name__ == "__main__":
    distributed_law.LEAST = 1
    if MPI.COMM_WORLD.rank:
        serve(MPI.COMM_WORLD)
    else:
        with Driver(MPI.COMM_WORLD):
            main()
