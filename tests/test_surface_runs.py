"""Runs of recipes with [surface]: the law from the kept table, what run.json says, going on."""

import json
from dataclasses import replace

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.recipe.recipe import load_recipe, make_recipe
from surrofe2.store.run_folder import read_record, read_run
from surrofe2.surface.tabulated import TabulatedSurface
from surrofe2.workflow import laws as surfaces
from surrofe2.workflow.laws import surface_notes, with_surface
from surrofe2.workflow.rest import rest_study
from surrofe2.workflow.run import new_record, run_study
from tests.conftest import RECIPE
from tests.folders import assert_same

SIDES = '\n[surface]\non = ["top", "right"]\n'


def table(cell, method, pull=40.0):
    """P_s = pull + 300 (λ − 1) + 20 λ̇ for 0.9 < λ < 1.1 and |λ̇| < 0.02."""
    coefficients = np.array([[pull, 0.4], [30.0, 0.0]])
    bounds = (0.9, 1.1), 0.02, 0.0, 12.0, 25.0
    return TabulatedSurface(coefficients, *bounds, cell, method, 1e-3, 80.0)


@pytest.fixture
def made(tmp_path, monkeypatch):
    """Tables that were asked for, instead of slabs; kept in a folder of their own."""
    asked = []

    def tabulate(slab, stretch, rate):
        asked.append((slab, stretch, rate))
        return table(slab.cell, slab.initialisation)

    monkeypatch.setattr(surfaces, "table_within", tabulate)
    monkeypatch.setattr(surfaces, "cache_folder", lambda: tmp_path / "kept")
    return asked


def test_a_run_with_a_surface_law(written, tmp_path, made):
    recipe = load_recipe(written(RECIPE + SIDES))
    record = run_study(recipe, "rve", tmp_path / "sided")
    assert len(made) == 1
    assert made[0][1:] == ((0.94, pytest.approx(np.hypot(1.05, 0.05) + 0.01)), 0.015)
    told = json.loads((tmp_path / "sided" / "run.json").read_text())["problem"]["surface"]
    assert told["on"] == ["top", "right"]
    assert (told["sides"], told["oblique"]) == (4, 0)
    law = told["laws"][""]
    assert law["cell_fingerprint"] == recipe.study().cell.parameters.fingerprint
    assert (law["kind"], law["outer_wall"], law["initialisation"]) == (
        "table", 1.0, "constrained-runs",
    )  # fmt: skip
    assert 0.01 < told["rest"] < 1.0
    (note,) = surface_notes(record)
    assert note == (f"surface: 4 sides (top, right); at rest moved by {told['rest']:.2g} µm", False)
    energies = (tmp_path / "sided" / "energies.csv").read_text().splitlines()[0]
    assert "surface" in energies
    assert "dissipated_surface_top" in energies.replace(" ", "_")

    bare = load_recipe(written(RECIPE))
    other = run_study(bare, "rve", tmp_path / "bare")
    assert "surface" not in other.problem
    sided, plain = (read_run(tmp_path / name).curve.displacement for name in ("sided", "bare"))
    assert 0.001 < abs(sided - plain).max() / abs(plain).max() < 0.5
    assert [*surface_notes(other)] == []
    again = run_study(recipe, "rve", tmp_path / "again")
    assert len(made) == 1  # the table was kept
    assert again.problem["surface"] == record.problem["surface"]


@pytest.mark.slow
def test_a_kept_table_of_another_plant_cell_is_made_again(written, tmp_path, made):
    recipe = load_recipe(written(RECIPE + SIDES))
    surfaces.cell_surface(recipe.study(), 4.0)
    (kept,) = (tmp_path / "kept" / "surfaces").iterdir()
    other = table(CellParameters.preset("water"), "constrained-runs")
    surfaces.write_surface(kept, other, recipe.to_dict())
    assert surfaces.cell_surface(recipe.study(), 4.0).cell == recipe.study().cell.parameters
    assert len(made) == 2


@pytest.mark.slow
def test_an_interrupted_run_with_a_surface_law_goes_on(written, tmp_path, made, monkeypatch):
    recipe = load_recipe(written(RECIPE + SIDES))
    run_study(recipe, "rve", tmp_path / "whole")
    monkeypatch.setattr("surrofe2.workflow.run.CHECKPOINT_INTERVAL", 0.0)
    calls = 0

    def stop(t, note):
        nonlocal calls
        calls += 1
        if calls == 8:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_study(recipe, "rve", tmp_path / "parts", report=stop)
    assert read_record(tmp_path / "parts").status == "interrupted"
    record = run_study(recipe, "rve", tmp_path / "parts")
    assert_same(tmp_path / "parts", tmp_path / "whole")
    told = [read_record(tmp_path / each).problem["surface"] for each in ("parts", "whole")]
    assert told[0] == told[1]
    assert record.problem["surface"]["rest"] == told[0]["rest"]


def test_rest_with_a_surface_law(written, tmp_path, made):
    recipe = load_recipe(written(RECIPE + SIDES))
    record = rest_study(recipe, tmp_path / "rest", load_steps=2)
    assert record.problem["surface"]["rest"] > 0.01
    bare = rest_study(load_recipe(written(RECIPE)), tmp_path / "bare", load_steps=2)
    soft, stiff = (each.met["watched"][1] for each in (record, bare))
    assert 0.001 < abs(soft / stiff - 1.0) < 0.5


def test_several_cells_and_oblique_sides(tmp_path, made):
    several = make_recipe({
        "cells": {"skin": {"preset": "printed", "regions": ["skin"]},
                  "flesh": {"preset": "water", "regions": ["rest"]}},
        "mesh": {"width": 100.0, "height": 100.0, "elements": [2, 2],
                 "regions": {"skin": {"box": [0, 50, 100, 100]}}},
        "conditions": {"clamp": {"kind": "fixed", "on": "left"}},
        "surface": {},
    })  # fmt: skip
    problem = with_surface(several, several.problem())
    assert [slab.cell for slab, *_ in made] == [CellParameters.preset(p)
                                               for p in ("printed", "water")]  # fmt: skip
    assert {*problem.surface.law} == {"skin", "flesh"}
    told = surfaces.surface_record(problem)
    assert told["on"] == "free"
    assert told["sides"] == 6
    assert len({law["cell_fingerprint"] for law in told["laws"].values()}) == 2
    oblique = {**told, "oblique": 3, "largest_angle": 30.0, "rest": 0.5}
    record = replace(new_record(several, "rve"), problem={"surface": oblique})
    _, (sentence, is_warning) = surface_notes(record)
    assert is_warning
    assert "3 sides are oblique to the rows of plant cells, by up to 30°; they take" in sentence


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ({"on": 3}, r'surface.on: 3; it must be names of boundaries, or "free"'),
        ({"on": []}, r'surface.on: \[\]; it must be names of boundaries, or "free"'),
        ({"on": ["tpo"]}, "surface.on: tpo; no such boundary; did you mean top"),
        ({"of": "free"}, "surface.of: unknown key; known are on"),
        ("free", r"surface: 'free'; it must be a section \[surface\]"),
    ],
)
def test_wrong_sections_are_refused(section, said):
    with pytest.raises(InputError, match=said):
        make_recipe({"surface": section}).problem()
