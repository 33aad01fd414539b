"""Differences and speed-ups against figures worked out by hand, and their picture."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.report.comparison import (
    audit_curves,
    compare,
    compare_runs,
    comparison_title,
    displacement_panels,
    force_panels,
)
from surrofe2.run.charts import draw_panels
from surrofe2.run.displacement_curve import DisplacementCurve
from surrofe2.store.run_folder import StoredRun, read_run
from surrofe2.store.store import plain
from tests.report.made_runs import audited, made_runs
from tests.run_records import finished_record


@pytest.fixture
def make_run(recipe):
    t = np.linspace(0.0, 4.0, 5)

    def make(name, law, offset, wall, solves, points=100):
        wall_time = {"total": wall, "law": 0.8 * wall, "macro": 0.2 * wall}
        counts = {"stress_points": points, "rve_solves": solves}
        record = finished_record(recipe, law, wall_time, counts)
        u = np.stack([0.0 * t, -2.0 * t + offset], axis=1)
        return StoredRun(Path(name), record, curve=DisplacementCurve(t, u))

    return make


def test_difference_and_speed_up_against_the_run_by_rves_wherever_it_stands(make_run):
    # The reference moves by 8 µm at most; the other one is 0.04 µm off throughout.
    runs = make_run("rve", "rve", 0.0, 30.0, 1000), make_run("cached", "cached", 0.04, 2.0, 10, 50)
    for order in (runs, runs[::-1]):
        result = compare(order)
        (run,) = result.runs
        assert (result.reference, run.name) == ("rve", "cached")
        assert run.difference.largest == pytest.approx(0.005)
        assert run.difference.rms == pytest.approx(0.005)
        assert run.speed_up["wall_time"] == pytest.approx(15.0)
        assert run.speed_up["rve_solves"] == pytest.approx(100.0)


def test_the_largest_are_compared_whenever_they_are_reached(make_run):
    """A curve and a force that come half a microsecond late, the force 2 % too small."""
    t = np.linspace(0.0, 4.0, 801)

    def run(name, law, late, factor):
        wave = factor * np.sin(np.pi * (t - late))
        history = {"force plate x": 0.0 * t, "force plate y": 50.0 * wave, "force idle x": 0.0 * t}
        history["force idle y"] = 0.0 * t
        curve = DisplacementCurve(t, np.stack([wave, 0.0 * t], axis=1))
        return replace(make_run(name, law, 0.0, 1.0, 1), curve=curve, history=history)

    result = compare([run("rve", "rve", 0.0, 1.0), run("cached", "cached", 0.5, 0.98)])
    difference = result.runs[0].difference
    assert difference.of_largest == pytest.approx(-0.02)
    assert difference.largest == pytest.approx(np.hypot(1.0, 0.98), rel=1e-4)
    plate, idle = result.force_table.to_records()
    assert (plate["run"], plate["force"], plate["largest"]) == ("cached", "plate", 50.0)
    assert plate["of_largest"] == pytest.approx(-0.02)
    assert plate["largest_difference"] == pytest.approx(difference.largest)
    assert (idle["force"], idle["largest"], idle["of_largest"]) == ("idle", 0.0, None)


def test_a_run_without_rve_solves_has_no_ratio(make_run):
    result = compare(
        [make_run("rve", "rve", 0.0, 30.0, 1000), make_run("s", "surrogate", 0.0, 2.0, 0)]
    )
    assert result.runs[0].speed_up["rve_solves"] is None
    json.dumps(plain(asdict(result)), allow_nan=False)
    tissue = make_run("t", "tissue", 0.0, 30.0, 0), make_run("rve", "rve", 0.0, 2.0, 1000)
    assert compare(tissue).runs[0].speed_up["rve_solves"] is None


def test_one_run_is_too_few(make_run):
    with pytest.raises(InputError, match=r"^compare: 1 run folder; give at least two$"):
        compare([make_run("a", "rve", 0.0, 1.0, 1)])


def test_each_audited_error_is_counted_once():
    errors = 10.0 ** np.random.default_rng(1).uniform(-6.0, 0.0, 1000)
    curve, tolerance = audit_curves(audited(0.1, errors).to_dict(), 0, "cached")
    below = 100.0 * (errors <= curve.x[:, None]).mean(axis=1)
    np.testing.assert_allclose(curve.y, below, atol=1e-9)
    assert (tolerance.x == 0.1).all()


def test_each_run_has_a_line_and_those_that_coincide_say_how_close_they_are(recipe, tmp_path):
    runs = [read_run(folder) for folder in made_runs(recipe, tmp_path)]  # 0.1 % apart
    (panel,) = displacement_panels(runs)
    labels = [curve.label for curve in panel.curves]
    assert labels == ["rve", "cached (displacement at most 0.1 % apart)"]
    assert [curve.name for curve in panel.curves] == ["reference", ""]
    runs[1].curve.displacement[:] *= 1.1
    (panel,) = displacement_panels(runs)
    assert [curve.label for curve in panel.curves] == ["rve", "cached"]


def test_the_largest_force_that_all_runs_have_is_drawn(recipe, tmp_path):
    runs = [read_run(folder) for folder in made_runs(recipe, tmp_path)]
    t = runs[0].curve.t
    for run in runs:
        run.history.update({f"force {name} x": np.zeros_like(t) for name in ("clamp", "grip")})
        run.history.update({"force clamp y": 3e6 * t, "force grip y": 1e6 * t})
    (panel,) = force_panels(runs)
    assert panel.y_label == "force clamp y (µN)"
    np.testing.assert_array_equal(panel.curves[0].y, 3e6 * t)
    runs[1].history.pop("force clamp x")
    (panel,) = force_panels(runs)
    assert panel.y_label == "force grip y (µN)"


def test_the_picture_has_displacements_force_and_difference(recipe, tmp_path, monkeypatch):
    folders = [run.folder for run in map(read_run, made_runs(recipe, tmp_path))]
    pictures = []

    def noted(panels, **words):
        pictures.append(panels)
        return draw_panels(panels, **words)

    monkeypatch.setattr("surrofe2.report.comparison.draw_panels", noted)
    compare_runs(folders, tmp_path / "compared")
    (panels,) = pictures
    names = [panel.y_label.split()[0] for panel in panels]
    assert names.index("displacement") < names.index("force") < names.index("difference")
    over_time = panels[: names.index("difference")]
    assert [panel.has_legend for panel in over_time] == [True] + [False] * (len(over_time) - 1)


def test_pictures_are_written_in_the_format_that_is_asked_for(recipe, tmp_path):
    folders = [run.folder for run in map(read_run, made_runs(recipe, tmp_path))]
    out = tmp_path / "compared"
    compare_runs(folders, out)
    before = (out / "comparison.json").read_bytes()
    compare_runs(folders, out, form="pdf")  # the comparison itself is kept
    assert (out / "comparison.pdf").read_bytes().startswith(b"%PDF")
    assert (out / "comparison.png").exists()
    assert (out / "comparison.json").read_bytes() == before
    with pytest.raises(InputError, match="format: 'gif': unknown format of pictures"):
        compare_runs(folders, out, form="gif")


def test_a_title_has_words_and_numbers_for_people(make_run):
    run = make_run("rve", "rve", 0.0, 1.0, 1)
    cell = {**run.record.recipe["cell"], "wall_stiffness": 5000.0}
    record = replace(run.record, recipe={**run.record.recipe, "cell": cell})
    title = comparison_title([replace(run, record=record)])
    assert title.endswith("cell by preset “printed” with wall stiffness 5,000, constrained runs"), (
        title
    )
