"""A parameter study by several processes is that by one, also where some of them are lost."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

from surrofe2.workflow.grid import run_grid
from surrofe2.workflow.workers import executor_of
from tests import commands
from tests.conftest import RECIPE
from tests.some_work import killed_once

ROOT = Path(__file__).parents[1]
BOTH = ("rve", "cached")
SHORT = RECIPE.replace("count = 40", "count = 60").replace("duration = 4.0", "duration = 1.0")
VALUES = {"cell.wall_stiffness": (3000, 5000)}


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """alone(laws): the folder of a recipe, with a grid by this process."""

    @cache
    def made(laws):
        folder = tmp_path_factory.mktemp("alone")
        (folder / "recipe.toml").write_text(SHORT, encoding="utf-8")
        run_grid(folder / "recipe.toml", VALUES, folder / "out", laws=laws, threads=1)
        return folder

    return made


class Killing:
    """An executor whose first process that runs is killed."""

    def __init__(self, inner, folder):
        self.inner, self.folder = inner, folder

    def submit(self, work, *arguments):
        told = str(self.folder), "out/rve*/run.json", work
        return self.inner.submit(killed_once, *told, *arguments)


def check(out, alone, laws):
    assert len([*out.glob("*/run.json")]) == 2 * len(laws)
    commands.assert_same(out, commands.left_in(alone(laws) / "out"))


@pytest.mark.parametrize("laws", [("rve",), pytest.param(BOTH, marks=pytest.mark.slow)])
def test_two_processes_of_which_one_is_killed_give_the_bits_of_one(laws, tmp_path, alone, caplog):
    (tmp_path / "recipe.toml").write_text(SHORT, encoding="utf-8")
    out = tmp_path / "out"
    with executor_of(2) as executor:
        killing = Killing(executor, tmp_path)
        run_grid(tmp_path / "recipe.toml", VALUES, out, laws=laws, threads=1, executor=killing)
    assert (tmp_path / "dead").exists()
    assert "a worker was lost" in caplog.text
    check(out, alone, laws)
