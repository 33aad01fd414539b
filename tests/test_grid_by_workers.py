"""A parameter study by several processes is that by one, also where some of them are lost."""

from __future__ import annotations

import pytest

from surrofe2.workflow.grid import run_grid
from surrofe2.workflow.workers import executor_of
from tests.conftest import RECIPE
from tests.folders import assert_same
from tests.some_work import killed_once

LAWS = ("rve", "cached")
SHORT = RECIPE.replace("count = 40", "count = 60").replace("duration = 4.0", "duration = 1.0")
VALUES = {"cell.wall_stiffness": (3000, 5000)}


class Killing:
    """An executor whose first process that runs is killed."""

    def __init__(self, inner, folder):
        self.inner, self.folder = inner, folder

    def submit(self, work, *arguments):
        told = str(self.folder), "out/rve*/run.json", work
        return self.inner.submit(killed_once, *told, *arguments)


@pytest.mark.slow
def test_two_processes_of_which_one_is_killed_give_the_bits_of_one(tmp_path, caplog):
    folders = [tmp_path / name for name in ("alone", "both")]
    for folder in folders:
        folder.mkdir()
        (folder / "recipe.toml").write_text(SHORT, encoding="utf-8")
    alone, both = folders
    run_grid(alone / "recipe.toml", VALUES, alone / "out", laws=LAWS, threads=1)
    with executor_of(2) as executor:
        killing = Killing(executor, both)
        run_grid(both / "recipe.toml", VALUES, both / "out", laws=LAWS, threads=1, executor=killing)
    assert (both / "dead").exists()
    assert "a worker was lost" in caplog.text
    assert len([*(both / "out").glob("*/run.json")]) == 4
    assert_same(both / "out", alone / "out", exact=True)
