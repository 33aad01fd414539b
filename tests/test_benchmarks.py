"""The benchmarks run, judge and report; how fast anything is, is not asked here."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from math import isfinite, nan
from pathlib import Path

import pytest

from benchmarks import (
    __main__ as runner,
)
from benchmarks import (
    inference,
    initialisations,
    macro_overhead,
    paper_scheme,
    trust,
)
from benchmarks.report import Outcome, make_report, to_markdown
from benchmarks.row import Row
from benchmarks.setting import Setting, rve
from benchmarks.watched_law import RecordingLaw
from surrofe2 import CachedLaw, LoadCase, MacroSettings, simulate
from surrofe2.cache import CacheSettings
from surrofe2.surrogate.settings import CalibrationSettings
from tests.laws import Learnt, Truth

ROOT = Path(__file__).parents[1]
SMALL = MacroSettings(elements=(2, 2))


class TinySetting(Setting):
    """Quick mode with a surrogate that takes a second to train."""

    def recipe(self, preset):
        recipe = super().recipe(preset)
        return replace(
            recipe,
            samples=replace(recipe.samples, count=512),
            training=replace(recipe.training, hidden=(4,), baseline_degree=1, iterations=2),
            calibration=CalibrationSettings(walks=100, runs=0, length=6),
        )


@pytest.fixture(scope="module")
def setting(tmp_path_factory):
    return TinySetting(quick=True, out=tmp_path_factory.mktemp("bench"))


@pytest.mark.parametrize(
    ("value", "limit", "at_least", "met"),
    [
        (1.0, None, False, None),
        (1.0, 1.0, False, True),
        (1.1, 1.0, False, False),
        (1.1, 1.0, True, True),
        (0.9, 1.0, True, False),
        (nan, 1.0, True, False),
        (nan, 1.0, False, False),
    ],
)
def test_a_limit_is_judged(value, limit, at_least, met):
    assert Row(name="a", value=value, unit="s", limit=limit, at_least=at_least).met is met


def test_a_missed_limit_and_a_failure_show():
    outcomes = [
        Outcome("a", "A", [Row(name="slow", value=3.0, unit="s", limit=2.0)]),
        Outcome("b", "B", failure="RuntimeError: broken"),
    ]
    page = to_markdown(make_report(outcomes, quick=True, load=0.0), outcomes)
    assert "| slow | 3 s | ≤ 2 s | **missed** | 1 |" in page
    assert "**Failed**: RuntimeError: broken" in page


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


@pytest.mark.parametrize(
    "module",
    [
        macro_overhead,
        inference,
        pytest.param(initialisations, marks=pytest.mark.slow),
    ],
)
def test_a_piece_gives_well_formed_rows(module, setting):
    rows = module.run(setting)
    assert rows
    assert len({row.name for row in rows}) == len(rows)
    for row in rows:
        assert isfinite(row.value), row.name
        json.dumps(row.to_dict(), allow_nan=False)


def test_a_replayed_run_gives_the_stresses_of_the_run():
    """Warm from call to call, as it is timed, and cold to 1e-11."""
    law = RecordingLaw(rve("printed"))
    done = simulate(LoadCase(duration=2.0), law, replace(SMALL, record_dissipation=False))
    assert len(law.asked) == done.counts["stress_calls"]
    assert sum(question.accepted for question in law.asked) == done.counts["steps"] + 1
    replay = paper_scheme.Replay(rve("printed"), stride=1)
    replay.answer(law.asked)
    exact = [paper_scheme._exact(question) for question in law.asked]
    assert paper_scheme._error(replay.kept, exact) < 1e-7
    iterated = paper_scheme.Replay(rve("printed", solver="iterated"), stride=1)
    iterated.answer(law.asked)
    assert 1e-6 < paper_scheme._error(iterated.kept, exact) < 0.1


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
    load = LoadCase(width=60.0, height=40.0, watched=(60.0, 20.0), duration=2.0)
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
    assert (
        f"| a tiny bar | {report['audit']['audited']:,} | {report['audit']['violations']} |" in page
    )
    assert ("missed" in page.split("Errors incurred")[0]) is not all(
        row.met is not False for row in rows
    )


def test_the_section_of_the_search_is_written_once():
    page = "# Trust\n\nSome.\n"
    once = trust.with_search(page, f"{trust.SEARCH}\n\nold\n")
    assert trust.with_search(once, f"{trust.SEARCH}\n\nnew\n") == f"{page}\n{trust.SEARCH}\n\nnew\n"
    assert trust.with_search(once, "") == page
