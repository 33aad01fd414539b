"""Runs by table, harvests, training on them and refining, over laws without cells."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from surrofe2.base.sampling import sample
from surrofe2.store.run_folder import read_record
from surrofe2.store.samples import HarvestWriter, read_data_set, read_harvest
from surrofe2.store.surrogates import read_surrogate
from surrofe2.store.tables import read_table
from surrofe2.workflow.generate import with_harvests
from surrofe2.workflow.laws import make_table
from surrofe2.workflow.run import origin_of
from tests.laws import SoftLaw, SquareLaw, square_stress


@pytest.fixture
def invoke(invoke):
    return partial(invoke, law=SquareLaw)


@pytest.fixture
def run(invoke, recipe_path):
    """run(out, *options, law="table"): the recipe's bar."""
    return lambda out, *more, law="table", **settings: invoke(
        "run", recipe_path, "--law", law, "--out", out, *more, **settings
    )


@pytest.fixture
def first(run, changed_recipe, tmp_path):
    """A finished run by table."""
    changed_recipe("-0.1]", "-0.5]")
    run(tmp_path / "first")
    return tmp_path / "first"


@pytest.mark.parametrize("entry", ['file = "cells.h5"', 'file = "cells-surrogate.h5"'])
def test_what_refine_lacks_is_named_before_anything_is_written(
    invoke, changed_recipe, tmp_path, entry
):
    path = changed_recipe(entry, "")
    out = tmp_path / "refined"
    assert "file: missing" in invoke("refine", path, "--out", out, code=1).stderr
    assert not out.exists()
    (out / "round-0").mkdir(parents=True)
    invoke("refine", path, "--out", out, "--fresh", code=1)
    assert (out / "round-0").exists()


def test_a_table_serves_alone_and_better_the_second_time(run, first, tmp_path):
    second = tmp_path / "second"
    done = run(second, "--table", first / "table.h5")
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
    run, first, changed_recipe, tmp_path
):
    out, table = tmp_path / "x", first / "table.h5"
    refused = run(out, "--table", table, law="rve", code=1)
    assert "--table: not with --law rve; it must be table" in refused.stderr
    changed_recipe('preset = "printed"', "viscosity = 0.2")
    refused = run(out, "--table", table, code=1)
    told = f"error: {table}: a table for cell.viscosity = 0.1, not 0.2; start an empty one"
    assert refused.stderr.startswith(told)
    assert not out.exists()


@pytest.mark.usefixtures("trained")
def test_a_harvest_is_added_to_the_training_data(invoke, first, recipe_path, surrogate_path):
    before = read_surrogate(surrogate_path)
    invoke("train", recipe_path, "--fresh", "--add", first / "harvest.h5")
    after = read_surrogate(surrogate_path)
    assert after.data_fingerprint != before.data_fingerprint
    assert after.errors["points"] > before.errors["points"]
    assert after.range == before.range


@pytest.fixture
def refine(invoke, changed_recipe, tmp_path):
    """refine(*options): that of a bar which leaves the range, in `refined`."""
    path = changed_recipe("-0.1]", "-1.0]")
    return partial(invoke, "refine", path, "--out", tmp_path / "refined", law=SoftLaw)


def test_refine_teaches_what_a_run_meets(refine, tmp_path):
    out = tmp_path / "refined"
    done = refine()
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
    refine(law=law)
    assert law.calls == 0


@pytest.mark.slow
def test_refine_that_does_not_settle_says_so_and_goes_on_with_its_recipe(refine, changed_recipe):
    short = refine("--rounds", 1, code=1)
    assert "states still unknown after 1 rounds; continue with --rounds 2" in short.stderr
    changed_recipe("-1.0]", "-1.1]")
    told = "conditions.load.acceleration: this call has [0.0, -1.1], what is there [0.0, -1.0]"
    assert told in refine(code=1).stderr
    changed_recipe("-1.1]", "-1.0]")
    assert refine().stdout.count("round 0:") == 1


def test_what_a_table_began_with_is_counted(run, tmp_path, monkeypatch):
    def dear(*given):
        table = make_table(*given)
        table.seconds = 100.0
        return table

    monkeypatch.setattr("surrofe2.workflow.laws.make_table", dear)
    run(tmp_path / "run")
    wall = read_record(tmp_path / "run").wall_time
    assert 100.0 < wall["law"] < wall["total"]
    assert wall["total"] == pytest.approx(wall["law"] + wall["macro"])


KNOWN, HARVESTED, FAILED, OTHERWISE = 40, 30, 3, 2


@pytest.fixture
def samples(invoke, recipe, changed_recipe):
    invoke("generate", changed_recipe("count = 40", "count = 40\ntangents = true"))
    return read_data_set(recipe.study().data_path())


@pytest.fixture
def harvest(recipe, tmp_path):
    """The first states failed, the next were on another branch."""
    F, F_dot = sample(recipe.study().cell.range, HARVESTED, 2)
    stress = square_stress(F, F_dot)
    status = np.zeros(HARVESTED, dtype=np.int8)
    stress[:FAILED], status[:FAILED] = np.nan, 1
    stress[FAILED : FAILED + OTHERWISE] += 0.1
    path = tmp_path / "harvest.h5"
    writer = HarvestWriter(path, origin_of(recipe.study()))
    writer(F, F_dot, stress, status, np.zeros(HARVESTED, dtype=np.int8))
    writer.flush()
    return path


def test_harvested_states_get_the_tangents_they_lack(samples, harvest, recipe, caplog):
    joined = with_harvests(samples, [harvest], recipe.study(), SquareLaw())
    new = slice(KNOWN, None)
    assert len(joined.F) == KNOWN + HARVESTED - OTHERWISE
    np.testing.assert_array_equal(joined.P_by_F[:KNOWN], samples.P_by_F)
    valid = joined.status == 0
    assert (~valid).sum() == FAILED
    exact = SquareLaw().respond(joined.F[valid], joined.F_dot[valid], tangents=True)
    np.testing.assert_allclose(joined.P_by_F[valid], exact.tangents.P_by_F, atol=1e-12)
    np.testing.assert_allclose(joined.P_by_F_dot[valid], exact.tangents.P_by_F_dot, atol=1e-12)
    assert np.isnan(joined.P_by_F[new][:FAILED]).all()
    np.testing.assert_allclose(joined.stress[valid], exact.stress, atol=1e-12)
    assert f"{OTHERWISE} harvested states left out" in caplog.text


def test_without_tangents_every_harvested_state_is_taken(samples, harvest, recipe):
    plain = replace(samples, P_by_F=None, P_by_F_dot=None)
    joined = with_harvests(plain, [harvest], recipe.study())
    assert len(joined.F) == KNOWN + HARVESTED
    assert joined.P_by_F is None
    assert with_harvests(samples, [], recipe.study()) is samples


def test_rounds_of_a_recipe_at_rest_are_rests(invoke, changed_recipe, tmp_path):
    path = changed_recipe("stretch = [0.95, 1.05]", "stretch = [0.999, 1.001]")
    path.write_text(path.read_text(encoding="utf-8") + "[rest]\nload_steps = 4\n", encoding="utf-8")
    out = tmp_path / "refined"
    invoke("refine", path, "--out", out, "--rounds", 1, law=SquareLaw, code=1)
    (row,) = json.loads((out / "refine.json").read_text(encoding="utf-8"))["rounds"]
    record = read_record(out / "round-0" / "run")
    assert (record.law, record.counts["load_steps"]) == ("cached", 4)
    assert row["unknown"] > 0
    assert row["wider"]["stretch"][1] > record.met["stretch"][1] - 1e-3 > 1.001
    assert row["wider"]["rate"] == row["range"]["rate"]  # nothing moves at rest
