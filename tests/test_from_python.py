"""All of it from Python: the page's example, runs saved as the commands do, laws of one's own."""

import json
import logging
from dataclasses import replace

import numpy as np
import pytest

import surrofe2
from surrofe2 import (
    CachedLaw,
    CalibrationSettings,
    CellParameters,
    MacroSettings,
    Problem,
    RegionalLaw,
    RveLaw,
    SamplingRange,
    Status,
    TrainingSettings,
    calibrate,
    compare_runs,
    load_recipe,
    points_by_region,
    read_data_set,
    read_run,
    read_surrogate,
    rectangle,
    sample_stress,
    save_run,
    simulate,
    train,
    write_surrogate,
    zoom_into,
)
from surrofe2.base.errors import InputError, MismatchError, SimulationError
from surrofe2.store.run_folder import read_record
from surrofe2.workflow.generate import generate_data_set
from surrofe2.workflow.run import run_study
from tests.conftest import ROOT
from tests.folders import assert_same, numbers
from tests.laws import KelvinVoigt, SoftLaw


def test_public_names_are_there():
    assert all(surrofe2.__getattr__(name) is not None for name in dir(surrofe2))


@pytest.mark.slow
def test_the_page_s_example_in_a_short_form(tmp_path, monkeypatch, caplog):
    """Fewer samples, paths and µs than the page has, and all of its lines."""
    part = (ROOT / "docs/howto/python.md").read_text(encoding="utf-8")
    code = "".join(block.split("```")[0] for block in part.split("```python\n")[1:])
    for usual, short in {
        "duration=50.0": "duration=6.0",
        "count=1024": "count=128",
        "iterations=300": "iterations=60",
        "walks=300, runs=100": "walks=30, runs=0, alpha=0.1, length=6",
        "duration=120.0": "duration=2.0",
        "duration=60.0, steps=120": "duration=6.0, steps=12",
    }.items():
        assert usual in code
        code = code.replace(usual, short)
    monkeypatch.chdir(tmp_path)
    found = {}
    exec(code, found)
    assert not caplog.records
    assert found["difference"](found["cached"].curve, found["full"].curve).largest < 2e-3
    assert found["cached"].effort["hits"] > 5000
    assert json.loads((tmp_path / "out/comparison/comparison.json").read_text())["runs"]
    assert zoom_into("out/cached", (100.0, 50.0)).seen.extremes()
    assert found["pressed"].history["force plate y"][-1] <= 0.0
    assert found["storage"] > found["loss"] > 0.0


def test_a_saved_run_is_the_one_that_the_command_writes(recipe, tmp_path):
    law = RveLaw(recipe.study().cell.parameters, recipe.rve)
    run_study(recipe, "rve", tmp_path / "command")
    save_run(simulate(recipe.problem(), law, recipe.macro), tmp_path / "python")
    files = [numbers(tmp_path / of) for of in ("command", "python")]
    for each in files:
        del each["run.json"]
    del files[0]["input/recipe.toml"]  # from Python there is no recipe
    assert_same(*files)
    records = [read_record(tmp_path / of) for of in ("command", "python")]
    compared = [record.compared() for record in records]
    stated = [name for name in compared[1] if not name.startswith("mesh.")]  # by its arrays
    for name in stated:
        assert compared[1][name] == compared[0][name], name
    counts = [record.counts for record in records]
    assert counts[0] == counts[1]
    assert records[0].met == records[1].met
    result = compare_runs([tmp_path / "command", tmp_path / "python"], tmp_path / "c")
    assert result.runs[0].difference.largest == 0.0
    shorter = replace(recipe.problem(), duration=3.0)
    with pytest.raises(MismatchError, match=r"duration: this call has 3\.0, what is there 4\.0"):
        save_run(simulate(shorter, law, recipe.macro), tmp_path / "python")


def test_samples_are_those_of_the_command(recipe):
    generate_data_set(recipe.study())
    law = RveLaw(recipe.study().cell.parameters, recipe.rve)
    found = sample_stress(
        law, recipe.study().cell.range, recipe.study().cell.samples.count, seed=3, tangents=False
    )
    assert found.fingerprint == read_data_set(recipe.study().data_path()).fingerprint


@pytest.mark.parametrize("name", ["block-between-plates", "notched-leaf"])
def test_a_law_of_one_s_own_runs_an_example(name, tmp_path):
    recipe = load_recipe(ROOT / "examples" / f"{name}.toml")
    problem = recipe.problem()
    if recipe.mesh.file is None:
        mesh = recipe.mesh
        problem = replace(problem, mesh=rectangle(mesh.width, mesh.height, (2, 2)))
    short = 0.05 * problem.duration
    problem = replace(problem, duration=short, output_interval=0.25 * short)
    run = simulate(problem, KelvinVoigt(), recipe.macro)
    record = save_run(run, tmp_path / "own")
    assert record.law == "KelvinVoigt"
    assert record.recipe["conditions"].keys() == recipe.to_dict()["conditions"].keys()
    stored = read_run(tmp_path / "own")
    np.testing.assert_array_equal(stored.curve.displacement, run.curve.displacement)
    assert stored.history.keys() == run.history.keys()
    with pytest.raises(InputError, match="law: KelvinVoigt; it has no plant cells to look into"):
        zoom_into(tmp_path / "own", tuple(problem.mesh.p.T.mean(axis=0)))


def test_a_law_for_each_region_is_saved_with_its_cells(tmp_path):
    mesh = rectangle(100.0, 100.0, (1, 2))
    mesh = mesh.with_subdomains({"under": np.array([0]), "over": np.array([1])})
    cells = {"under": CellParameters(), "over": CellParameters.preset("water", viscosity=0.2)}
    law = RegionalLaw(
        {name: RveLaw(cell, initialisation="elastic") for name, cell in cells.items()},
        points_by_region(mesh, ("under", "over")),
    )
    problem = Problem(mesh=mesh, conditions=(), duration=1.0)
    save_run(simulate(problem, law), tmp_path)
    record = read_record(tmp_path)
    assert record.initialisation == "elastic"
    assert [cell["preset"] for cell in record.recipe["cells"].values()] == ["printed", "own"]
    for y, name in ((20.0, "under"), (80.0, "over")):
        found = zoom_into(tmp_path, (50.0, y))
        assert found.cell == name
        own = RveLaw(cells[name]).particles(np.eye(2)[None], np.zeros((1, 2, 2)))
        np.testing.assert_allclose(found.seen.pressure[0], own.pressure[0], rtol=1e-9)


def test_a_run_that_fails_is_saved_as_failed(recipe, tmp_path):
    load = replace(recipe.problem(), duration=30.0)
    with pytest.raises(SimulationError) as stopped:
        simulate(load, SoftLaw(fails_above=1.005), MacroSettings())
    assert save_run(stopped.value.partial, tmp_path / "own").status == "failed"
    with pytest.raises(InputError, match="the run is failed"):
        read_run(tmp_path / "own")


def test_why_a_surrogate_is_not_trusted_is_one_line(caplog, tmp_path):
    law = RveLaw(CellParameters())
    wanted = SamplingRange(stretch=(0.98, 1.02), shear=0.02, rate=0.01)
    samples = sample_stress(law, wanted, 64)
    surrogate = train(samples, TrainingSettings(hidden=(4,), iterations=20))

    def warnings(surrogate):
        caplog.clear()
        with caplog.at_level(logging.WARNING):
            CachedLaw(surrogate, law)
        return [record.getMessage() for record in caplog.records]

    assert ["not calibrated" in line for line in warnings(surrogate)] == [True]
    write_surrogate(surrogate, str(tmp_path / "own-surrogate.h5"))
    assert not read_surrogate(str(tmp_path / "own-surrogate.h5")).is_calibrated
    paths = CalibrationSettings(walks=40, runs=0, alpha=0.1)
    assert warnings(calibrate(surrogate, samples, settings=paths)) == []

    class Failing(RveLaw):
        def respond(self, F, F_dot, state=None, *, tangents=False):
            answer = super().respond(F, F_dot, state, tangents=tangents)
            answer.status[:] = Status.NOT_CONVERGED
            return answer

    caplog.clear()
    calibrate(surrogate, samples, Failing(CellParameters()), paths)
    (line,) = [record.getMessage() for record in caplog.records]
    assert line.startswith("bound: none, because")
