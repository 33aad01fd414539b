"""One RVE by each initialisation, by what must hold for any cell; and the studies as commands."""

import numpy as np
import pytest

from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.store.store import read_json
from validation import rve
from validation.__main__ import STUDIES, main

WATER = CellParameters.preset("water")


def test_at_rate_zero_all_but_cauchy_born_are_the_elastic_equilibrium():
    run = rve.shear_steps(WATER, 0.0, steps=5)
    for name in ("constrained-runs", "slow-manifold"):
        np.testing.assert_allclose(run.stress[name], run.stress["elastic"], rtol=0, atol=1e-7)
    born, elastic = run.stress["cauchy-born"][1:, 0, 1], run.stress["elastic"][1:, 0, 1]
    assert (born > 1.1 * elastic).all()
    assert "micro-integration" not in run.stress
    assert set(run.unstable_from.values()) == {None}


@pytest.mark.slow
def test_at_a_rate_initialisations_rank_against_the_integrated_line():
    study = rve.describe_shear([rve.shear_steps(WATER, steps=4, micro_step=2e-3)])
    error = {row["method"]: row["largest_difference"] for row in study.table.to_records()}
    names = ("slow-manifold", "constrained-runs", "elastic", "cauchy-born")
    assert sorted(error, key=error.get) == list(names)


@pytest.mark.slow
def test_orders_in_the_rate():
    errors = rve.rate_errors(WATER, (1.0, 2.0, 4.0), times=(0.0, 8.0, 14.0))
    for name, order in rve.EXPECTED.items():
        assert errors.order(name) == pytest.approx(order, abs=0.1)


@pytest.mark.slow
def test_relaxation_reaches_the_fixed_point_elastic_does_not():
    solvers = rve.relaxations(WATER, limit=20_000, samples=20)
    runs, elastic, direct = (solvers[n] for n in ("constrained-runs", "elastic", "direct"))
    start = runs.error[0]
    assert elastic.error[0] == pytest.approx(start)
    assert direct.error[0] == pytest.approx(start)
    assert direct.iterations[-1] <= 6
    assert direct.error[-1] < 1e-11
    assert runs.mean_force[-1] < 1e-2
    assert runs.error[-1] < 0.5 * elastic.error[-1]  # cut off while it still falls
    assert 100 < runs.first_below(1.0) < 10_000


@pytest.mark.slow
def test_studies_are_listed_and_one_is_written_and_kept(tmp_path, capsys):
    assert main([]) == 0
    listed = capsys.readouterr().out
    assert all(f"\n  {name} " in listed for name in STUDIES)
    call = ["fig5", "--cell", "water", "--out", str(tmp_path)]
    assert main(call) == 0
    assert "| slow-manifold | 0.01 | micro-integration |" in capsys.readouterr().out
    assert (tmp_path / "fig5-water.png").stat().st_size > 10_000
    assert (
        (tmp_path / "fig5-water.csv")
        .read_text(encoding="utf-8")
        .startswith("panel,x is,y is,curve,x,y")
    )
    record = read_json(tmp_path / "fig5-water.json")
    assert record["preset"] == "water"
    assert record["cell"]["fluid_particle_mass"] == 0.27
    assert record["units"]["largest_difference"] == "µN/µm"
    assert main(call) == 0
    assert "there already" in capsys.readouterr().out
    assert main([*call, "--meshes", "2"]) == 1
    assert "asked.meshes" in capsys.readouterr().out
