"""What a study asks of its runs: columns and what of them, by closed curves."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.report.chosen import Chosen, peaks_of
from surrofe2.report.grid import Grid, grid_row, map_of, write_grid_map
from surrofe2.run.displacement_curve import DisplacementCurve
from surrofe2.store.run_folder import StoredRun
from tests.run_records import finished_record

T = np.linspace(0.0, 10.0, 401)
PLACE = {
    "displacement": "mean displacement top",
    "section": 50.0,
    "length": [100.0, 200.0],
    "thickness": 10.0,
}


@pytest.fixture
def run(recipe):
    record = finished_record(recipe, "rve", {"total": 1.0}, {})
    record.problem["places"] = {"grip": PLACE}
    curve = DisplacementCurve(T, np.stack([0.0 * T, np.sin(np.pi * T)], axis=1))
    history = {
        "mean displacement top x": 0.0 * T,
        "mean displacement top y": 0.2 * T,
        "force grip x": 0.0 * T,
        "force grip y": -7.0 * T,
    }
    return StoredRun(Path("run"), record, curve=curve, curves={"tip": curve}, history=history)


@pytest.mark.parametrize(
    ("text", "value", "unit"),
    [
        ("force grip y", -70.0, "µN"),
        ("force grip y:maximum", -70.0, "µN"),
        ("force grip y:end", -70.0, "µN"),
        ("force grip y:slope", -35.0, "µN/µm"),
        ("force grip y:work", -70.0, "pJ"),
        ("u_y tip:period", 2.0, "µs"),
        ("u_y tip", 1.0, "µm"),
        ("force grip y:period", None, "µs"),
        ("force grip x:slope", None, ""),
    ],
)
def test_a_quantity_is_what_its_curve_has(run, text, value, unit):
    found, its_unit = Chosen.read(text).of(run)
    assert its_unit == unit
    assert found == (None if value is None else pytest.approx(value, rel=1e-3))


def test_a_period_counts_crossings_at_which_a_value_is_the_mean(run):
    t = np.arange(40.0)
    swing = np.tile([0.0, 1.0, 0.0, -1.0], 10)
    curve = DisplacementCurve(t, np.stack([swing, swing], axis=1))
    swinging = replace(run, curve=curve, curves={"tip": curve}, history={})
    assert Chosen.read("u_y tip:period").of(swinging)[0] == pytest.approx(4.0)


def test_what_is_not_there_is_refused_with_what_is(run):
    with pytest.raises(InputError, match="run has only u_x tip, u_y tip, mean displacement top x"):
        Chosen.read("force grab y").of(run)
    with pytest.raises(InputError, match="unknown statistic; did you mean slope"):
        Chosen.read("force grip y:slop")


def test_where_nobody_chose_a_study_shows_the_peaks_of_forces(run):
    assert peaks_of(run) == [Chosen("force grip y", "maximum")]
    row = grid_row({"cell.viscosity": 0.1}, "rve", "run", run, None, None)
    failed = grid_row({"cell.viscosity": 0.2}, "rve", "other", None, None, "it failed")
    grid = Grid("recipe", {"cell.viscosity": (0.1, 0.2)}, (row, failed))
    assert grid.asked == {"maximum of force grip y": "µN"}
    first, second = grid.table.to_records()
    assert first["maximum_of_force_grip_y"] == pytest.approx(-70.0)
    assert second["maximum_of_force_grip_y"] is None


def test_a_map_over_two_entries_has_a_field_for_each_run(run, tmp_path):
    values = {"cell.viscosity": (0.1, 0.2), "load.duration": (1.0, 2.0, 3.0)}
    rows = []
    for i, viscosity in enumerate(values["cell.viscosity"]):
        for j, duration in enumerate(values["load.duration"]):
            facts = {"cell.viscosity": viscosity, "load.duration": duration}
            there = None if (i, j) == (1, 2) else run
            row = grid_row(facts, "rve", f"{i}{j}", there, None, None)
            if there is not None:
                row.facts["maximum of force grip y"] = 10.0 * i + j
            rows.append(row)
    grid = Grid("recipe", values, tuple(rows))
    label, found = map_of(grid)
    assert label == "maximum of force grip y (µN)"
    np.testing.assert_array_equal(found, [[0.0, 1.0, 2.0], [10.0, 11.0, np.nan]])
    assert write_grid_map(tmp_path / "map.png", grid)
    assert (tmp_path / "map.png").stat().st_size > 10_000
    one = Grid("recipe", {"cell.viscosity": (0.1, 0.2)}, tuple(rows[:2]))
    assert map_of(one) is None
    assert not write_grid_map(tmp_path / "none.png", one)
    assert not (tmp_path / "none.png").exists()
