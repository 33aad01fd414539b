"""The benchmarks run, judge and report; how fast anything is, is not asked here."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import __main__ as runner
from benchmarks import inference, trust
from benchmarks.report import Outcome, make_report
from surrofe2 import CachedLaw, LoadCase, MacroSettings
from surrofe2.cache import CacheSettings
from tests.laws import Learnt, Truth

ROOT = Path(__file__).parents[1]
SMALL = MacroSettings()


def test_a_failing_benchmark_does_not_stop_the_others(monkeypatch, tmp_path, capsys):
    def fail(setting):
        raise RuntimeError("broken")

    monkeypatch.setattr(inference, "run", fail)
    arguments = ["--quick", "--only", "inference", "macro_overhead", "--out", str(tmp_path)]
    assert runner.main(arguments) == 1
    assert "broken" in capsys.readouterr().err
    report = json.loads((tmp_path / "benchmarks.json").read_text(encoding="utf-8"))
    overhead, failed = report["benchmarks"]
    assert failed["failure"] == "RuntimeError: broken"
    assert [row["limit"] for row in overhead["rows"]] == [80.0, 0.2]
    assert report["mode"] == "quick"
    assert report["platform"]["cores"]


@pytest.mark.slow
def test_quick_mode_runs_as_a_command(tmp_path):
    command = [sys.executable, "-m", "benchmarks", "--quick", "--out", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "benchmarks.json").read_text(encoding="utf-8"))
    assert [found["name"] for found in report["benchmarks"]] == list(runner.NAMES)
    assert all(found["rows"] for found in report["benchmarks"])


@pytest.mark.parametrize(("error", "kept"), [(0.5, True), (1.5, False)])
def test_trust_compares_every_accepted_answer_with_the_tolerance(error, kept):
    law = CachedLaw(
        Learnt(
            lambda F, F_dot: 0.01 * error + 0.0 * F[:, 0, 0],
            lambda F, F_dot: 0.005 + F[:, 0, 1] ** 2,
        ),
        Truth(),
        CacheSettings(tolerance=1e-3, audit=1.0),
    )
    load = LoadCase(width=60.0, height=40.0, watched=(60.0, 20.0), duration=2.0, elements=(2, 2))
    case = trust.Case("tiny", load, SMALL)
    rows, report = trust.measure("a tiny bar", law, case)
    assert report["audit"]["audited"] == report["accepted"]["hits"] > 0
    quotient, hits, calls, displacement = rows
    assert quotient.value == pytest.approx(error, rel=0.05)
    assert quotient.met is kept
    assert hits.value <= 100.0
    assert calls.value == pytest.approx(1.0, abs=0.5)
    # Every answer wrong: the first audit switches the cache off, and the run is the true one.
    assert (displacement.value > 0.0) is kept
    outcome = Outcome("trust", trust.TITLE, rows)
    page = trust.to_page(make_report([outcome], quick=False, load=0.0), outcome, [report])
    assert ("missed" in page.split("Errors incurred")[0]) is not kept
