"""Runs by table, harvests, training on them and refining, over laws without cells."""

from __future__ import annotations

import json

import numpy as np
import pytest

from surrofe2.store.run_folder import read_record
from surrofe2.store.samples import read_harvest
from surrofe2.store.surrogates import read_surrogate
from surrofe2.store.tables import read_table
from surrofe2.workflow.laws import make_table
from tests.laws import SoftLaw, SquareLaw, square_stress


def run(invoke, recipe, out, *more, law=None):
    return invoke("run", recipe, "--out", out, *more, law=law or SquareLaw())


@pytest.fixture
def first(invoke, changed_recipe, tmp_path):
    """A finished run by table."""
    recipe = changed_recipe("-0.1]", "-0.5]")
    done = run(invoke, recipe, tmp_path / "first", "--law", "table")
    assert done.exit_code == 0, done.output
    return tmp_path / "first"


def test_a_table_serves_alone_and_better_the_second_time(invoke, first, recipe_path, tmp_path):
    second = tmp_path / "second"
    done = run(invoke, recipe_path, second, "--law", "table", "--table", first / "table.h5")
    assert done.exit_code == 0, done.output
    counts = [read_record(folder).counts for folder in (first, second)]
    hits = [entry["hits"] / (entry["hits"] + entry["fallbacks"]) for entry in counts]
    assert 0.5 < hits[0] < hits[1]
    assert hits[1] > 0.7
    assert counts[0]["table_added"] == counts[0]["table_records"] > 0
    assert read_table(second / "table.h5").records.centre.shape[0] == counts[1]["table_records"]
    assert f"table of {counts[1]['table_records']} records" in done.stdout
    assert read_record(second).surrogate["file"] == "table.h5"


def test_true_answers_of_a_run_are_harvested(first):
    harvest = read_harvest(first / "harvest.h5")
    np.testing.assert_allclose(harvest.stress, square_stress(harvest.F, harvest.F_dot), atol=1e-12)
    assert set(harvest.why) == {0, 1}, "what the table might not answer, and audits"
    assert 0 < len(harvest.F) <= read_record(first).counts["fallbacks"]


def test_a_table_of_other_parameters_or_for_true_runs_is_refused(
    invoke, first, recipe_path, changed_recipe, tmp_path
):
    out, table = tmp_path / "x", first / "table.h5"
    refused = run(invoke, recipe_path, out, "--law", "rve", "--table", table)
    assert "--table: not with --law rve; it must be table" in refused.stderr
    changed_recipe('preset = "printed"', "viscosity = 0.2")
    refused = run(invoke, recipe_path, out, "--law", "table", "--table", table)
    assert refused.exit_code == 1
    told = f"error: {table}: a table for cell.viscosity = 0.1, not 0.2; start an empty one"
    assert refused.stderr.startswith(told)
    assert not out.exists()


@pytest.fixture
def _trained(invoke, recipe_path):
    for command in ("generate", "train"):
        assert invoke(command, recipe_path, law=SquareLaw()).exit_code == 0


@pytest.mark.usefixtures("_trained")
def test_a_harvest_is_added_to_the_training_data(invoke, first, recipe_path):
    surrogate = recipe_path.parent / "cells-surrogate.h5"
    before = read_surrogate(surrogate)
    harvest = first / "harvest.h5"
    done = invoke("train", recipe_path, "--fresh", "--add", harvest)
    assert done.exit_code == 0, done.output
    after = read_surrogate(surrogate)
    assert after.data_fingerprint != before.data_fingerprint
    assert after.errors["points"] > before.errors["points"]
    assert after.range == before.range


@pytest.fixture
def leaving_recipe(changed_recipe):
    """Its bar leaves the range."""
    return changed_recipe("-0.1]", "-1.0]")


def test_refine_teaches_what_a_run_meets(invoke, leaving_recipe, tmp_path):
    out = tmp_path / "refined"
    done = invoke("refine", leaving_recipe, "--out", out, law=SoftLaw())
    assert done.exit_code == 0, done.output
    rows = json.loads((out / "refine.json").read_text(encoding="utf-8"))["rounds"]
    assert len(rows) > 1
    assert rows[0]["unknown"] > 0
    assert rows[-1]["unknown"] == 0
    assert rows[0]["hits"] < 0.5 < 0.95 < rows[-1]["hits"]
    assert rows[1]["samples"] == rows[0]["samples"] + rows[0]["added"]
    low, high = (row["range"] for row in (rows[0], rows[1]))
    assert high != low
    assert high["rate"] >= low["rate"]
    last = read_surrogate(out / "surrogate.h5")
    assert last.range.rate == rows[-1]["range"]["rate"]
    for word in ("round", "hits", "unknown", "held-out", "audit", "settled"):
        assert word in done.stdout
    law = SoftLaw()
    kept = invoke("refine", leaving_recipe, "--out", out, law=law)
    assert kept.exit_code == 0
    assert law.calls == 0


def test_refine_that_does_not_settle_says_so_and_goes_on(invoke, leaving_recipe, tmp_path):
    out = tmp_path / "refined"
    short = invoke("refine", leaving_recipe, "--out", out, "--rounds", 1, law=SoftLaw())
    assert short.exit_code == 1
    assert "states still unknown after 1 rounds; continue with --rounds 2" in short.stderr
    done = invoke("refine", leaving_recipe, "--out", out, law=SoftLaw())
    assert done.exit_code == 0, done.output
    assert done.stdout.count("round 0:") == 1


def test_rounds_of_another_recipe_are_refused(invoke, leaving_recipe, changed_recipe, tmp_path):
    out = tmp_path / "refined"
    invoke("refine", leaving_recipe, "--out", out, "--rounds", 1, law=SoftLaw())
    changed_recipe("-1.0]", "-1.1]")
    refused = invoke("refine", leaving_recipe, "--out", out, law=SoftLaw())
    assert refused.exit_code == 1
    assert (
        "conditions.load.acceleration: this call has [0.0, -1.1], what is there [0.0, -1.0]"
        in refused.stderr
    )


def test_what_a_table_began_with_is_counted(invoke, recipe_path, tmp_path, monkeypatch):
    def dear(*given):
        table = make_table(*given)
        table.seconds = 100.0
        return table

    monkeypatch.setattr("surrofe2.workflow.laws.make_table", dear)
    done = run(invoke, recipe_path, tmp_path / "run", "--law", "table")
    assert done.exit_code == 0, done.output
    wall = read_record(tmp_path / "run").wall_time
    assert 100.0 < wall["law"] < wall["total"]
    assert wall["total"] == pytest.approx(wall["law"] + wall["macro"])
