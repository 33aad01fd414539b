"""The paper's bar by full FE² moves as the prototype's did; recipes as they ship do the main job:
generate, train, run with and without the cache.
"""

import json
from dataclasses import replace
from shutil import copy

import numpy as np
import pytest

from surrofe2 import CellParameters, LoadCase, MacroSettings, RveLaw, simulate
from surrofe2.recipe.recipe import load_recipe
from surrofe2.report.comparison import compare_runs
from surrofe2.store.surrogates import read_surrogate
from surrofe2.surrogate.settings import CalibrationSettings
from surrofe2.workflow.generate import generate_data_set
from surrofe2.workflow.run import run_study
from surrofe2.workflow.train import train_surrogate
from tests.conftest import ROOT

# first minimum (µm) and, of `water`, the period (µs) on 4 × 4 elements, of the prototype
REPORTED = {
    ("printed", "cauchy-born"): (-25.4, None),
    ("printed", "constrained-runs"): (-26.9, None),
    ("printed", "elastic"): (-26.9, None),
    ("water", "cauchy-born"): (-25.8, 44.4),
    ("water", "elastic"): (-31.8, 49.5),
    ("water", "constrained-runs"): (-31.9, 49.5),
}
QUICK = (("printed", "cauchy-born"), ("printed", "constrained-runs"), ("water", "elastic"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("preset", "initialisation"),
    [pytest.param(*each, marks=[pytest.mark.slow] * (each not in QUICK)) for each in REPORTED],
)
def test_bar_moves_as_the_model_reports(preset, initialisation):
    law = RveLaw(CellParameters.preset(preset), initialisation=initialisation)
    run = simulate(LoadCase(), law, MacroSettings())
    assert run.finished
    first, period = REPORTED[preset, initialisation]
    u = run.curve.displacement[:, 1]
    minima = np.flatnonzero((u[1:-1] < u[:-2]) & (u[1:-1] <= u[2:])) + 1
    assert u[minima[0]] == pytest.approx(first, abs=0.25)
    if period is not None:
        assert np.diff(run.curve.t[minima]).mean() == pytest.approx(period, abs=0.4)
    assert run.met.stretch[0] > (0.95 if preset == "printed" else 0.96)
    assert run.met.rate < 0.0085

    energies = run.energies
    scale = np.abs(energies["load"]).max()
    assert np.abs(energies["balance"]).max() < 1e-9 * scale
    assert np.abs(energies["numerical"]).max() < 0.03 * scale  # the paper's tolerances are loose
    assert np.diff(energies["dissipated"]).min() > -1e-9 * scale
    assert energies["dissipated"][-1] > 0.01 * scale


@pytest.mark.slow
def test_the_papers_iteration_moves_the_bar_as_the_direct_solve_does():
    """At the paper's loose stop (1.0 µN) for a tenth of the run: within 1 %."""
    load, cell = LoadCase(duration=25.0), CellParameters.preset("printed")
    settings = MacroSettings(record_dissipation=False)
    direct = simulate(load, RveLaw(cell), settings).curve.displacement
    iterated = simulate(load, RveLaw(cell, solver="iterated"), settings).curve.displacement
    assert np.abs(iterated - direct).max() < 0.01 * np.abs(direct).max()


FEWER_PATHS = CalibrationSettings(walks=300, runs=0)


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """A folder with the recipes, the default data set and its surrogate."""
    root = tmp_path_factory.mktemp("study")
    for name in ("data", "training"):
        (root / name).mkdir()
    for recipe in (ROOT / "data").glob("*.toml"):
        copy(recipe, root / "data")
    recipe = load_recipe(root / "data" / "bending-bar.toml")
    recipe = replace(recipe, calibration=FEWER_PATHS)
    generate_data_set(recipe.study())
    train_surrogate(recipe.study())
    return root


def run_both(study, recipe_name):
    recipe = load_recipe(study / "data" / f"{recipe_name}.toml")
    folders = [study / "out" / recipe_name / law for law in ("rve", "cached")]
    for folder in folders:
        run_study(recipe, folder.name, folder)
    together = study / "out" / recipe_name / "comparison"
    compare_runs(folders, together)
    comparison = json.loads((together / "comparison.json").read_text())
    true, cached = (json.loads((folder / "run.json").read_text()) for folder in folders)
    calls = [record["counts"]["right_hand_sides"] for record in (true, cached)]
    assert calls[1] <= 1.05 * calls[0]  # switching does not disturb the steps
    return comparison, cached


def test_default_surrogate_meets_its_accuracy(study):
    errors = read_surrogate(study / "training" / "bending-bar.h5").errors
    for component in ("xx", "xy", "yx", "yy"):
        assert errors["rms"][component] < 0.0001
        assert errors["worst"][component] < 0.0015


def test_cached_bar_follows_the_true_one_nearly_without_a_fallback(study):
    comparison, cached = run_both(study, "bending-bar")
    assert comparison["reference"] == "rve"
    assert comparison["runs"][0]["difference"]["largest"] < 0.001
    assert cached["counts"]["hits"] > 100_000
    assert cached["counts"]["fallbacks"] <= 0.01 * cached["counts"]["hits"]
    assert cached["cache"]["audit"]["audited"] > 50
    assert cached["cache"]["audit"]["violations"] <= 1
    assert not cached["cache"]["trust"]["off"]


def test_triple_load_leaves_the_range_and_falls_back_where_it_does(study):
    comparison, cached = run_both(study, "bending-bar-triple-load")
    assert comparison["reference"] == "rve"
    assert comparison["runs"][0]["difference"]["largest"] < 0.005
    counts = cached["counts"]
    assert counts["fallbacks_out_of_range"] > 200
    assert counts["fallbacks_not_finite"] == 0
    assert counts["rve_solves"] >= counts["fallbacks"]
    assert counts["hits"] > counts["fallbacks"]
