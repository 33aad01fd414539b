"""The benchmarks run, judge and report; how fast anything is, is not asked here."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from math import isfinite, nan
from pathlib import Path

import numpy as np
import pytest

from benchmarks import (
    __main__ as runner,
)
from benchmarks import (
    climb,
    force_evaluation,
    inference,
    initialisations,
    linear_cost,
    macro_overhead,
    paper_scheme,
    tissue,
    trust,
)
from benchmarks.report import Outcome, make_report, to_markdown
from benchmarks.row import Row
from benchmarks.setting import Setting, rve
from benchmarks.timing import side_by_side
from benchmarks.watched_law import RecordingLaw, TimedLaw
from surrofe2 import CachedLaw, LoadCase, MacroSettings, simulate
from surrofe2.cache import CacheSettings
from surrofe2.displacement_curve import DisplacementCurve
from surrofe2.sampling import SamplingRange
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
            calibration=CalibrationSettings(walks=100, states=100, runs=0, length=4),
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


def test_what_is_compared_is_called_in_turns():
    calls = []
    side_by_side([lambda: calls.append("a"), lambda: calls.append("b")], repeats=2)
    order = [name for k, name in enumerate(calls) if k == 0 or calls[k - 1] != name]
    assert order == ["a", "b"] * 3


@pytest.mark.slow
def test_plain_and_lane_forces_are_those_of_the_twin(setting):
    rows = force_evaluation.run(setting)
    errors = [
        error
        for row in rows
        for error in (row.error, row.baseline_error)
        if row.error_of and error is not None
    ]
    assert len(errors) == 6
    assert max(errors) < 1e-12


@pytest.mark.parametrize(
    "module",
    [
        macro_overhead,
        inference,
        pytest.param(initialisations, marks=pytest.mark.slow),
        linear_cost,
    ],
)
def test_a_piece_gives_well_formed_rows(module, setting):
    rows = module.run(setting)
    assert rows
    assert len({row.name for row in rows}) == len(rows)
    for row in rows:
        assert isfinite(row.value), row.name
        json.dumps(row.to_dict(), allow_nan=False)


def test_plain_macro_force_and_torch_agree_with_what_is_timed(setting):
    assert max(row.error for row in macro_overhead.run(setting)) < 1e-12
    agreement = [row for row in inference.run(setting) if row.unit == ""]
    assert [row.met for row in agreement if row.limit is not None] == [True, True]


def test_the_motion_for_the_cost_plot_starts_at_rest_and_ends_in_a_picture(setting):
    u_and_v = linear_cost._motion(np.ones((3, 2)), 0.0)
    np.testing.assert_array_equal(u_and_v, np.zeros(12))
    linear_cost.run(setting)
    assert (setting.out / "cost.png").read_bytes().startswith(b"\x89PNG")


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


def test_the_fastest_step_that_holds_the_error_over_the_whole_run_is_taken(monkeypatch):
    t = np.linspace(0.0, 10.0, 21)

    def run(preset, cells, duration, step):
        if step > 2.35e-3:
            return tissue.TissueTime(0.0, 0.0, None)
        late = 0.1 if step > 2.25e-3 else 1e-4  # one breaks after the first tenth
        u = np.stack([0.0 * t, -t - late * (t > 5.0)], axis=1)[t <= duration]
        seconds = 2.0 if step == 2.2e-3 else 1e-3 / step  # one rattles
        return tissue.TissueTime(seconds, 2.0, DisplacementCurve(t[t <= duration], u))

    monkeypatch.setattr(tissue, "_tissue", run)
    u = np.stack([0.0 * t, -t], axis=1)
    reference = tissue.TissueTime(1.0, 2.0, DisplacementCurve(t, u))
    step, _, error = tissue._fastest_step("printed", 16, 10.0, reference)
    assert step == 2.1e-3
    assert error == pytest.approx(1e-5)
    monkeypatch.setattr(tissue, "ERROR", 1e-6)
    with pytest.raises(RuntimeError, match="no micro step"):
        tissue._fastest_step("printed", 16, 10.0, reference)


def test_a_timed_law_changes_nothing():
    timed = TimedLaw(rve("printed"))
    watched = simulate(LoadCase(duration=2.0), timed, SMALL)
    usual = simulate(LoadCase(duration=2.0), rve("printed"), SMALL)
    np.testing.assert_array_equal(watched.curve.displacement, usual.curve.displacement)
    assert timed.solved == usual.effort["rve_solves"]
    assert timed.accepted == 20 * (usual.counts["steps"] + 1)


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


class Peaked(Learnt):
    """Wrong by twice the tolerance on a peak that few states are near."""

    range = SamplingRange(stretch=(0.9, 1.1), shear=0.1, rate=0.01)

    def __init__(self):
        def error(F, F_dot):
            far = (F[:, 0, 0] - 1.05) ** 2 + (F[:, 1, 1] - 0.97) ** 2 + (F[:, 0, 1] - 0.03) ** 2
            return 2e-3 * self.stress_spread / (1.0 + 1e4 * far)

        super().__init__(error, lambda F, F_dot: np.full(len(F), 5e-4 * self.stress_spread))


def test_a_search_finds_the_error_that_random_states_do_not():
    found = climb.Search(Peaked(), Truth(), CacheSettings())
    at = np.random.default_rng(0).uniform(-1.0, 1.0, (300, 7))
    some = found.judge(at)
    np.testing.assert_allclose(
        climb.from_state(*climb.to_state(at, Peaked.range), Peaked.range), at
    )
    np.testing.assert_allclose(some.over_bound, 2.0 * some.over_tolerance)
    starts = some.of(np.argsort(some.over_bound)[-20:])
    assert starts.over_tolerance.max() < 1.0
    best = found.climb(starts, "over_bound", 60, seed=1)
    assert best.over_tolerance.max() > 1.9


def test_the_section_of_the_search_is_written_once():
    page = "# Trust\n\nSome.\n"
    once = trust.with_search(page, f"{trust.SEARCH}\n\nold\n")
    assert trust.with_search(once, f"{trust.SEARCH}\n\nnew\n") == f"{page}\n{trust.SEARCH}\n\nnew\n"
    assert trust.with_search(once, "") == page


def test_the_push_of_the_trust_cases_reverses():
    case = trust.cases("printed", 250.0)[-1]
    assert case.load.amplitude_at(50.0) == 1.0
    assert case.load.amplitude_at(200.0) == -1.0
