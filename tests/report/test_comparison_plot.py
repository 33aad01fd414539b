"""The picture of a comparison: audited errors, and curves that nobody tells apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from surrofe2.cache.audit import ErrorRecord
from surrofe2.report.comparison import audit_curves, comparison_title, displacement_panels
from surrofe2.store.run_folder import read_run
from tests.report.made_runs import made_runs


def test_each_audited_error_is_counted_once():
    errors = 10.0 ** np.random.default_rng(1).uniform(-6.0, 0.0, 1000)
    record = ErrorRecord(0.1)
    record.add(errors)
    curve, tolerance = audit_curves(record.to_dict(), 0, "cached")
    below = 100.0 * (errors <= curve.x[:, None]).mean(axis=1)
    np.testing.assert_allclose(curve.y, below, atol=1e-9)
    assert (tolerance.x == 0.1).all()


def test_curves_that_coincide_are_one_line_with_both_names(recipe, tmp_path):
    runs = [read_run(folder) for folder in made_runs(recipe, tmp_path)]  # 0.1 % apart
    assert [len(panel.curves) for panel in displacement_panels(runs)] == [1]
    (panel,) = displacement_panels(runs)
    assert panel.curves[0].label == "rve, cached (at most 0.1 % apart)"
    runs[1].curve.displacement[:] *= 1.1
    (panel,) = displacement_panels(runs)
    assert [curve.label for curve in panel.curves] == ["rve", "cached"]


def test_a_title_has_words_and_numbers_for_people(recipe, tmp_path):
    run = read_run(made_runs(recipe, tmp_path)[0])
    cell = {**run.record.recipe["cell"], "wall_stiffness": 5000.0}
    record = replace(run.record, recipe={**run.record.recipe, "cell": cell})
    title = comparison_title([replace(run, record=record)])
    assert title.endswith("cell by preset “printed” with wall stiffness 5,000, constrained runs"), (
        title
    )
