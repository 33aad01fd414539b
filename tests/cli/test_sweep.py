"""A sweep over tolerances, over a law without cells and a surrogate that knows its error."""

from __future__ import annotations

import json

import numpy as np
import pytest

from surrofe2.io.run_folder import read_record
from surrofe2.stress_law import Status
from surrofe2.surrogate import SurrogateLaw
from tests.laws import SoftLaw


@pytest.fixture(autouse=True)
def _bounded(invoke, recipe_path, monkeypatch):
    """A trained surrogate, off by up to half of a bound that grows with the shear."""
    assert invoke("generate", recipe_path).exit_code == 0
    assert invoke("train", recipe_path).exit_code == 0
    plain = SurrogateLaw.lookup

    def lookup(self, F, F_dot, tolerance=np.inf):
        stress, status, _ = plain(self, F, F_dot)
        bound = 0.004 + 4.0 * abs(F[:, 1, 0])
        stress += 0.5 * (bound - 0.004)[:, None, None] * np.array([[0.8, 0.0], [0.0, -0.6]])
        status[(status == 0) & ~(bound <= tolerance)] = Status.NOT_TRUSTED
        stress[status != 0] = np.nan
        return stress, status, bound

    monkeypatch.setattr(SurrogateLaw, "lookup", lookup)
    monkeypatch.setattr(SurrogateLaw, "status_and_bound", lambda *asked: lookup(*asked)[1:])
    monkeypatch.setattr(SurrogateLaw, "stress_spread", 2.0, raising=False)


def test_a_tolerance_buys_hits_for_error(invoke, recipe_path, tmp_path):
    out = tmp_path / "sweep"
    command = ("sweep", recipe_path, "--out", out, "--tolerances", "1e-1,1e-2,3e-3")
    done = invoke(*command, "--audit", "1.0")
    assert done.exit_code == 0, done.output
    sweep = json.loads((out / "sweep.json").read_text(encoding="utf-8"))
    rows = sweep["rows"]
    assert [row["tolerance"] for row in rows] == [1e-1, 1e-2, 3e-3]
    hits = [row["hits"] for row in rows]
    assert 1.0 >= hits[0] > hits[1] > hits[2]
    for row in rows:
        assert row["above"].startswith("0 of ")
        assert row["stress_error"] <= row["largest_stress_error"] <= row["tolerance"]
        assert row["right_hand_sides"] == pytest.approx(1.0, abs=0.2)  # a step of 6 is 0.16
        assert row["displacement_error"] < 0.05
        record = read_record(out / f"tolerance-{row['tolerance']:g}")
        assert record.recipe["cache"]["tolerance"] == row["tolerance"]
        assert row["above"] == f"0 of {record.cache['audit']['audited']}"
    assert rows[0]["displacement_error"] > rows[2]["displacement_error"]
    assert (out / "sweep.png").stat().st_size > 20_000
    assert "Against true FE²" in done.stdout
    law = SoftLaw()
    again = invoke(*command, "--audit", "1.0", law=law)
    assert again.exit_code == 0, again.output
    assert law.calls == 0
    other = invoke(*command, "--audit", "0.5")
    assert other.exit_code == 1
    assert "cache.audit: this call has 0.5, what is there 1.0" in other.stderr


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1e-2;1e-3", "--tolerances: '1e-2;1e-3'; they must be numbers between commas"),
        ("0.1,-1", "cache.tolerance: -1.0; it must be positive"),
    ],
)
def test_tolerances_that_are_none(invoke, recipe_path, tmp_path, text, message):
    refused = invoke("sweep", recipe_path, "--out", tmp_path / "sweep", "--tolerances", text)
    assert refused.exit_code == 1
    assert message in refused.stderr
    assert not (tmp_path / "sweep").exists()
