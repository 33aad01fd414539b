"""The examples: every recipe runs by true RVEs in a short form; whole ones give their pages."""

from __future__ import annotations

import re
import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from surrofe2 import CellParameters, RveLaw, simulate
from surrofe2.amplitude import Constant
from surrofe2.macro.mesh import Mesh
from surrofe2.recipe import load_recipe

FOLDER = Path(__file__).parents[1] / "examples"
RECIPES = sorted(FOLDER.glob("*.toml"))


def law_of(recipe):
    rve = recipe.rve
    return RveLaw(recipe.cell, initialisation=rve.initialisation, solver=rve.solver)


def run_of(recipe, problem):
    return simulate(problem, law_of(recipe), recipe.macro)


@pytest.mark.parametrize("path", RECIPES, ids=lambda path: path.stem)
def test_a_recipe_is_short_has_a_page_and_runs(path):
    """A hundredth of the time, rectangles of at most 2 × 2 elements; the energies balance."""
    assert len(path.read_text(encoding="utf-8").splitlines()) < 60
    page = path.with_suffix(".md").read_text(encoding="utf-8")
    assert f"examples/{path.name}" in page
    for picture in re.findall(r"!\[.*?\]\((.*?)\)", page):
        assert (FOLDER / picture).is_file()
    recipe = load_recipe(path)
    problem = recipe.problem()
    driven = [each for each in problem.amplitudes() if not isinstance(each, Constant)]
    assert driven or any(c.kind() == "initial_velocity" for c in problem.conditions)
    if recipe.stated.mesh.file is None:
        mesh = recipe.stated.mesh
        few = tuple(min(number, 2) for number in mesh.elements)
        problem = replace(problem, mesh=Mesh.rectangle(mesh.width, mesh.height, few))
    # The thin sample starts with a jump in velocity, which a hundredth resolves at great cost.
    short = problem.duration * {"cyclic-shear": 0.3, "notched-leaf": 0.1}.get(path.stem, 0.01)
    run = run_of(recipe, replace(problem, duration=short, output_interval=0.25 * short))
    assert run.finished
    assert run.counts["steps"] >= 1
    moved = abs(run.frames.velocity[-1]).max()
    assert 0.0 < moved < 10.0
    scale = max(run.energies["kinetic"].max(), abs(run.energies["internal"]).max())
    assert abs(run.energies["balance"]).max() < 0.02 * scale


def test_moduli_from_loops_are_those_of_the_tangents():
    """The Python example at its lowest frequency: within half a per cent."""
    script = runpy.run_path(str(FOLDER / "cyclic_shear.py"))
    law = RveLaw(CellParameters.preset("printed"), initialisation="slow-manifold")
    frequency = script["FREQUENCIES"][0]
    found = script["moduli_of"](*script["loop_of"](law, frequency))
    np.testing.assert_allclose(found, script["tangent_moduli"](law, frequency), rtol=0.005)


def whole(name):
    recipe = load_recipe(FOLDER / f"{name}.toml")
    return recipe, run_of(recipe, recipe.problem())


@pytest.mark.slow
def test_both_plates_feel_one_force_and_get_the_work_back():
    _, run = whole("block-between-plates")
    upper, lower = (run.history[f"force {name} y"] for name in ("upper", "lower"))
    assert abs(upper + lower).max() < 0.05 * abs(upper).max()
    side = 100.0  # of an element, µm; a run warns above a hundredth of it
    assert run.history["penetration upper"].max() < 0.01 * side
    assert abs(upper[-1]) < 0.01 * abs(upper).max()


@pytest.mark.slow
def test_a_dropped_sample_meets_the_force_of_the_wave_and_rebounds():
    """ρ c v over the side, for 2 H/c; c of docs/cells.md, 69 m/s."""
    recipe, run = whole("drop-on-plate")
    t, force = run.curve.t, run.history["force plate y"]
    touching = t[force > 0.02 * force.max()]
    time = touching[-1] - touching[0]
    assert time == pytest.approx(2.0 * 10000.0 / 69.0, rel=0.06)
    wave = recipe.cell.density * 69.0 * 1.0 * 5000.0
    assert np.trapezoid(force, t) / time == pytest.approx(wave, rel=0.06)
    assert force.min() >= 0.0
    assert run.curves["top"].displacement[-1, 1] > 100.0
