"""The table of thin tissue from curves whose periods and decrements are known."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2.displacement_curve import DisplacementCurve
from surrofe2.load_case import LoadCase
from surrofe2.macro import MacroSettings, Surface, find_rest, simulate
from surrofe2.macro.problem import bar
from surrofe2.report.study import NamedCell
from surrofe2.studies.thin_tissue import (
    BAR,
    CANTILEVER,
    METHODS,
    STRIP,
    ThinRun,
    small_oscillations,
    thin_cases,
    thin_tissue,
)
from tests.laws import KelvinVoigt, Skin

PERIODS = dict(zip(METHODS, (12.0, 11.4, 12.06), strict=True))


def run_of(case):
    """A damped oscillation about 1 along the load, of a period and decrement 0.08."""
    slower = case.duration / 100.0
    t = np.arange(0.0, case.duration + 0.25, 0.5 * slower)
    period = PERIODS[case.method] * slower
    u = 1.0 - np.exp(-0.08 * t / period) * np.cos(2.0 * np.pi * t / period)
    both = np.stack([u if case.shape == STRIP else 0.0 * u, -u], axis=1)
    return ThinRun(case, DisplacementCurve(t, both), 1.0)


def test_rows_say_how_far_each_method_is_from_the_tissue():
    cases = thin_cases(NamedCell.of("water"), sizes=(2, 4), bars=(8,))
    assert [case.method for case in cases[:3]] == [*METHODS]
    assert [case.shape for case in cases[::3]] == [STRIP, STRIP, CANTILEVER, BAR]
    assert [case.elements for case in cases[::3]] == [(16, 2), (16, 4), (16, 4), (8, 8)]
    assert len({case.name for case in cases}) == len(cases)
    study = thin_tissue([run_of(case) for case in cases])
    rows = study.table.to_records()
    assert len(rows) == 2 * 4
    strip = next(row for row in rows if row["plant_cells_across"] == 4)
    assert strip["FE²_off"] == pytest.approx(-5.0, abs=0.01)
    assert strip["with_surface_law_off"] == pytest.approx(0.5, abs=0.01)
    assert strip["c"] == pytest.approx(4.0 * (1.0 - 0.95**2), rel=1e-3)
    assert sum(row["c"] is not None for row in rows) == 2
    assert [panel.title for panel in study.panels][1:] == [
        f"{shape}, {n} plant cells across" for shape, n in ((STRIP, 2), (CANTILEVER, 4), (BAR, 8))
    ]


def test_small_oscillations_are_those_of_a_run_under_a_small_load():
    load = LoadCase(width=20.0, height=10.0, body_force=(2e-4, -1e-4), duration=12.0,
                    watched=(20.0, 5.0), output_interval=0.05)  # fmt: skip
    surface = Surface(law=Skin(a=5.0, b=200.0, eta=40.0, depth=2.0), on=("top", "right"))
    problem, law = replace(bar(load, (4, 2)), surface=surface), KelvinVoigt()
    tight = MacroSettings(elements=(4, 2), relative_tolerance=1e-8, absolute_tolerance=1e-12)
    true = simulate(problem, law, tight).curve.displacement
    found = small_oscillations(find_rest(problem, law, tight, factor=0.0), load).displacement
    assert abs(found - true).max() < 1e-3 * abs(true).max()
