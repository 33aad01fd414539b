"""Whatever ends a command, no record of it says that a run is still running."""

from unittest import mock

import pytest

from surrofe2.base.errors import InputError
from surrofe2.recipe.recipe import load_recipe
from surrofe2.store.run_folder import RunFolder, read_record
from surrofe2.workflow.grid import run_grid
from surrofe2.workflow.rest import rest_study
from surrofe2.workflow.run import run_study
from surrofe2.workflow.tissue import run_tissue
from tests import commands
from tests.cli.conftest import call
from tests.conftest import BAR, changed
from tests.folders import assert_same

ENDED = ("cached", "rest")
LONGER = ("rve", "implicit", "tissue", "refine", "grid")
LOAD = commands.SHORT[commands.SHORT.index("[load]") :]
JUMPS = changed(
    BAR,
    'load = { kind = "body_force", acceleration = [0.0, -0.1] }',
    'pull = { kind = "prescribed_motion", on = "right", displacement = [1.0, 0.0] }',
)
UNHELD = changed(BAR, 'clamp = { kind = "fixed", on = "left" }\n', "")


@pytest.mark.parametrize(
    "name", [*ENDED, *(pytest.param(each, marks=pytest.mark.slow) for each in LONGER)]
)
def test_a_command_that_an_error_ends_resumes_to_the_bit(name, tmp_path, learnt):
    """At the second checkpoint of a run, and at the next but one."""
    whole, ended = tmp_path / "whole", tmp_path / "ended"
    for folder in (whole, ended):
        commands.prepare(name, folder, learnt)
    commands.execute(name, whole)
    for error in (MemoryError("no room"), InputError("beyond what it takes")):
        folder = end_by(error, name, ended)
        record = read_record(folder)
        assert record.status == "failed"
        assert str(error) in record.error
        records = [read_record(path.parent) for path in ended.rglob("run.json")]
        assert "running" not in {each.status for each in records}
    commands.execute(name, ended)
    assert_same(ended, whole)


def end_by(error, name, folder):
    """End a command at its second checkpoint; the folder of the run."""
    written, checkpoint = [], RunFolder.checkpoint

    def fail(run, *arguments):
        written.append(run.folder)
        if len(written) == 2:
            raise error
        checkpoint(run, *arguments)

    with mock.patch.object(RunFolder, "checkpoint", fail):
        if name == "grid" and isinstance(error, InputError):  # a row of the grid says so
            commands.execute(name, folder)
        else:
            with pytest.raises(type(error)):
                commands.execute(name, folder)
    return written[1]


def test_a_motion_that_jumps_is_refused_before_anything_is_written(written, tmp_path):
    path = written(changed(commands.SHORT, LOAD, JUMPS))
    recipe = load_recipe(path)
    works = (
        lambda out: run_study(recipe, "rve", out),
        lambda out: run_tissue(recipe, out),
    )
    for k, work in enumerate(works):
        with pytest.raises(InputError, match=r"pull.amplitude: jumps from 0 to 1 at t = 0 µs"):
            work(tmp_path / f"out-{k}")
        assert not (tmp_path / f"out-{k}").exists()


def test_a_grid_and_a_study_leave_no_run_of_it(written, tmp_path):
    path = written(changed(commands.SHORT, LOAD, JUMPS))
    grid = run_grid(path, {"cell.wall_stiffness": (3000.0, 4000.0)}, tmp_path / "grid")
    assert all("jumps from 0 to 1" in message for message in grid.failed.values())
    assert len(grid.failed) == 2
    assert not [*(tmp_path / "grid").rglob("run.json")]
    refused = call("study", path, "--out", tmp_path / "study", code=1)
    assert "jumps from 0 to 1" in refused.stderr
    assert not (tmp_path / "study").exists()


def test_a_rest_of_a_tissue_that_nothing_holds_is_recorded_as_failed(written, tmp_path):
    path = written(changed(commands.SHORT, LOAD, UNHELD))
    with commands.checkpointed("implicit"), pytest.raises(InputError) as caught:
        rest_study(load_recipe(path), tmp_path / "out")
    record = read_record(tmp_path / "out")
    assert record.status == "failed"
    assert record.error == str(caught.value)
    assert "nothing holds the tissue along x" in record.error
