"""What `check` tells of a recipe, over laws without cells."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from surrofe2 import compilation
from surrofe2.recipe import load_recipe
from surrofe2.workflow import laws
from surrofe2.workflow.dry_run import WARM, coarser, dry_run, timed_run
from surrofe2.workflow.recipe_check import recipe_faults
from surrofe2.workflow.run import run_study
from tests.conftest import RECIPE
from tests.laws import SquareLaw

MANY_FAULTS = (
    RECIPE.replace("count = 40", "count = 0")
    .replace("shear = 0.05\n", "")
    .replace("[macro]", "[makro]")
    .replace("iterations = 40", "iteration = 40")
    .replace("duration = 4.0", "duration = '4 µs'")
)


def test_all_that_is_wrong_is_told_in_one_go(invoke, recipe_path):
    recipe_path.write_text(MANY_FAULTS, encoding="utf-8")
    done = invoke("check", recipe_path)
    assert done.exit_code == 1
    told = done.stderr.splitlines()
    starts = {line.partition(": ")[2].partition(": ")[0] for line in told[:-1]}
    wrong = {"samples.count", "range.shear", "makro", "training.iteration", "load.duration"}
    assert starts == wrong
    assert told[-1] == f"error: {recipe_path}: 5 things to mend"


STATED = """
[cells.skin]
samples = { file = "a.h5" }
training = { file = "a.safetensors" }
[cells.flesh]
samples = { file = "a.h5" }
training = { file = "b.safetensors" }
[mesh]
width = 100.0
height = -1.0
elements = [2, 2]
[mesh.regions.skin]
box = [0.0, 0.0]
[conditions.clamp]
kind = "fixd"
on = "left"
[conditions.pull]
kind = "traction"
on = "right"
[watch]
tip = [100.0]
"""


def test_faults_of_a_stated_problem(tmp_path):
    path = tmp_path / "stated.toml"
    path.write_text(STATED, encoding="utf-8")
    told = [sentence.partition(": ")[2].partition(": ")[0] for sentence in recipe_faults(path)]
    wrong = {"mesh.height", "mesh.regions.skin.box", "conditions.clamp.kind", "watch.tip"}
    wrong |= {"conditions.pull.traction", "cells.flesh.samples.file"}
    assert set(told) == wrong
    assert len(told) == len(wrong)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[cell", "not TOML"),
        (RECIPE + "[surface]\non = ['nowhere']\n", "surface.on"),
        (RECIPE.replace("count = 40", 'count = 40\nadd = ["no.h5"]'), "no.h5"),
        (RECIPE.replace('file = "cells.h5"', ""), "samples.file: missing"),
    ],
)
def test_files_and_names(invoke, recipe_path, text, said):
    recipe_path.write_text(text, encoding="utf-8")
    done = invoke("check", recipe_path, "--only")
    assert said in done.stdout + done.stderr
    is_fault = "samples" not in said and said != "no.h5"  # a true run needs no samples
    assert done.exit_code == int(is_fault)


def test_estimates(invoke, recipe_path, tmp_path):
    done = invoke("check", recipe_path, "--json", law=SquareLaw())
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)["result"]
    assert found["points"] == 20
    assert set(found["totals"]) == {"rve", "cached", "table"}
    assert all(0.0 < found[name] < 60.0 for name in ("rve", "cached", "table", "data", "training"))
    assert found["totals"]["cached"] == found["data"] + found["training"] + found["cached"]
    assert found["best"] == min(found["totals"], key=found["totals"].get)
    few = found["memory"]["rve"]  # of a few points, whose law keeps next to nothing
    assert found["memory"] == pytest.approx(dict.fromkeys(found["totals"], few), rel=1e-3)
    assert 1e8 < few < found["making"]
    assert f"take --law {found['best']}" in done.stdout
    assert [path.name for path in tmp_path.iterdir()] == ["recipe.toml"]


def test_what_is_there_costs_nothing_more(invoke, recipe_path):
    law = SquareLaw()
    assert invoke("generate", recipe_path, law=law).exit_code == 0
    assert invoke("train", recipe_path, law=law).exit_code == 0
    done = invoke("check", recipe_path, "--json", law=law)
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)["result"]
    assert found["data"] == found["training"] == 0.0
    other = recipe_path.with_name("other.toml")
    other.write_text(recipe_path.read_text().replace("seed = 3", "seed = 4"), encoding="utf-8")
    refused = invoke("check", other, "--only", law=law)
    assert "samples.seed: made by another recipe" in refused.stdout


@pytest.fixture
def soft_law(monkeypatch):
    law = SquareLaw()
    monkeypatch.setattr(laws, "true_law", lambda recipe, *_: law.of(recipe.cell, recipe.rve))


@pytest.mark.usefixtures("soft_law")
def test_a_dry_run_asks_as_often_as_the_run(recipe_path, tmp_path):
    recipe = load_recipe(recipe_path, {"load.duration": 40.0})
    found = dry_run(recipe, 60.0)
    counts = run_study(recipe, "rve", tmp_path / "rve").counts
    assert found.is_whole
    calls = (counts["stress_points"] + counts["dissipation_points"]) / found.points
    assert found.calls == pytest.approx(calls, rel=0.05)
    assert found.steps == pytest.approx(counts["steps"], rel=0.05)
    assert len(found.windows) >= 3
    assert all(sum(each.ends_step for each in window) > WARM for window in found.windows)


@pytest.mark.usefixtures("soft_law")
def test_a_dry_run_that_is_cut_short_is_extrapolated(recipe_path):
    changes = {"load.duration": 40.0, "macro.elements": [8, 8]}
    recipe = load_recipe(recipe_path, changes)
    whole, short = dry_run(recipe, 60.0), dry_run(recipe, 0.2 * 1e-9)
    assert whole.is_whole
    assert not short.is_whole
    assert short.points == whole.points == 320
    assert len(short.windows[0][0].F) == 80  # of 4 × 4 elements


@pytest.mark.usefixtures("soft_law")
def test_the_path_of_a_dry_run_goes_from_rest_to_the_end(recipe_path):
    recipe = load_recipe(recipe_path, {"load.duration": 200.0})
    found = dry_run(recipe, 60.0)
    assert 64 <= len(found.path) <= 128
    assert all(each.ends_step and len(each.F) == found.points for each in found.path)
    way = np.array([np.abs(each.F - np.eye(2)).max() for each in found.path])
    steps = [each for window in found.windows for each in window if each.ends_step]
    assert way[0] < 0.01 * way.max()
    assert way.max() >= 0.9 * max(np.abs(each.F - np.eye(2)).max() for each in steps)
    assert np.abs(np.diff(way)).max() < 0.2 * way.max()


@pytest.mark.usefixtures("soft_law")
def test_a_run_is_timed_and_goes_on_as_in_its_second_half(recipe_path, monkeypatch):
    recipe = load_recipe(recipe_path, {"load.duration": 20.0})
    law, dry = SquareLaw().of(recipe.cell, recipe.rve), dry_run(recipe, 60.0)
    assert dry.share(0.0) == 0.0
    assert dry.share(20.0) == 1.0
    monkeypatch.setattr("surrofe2.workflow.dry_run.clock", lambda: float(len(law.states)))
    whole, is_done = timed_run(recipe, law, math.inf, dry)
    assert is_done
    assert whole == pytest.approx(dry.calls, rel=0.02)
    part, is_done = timed_run(recipe, law, 0.5 * whole, dry)
    assert not is_done
    assert part == pytest.approx(whole, rel=0.02)
    first, is_done = timed_run(recipe, law, 1e-9, dry)  # a single step
    assert not is_done
    assert first == pytest.approx(whole, rel=0.5)


def test_the_clock_stands_while_a_kernel_is_compiled(monkeypatch):
    times = iter([1.0, 3.0, 10.0, 14.0, 20.0])
    monkeypatch.setattr(compilation, "perf_counter", lambda: next(times))
    monkeypatch.setattr(compilation, "_waited", [0.0, 0.0])
    assert compilation.clock() == 1.0
    with compilation._waiting():
        with compilation._waiting():  # a kernel that it calls
            pass
        assert compilation.clock() == 3.0
    assert compilation.clock() == 20.0 - 11.0


def test_coarser_meshes(recipe_path):
    recipe = load_recipe(recipe_path, {"macro.elements": [16, 6]})
    found = coarser(recipe)
    assert found.macro.elements == (8, 3)
    assert coarser(found).macro.elements == (4, 1)
    assert coarser(coarser(found)) is None
