"""rest, modes and moduli, with memory and stability, over plant cells."""

import json
import re
from functools import partial
from unittest.mock import Mock

import numpy as np
import pytest

from surrofe2.cli import console
from surrofe2.macro import find_modes, find_rest
from surrofe2.questions import cell_image, stability
from surrofe2.recipe.recipe import load_recipe
from surrofe2.report.page import write_report
from surrofe2.rve import RveLaw
from surrofe2.store.fields import read_fields
from surrofe2.store.run_folder import read_record, read_run
from surrofe2.store.store import locked_file, read_json, write_json
from surrofe2.workflow import rest as rest_of_workflow
from tests.cli.conftest import call
from tests.laws import SquareLaw, failing


def test_rest_writes_its_load_path_and_fields(recipe, recipe_path, tmp_path):
    out = tmp_path / "rest"
    done = call("rest", recipe_path, "--out", out, "--load-steps", 4)
    law = RveLaw(recipe.study().cell.parameters, recipe.rve)
    expected = find_rest(recipe.problem(), law, recipe.macro, load_steps=4)
    lines = (out / "path.csv").read_text(encoding="utf-8").splitlines()
    names = [f"force {name} {axis}_uN" for name in expected.system.force_names for axis in "xy"]
    means = [f"mean displacement left {axis}_um" for axis in "xy"]
    last = [*means, *names, "beyond bifurcation_points"]
    assert lines[0].split(",") == ["factor", "u_x_um", "u_y_um", *last]
    whole = np.array([[float(entry) for entry in line.split(",")] for line in lines[1:]])
    table, forces = whole[:, :3], whole[:, -1 - len(names) : -1]
    assert not whole[:, -1].any()
    np.testing.assert_array_equal(table[:, 0], [0.0, 0.25, 0.5, 0.75, 1.0])
    np.testing.assert_allclose(table, expected.path, rtol=0, atol=1e-9)
    lines = (out / "energies.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "factor,internal_pJ,load_pJ,balance_pJ"
    found = np.loadtxt(lines[1:], delimiter=",")
    np.testing.assert_array_equal(found[:, 0], table[:, 0])
    np.testing.assert_allclose(found[:, 1:].T, [*expected.energies.values()], rtol=0, atol=1e-9)
    assert abs(found[:, 3]).max() < 1e-6 * found[-1, 2]
    record = read_record(out)
    assert (record.status, record.law) == ("finished", "rve")
    assert record.recipe["rest"] == {"factor": 1.0, "load_steps": 4}
    assert record.counts["load_steps"] == 4
    low, high = np.array(record.met["F"])
    assert (low <= np.eye(2)).all()
    assert (high >= np.eye(2)).all()
    assert record.met["stretch"][0] < 1.0 < record.met["stretch"][1]
    assert record.met["shear"] > 0.0 == record.met["rate"]
    assert record.cell_fingerprint == recipe.study().cell.parameters.fingerprint
    stored = read_fields(out, (), None)
    shapes = [values.shape for values in stored.values.values()]
    assert shapes.count((5, 9, 2)) == 2  # displacement and velocity
    assert shapes.count((5, 4, 2, 2)) == 3  # stress, F, its rate
    size = abs(expected.forces).max()
    np.testing.assert_allclose(forces[-1], expected.forces.ravel(), rtol=0, atol=1e-6 * size)
    total = forces.reshape(5, -1, 2).sum(axis=1)
    assert abs(total).max() < 1e-6 * size < 1e-3 * abs(forces[-1]).sum()
    assert not (out / "history.csv").exists(), "one table has all over the factor"
    assert record.met["beyond_bifurcation"] == {"points": 0, "of": 20, "from": None}
    assert f"watched point at ({table[-1, 1]:.4g}, {table[-1, 2]:.4g}) µm" in done.stdout
    run = read_run(out)
    assert run.clock == "load factor"
    np.testing.assert_array_equal(run.curve.t, table[:, 0])
    np.testing.assert_array_equal(run.curve.displacement, table[:, 1:])
    assert not run.history["beyond bifurcation"].any()
    assert [*run.energies] == ["internal", "load", "balance"]
    assert run.facts()["load factor"] == "1 in 4 load steps"
    assert "time" not in run.facts()
    kept = call("rest", recipe_path, "--out", out, "--load-steps", 4)
    assert f"{out}: finished before" in kept.stdout
    assert kept.stdout.splitlines()[-1] == done.stdout.splitlines()[-1]
    refused = call("rest", recipe_path, "--out", out, "--load-steps", 4, "--factor", 0.5, code=1)
    assert "rest.factor: this call has 0.5, what is there 1.0" in refused.stderr


def test_rest_by_every_law(stand_in, recipe_path, tmp_path):
    stand_in(SquareLaw)
    call("generate", recipe_path)
    call("train", recipe_path)
    rest = partial(call, "rest", recipe_path, "--load-steps", 4)
    rest("--out", tmp_path / "rve")
    true = read_record(tmp_path / "rve").met["watched"]
    for law in ("surrogate", "cached", "table"):
        out = tmp_path / law
        done = rest("--out", out, "--law", law)
        record = read_record(out)
        assert (record.status, record.law) == ("finished", law)
        np.testing.assert_allclose(record.met["watched"], true, rtol=0.05, atol=1e-3)
        counts = record.counts
        assert counts["load_steps"] == 4
        assert (out / "table.h5").exists() == (law == "table")
        assert "error of the answer, by RVEs at all 4 elements: it is off in " in done.stdout
        error = record.met["error_of_answer"]
        off = np.subtract(true, record.met["watched"])
        np.testing.assert_allclose(error["watched"], off, rtol=0.1, atol=1e-4)
        assert error["displacement"] >= 0.99 * np.linalg.norm(error["watched"])
        if law == "surrogate":
            assert record.cache is None
            continue
        assert counts["hits"] > 0
        assert counts["rve_solves"] >= counts["audits"] > 0
        assert f"{counts['hits']:,} hits" in done.stdout
        assert "closing audit: " in done.stdout
        assert (out / "harvest.h5").exists()
        assert (out / "events.jsonl").exists()
    kept = rest("--out", tmp_path / "kept", "--law", "surrogate", "--correct")
    assert "it was, and is corrected, off in " in kept.stdout
    record = read_record(tmp_path / "kept")
    found = np.linalg.norm(np.subtract(true, record.met["watched"]))
    rough = read_record(tmp_path / "surrogate").met["watched"]
    assert found < max(0.2 * np.linalg.norm(np.subtract(true, rough)), 1e-9)
    last = read_run(tmp_path / "kept").curve.displacement[-1]
    np.testing.assert_allclose(last, record.met["watched"])
    fields = read_fields(tmp_path / "kept", (), None)
    assert len(fields.t) == 5
    refused = rest("--out", tmp_path / "none", "--correct", code=1)
    assert "--correct: not with --law rve" in refused.stderr
    refused = rest("--out", tmp_path / "surrogate", "--law", "surrogate", "--correct", code=1)
    assert "rest.correct: this call has True, what is there False" in refused.stderr


def test_rest_that_fails_keeps_the_way_there(recipe_path, tmp_path, invoke):
    def far(F, F_dot):
        return abs(F - np.eye(2)).max(axis=(1, 2)) > 0.02

    out, law = tmp_path / "rest", failing(SquareLaw(), fails=far)
    failed = invoke("rest", recipe_path, "--out", out, "--load-steps", 2, law=law, code=1)
    assert "no load step succeeds after 10 halvings" in failed.stderr
    record = read_record(out)
    assert record.status == "failed"
    assert record.error in failed.stderr
    factors = np.loadtxt(out / "path.csv", delimiter=",", skiprows=1)[:, 0]
    assert factors[0] == 0.0
    assert 0.1 < factors[-1] < 1.0
    invoke("rest", recipe_path, "--out", out, "--factor", 0.1, "--fresh", law=law)


def test_an_interrupt_while_the_error_is_sought_loses_no_load_step(
    invoke, recipe_path, tmp_path, monkeypatch
):
    asked = []

    class Counted(SquareLaw):
        def respond(self, F, F_dot, state=None, *, tangents=False):
            asked.append(len(F))
            return super().respond(F, F_dot, state, tangents=tangents)

    law = Counted()
    rest = partial(invoke, "rest", recipe_path, "--load-steps", 4, "--law", "table", law=law)
    rest("--out", tmp_path / "whole")
    all_asked = sum(asked)
    with monkeypatch.context() as patch:
        patch.setattr(rest_of_workflow, "answer_error", Mock(side_effect=KeyboardInterrupt))
        rest("--out", tmp_path / "rest", code=130)
    assert read_record(tmp_path / "rest").status == "interrupted"
    asked.clear()
    rest("--out", tmp_path / "rest")
    assert sum(asked) < 0.2 * all_asked, "a new table, the last equilibrium and its error"
    there, whole = (read_run(tmp_path / name) for name in ("rest", "whole"))
    assert there.record.met == whole.record.met
    assert there.record.counts == whole.record.counts
    np.testing.assert_array_equal(there.curve.displacement, whole.curve.displacement)


REST = "\n[rest]\nload_steps = 2\nfactor = 0.5\n"


def test_a_recipe_states_the_method(invoke, recipe_path, tmp_path):
    """`run`, `study` and `grid` obey; `rest` and `run --integrator` say where they do not."""
    law = SquareLaw()
    plain = recipe_path.read_text(encoding="utf-8")
    of_time = invoke("rest", recipe_path, "--out", tmp_path / "rest", law=law)
    assert "though the recipe states a run in time" in of_time.stdout
    recipe_path.write_text(plain + REST, encoding="utf-8")
    stated = invoke("rest", recipe_path, "--out", tmp_path / "stated", law=law)
    assert "though" not in stated.stdout
    assert read_record(tmp_path / "stated").recipe["rest"] == {"factor": 0.5, "load_steps": 2}
    run = invoke("run", recipe_path, "--law", "rve", "--out", tmp_path / "run", law=law)
    assert "at rest under 0.5 times the load by rve" in run.stdout
    assert read_run(tmp_path / "run").curve.t.tolist() == [0.0, 0.25, 0.5]
    more = "--law", "rve", "--integrator", "explicit", "--out", tmp_path / "time"
    in_time = invoke("run", recipe_path, *more, law=law)
    assert "in time by explicit steps, though the recipe states a [rest]" in in_time.stdout
    assert read_run(tmp_path / "time").clock == "time (µs)"
    refused = call("compare", tmp_path / "run", tmp_path / "time", code=1)
    assert "rest.factor is None" in refused.stderr
    done = invoke("study", recipe_path, "--law", "table", "--out", tmp_path / "study", law=law)
    assert done.stdout.count("at rest under 0.5 times the load") == 2
    more = "--law", "table", "--without-true", "--out", tmp_path / "alone"
    alone = invoke("study", recipe_path, *more, law=law)
    for note in ("audit: ", "closing audit: ", "error of the answer, by RVEs at all "):
        assert any(line.startswith(note) for line in alone.stdout.splitlines())
    page = (tmp_path / "study" / "report.html").read_text(encoding="utf-8")
    assert "load factor" in page
    assert "time (µs)" not in page
    assert '"clock": ["load factor ", ""]' in page
    # the body force acts downwards, in the middle; the recipe is read from the run folder
    arrows = re.findall(r'"arrows": \[\[\d+, \[0.0, 0.0\], \[0.0, (-[\d.]+)\]\]\]', page)
    assert len(arrows) == 2
    (tmp_path / "run" / "input" / "recipe.toml").write_text("changed", encoding="utf-8")
    damaged = write_report([tmp_path / "run"], tmp_path / "page.html").read_text(encoding="utf-8")
    assert '"arrows": []' in damaged
    assert "Only loads on single nodes are drawn: " in damaged
    assert "damaged, or changed since the run was recorded" in damaged
    values = "--set", "rest.factor=0.25,0.5"
    invoke("grid", recipe_path, *values, "--out", tmp_path / "grid", law=law)
    rows = read_json(tmp_path / "grid" / "grid.json")["rows"]
    small, large = (row["largest_displacement"] for row in rows)
    assert small < 0.6 * large


def test_a_rest_and_a_run_are_not_taken_for_each_other(recipe_path, tmp_path):
    call("rest", recipe_path, "--out", tmp_path / "rest")
    refused = call("run", recipe_path, "--law", "rve", "--out", tmp_path / "rest", code=1)
    assert "rest.factor: this call has nothing, what is there 1.0" in refused.stderr


def test_modes_about_both_states(recipe, recipe_path, tmp_path):
    out = tmp_path / "modes.json"
    done = call("modes", recipe_path, "--initialisation", "elastic", "--count", 2, "--out", out)
    assert "Unloaded, 4 elements, preset printed" in done.stdout
    record = json.loads(out.read_text(encoding="utf-8"))
    assert record["fingerprint"] == recipe.study().cell.parameters.fingerprint
    law = RveLaw(recipe.study().cell.parameters, initialisation="elastic")
    for state, factor in (("unloaded", 0.0), ("loaded", 1.0)):
        numbers = record["states"][state]["elastic"]
        modes = find_modes(find_rest(recipe.problem(), law, recipe.macro, factor=factor), 2)
        np.testing.assert_allclose(numbers["period"], modes.periods, rtol=1e-6)
        np.testing.assert_allclose(numbers["decrement"], modes.decrements, rtol=1e-4)
        assert f"{modes.periods[0]:.3f}" in done.stdout
    assert record["states"]["unloaded"]["elastic"]["watched"] == [0.0, 0.0]
    assert record["states"]["loaded"]["elastic"]["watched"][1] < -0.01
    kept = call("modes", recipe_path, "--initialisation", "elastic", "--count", 2, "--out", out)
    assert kept.stdout.splitlines()[:-1] == done.stdout.splitlines()[:-1]
    refused = call("modes", recipe_path, "--initialisation", "elastic", "--out", out, code=1)
    assert "asked.count: this call has 4, what is there 2" in refused.stderr


def test_moduli(tmp_path, monkeypatch):
    monkeypatch.setattr(console, "SELDOM", 0.0)
    path = tmp_path / "moduli.json"
    done = call("moduli", "--preset", "water", "--turgor", "2.5", "--all", "--out", path)
    assert "Viscous moduli, MPa µs" in done.stdout
    assert "moduli: 40 %" in done.stderr
    assert done.stdout.splitlines()[-1].startswith(f"{path}: at rest, of ")
    record = json.loads(path.read_text(encoding="utf-8"))
    tests = {row["quantity"]: row["value"] for row in record["experiment"]}
    assert tests["turgor"] == pytest.approx(2.5)
    rows = record["tables"]["Elastic moduli, MPa"]
    assert [row["initialisation"] for row in rows] == [
        "cauchy-born", "elastic", "constrained-runs", "slow-manifold"
    ]  # fmt: skip
    assert rows[0]["bulk"] > rows[1]["bulk"] > 0.0
    assert tests["Young's modulus along x"] == pytest.approx(rows[1]["young"], rel=1e-9)
    alone = call("moduli", "--preset", "water")
    assert "Young's modulus at 45°" in alone.stdout
    assert "Viscous" not in alone.stdout
    assert alone.stdout.splitlines()[-1].startswith("moduli: at rest, of "), "no file"


def test_wilting_is_written(tmp_path):
    done = call("moduli", "--cell", "apple", "--wilt", tmp_path)
    assert "potential" in done.stdout
    rows = read_json(tmp_path / "wilting-apple.json")["results"]["rows"]
    assert rows[0]["turgor"] == pytest.approx(0.4)
    assert (tmp_path / "wilting-apple.png").stat().st_size > 10_000


def test_cells_of_an_image_become_a_recipe(tmp_path, monkeypatch):
    monkeypatch.setattr(cell_image, "_ENOUGH", 1)
    monkeypatch.setattr(cell_image, "_CORRECTIONS", 0)
    draw = pytest.importorskip("skimage.draw")
    labels = np.zeros((80, 320), dtype=np.int64)
    for k, half in enumerate((30.0, 24.0, 34.0, 27.0)):
        rows, columns = draw.ellipse(40.0, 40.0 + 80.0 * k, half / 1.2, 1.2 * half)
        labels[rows, columns] = k + 1
    image, out = tmp_path / "labels.npy", tmp_path / "tissue.toml"
    np.save(image, labels)
    done = call("cells", image, "--pixel", 0.5, "--cells", 4, "--out", out)
    assert "mean aspect ratio" in done.stdout
    assert "variation of areas" in done.stdout.rpartition("RVE of 4 cells")[2]
    cell = load_recipe(out).study().cell.parameters
    assert (cell.arrangement, cell.cells) == ("voronoi", 4)
    assert cell.cell_side == pytest.approx(np.sqrt((labels > 0).sum() / 4) * 0.5, rel=1e-3)
    assert (tmp_path / "tissue.png").stat().st_size > 10_000
    refused = call("cells", image, "--pixel", 0.5, "--out", out, code=1)
    assert "it is there; --fresh writes this one" in refused.stderr
    out.write_text("[cell]", encoding="utf-8")
    refused = call("cells", image, "--pixel", 0.5, "--out", out, "--fresh", code=1)
    assert "not a recipe that `cells` wrote" in refused.stderr
    before = (tmp_path / "tissue.png").read_bytes()
    other = tmp_path / "other.toml"
    refused = call(
        "cells", image, "--pixel", 0.5, "--out", other, "--picture", tmp_path / "tissue.png", code=1
    )
    assert "tissue.png: it is there; --fresh writes this one" in refused.stderr
    assert (tmp_path / "tissue.png").read_bytes() == before
    assert not other.exists()
    refused = call("cells", image, "--pixel", 0.5, "--picture", tmp_path / "a.pdf", code=1)
    assert "--picture: 'a.pdf'; it must end in .png" in refused.stderr
    alone = call("cells", image, "--pixel", 0.5)
    assert alone.stdout.splitlines()[-1].startswith("cells: 4 cells measured")


def test_cells_never_replaces_the_image_by_its_picture(tmp_path):
    io = pytest.importorskip("skimage.io")
    image = tmp_path / "leaf.png"
    io.imsave(image, np.arange(1, 17, dtype=np.uint8).reshape(4, 4), check_contrast=False)
    before = image.read_bytes()
    refused = call(
        "cells", image, "--pixel", 0.5, "--out", tmp_path / "leaf.toml", "--fresh", code=1
    )
    assert "leaf.png: the picture would replace the image" in refused.stderr
    assert image.read_bytes() == before


WATER = "moduli", "--cell", "water"


@pytest.mark.slow
def test_memory_gives_a_verdict_and_is_kept(tmp_path):
    memory = partial(call, *WATER, "--memory", tmp_path)
    done = memory()
    assert done.stdout.splitlines()[-2].startswith("Motions as fast as 17 µs can be")
    assert (tmp_path / "memory-water.png").stat().st_size > 10_000
    record = read_json(tmp_path / "memory-water.json")
    assert record["cell"]["fluid_particle_mass"] == 0.27
    assert record["units"]["largest_difference"] == "µN/µm"
    with locked_file(tmp_path / "memory-water.json"):
        refused = memory("--fresh", code=1)
    assert f"error: {tmp_path / 'memory-water.json'}: in use by" in refused.stderr
    assert "memory-water.json, there already" in memory().stdout
    refused = memory("--period", "20", code=1)
    assert "asked.period: this call has 20.0, what is there 17.0" in refused.stderr
    changed = {**record, "cell": {**record["cell"], "viscosity": 9.0}}
    write_json(tmp_path / "memory-water.json", changed)
    refused = memory(code=1)
    assert "cell.viscosity: this call has 0.1, what is there 9.0" in refused.stderr


def test_the_map_of_stability_is_written(tmp_path, monkeypatch):
    monkeypatch.setattr(stability, "stability", partial(stability.stability, points=3))
    done = call(*WATER, "--stability", tmp_path)
    assert "simple shear" in done.stdout
    assert (tmp_path / "stability-water.png").exists()
