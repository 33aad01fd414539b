"""FE² against the full tissue in problems other than the bar: what is read off runs, and a run."""

from __future__ import annotations

import json

import numpy as np
import pytest

from surrofe2.displacement_curve import DisplacementCurve
from surrofe2.io.kept import KeptCurves
from surrofe2.report.study import NamedCell
from surrofe2.studies.tissue_problems import DURATION, ProblemRun, problem_cases, problems
from surrofe2.workflow.reproduce import compute_all

WATER = NamedCell.of("water")


def made(case):
    """A force that rises to its hold, too large by 1/(1 − c/n) in FE²; a damped oscillation."""
    t = np.linspace(0.0, case.duration, 301)
    factor = 1.0 if case.method == "tissue" else 1.0 / (1.0 - 0.48 / case.across)
    values = 1000.0 * factor * np.minimum(t / (0.75 * DURATION), 1.0)
    if case.problem == "skin over parenchyma":
        period = (60.0 if case.method == "tissue" else 59.4) * case.across / 8
        values = 5.0 * (np.exp(-1e-3 * t) * np.cos(2.0 * np.pi * t / period) - 1.0)
    axis = 0 if case.problem == "tensile strip" else 1
    both = np.zeros((t.size, 2))
    both[:, axis] = values
    return ProblemRun(case, DisplacementCurve(t, both), 1.0)


def test_what_the_surface_takes_is_read_off_the_forces():
    study = problems([made(case) for case in problem_cases(WATER)])
    rows = study.table.rows
    skin = ["first minimum (µm)", "period (µs)"]
    assert [row.measure for row in rows] == ["force (µN)"] * 8 + skin * 4
    for row in rows[:8]:
        assert row.c == pytest.approx(0.48)
        assert row.off == pytest.approx(100.0 / (row.case.across / 0.48 - 1.0))
    assert rows[8].off == pytest.approx(0.0, abs=0.1)
    assert rows[9].off == pytest.approx(-1.0, abs=0.01)
    assert rows[9].c is None


def test_curves_are_kept_by_what_they_depend_on(tmp_path, monkeypatch):
    cases = problem_cases(WATER, (3, 4))
    texts = {json.dumps(case.configuration(), sort_keys=True) for case in cases}
    assert len(texts) == len(cases) == 2 * (2 * 2 + 1)
    computed = []
    skins = [case.recipe.stated for case in cases if "skin" in case.problem]
    assert {(each.mesh.width, each.mesh.height) for each in skins} == {(200.0, 100.0)}

    def compute(case, progress=None):
        computed.append(case.name)
        return made(case)

    monkeypatch.setattr("surrofe2.studies.tissue_problems.ProblemCase.compute", compute)
    kept = KeptCurves(tmp_path)
    first, second = (compute_all(cases, kept) for _ in range(2))
    assert computed == [case.name for case in cases]
    for one, two in zip(first, second, strict=True):
        assert one.measures() == pytest.approx(two.measures())


@pytest.mark.slow
def test_strip_is_too_stiff_by_its_surface_and_less_so_where_it_is_wider():
    """docs/tissue.md: 0.4 plant cells of `water`, whatever the width."""
    found = []
    for across in (4, 8):
        cases = [each for each in problem_cases(WATER, (across,)) if "strip" in each.problem]
        tissue, fe2 = (each.compute() for each in cases)
        found.append(problems([tissue, fe2]).table.rows[0])
    narrow, wide = found
    assert 0.3 < narrow.c < 0.5
    assert wide.c == pytest.approx(narrow.c, abs=0.1)
    assert 0.0 < wide.off < 0.6 * narrow.off
