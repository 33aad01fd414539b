"""Steps that audits find wrong are made again; steps that are right keep every bit."""

from collections import Counter
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from surrofe2.cache import CachedLaw, CacheSettings
from surrofe2.cache.cached_law import AUDIT
from surrofe2.cache.trust import AUDITS, VIOLATIONS, audits_of
from surrofe2.law.regional_law import RegionalLaw
from surrofe2.macro import MacroSettings, simulate
from surrofe2.run.displacement_curve import difference
from tests.cache.tables import LOAD_CASE, Kept, cached, keeping, resumed, rising
from tests.laws import Learnt, Truth, shear_error
from tests.macro.bars import assert_same_run

SETTINGS = MacroSettings(frames=5)
ALLOWED = 0.1
"""µN/µm: a hundredth of the spread of `Learnt`."""
BOUND = rising(0.01, 0.2)


def bad_beyond(shear):
    """Errors within the bound below a shear, and five times the tolerance above."""
    return lambda F, F_dot: np.where(abs(F[:, 1, 0]) > shear, 5.0 * ALLOWED, 0.5 * BOUND(F, F_dot))


@cache
def true_run(settings):
    return simulate(LOAD_CASE, Truth(), settings)


@pytest.mark.slow
@pytest.mark.parametrize("shear", [0.0, 0.02, 0.03])
@pytest.mark.parametrize("integrator", ["explicit", "implicit"])
def test_no_window_that_stands_has_a_wrong_share(shear, integrator):
    settings = replace(SETTINGS, integrator=integrator)
    law = cached(bad_beyond(shear), BOUND, 0.3, kind=Kept)
    run = simulate(LOAD_CASE, law, settings)
    true = true_run(settings)
    assert run.rolled_back["steps"] > 0
    assert max(law.wrong_shares(Truth(), ALLOWED), default=0.0) <= 0.02
    assert difference(run.curve, true.curve).largest < 2e-3
    assert law.counts["steps"] == run.counts["steps"] + 1
    record = law.report()["audit"]
    assert record["violations"] <= 0.01 * record["audited"]


class Counted(CachedLaw):
    """Counts the points it is asked about, and RVE stresses of audits."""

    def __init__(self):
        super().__init__(
            Learnt(bad_beyond(0.02), BOUND),
            Truth(),
            CacheSettings(tolerance=0.01, audit=0.3),
            lambda *answer: self.audits.extend(answer[-1] == AUDIT),
        )
        self.points, self.audits = 0, []

    def respond(self, F, F_dot, state=None, *, tangents=False):
        self.points += len(F)
        return super().respond(F, F_dot, state, tangents=tangents)


def test_counts_are_of_what_stands_and_what_was_rolled_back_is_apart():
    """Of a run that was resumed after a roll-back too."""
    law, states = Counted(), []
    checkpoints = {"checkpoint": keeping(law, states), "checkpoint_interval": 0.0}
    run = simulate(LOAD_CASE, law, SETTINGS, **checkpoints)
    for counts in (Counter({**run.counts, **run.effort}), Counter(run.rolled_back)):
        asked = counts["stress_points"] + counts["dissipation_points"]
        assert 0 < asked == counts["hits"] + counts["fallbacks"]
        law.points -= asked
    assert law.points == 0
    assert law.counts["steps"] == run.counts["steps"] + 1
    samples = states[-1][0]["samples"]
    assert run.counts["dissipation_points"] == 60 * (len(samples) - 1)  # none at rest
    audit = law.report()["audit"]
    audits = sum(law.audits) - run.cache["closing_audit"]["audited"]
    assert 0 < audit["audited"] == audits - audit["rolled_back"] < audits
    back = next(kept for kept in states if "rolled_back.steps" in kept[0])
    again = Counted()
    rerun = resumed(LOAD_CASE, again, SETTINGS, back)
    assert_same_run(rerun, run)
    assert rerun.effort == run.effort
    assert rerun.rolled_back == run.rolled_back
    assert again.report()["audit"]["rolled_back"] == audit["rolled_back"]


def test_a_fault_that_is_entered_late_leaves_the_steps_before_alone():
    law = cached(bad_beyond(0.03), BOUND, 0.3)
    run = simulate(LOAD_CASE, law, SETTINGS)
    told = [line["decision"] for line in law.decisions]
    assert told[0] == "stands"
    assert "rolled back" in told
    assert told[-1] == "stands"
    assert run.rolled_back["steps"] < run.counts["steps"]
    back = law.decisions[told.index("rolled back")]
    assert back["violations"] > 0
    assert back["points"]
    assert back["true_error"] > ALLOWED
    assert back["risk"] <= 1.0 == back["limit_before"]
    assert back["limit_after"] is None or back["limit_after"] < 1.0
    # Windows follow each other without a gap, whatever went back.
    stands = [line for line in law.decisions if line["decision"] == "stands"]
    assert [line["from_t"] for line in stands[1:]] == [line["t"] for line in stands[:-1]]
    assert stands[0]["from_t"] == 0.0
    assert stands[-1]["t"] == pytest.approx(LOAD_CASE.duration)
    assert all(line["audits"] >= AUDITS for line in stands[:-1])


def test_a_run_without_violation_keeps_its_bits(monkeypatch):
    """The same run by a law that nobody asks for verdicts."""
    law, plain = (cached(shear_error(0.01), BOUND, 0.3) for _ in range(2))
    run = simulate(LOAD_CASE, law, SETTINGS)
    monkeypatch.setattr(CachedLaw, "is_audited", False)
    alone = simulate(LOAD_CASE, plain, SETTINGS)
    assert np.array_equal(run.curve.displacement, alone.curve.displacement)
    assert run.counts == alone.counts
    of_windows, at_once = law.report()["audit"], plain.report()["audit"]
    assert of_windows.pop("rms") == pytest.approx(at_once.pop("rms"))  # they add up otherwise
    assert of_windows == at_once
    assert law.counts == plain.counts
    assert {line["decision"] for line in law.decisions} == {"stands"}
    assert not plain.decisions


def test_answers_that_lead_a_run_astray_are_taken_back():
    """An answer so wrong that no step succeeds any more."""

    class Astray(Learnt):
        def lookup(self, F, F_dot, limit=np.inf):
            stress, status, risk = super().lookup(F, F_dot, limit)
            stress[abs(F[:, 1, 0]) > 0.03] *= -40.0
            return stress, status, risk

    settings = CacheSettings(tolerance=0.01, audit=0.05)
    law = CachedLaw(Astray(shear_error(0.01), BOUND), Truth(), settings)
    run = simulate(LOAD_CASE, law, SETTINGS)
    true = true_run(SETTINGS)
    assert run.rolled_back["steps"] > 0
    assert difference(run.curve, true.curve).largest < 2e-3


def test_regions_go_back_together_and_a_fault_of_one_does_not_cost_the_other_audits():
    """The sound law audits as many of its answers as by itself, but for those taken back."""
    points = {"sound": np.arange(0, 30), "wrong": np.arange(30, 60)}
    audited = []
    for error in (shear_error(0.01), bad_beyond(0.02)):
        laws = {"sound": cached(shear_error(0.01), BOUND, 0.3), "wrong": cached(error, BOUND, 0.3)}
        run = simulate(LOAD_CASE, RegionalLaw(laws, points), SETTINGS)
        counted = laws["sound"].history()
        assert counted["accepted"]["hits"] == 30 * (run.counts["steps"] + 1)
        audited.append(counted["audit"]["audited"] / counted["accepted"]["hits"])
    assert run.rolled_back["steps"] > 0
    assert audited == pytest.approx([0.3, 0.3], rel=0.1)
    assert laws["sound"].counts["steps"] == laws["wrong"].counts["steps"] == run.counts["steps"] + 1
    assert laws["sound"].history()["trust"]["factor"] == 1.0
    assert laws["wrong"].history()["trust"]["factor"] > 1.0
    ends = [[line["t"] for line in law.decisions] for law in laws.values()]
    assert ends[0] == ends[1]


def test_a_window_that_ends_early_carries_on_its_audits():
    """One of three answers a window is wrong: the third such window fails, and alone goes back."""
    law = cached(lambda F, F_dot: np.where(np.arange(len(F)), 0.0, 5.0 * ALLOWED), BOUND, 1.0)
    F = np.tile(np.eye(2), (3, 1, 1))
    state, found = law.respond(F, 0.0 * F).state, []
    for k in range(1, 4):
        law.mark(float(k), state)
        state = law.accept(F, 0.0 * F, law.respond(F, 0.0 * F, state)).state
        found.append(law.verdict(final=True))
    assert found == [True, True, False]
    assert law.roll_back(4.0).limit < 1.0
    line = law.decisions[-1]
    assert (line["from_t"], line["violations"], line["audits"]) == (3.0, VIOLATIONS + 1, 9)
    assert law.verdict() is None


def short_windows():
    """A law that is wrong where the risk is above `wrong_from`, to which windows may be cut short,
    and 1,000 points of all risks below 1, of which it audits 0.5 % and what it is short of."""
    wrong_from = [1.0]
    risk = lambda F, F_dot: ALLOWED * F[:, 1, 0]  # noqa: E731
    error = lambda F, F_dot: np.where(F[:, 1, 0] > wrong_from[0], 5.0 * ALLOWED, 0.0)  # noqa: E731
    F = np.tile(np.eye(2), (1000, 1, 1))
    F[:, 1, 0] = np.linspace(0.0, 0.99, 1000)
    return cached(error, risk, 0.005), F, wrong_from


def stepped(law, F, state):
    """The state after five steps from this one."""
    for _ in range(5):
        state = law.accept(F, 0.0 * F, law.respond(F, 0.0 * F, state)).state
    return state


def fail_twice(law, F, wrong_from, state):
    """The state from which a marked window is tried for the third time."""
    for risk in (0.5, 0.2):  # the second one is below what the first failure leaves
        wrong_from[0] = risk
        stepped(law, F, state)
        assert law.verdict(final=True) is False
        state = law.roll_back(1.0)
    wrong_from[0] = 1.0
    return state


@pytest.mark.parametrize("is_first", [True, False])
def test_a_short_window_has_the_audits_of_its_try(is_first):
    """Whatever the windows before it had: all that a run asks for, where it is not the first."""
    law, F, wrong_from = short_windows()
    state = law.respond(F, 0.0 * F).state
    if not is_first:
        law.mark(0.0, state)
        state = stepped(law, F, state)
        assert law.verdict(final=True)
    law.mark(0.5, state)
    state = fail_twice(law, F, wrong_from, state)
    state = stepped(law, F, state)
    assert law.verdict(final=True)
    law.mark(1.0, state)
    tries = [(line["try"], line["audits"]) for line in law.decisions[-3:]]
    assert [number for number, _ in tries] == [1, 2, 3]
    assert tries[1][1] >= audits_of(2)
    assert tries[2][1] >= audits_of(3)


def test_a_window_that_carries_on_audits_carries_on_their_try():
    """It has all its answers audited, which are fewer than the third try asks for."""
    law, F, wrong_from = short_windows()
    law.mark(0.5, None)
    fail_twice(law, F, wrong_from, None)
    few, state = F[:200], None
    for t in (1.0, 2.0):
        state = law.accept(few, 0.0 * few, law.respond(few, 0.0 * few, state)).state
        assert law.verdict(final=True)
        law.mark(t, state)
    first, second = law.decisions[-2:]
    assert 0 < first["audits"] < audits_of(3)
    assert second["audits"] > first["audits"]
    assert (first["try"], second["try"]) == (3, 3)
