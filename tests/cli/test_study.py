"""A whole study by one command, and comparisons, over a law without cells."""

import json
import re
import shutil
from shutil import copytree

import pytest

from surrofe2.store.run_folder import read_record
from tests.laws import SoftLaw, SquareLaw


def _largest_difference(out):
    result = json.loads((out / "comparison" / "comparison.json").read_text(encoding="utf-8"))
    assert result["reference"] == "rve"
    return result["runs"][0]["difference"]["largest"]


def test_everything_by_one_command(invoke, recipe_path, tmp_path):
    out = tmp_path / "study"
    done = invoke("study", recipe_path, "--out", out)
    assert _largest_difference(out) < 1e-3
    steps = re.findall(r"^(\d)/4 ", done.stdout, re.M)
    assert steps == ["1", "2", "3", "4"]
    assert "\\n" not in done.stdout, "an end of a line that was escaped"
    assert "including data and training" in done.stdout
    law = SoftLaw()
    again = invoke("study", recipe_path, "--out", out, law=law)
    assert law.calls == 1  # of the stress near rest, by which a cached law checks its surrogate
    assert "40 samples (already finished)" in again.stdout
    assert "(already trained)" in again.stdout

    # what is missing alone is done
    kept = (out / "rve" / "run.json").read_bytes()
    shutil.rmtree(out / "cached")
    (tmp_path / "cells.h5").unlink()  # its surrogate needs it no more
    invoke("study", recipe_path, "--out", out)
    assert (out / "rve" / "run.json").read_bytes() == kept
    assert read_record(out / "cached").status == "finished"
    assert not (tmp_path / "cells.h5").exists()


@pytest.mark.slow
def test_a_true_run_that_was_kept(invoke, recipe_path, tmp_path):
    invoke("run", recipe_path, "--law", "rve", "--out", tmp_path / "rve")
    out = tmp_path / "study"
    invoke("study", recipe_path, "--out", out, "--true", tmp_path / "rve")
    assert not (out / "rve").exists()
    assert _largest_difference(out) < 1e-3


@pytest.mark.slow
def test_without_a_true_run(invoke, recipe_path, tmp_path):
    out = tmp_path / "study"
    done = invoke("study", recipe_path, "--out", out, "--without-true")
    assert sorted(path.name for path in out.iterdir()) == ["cached", "report.html"]
    assert "audit: " in done.stdout
    invoke("compare", out / "cached", "--out", tmp_path / "page")
    assert [path.name for path in (tmp_path / "page").iterdir()] == ["report.html"]
    both = invoke("study", recipe_path, "--without-true", "--true", tmp_path, code=1)
    assert both.stderr == "error: --true: not with --without-true; leave one of them out\n"


def test_a_table_needs_no_data_set(invoke, changed_recipe, tmp_path):
    out, path = tmp_path / "study", changed_recipe('file = "cells.h5"\n', "")
    done = invoke("study", path, "--out", out, "--law", "table", law=SquareLaw)
    assert _largest_difference(out) < 1e-3
    assert "1/2 " in done.stdout


@pytest.mark.parametrize("law", ["cached", "table"])
def test_a_mistake_in_the_problem_is_told_before_anything_is_made(
    invoke, changed_recipe, tmp_path, law
):
    path = changed_recipe("watched = [100.0, 50.0]", "watched = [100.0, 49.0]\n[surface]\non = 'x'")
    invoke("study", path, "--out", tmp_path / "study", "--law", law, code=1)
    assert not (tmp_path / "cells.h5").exists()
    assert not (tmp_path / "study").exists()


@pytest.fixture
def runs(invoke, recipe_path, tmp_path):
    folders = [tmp_path / "stiff", tmp_path / "soft"]
    for folder, stiffness in zip(folders, (50.0, 49.0), strict=True):
        command = "run", recipe_path, "--law", "rve", "--out", folder
        invoke(*command, law=SoftLaw(a=stiffness))
    return folders


def test_comparison(invoke, runs, tmp_path):
    out = tmp_path / "comparison"
    done = invoke("compare", *runs, "--out", out, env={"COLUMNS": "50"})
    assert "\x1b" not in done.output
    result = json.loads((out / "comparison.json").read_text(encoding="utf-8"))
    assert result["reference"] == "stiff"
    (run,) = result["runs"]
    assert run["name"] == "soft"
    assert 0.0 < run["difference"]["rms"] < run["difference"]["largest"] < 0.05
    assert run["speed_up"]["wall_time"] > 0.0
    assert (out / "comparison.png").stat().st_size > 10_000


@pytest.mark.slow
def test_a_comparison_is_kept_and_one_of_other_runs_refused(invoke, runs, tmp_path):
    out = tmp_path / "comparison"
    invoke("compare", *runs, "--out", out)
    before = (out / "comparison.png").stat().st_mtime_ns
    invoke("compare", *runs, "--out", out)
    assert (out / "comparison.png").stat().st_mtime_ns == before
    third = runs[0].with_name("third")
    copytree(runs[1], third)
    refused = invoke("compare", *runs, third, "--out", out, code=1)
    assert refused.stderr.startswith(f"error: {out / 'comparison.json'}: of.third: this call has ")
    invoke("compare", *runs, third, "--out", out, "--fresh")
