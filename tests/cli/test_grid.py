"""Parameter studies, over a law without cells."""

import csv
import json
from functools import partial

import numpy as np
import pytest

from surrofe2.store.run_folder import read_record, read_run
from tests.laws import SoftCell, SoftLaw

WALLS = "cell.wall_stiffness=3000,4000"


def read_rows(out):
    return json.loads((out / "grid.json").read_text(encoding="utf-8"))["rows"]


@pytest.fixture
def grid(invoke, recipe_path, tmp_path):
    """grid(*options): a grid of the small recipe in `out`."""

    run = partial(invoke, "grid", recipe_path, "--out", tmp_path / "out")
    run.out = tmp_path / "out"
    return run


def test_each_member_is_a_run_with_changed_entries(grid):
    done = grid("--set", "cell.wall_stiffness=3000:5000:3", "--set", "load.body_force.1=-0.1,-0.2",
                law=SoftCell)  # fmt: skip
    rows = read_rows(grid.out)
    assert [(row["wall_stiffness"], row["body_force_1"]) for row in rows] == [
        (wall, force) for wall in (3000, 4000, 5000) for force in (-0.1, -0.2)
    ]
    for row in rows:
        record = read_record(grid.out / row["run"])
        assert record.recipe["cell"]["wall_stiffness"] == row["wall_stiffness"]
        acceleration = record.recipe["conditions"]["load"]["acceleration"]
        assert acceleration == [0.0, row["body_force_1"]]
        curve = read_run(grid.out / row["run"]).curve
        largest = np.linalg.norm(curve.displacement, axis=1).max()
        assert row["largest_displacement"] == pytest.approx(largest)
    largest = np.array([row["largest_displacement"] for row in rows]).reshape(3, 2)
    assert (np.diff(largest, axis=0) < 0.0).all()
    assert largest[:, 1] == pytest.approx(2.0 * largest[:, 0], rel=0.02)
    with (grid.out / "grid.csv").open(encoding="utf-8") as file:
        table = [*csv.DictReader(file)]
    assert [float(row["wall_stiffness (µN/µm)"]) for row in table[::2]] == [3000, 4000, 5000]
    assert [float(row["largest displacement (µm)"]) for row in table] == [*largest.flat]
    assert (grid.out / "grid.png").stat().st_size > 20_000
    assert max(map(len, done.stdout.splitlines()[:-1])) <= 80


def test_a_member_that_is_finished_is_not_done_again_and_a_grid_may_grow(grid):
    first = SoftLaw()
    grid("--set", WALLS, law=first)
    law = SoftLaw()
    again = grid("--set", WALLS, "--format", "svg", law=law)
    assert "<svg" in (grid.out / "grid.svg").read_text(encoding="utf-8")
    assert "grid.json, grid.svg" in again.stdout
    assert law.calls == 0
    assert "rve,cell.wall_stiffness=4000: finished before" in again.stdout
    law = SoftLaw()
    grid("--set", "cell.wall_stiffness=3000,4000,5000", law=law)
    assert law.calls == pytest.approx(first.calls / 2, rel=0.1)
    assert len(read_rows(grid.out)) == 3
    law = SoftLaw()
    grid("--set", WALLS, "--fresh", law=law)
    assert law.calls == first.calls


@pytest.mark.slow
def test_surrogates_are_made_where_what_they_learn_changes(grid, recipe_path):
    grid("--set", "cell.wall_stiffness=4000,5000", "--set", "load.duration=2.0,3.0",
                "--law", "rve,cached")  # fmt: skip
    made = sorted(path.name for path in grid.out.glob("*-surrogate.h5"))
    assert made == ["cell.wall_stiffness=5000-surrogate.h5"]
    assert recipe_path.with_name("cells-surrogate.h5").exists()  # with 4000, as the preset has it
    rows = read_rows(grid.out)
    assert [row["law"] for row in rows] == ["rve", "cached"] * 4
    used = [read_record(grid.out / row["run"]).surrogate for row in rows[1::2]]
    assert [each["file"] for each in used] == ["cells-surrogate.h5"] * 2 + made * 2
    for true, cached in zip(rows[::2], rows[1::2], strict=True):
        assert true["displacement_error"] is None
        largest = [row["largest_displacement"] for row in (true, cached)]
        assert largest[0] == pytest.approx(largest[1], rel=0.1)
        assert cached["speed_up"] == pytest.approx(true["wall_time"] / cached["wall_time"])
        assert 0.0 <= cached["displacement_error"] < 0.1


def test_a_run_that_fails_is_a_row_and_the_others_go_on(grid):
    options = ("--set", "load.body_force.0=0.1,90.0", "--set", "macro.frames=2")
    done = grid(*options, law=SoftLaw(fails_above=1.02), code=1)
    assert "1 of 2 runs failed, rve,load.body_force.0=90,macro.frames=2 first:" in done.stderr
    rows = read_rows(grid.out)
    assert [row["error"] is None for row in rows] == [True, False]
    assert rows[0]["largest_displacement"] > 0.0
    assert rows[1]["largest_displacement"] is None
    assert "failed" in done.stdout


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--set", "cell.wal_stiffness=1,2"), "wal_stiffness: unknown key; did you mean wall_"),
        (("--set", "cell.wall_stiffness=1,-2"), "cell.wall_stiffness: -2; it must be positive"),
        (("--set", "load.watched.0=50.0,900.0"), "watch"),
        (("--set", "nothing"), "--set: 'nothing'; it must be KEY=VALUES"),
        (("--set", WALLS, "--set", WALLS), f"--set: '{WALLS}'; it is there twice"),
        (("--set", WALLS, "--law", "rve,cache"), "unknown law; did you mean cached?"),
        (("--set", "cell.wall_stiffness=1:9:200", "--set", "cell.wall_damping=1:9:100"),
         "cell.wall_damping: 20,000 runs; a grid has 1 to 10,000"),
    ],
)  # fmt: skip
def test_what_is_no_grid_is_refused_before_anything_runs(grid, options, message):
    law = SoftLaw()
    refused = grid(*options, law=law, code=1)
    assert message in refused.stderr
    assert law.calls == 0
    assert not grid.out.exists()
