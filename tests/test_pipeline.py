"""The main job with the recipes as they ship: generate, train, run with and without the cache."""

import json
from dataclasses import replace
from shutil import copy

import pytest

from surrofe2.recipe.recipe import load_recipe
from surrofe2.report.comparison import compare_runs
from surrofe2.store.surrogates import read_surrogate
from surrofe2.surrogate.settings import CalibrationSettings
from surrofe2.workflow.generate import generate_data_set
from surrofe2.workflow.run import run_study
from surrofe2.workflow.train import train_surrogate
from tests.conftest import ROOT

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
    generate_data_set(recipe)
    train_surrogate(recipe)
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
