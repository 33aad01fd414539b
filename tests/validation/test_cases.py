"""What is read off curves of known period, decrement and force, and curves that are kept."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from surrofe2 import LoadCase
from surrofe2.macro import MacroSettings, find_rest, simulate
from surrofe2.problem import Surface
from surrofe2.report.study import NamedCell
from tests.laws import KelvinVoigt, Skin
from validation.bars import LIMIT, aitken, bar, with_limits
from validation.case import (
    FE2,
    SURFACE,
    TISSUE,
    Case,
    Run,
    Setting,
    apart_panel,
    compare,
    small_oscillations,
)
from validation.sketch import draw_sketch
from validation.tissues import (
    CANTILEVER,
    PULLED,
    SKINNED,
    block,
    problem_cases,
    skinned,
    strip,
    thin_cases,
)

WATER = NamedCell.of("water")
T = np.arange(0.0, 250.25, 0.5)


def oscillation(period, decrement, t=T):
    return -np.exp(-decrement * t / period) * np.cos(2.0 * np.pi * t / period)


def bar_run(method, mesh=0, n=16, *, period=50.0, decrement=0.04):
    return Run(bar(WATER, method, mesh, n), T, 16.0 * oscillation(period, decrement) - 16.0, 1.0)


def test_bars_of_all_sizes_are_one_bar_in_their_own_units():
    """ρ g L, and so stress and strain, and t √(E/ρ)/L do not change with the size."""
    paper = bar(WATER, FE2, 4).recipe.problem()
    assert paper.conditions == LoadCase().conditions
    for n in (8, 32):
        load = bar(WATER, FE2, 4, n).recipe.problem()
        (width, _), weight = load.mesh.p.max(axis=1), load.conditions[-1].acceleration[1]
        assert weight * width == pytest.approx(-80.0)
        assert load.duration / width == pytest.approx(250.0 / 400.0)
        assert len(load.output_times()) == len(paper.output_times())


def test_aitken_finds_the_limit_of_a_geometric_approach_and_says_where_there_is_none():
    assert aitken(1.0 + 0.4, 1.0 + 0.1, 1.0 + 0.025) == pytest.approx(1.0)
    for none in ((1.0, 2.0, 3.0), (1.0, 2.0, 1.5), (1.0, 1.0, 1.0)):
        assert np.isnan(aitken(*none))


def test_runs_are_compared_with_the_tissue_of_their_size():
    runs = []
    for n in (8, 16):
        runs.append(bar_run(TISSUE, n=n))
        for mesh, off in ((4, 0.04), (8, 0.01), (16, 0.0025)):
            runs.append(bar_run(FE2, mesh, n, period=50.0 * (1.0 - off), decrement=0.05))
    rows = [row for row in with_limits(compare(runs)) if row.measure == "period"]
    assert [row.run_name for row in rows[:5]] == [
        "full tissue",
        *(f"slow manifold, {n} × {n} elements" for n in (4, 8, 16)),
        LIMIT,
    ]
    assert rows[0].off is None
    np.testing.assert_allclose([row.off for row in rows[1:5]], [-4.0, -1.0, -0.25, 0.0], atol=1e-5)
    assert rows[1].case.across == 8
    (decrement,) = (row.off for row in compare(runs[:2]) if row.measure == "decrement" and row.off)
    assert decrement == pytest.approx(25.0, abs=1e-3)
    assert all(row.off is None for row in compare(runs[1:4]))


def held(case):
    """A force that rises to its hold, too large by 1/(1 − c/n) in FE²; a damped oscillation."""
    recipe = case.recipe
    t = np.linspace(0.0, recipe.duration, 301)
    factor = 1.0 if case.method == TISSUE else 1.0 / (1.0 - 0.48 / case.across)
    u = 1000.0 * factor * np.minimum(t / (0.75 * t[-1]), 1.0)
    if case.problem == SKINNED:
        u = oscillation((60.0 if case.method == TISSUE else 59.4) * case.across / 8, 0.05, t) - 1.0
    return Run(case, t, u, 1.0)


def test_what_the_surface_takes_is_read_off_the_forces():
    rows = [row for row in compare([held(case) for case in problem_cases(WATER)]) if row.off]
    forces = [row for row in rows if row.measure == "held force"]
    assert len(forces) == 8
    for row in forces:
        assert row.c == pytest.approx(0.48)
        assert row.off == pytest.approx(100.0 / (row.case.across / 0.48 - 1.0))
    (period,) = (row for row in rows if row.measure == "period" and row.case.across == 8)
    assert period.off == pytest.approx(-1.0, abs=0.02)
    assert period.c is None


def test_what_the_surface_takes_is_read_off_the_periods_of_thin_strips():
    cases = thin_cases(WATER, sizes=(2, 4), bars=(8,))
    assert [case.method for case in cases[:3]] == [TISSUE, FE2, SURFACE]
    assert [case.elements for case in cases[1::3]] == [(16, 2), (16, 4), (16, 4), (8, 8)]
    assert [case.problem for case in cases[::3]] == [PULLED, PULLED, CANTILEVER, "bar"]
    periods = {TISSUE: 12.0, FE2: 11.4, SURFACE: 12.06}
    t = np.arange(0.0, 100.25, 0.5)
    runs = [Run(case, t, oscillation(periods[case.method], 0.08, t), 1.0) for case in cases]
    rows = {
        (row.case.problem, row.case.across, row.case.method): row
        for row in compare(runs)
        if row.measure == "period"
    }
    strip = rows[PULLED, 4, FE2]
    assert strip.off == pytest.approx(-5.0, abs=0.01)
    assert strip.c == pytest.approx(4.0 * (1.0 - 0.95**2), rel=1e-3)
    assert rows[PULLED, 4, SURFACE].off == pytest.approx(0.5, abs=0.01)
    assert [key for key, row in rows.items() if row.c is not None] == [
        (PULLED, 2, FE2), (PULLED, 4, FE2)
    ]  # fmt: skip


def test_a_stopped_study_resumes_with_the_curves_it_has(tmp_path, monkeypatch):
    cases = [bar(WATER, TISSUE, 0, 2), bar(WATER, FE2, 1, 2), bar(WATER, FE2, 2, 2)]
    computed = []

    def compute(case):
        if len(computed) == 2:
            raise KeyboardInterrupt
        computed.append(case.name)
        return Run(case, T, oscillation(50.0, 0.04), 3.5)

    monkeypatch.setattr(Case, "compute", compute)
    setting = Setting(of=WATER, out=tmp_path)
    with pytest.raises(KeyboardInterrupt):
        setting.runs(cases)
    computed.clear()
    runs = setting.runs(cases)
    assert computed == [cases[2].name]
    np.testing.assert_array_equal(runs[0].u, oscillation(50.0, 0.04))
    assert runs[0].seconds == 3.5
    computed.clear()
    setting.runs([replace(cases[1], table={**cases[1].table, "tissue": {"frames": 3}})])
    assert len(computed) == 1


@pytest.mark.slow
def test_small_oscillations_are_those_of_a_run_under_a_small_load():
    load = LoadCase(width=20.0, height=10.0, body_force=(2e-4, -1e-4), duration=12.0,
                    watched=(20.0, 5.0), output_interval=0.05, elements=(4, 2))  # fmt: skip
    surface = Surface(law=Skin(a=5.0, b=200.0, eta=40.0, depth=2.0), on=("top", "right"))
    problem, law = replace(load, surface=surface), KelvinVoigt()
    tight = MacroSettings(relative_tolerance=1e-8, absolute_tolerance=1e-12)
    true = simulate(problem, law, tight).curve.displacement
    rest = find_rest(problem, law, tight, factor=0.0)
    found = small_oscillations(rest, load.output_times(), (2e-4, -1e-4))
    assert abs(found - true).max() < 1e-3 * abs(true).max()


@pytest.mark.slow
def test_bar_with_water_has_the_model_s_decrements():
    """validation/paper.md, 4 × 4: period 49.5, decrement 0.0678 elastic, 0.0411 slow manifold."""
    for name, decrement in (("elastic", 0.0678), (FE2, 0.0411)):
        run = bar(WATER, name, 4).compute()
        assert run.fit.first.period == pytest.approx(49.5, abs=0.05)
        assert run.fit.first.decrement == pytest.approx(decrement, rel=0.01)
        assert run.fit.residual < 0.1


@pytest.mark.slow
def test_strip_is_too_stiff_by_its_surface_and_less_so_where_it_is_wider():
    """docs/validation/tissue.md: 0.4 plant cells of `water`, whatever the width."""
    cases = [case for case in problem_cases(WATER, (4, 8)) if "strip" in case.problem]
    narrow, wide = (row for row in compare([case.compute() for case in cases]) if row.off)
    assert 0.3 < narrow.c < 0.5
    assert wide.c == pytest.approx(narrow.c, abs=0.1)
    assert 0.0 < wide.off < 0.6 * narrow.off


@pytest.mark.parametrize(
    ("make", "patches", "arrows"),
    [(strip, 2, 1), (block, 3, 1), (skinned, 3, 3)],  # tissue, supports, regions; plates
)
def test_a_sketch_shows_what_holds_and_what_loads(make, patches, arrows):
    axes = Figure().subplots()
    draw_sketch(axes, make(WATER, 4, TISSUE).recipe.problem())
    assert len(axes.patches) == patches
    assert len([text for text in axes.texts if text.get_text() == ""]) == arrows


def test_the_difference_from_the_tissue_is_drawn_and_the_tissue_is_zero():
    tissue, fe2 = strip(WATER, 4, TISSUE), strip(WATER, 4, FE2)
    runs = [
        Run(tissue, np.linspace(0.0, 1.0, 5), np.ones(5), 0.0),
        Run(fe2, np.linspace(0.0, 1.0, 3), np.array([1.0, 2.0, 4.0]), 0.0),
    ]
    panel = apart_panel(runs, "")
    assert [curve.y.tolist() for curve in panel.curves] == [[0.0, 0.0], [0.0, 1.0, 3.0]]
    assert panel.y_label == "FE² − tissue (µN)"
