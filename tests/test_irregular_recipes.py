"""Recipes of irregular tissue in data/: the press, drained and undrained, on a small mesh."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2.base.tensors import det
from surrofe2.macro import find_rest
from surrofe2.recipe.recipe import load_recipe
from surrofe2.rve import RveLaw
from surrofe2.workflow.scale import scale_warnings
from tests.conftest import ROOT

PRESSED = 0.15


@pytest.fixture(scope="module")
def pressed():
    """The tissue at rest under both plates, by name of the recipe, on 2 × 2 elements."""
    rests = {}
    for name in ("apple-press", "apple-press-undrained"):
        recipe = load_recipe(ROOT / f"data/{name}.toml")
        few = replace(recipe, mesh=replace(recipe.mesh, elements=(2, 2)))
        law = RveLaw(few.study().cell.parameters, few.rve)
        rests[name] = find_rest(few.problem(), law, few.macro, load_steps=4)
    return rests


def area_ratio(rest):
    """Area of the tissue over that without load."""
    space = rest.system.discretisation
    J = det(rest.F).reshape(space.weights.shape)[:, -1]
    return float(J @ space.weights[:, -1] / space.weights[:, -1].sum())


def force_of(rest):
    """Of the upper plate along y, µN."""
    return float(rest.forces[rest.system.force_names.index("upper"), 1])


@pytest.mark.parametrize("name", ["apple-press", "apple-press-undrained"])
def test_the_plates_come_together_by_15_percent_and_press_alike(pressed, name):
    rest = pressed[name]
    height = rest.system.problem.mesh.p[1].max()
    assert rest.u[:, 1].min() == pytest.approx(-PRESSED * height, rel=1e-12)
    lower = float(rest.forces[rest.system.force_names.index("lower"), 1])
    assert force_of(rest) < 0.0
    assert force_of(rest) + lower == pytest.approx(0.0, abs=1e-5 * lower)


def test_water_that_stays_keeps_the_area_and_bears_more(pressed):
    """Drained, the tissue loses about as much area as height; undrained it bulges instead."""
    drained, undrained = pressed["apple-press"], pressed["apple-press-undrained"]
    assert 0.05 < 1.0 - area_ratio(drained) < PRESSED
    assert abs(1.0 - area_ratio(undrained)) < 2e-3
    bulges = [rest.watched[0] for rest in (drained, undrained)]
    assert bulges[1] > 2.0 * max(bulges[0], 1.0)
    assert force_of(undrained) < 1.3 * force_of(drained)


@pytest.mark.parametrize(
    "name", ["voronoi-bar", "voronoi-large", "apple-press", "apple-press-undrained"]
)
def test_elements_are_at_least_as_wide_as_an_rve_with_a_uniform_fluid(name):
    recipe = load_recipe(ROOT / f"data/{name}.toml")
    assert recipe.study().cell.parameters.has_uniform_fluid
    assert not [*scale_warnings(recipe)]


def test_the_drained_and_the_undrained_press_differ_by_the_sap_alone():
    drained, undrained = (
        load_recipe(ROOT / f"data/{name}.toml") for name in ("apple-press", "apple-press-undrained")
    )
    assert (
        replace(undrained.study().cell.parameters, sap_bulk_modulus=0.0)
        == drained.study().cell.parameters
    )
    assert undrained.study().cell.parameters.sap_bulk_modulus == 2200.0
    assert undrained.problem().conditions == drained.problem().conditions
    np.testing.assert_array_equal(undrained.problem().mesh.p, drained.problem().mesh.p)
