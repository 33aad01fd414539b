"""Scale separation and damping: scaling, extrapolation, uncertainty, and going on after Ctrl-C."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from surrofe2.cli import app
from surrofe2.displacement_curve import DisplacementCurve
from surrofe2.errors import InputError
from surrofe2.io.kept import KeptCurves
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.damped_fit import fit_damped_modes
from surrofe2.report.study import NamedCell
from surrofe2.studies import bar_comparison
from surrofe2.studies.bar_comparison import Bars
from surrofe2.studies.bar_runs import WAYS, BarCase, BarRun
from surrofe2.workflow.reproduce import compute_all

WATER = NamedCell(CellParameters.preset("water"), "water")
T = np.arange(0.0, 250.25, 0.5)


def curve(period, decrement, noise=0.0, seed=0):
    w, d = 2.0 * np.pi / period, decrement / period
    u = -16.0 + 16.0 * np.exp(-d * T) * np.cos(w * T)
    u += 0.7 * np.exp(-3.0 * d * T) * np.cos(2.9 * w * T)
    u += noise * np.random.default_rng(seed).normal(size=T.size)
    return DisplacementCurve(T, np.stack([0.0 * u, u], axis=1))


def test_bars_of_all_sizes_are_one_bar_in_their_own_units():
    """ρ g L, and so stress and strain, and t √(E/ρ)/L do not change with the size."""
    paper = bar_comparison.scaled_load_case(16)
    assert (paper.width, paper.body_force, paper.duration) == (400.0, (0.0, -0.2), 250.0)
    for n in (8, 32):
        bar = bar_comparison.scaled_load_case(n)
        assert bar.body_force[1] * bar.width == pytest.approx(-80.0)
        assert bar.duration / bar.width == pytest.approx(250.0 / 400.0)
        assert len(bar.output_times()) == len(paper.output_times())


def test_aitken_finds_the_limit_of_a_geometric_approach_and_says_where_there_is_none():
    assert bar_comparison.aitken(1.0 + 0.4, 1.0 + 0.1, 1.0 + 0.025) == pytest.approx(1.0)
    for none in ((1.0, 2.0, 3.0), (1.0, 2.0, 1.5), (1.0, 1.0, 1.0)):
        assert np.isnan(bar_comparison.aitken(*none))


def case(method, mesh=None, n=16):
    load = bar_comparison.scaled_load_case(n)
    elements = None if mesh is None else (mesh, mesh)
    return BarCase(of=WATER, method=method, load_case=load, elements=elements)


def test_deviations_are_from_the_tissue_of_the_same_size():
    runs = [
        run
        for n in (8, 16)
        for run in (
            BarRun(case("tissue", n=n), curve(50.0, 0.04), 1.0),
            *(
                BarRun(case("slow-manifold", m, n), curve(50.0 * (1.0 - off), 0.05), 1.0)
                for m, off in ((4, 0.04), (8, 0.01), (16, 0.0025))
            ),
        )
    ]
    rows = bar_comparison.with_limits(bar_comparison.compare_bars(runs))
    study = bar_comparison.growing_bars(runs)
    records = study.table.to_records()
    assert [record["run"] for record in records[:5]] == [
        "full tissue", "slow-manifold 4x4", "slow-manifold 8x8", "slow-manifold 16x16",
        bar_comparison.LIMIT,
    ]  # fmt: skip
    off = [row.off["period"] for row in rows[1:5]]
    np.testing.assert_allclose(off, [-4.0, -1.0, -0.25, 0.0], atol=1e-5)
    assert rows[3].off["decrement"] == pytest.approx(25.0, abs=1e-3)
    assert len(study.panels) == 3
    assert records[4]["period"] is None
    assert records[1]["first_minimum_16_n"] == 2.0 * records[1]["first_minimum"]
    assert study.table.units["period_off"] == "%"


def test_bars_are_compared_with_the_tissue_where_there_is_one():
    runs = [
        BarRun(case("tissue"), curve(50.0, 0.04), 1.0),
        BarRun(case("elastic", 4), curve(51.0, 0.05), 1.0),
    ]
    study = bar_comparison.figure_8(runs)
    headings, texts = study.table.for_people()
    found = [dict(zip(headings, row, strict=True)) for row in texts]
    assert [row["run"] for row in found] == ["full tissue", "elastic 4x4"]
    assert [row["period off (%)"] for row in found] == ["–", "+2.0"]
    assert [row["decrement off (%)"] for row in found] == ["–", "+25.0"]
    alone = bar_comparison.figure_8(runs[1:])
    assert "period off (%)" not in alone.table.for_people()[0]
    assert alone.results["full_tissue"] == "not computed"


def test_standard_error_is_the_scatter_of_noisy_curves():
    fits = [
        fit_damped_modes(T, curve(50.0, 0.04, 0.05, seed).displacement[:, 1]) for seed in range(12)
    ]
    scatter = np.std([fit.first.decrement for fit in fits], ddof=1)
    told = np.mean([fit.decrement_error for fit in fits])
    assert told == pytest.approx(scatter, rel=0.6)
    assert abs(np.mean([fit.first.decrement for fit in fits]) - 0.04) < scatter


def test_a_third_mode_needs_a_third_mode():
    third = 0.05 * np.exp(-0.02 * T) * np.cos(2.0 * np.pi * T / 9.0)
    u = curve(50.0, 0.04).displacement[:, 1] + third
    two, three = fit_damped_modes(T, u), fit_damped_modes(T, u, 3)
    assert three.residual < 1e-5 < 0.02 < two.residual
    assert three.first.decrement == pytest.approx(0.04, rel=1e-5)
    with pytest.raises(InputError, match="1 modes; it must be at least 2"):
        fit_damped_modes(T, u, 1)


def test_damping_is_compared_way_by_way():
    runs = [
        BarRun(case("tissue"), curve(50.0, 0.04), 1.0),
        BarRun(case("elastic", 4), curve(50.0, 0.06), 1.0),
    ]
    tissue, elastic = bar_comparison.damping(runs).table.to_records()
    excess = ("excess_over_the_tissue_s", "lowest_excess", "highest_excess")
    assert [tissue[name] for name in excess] == [0.0, 0.0, 0.0]
    assert elastic["decrement"] == pytest.approx(0.06, rel=1e-5)
    assert elastic["excess_over_the_tissue_s"] == pytest.approx(50.0, abs=1e-3)
    lowest, highest = elastic["lowest_of_all_fits"], elastic["highest_of_all_fits"]
    assert lowest <= elastic["decrement"] <= highest
    assert sum(name.startswith("period_") for name in elastic) == len(WAYS)


def test_the_first_way_to_fit_is_that_of_all_figures():
    run = BarRun(case("tissue"), curve(50.0, 0.04, noise=0.01), 1.0)
    assert fit_damped_modes(T, run.curve.displacement[:, 1]) == run.fit == run.fits[0]


def test_configurations_tell_cases_apart():
    found = bar_comparison.damping_cases(WATER, Bars())
    texts = {json.dumps(each.configuration(), sort_keys=True) for each in found}
    assert len(texts) == len(found) == 2 + 3 * (2 + 2 + 1)
    scales = bar_comparison.growing_cases(WATER, Bars())
    assert len(scales) == 3 * (1 + 3)
    at_16 = [each for each in scales if each.plant_cells == (16, 16)]
    shared = {json.dumps(each.configuration(), sort_keys=True) for each in at_16}
    assert shared < texts


def test_a_stopped_study_goes_on_with_the_curves_it_has(tmp_path, monkeypatch):
    cases = bar_comparison.growing_cases(WATER, Bars(sizes=(2,), meshes=(1, 2)))
    computed = []

    def compute(case, progress=None):
        if len(computed) == 2:
            raise KeyboardInterrupt
        computed.append(case.name)
        return BarRun(case, curve(50.0, 0.04), 1.0)

    monkeypatch.setattr(BarCase, "compute", compute)
    kept = KeptCurves(tmp_path / "curves")
    with pytest.raises(KeyboardInterrupt):
        compute_all(cases, kept)
    assert [kept.read(c.name, c.configuration()) is not None for c in cases] == [True, True, False]
    computed.clear()
    runs = compute_all(cases, kept)
    assert computed == [cases[2].name]
    assert len(runs) == 3


@pytest.mark.slow
def test_the_command_writes_figure_and_table(tmp_path):
    arguments = [
        "reproduce", "scales", "--preset", "water", "--out", str(tmp_path), "--sizes", "2,3",
        "--meshes", "2", "--duration", "100",
    ]  # fmt: skip
    done = CliRunner().invoke(app, arguments, env={"COLUMNS": "200"})
    assert done.exit_code == 0, done.output
    assert (tmp_path / "scales-water.png").stat().st_size > 10_000
    lines = (tmp_path / "scales-water.md").read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith("| plant cells a side | run | first minimum × 16/n (µm) |")
    assert len(lines) == 2 + 4
    curves = {path: path.stat().st_mtime_ns for path in (tmp_path / "curves").iterdir()}
    assert len(curves) == 4
    assert CliRunner().invoke(app, [*arguments, "--fresh"]).exit_code == 0
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "curves").iterdir()} == curves
