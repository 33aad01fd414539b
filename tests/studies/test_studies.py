"""Studies of one RVE, by what must hold for any cell."""

import numpy as np
import pytest

from surrofe2.errors import InputError
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.study import NamedCell
from surrofe2.studies import initialisations, memory, relaxation
from surrofe2.studies.bar_runs import BarCase
from surrofe2.studies.drives import returning, steady_shear

WATER = CellParameters.preset("water")


def test_at_rate_zero_all_but_cauchy_born_are_the_elastic_equilibrium():
    run = initialisations.shear_steps(WATER, 0.0, steps=5)
    for name in ("constrained-runs", "slow-manifold"):
        np.testing.assert_allclose(run.stress[name], run.stress["elastic"], rtol=0, atol=1e-7)
    born, elastic = run.stress["cauchy-born"][1:, 0, 1], run.stress["elastic"][1:, 0, 1]
    assert (born > 1.1 * elastic).all()
    assert "micro-integration" not in run.stress
    assert set(run.unstable_from.values()) == {None}


@pytest.mark.slow
def test_at_a_rate_initialisations_rank_against_the_integrated_line():
    runs = (initialisations.shear_steps(WATER, steps=4, micro_step=2e-3),)
    study = initialisations.figure_5(runs)
    error = {row["method"]: row["largest_difference"] for row in study.table.to_records()}
    names = ("slow-manifold", "constrained-runs", "elastic", "cauchy-born")
    assert sorted(error, key=error.get) == list(names)
    assert study.to_csv().count("\n") == 6
    assert study.to_record()["units"]["largest_difference"] == "µN/µm"


def test_orders_in_the_rate():
    errors = initialisations.rate_errors(WATER, (1.0, 2.0, 4.0), times=(0.0, 8.0, 14.0))
    for name, order in initialisations.EXPECTED.items():
        assert errors.order(name) == pytest.approx(order, abs=0.1)


def test_relaxation_reaches_the_fixed_point_elastic_does_not():
    ways = relaxation.relaxations(WATER, limit=20_000, samples=20)
    runs, elastic, direct = (ways[n] for n in ("constrained-runs", "elastic", "direct"))
    start = runs.error[0]
    assert elastic.error[0] == pytest.approx(start)
    assert direct.error[0] == pytest.approx(start)
    assert direct.iterations[-1] <= 6
    assert direct.error[-1] < 1e-11
    assert runs.mean_force[-1] < 1e-2
    assert runs.error[-1] < 0.5 * elastic.error[-1]  # cut off while it still falls
    assert 100 < runs.first_below(1.0) < 10_000
    assert len(relaxation.describe(ways).series["method"]) > 40


def test_pasts_meet_in_F_and_rate_and_the_difference_fades():
    settings = memory.MemorySettings(after=2.0, micro_step=2e-3)
    steady = steady_shear(settings.rate)
    away = returning(steady, settings.stretch, settings.shear, settings.period)
    for a, b in zip(steady(-1e-9), away(-1e-9), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-9)
    assert np.abs(steady(-3.0)[0] - away(-3.0)[0]).max() > 1e-3
    step = 1e-5
    for t in (-4.0, -11.0):
        slope = (away(t + step)[0] - away(t - step)[0]) / (2.0 * step)
        np.testing.assert_allclose(slope, away(t)[1], rtol=0, atol=1e-9)
    found = memory.memory(WATER, settings)
    assert 0.0 < found.difference[-1] < 0.1 * found.largest
    assert found.sound
    assert found.verdict.startswith("sound")


def test_verdict_turns_where_the_past_matters():
    settings = memory.MemorySettings(after=1.0, tolerance=1e-6, micro_step=2e-3)
    found = memory.memory(WATER, settings)
    assert not found.sound
    assert found.verdict.startswith("not sound")


def test_fading_time():
    t = np.linspace(0.0, 10.0, 1001)
    assert memory.fading_time(t, np.exp(-t / 2.0), np.exp(-1.0)) == pytest.approx(2.0, abs=0.02)
    assert memory.fading_time(t, np.ones_like(t), 0.5) is None


@pytest.mark.slow
def test_bar_with_water_has_the_model_s_decrements():
    """docs/theory.md, 4 × 4: period 49.5, decrement 0.0678 elastic, 0.0411 slow manifold."""
    for name, decrement in (("elastic", 0.0678), ("slow-manifold", 0.0411)):
        case = BarCase(of=NamedCell(WATER, "water"), method=name, elements=(4, 4))
        run = case.compute()
        assert run.fit.first.period == pytest.approx(49.5, abs=0.05)
        assert run.fit.first.decrement == pytest.approx(decrement, rel=0.01)
        assert run.fit.residual < 0.1


def test_settings_are_checked():
    with pytest.raises(InputError, match=r"memory\.period: 0"):
        memory.MemorySettings(period=0)
