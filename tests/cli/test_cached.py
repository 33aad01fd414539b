"""Runs through a surrogate over a law without cells."""

import re

import numpy as np
import pytest

from surrofe2.law.stress_law import Status
from surrofe2.store.run_folder import read_record
from surrofe2.surrogate import SurrogateLaw


@pytest.mark.usefixtures("trained")
@pytest.mark.parametrize("law", ["surrogate", "cached"])
def test_run_through_the_surrogate(invoke, recipe_path, tmp_path, law):
    invoke("run", recipe_path, "--law", law, "--out", tmp_path / law, "--tolerance", "0.1")
    record = read_record(tmp_path / law)
    assert record.surrogate["file"] == "cells-surrogate.h5"
    assert len(record.surrogate["fingerprint"]) == 16
    assert record.surrogate["errors"]["points"] == 4
    if law == "cached":
        assert record.counts["hits"] > 0
        assert record.counts["fallbacks"] == 0
        assert record.counts["rve_solves"] == record.counts["audits"] > 0


def cached(recipe, folder):
    return "run", recipe, "--law", "cached", "--out", folder / "cached"


@pytest.mark.usefixtures("trained")
def test_fallbacks_are_counted_by_reason(invoke, recipe_path, changed_recipe, tmp_path):
    changed_recipe("-0.1]", "-2.0]")
    done = invoke(*cached(recipe_path, tmp_path), "--tolerance", "inf")
    counts = read_record(tmp_path / "cached").counts
    assert counts["fallbacks"] == counts["fallbacks_out_of_range"] > 0
    assert counts["rve_solves"] == counts["fallbacks"] + counts["audits"]
    number = f"{counts['fallbacks']:,}"
    assert f"{number} fallbacks ({number} out of range)" in done.stdout
    told = r"out of range: \d+ of \d+ fallbacks by .* = .* of at (most|least)"
    assert re.search(told, done.stdout)


@pytest.mark.usefixtures("trained")
def test_a_surrogate_of_another_cell_or_initialisation_or_none(
    invoke, recipe_path, changed_recipe, surrogate_path, tmp_path
):
    def told(law, *more):
        refused = invoke("run", recipe_path, "--law", law, "--out", tmp_path / law, *more, code=1)
        assert not (tmp_path / law).exists()
        begin, _, rest = refused.stderr.partition(f"{surrogate_path}: ")
        assert begin == "error: "
        return rest

    found = told("cached", "--initialisation", "elastic")
    assert "initialisation constrained-runs, not elastic; train" in found
    changed_recipe('preset = "printed"', "viscosity = 0.2")
    for law in ("surrogate", "cached"):
        assert "trained for cell.viscosity = 0.1, not 0.2; train" in told(law)
    surrogate_path.unlink()
    assert told("cached").startswith("cannot be read: no such file; make it with `surrofe2 train ")


@pytest.fixture
def bias(trained, monkeypatch):
    """The trained surrogate as if it knew its error; bias[0] µN/µm is added to its stress."""
    size, plain = [0.0], SurrogateLaw.lookup

    def lookup(self, F, F_dot, limit=np.inf):
        stress, status, _ = plain(self, F, F_dot)
        risk = 0.004 + 0.1 * abs(F[:, 1, 0])
        risk /= 1.0 if self.tolerance is None else self.tolerance[-1]
        status[(status == 0) & ~(risk <= limit)] = Status.NOT_TRUSTED
        stress[status != 0] = np.nan
        return stress + size[0], status, risk

    monkeypatch.setattr(SurrogateLaw, "lookup", lookup)
    monkeypatch.setattr(SurrogateLaw, "status_and_risk", lambda *asked: lookup(*asked)[1:])
    monkeypatch.setattr(SurrogateLaw, "stress_spread", 10.0, raising=False)
    return size


@pytest.mark.usefixtures("bias")
def test_the_record_tells_how_wrong_the_cache_was(invoke, recipe_path, tmp_path):
    done = invoke(*cached(recipe_path, tmp_path), "--tolerance", "2e-3", "--audit", "1.0")
    record = read_record(tmp_path / "cached")
    settings = {"tolerance": 2e-3, "relative_tolerance": None, "audit": 1.0, "seed": 1}
    assert record.recipe["cache"] == settings
    cache = record.cache
    absolute = pytest.approx(0.02)
    told = {"share": 2e-3, "relative": pytest.approx(6e-2), "spread": 10.0, "absolute": absolute}
    assert cache["tolerance"] == told
    assert cache["audit"]["audited"] == cache["accepted"]["hits"] > 100
    assert cache["audit"]["largest"] <= 0.02
    assert cache["audit"]["worst"]["error"] == cache["audit"]["largest"]
    assert cache["trust"] == {"factor": 1.0, "reach": [], "off": False, "events": []}
    assert f"audit: {cache['audit']['audited']} of {cache['audit']['audited']}" in done.stdout
    assert "0 above the tolerance of 0.02 µN/µm" in done.stdout
    closing = cache["closing_audit"]
    assert closing["answers"] == cache["accepted"]["hits"]
    count = closing["sampled"]
    assert count == min(320, closing["answers"])
    if count == closing["answers"]:
        assert closing["wrong_at_most"] == 0.0
    else:
        assert closing["wrong_at_most"] == pytest.approx(1.0 - 0.05 ** (1.0 / count))
    assert done.stdout.splitlines()[-1].startswith("closing audit: ")
    assert record.counts["audits"] == cache["audit"]["audited"] + count


def test_a_corrupted_surrogate_loses_trust_loudly(invoke, recipe_path, tmp_path, bias):
    bias[0] = 1.0
    done = invoke(*cached(recipe_path, tmp_path), "--audit", "1.0")
    record = read_record(tmp_path / "cached")
    (event,) = record.cache["trust"]["events"]
    assert event["action"] == "tightened"
    assert record.counts["fallbacks_not_trusted"] == record.counts["fallbacks"] > 0
    assert record.cache["accepted"]["hits"] <= 20  # at the very start, which cannot go back
    assert "audited answers are off by more than the tolerance" in done.stderr
    assert "the risks count 2.75 times from here on" in done.stderr
    assert "state more samples ([samples] count) and train again" in done.stderr
