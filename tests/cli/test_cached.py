"""Runs through a surrogate, and the demo, over a law without cells."""

from __future__ import annotations

import json

import pytest

from surrofe2.io.runs import read_record
from tests.fakes import SoftLaw


@pytest.fixture
def _trained(invoke, recipe_path):
    assert invoke("generate", recipe_path).exit_code == 0
    assert invoke("train", recipe_path).exit_code == 0


@pytest.mark.usefixtures("_trained")
@pytest.mark.parametrize("law", ["surrogate", "cached"])
def test_run_through_the_surrogate(invoke, recipe_path, tmp_path, law):
    done = invoke("run", recipe_path, "--law", law, "--out", tmp_path / law)
    assert done.exit_code == 0, done.output
    record = read_record(tmp_path / law)
    assert record.surrogate["file"] == "cells.pt"
    assert len(record.surrogate["fingerprint"]) == 16
    assert record.surrogate["errors"]["points"] == 4
    if law == "cached":
        assert record.counts["hits"] > 0
        assert record.counts["fallbacks"] == record.counts.get("rve_solves", 0) == 0


@pytest.mark.usefixtures("_trained")
def test_fallbacks_are_counted_by_reason(invoke, recipe_path, changed_recipe, tmp_path):
    changed_recipe("-0.1]", "-2.0]")
    done = invoke("run", recipe_path, "--law", "cached", "--out", tmp_path / "cached")
    assert done.exit_code == 0, done.output
    counts = read_record(tmp_path / "cached").counts
    assert counts["fallbacks"] == counts["fallbacks_out_of_range"] == counts["rve_solves"] > 0
    assert f"{counts['fallbacks']} fallbacks ({counts['fallbacks']} out of range)" in done.stdout


@pytest.mark.usefixtures("_trained")
@pytest.mark.parametrize("law", ["surrogate", "cached"])
def test_surrogate_for_other_cell_parameters(invoke, recipe_path, changed_recipe, tmp_path, law):
    changed_recipe('preset = "printed"', "viscosity = 0.2")
    refused = invoke("run", recipe_path, "--law", law, "--out", tmp_path / law)
    assert refused.exit_code == 1
    assert refused.stderr == (
        f"error: {recipe_path.parent / 'cells.pt'}: trained for cell.viscosity = 0.1, the recipe "
        "has 0.2; train a surrogate for this recipe\n"
    )
    assert not (tmp_path / law).exists()


@pytest.mark.usefixtures("_trained")
def test_surrogate_for_another_initialisation(invoke, recipe_path, tmp_path):
    refused = invoke(
        "run", recipe_path, "--law", "cached", "--out", tmp_path / "cached",
        "--initialisation", "elastic",
    )  # fmt: skip
    assert refused.exit_code == 1
    assert refused.stderr == (
        f"error: {recipe_path.parent / 'cells.pt'}: trained for initialisation constrained-runs, "
        "the run has elastic; train a surrogate for this recipe\n"
    )


def test_missing_surrogate(invoke, recipe_path, tmp_path):
    refused = invoke("run", recipe_path, "--law", "cached", "--out", tmp_path / "cached")
    assert refused.exit_code == 1
    assert refused.stderr == (
        f"error: {recipe_path.parent / 'cells.pt'}: cannot be read: No such file or directory\n"
    )


def test_demo(invoke, recipe_path, tmp_path):
    out = tmp_path / "demo"
    done = invoke("demo", "--recipe", recipe_path, "--out", out)
    assert done.exit_code == 0, done.output
    result = json.loads((out / "comparison" / "comparison.json").read_text(encoding="utf-8"))
    assert result["reference"] == "rve"
    assert result["runs"][0]["difference"]["largest"] < 1e-3
    assert (out / "comparison" / "comparison.png").exists()
    law = SoftLaw()
    again = invoke("demo", "--recipe", recipe_path, "--out", out, law=law)
    assert again.exit_code == 0, again.output
    assert law.calls == 0
    assert "40 samples (already finished)" in again.stdout
    assert "(already trained)" in again.stdout


def test_demo_away_from_the_repository(invoke, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused = invoke("demo")
    assert refused.exit_code == 1
    assert refused.stderr == (
        "error: data/bending-bar.toml: cannot be read: No such file or directory\n"
    )
