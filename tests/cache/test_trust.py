"""Each safeguard sees its planted fault, and only that."""

import logging

import numpy as np
import pytest

from surrofe2.cache import CachedLaw, CacheSettings
from surrofe2.cache.branches import CachedState
from surrofe2.cache.trust import NOMINAL, Trust, chance
from surrofe2.load_case import LoadCase
from surrofe2.macro import MacroSettings, simulate
from tests.laws import Learnt, Truth, shear_error

LOAD_CASE = LoadCase(
    width=60.0, height=40.0, watched=(60.0, 20.0), duration=6.0, output_interval=0.5
)
SETTINGS = MacroSettings(elements=(4, 3), frames=5)


def sound_bound(F, F_dot):
    return 0.02 + 0.4 * abs(F[:, 1, 0])


SMALL = shear_error(0.01)


def run(error=SMALL, bound=sound_bound, audit=0.05, **more):
    """A bar on a cache with tolerance 0.1 µN/µm; the cache and what it reports."""
    cached = CachedLaw(
        Learnt(error, bound, **more), Truth(), CacheSettings(tolerance=0.01, audit=audit)
    )
    done = simulate(LOAD_CASE, cached, SETTINGS)
    return cached, cached.report(), done


def test_a_sound_cache_is_left_alone(caplog):
    with caplog.at_level(logging.WARNING, logger="surrofe2.cache"):
        cached, report, _ = run()
    assert report["trust"] == {"factor": 1.0, "off": False, "events": []}
    assert not caplog.records
    assert report["audit"]["audited"] > 50
    assert cached.counts["fallbacks"] == 0


def test_a_biased_surrogate_is_tightened_until_it_keeps_its_word(caplog):
    """Errors three times the bound: the bound comes to count as often, and then holds."""
    biased = lambda F, F_dot: 3.0 * sound_bound(F, F_dot)  # noqa: E731
    with caplog.at_level(logging.WARNING, logger="surrofe2.cache"):
        cached, report, _ = run(error=biased, audit=0.2)
    trust = report["trust"]
    assert not trust["off"]
    assert trust["factor"] == pytest.approx(3.3, rel=0.01)
    assert [event["action"] for event in trust["events"]] == ["tightened"]
    assert "off by more than the tolerance of 0.1 µN/µm" in caplog.text
    assert cached.counts["fallbacks_not_trusted"] > 0
    assert cached.counts["hits"] > 0
    # From the step of the alarm on nothing is accepted that is off by more than the tolerance.
    F = np.eye(2) + np.linspace(0.0, 0.3, 50)[:, None, None] * [[0.0, 0.0], [1.0, 0.0]]
    answer = cached.respond(F, 0.0 * F)
    error = np.linalg.norm(answer.stress - Truth().stress(F, 0.0 * F), axis=(1, 2))
    assert error.max() <= 0.1
    assert 0 < answer.effort["hits"] < 50


def test_a_surrogate_that_lies_grossly_is_switched_off_and_the_run_is_the_true_one(caplog):
    with caplog.at_level(logging.WARNING, logger="surrofe2.cache"):
        cached, report, done = run(error=lambda F, F_dot: 3.0 + 0.0 * F[:, 0, 0])
    assert cached.history()["trust"]["off"]
    assert report["trust"]["events"][-1]["action"] == "off"
    assert "the cache is off from here on" in caplog.text
    last = report["trust"]["events"][-1]["step"]
    assert last < 0.2 * done.counts["steps"]
    looked_up = cached.surrogate.looked_up
    cached.respond(np.eye(2)[None], np.zeros((1, 2, 2)))
    assert cached.surrogate.looked_up == looked_up
    # The steps up to the alarm were made again; only at rest, before the first, was it asked.
    assert done.counts["rolled_back_steps"] == last - 1
    assert cached.counts["hits"] == 60
    assert cached.counts["fallbacks"] == 60 * done.counts["steps"]


def test_without_any_audit_nobody_notices():
    """The fault above is found by audits alone: this is what they are for."""
    cached, report, _ = run(error=lambda F, F_dot: 3.0 + 0.0 * F[:, 0, 0], audit=0.0)
    assert not report["trust"]["events"]
    assert cached.counts["fallbacks"] == 0


def test_a_fault_that_begins_late_is_found():
    trust = Trust(0.1)
    good, bound = np.full(100, 0.05), np.full(100, 0.08)
    for step in range(50):
        trust.judge(step, good > 0.1, good, bound)
    bad = np.where(np.arange(100) % 5, 0.05, 0.5)
    trust.judge(50, bad > 0.1, bad, bound)
    assert trust.factor > 5.0


def test_few_violations_among_few_audits_are_no_alarm():
    trust = Trust(0.1)
    error = np.full(16, 0.05)
    error[:2] = 0.11
    trust.judge(1, error > 0.1, error, np.full(16, 0.09))
    assert not trust.events
    assert chance(2, 16) > 0.01
    assert chance(0, 16) == 1.0
    # 1 − (1 − p)³ for at least one of three.
    assert chance(1, 3) == pytest.approx(1.0 - (1.0 - NOMINAL) ** 3)


def test_the_nominal_rate_alarms_in_few_runs():
    random = np.random.default_rng(3)
    alarms = 0
    for _ in range(200):
        trust = Trust(0.1)
        for step in range(60):
            error = np.where(random.random(16) < NOMINAL, 0.11, 0.05)
            trust.judge(step, error > 0.1, error, np.full(16, 0.09))
        alarms += bool(trust.events)
    assert alarms <= 4


def test_a_surrogate_shifted_out_of_its_range_is_silent_and_switched_off(caplog):
    with caplog.at_level(logging.WARNING, logger="surrofe2.cache"):
        _, report, _ = run(outside=lambda F: F[:, 0, 0] < 1.5)
    (event,) = report["trust"]["events"]
    assert event["action"] == "off"
    assert "no hit in 20 steps (1200 points, most of them out of range)" in event["finding"]
    assert event["finding"] in caplog.text


def test_a_surrogate_of_nan_is_silent_and_switched_off():
    def lookup(F, F_dot, tolerance):
        return np.full_like(F, np.nan), np.full(len(F), 4, dtype=np.int8), np.full(len(F), np.inf)

    cached = CachedLaw(Learnt(None, None), Truth(), CacheSettings(tolerance=0.01))
    cached.surrogate.lookup = lookup
    done = simulate(LOAD_CASE, cached, SETTINGS)
    assert "most of them not finite" in cached.report()["trust"]["events"][0]["finding"]
    true = simulate(LOAD_CASE, Truth(), SETTINGS)
    np.testing.assert_allclose(done.curve.displacement, true.curve.displacement, rtol=1e-9)


def test_a_learner_that_begins_empty_is_given_time():
    surrogate = Learnt(shear_error(0.0), sound_bound, outside=lambda F: np.ones(len(F), dtype=bool))
    surrogate.learns = True
    cached = CachedLaw(surrogate, Truth(), CacheSettings(tolerance=0.01))
    simulate(LOAD_CASE, cached, SETTINGS)
    assert cached.counts["hits"] == 0
    assert not cached.report()["trust"]["events"]


def test_one_answer_everywhere_is_a_collapse():
    """A dead network: the stress at rest at every point, and a bound that suspects nothing."""

    class Dead(Learnt):
        def lookup(self, F, F_dot, tolerance=np.inf):
            stress, status, bound = super().lookup(F, F_dot, tolerance)
            return np.zeros_like(stress), status, bound

    cached = CachedLaw(
        Dead(shear_error(0.0), sound_bound), Truth(), CacheSettings(tolerance=0.01, audit=0.0)
    )
    simulate(LOAD_CASE, cached, SETTINGS)
    assert cached.history()["trust"]["off"]
    assert "one answer at" in cached.report()["trust"]["events"][0]["finding"]


def test_a_bound_that_never_moves_is_a_collapse():
    cached, report, _ = run(bound=lambda F, F_dot: np.full(len(F), 0.05), audit=0.0)
    assert cached.history()["trust"]["off"]
    assert "bound stands still at 0.05 µN/µm" in report["trust"]["events"][0]["finding"]


def test_a_bound_that_is_the_tolerance_itself_may_stand():
    cached, report, _ = run(bound=lambda F, F_dot: np.full(len(F), 0.1), audit=0.0)
    assert not cached.history()["trust"]["off"]
    assert not report["trust"]["events"]


def test_a_surrogate_of_other_parameters_with_a_forged_label_is_caught():
    """Learnt of a solid that is 5 % stiffer; labels agree, the audit does not."""

    class Stiffer(Learnt):
        def lookup(self, F, F_dot, tolerance=np.inf):
            _, status, bound = super().lookup(F, F_dot, tolerance)
            return Truth(shear_modulus=63.0, lame=84.0).stress(F, F_dot), status, bound

    cached = CachedLaw(
        Stiffer(shear_error(0.0), sound_bound), Truth(), CacheSettings(tolerance=0.001, audit=0.2)
    )
    cached.surrogate.bound = lambda F, F_dot: 1e-3 + 1e-3 * abs(F[:, 1, 0])
    run = simulate(LOAD_CASE, cached, SETTINGS)
    event = cached.report()["trust"]["events"][0]
    assert event["action"] in ("tightened", "off")
    assert event["step"] < 0.25 * run.counts["steps"]
    # All but what hardly deforms is answered by the true law from there on.
    counts = cached.counts
    points = (counts["hits"] + counts["fallbacks"]) // counts["steps"]
    assert counts["hits"] - points * event["step"] < 0.1 * counts["fallbacks"]


def test_a_surrogate_without_a_bound_says_so(caplog):
    surrogate = Learnt(shear_error(0.0), lambda F, F_dot: np.full(len(F), np.inf))
    surrogate.has_bound = False
    with caplog.at_level(logging.WARNING, logger="surrofe2.cache"):
        cached = CachedLaw(surrogate, Truth())
    assert cached.history()["tolerance"]["absolute"] == np.inf
    assert "knows no bound" in caplog.text


def test_history_goes_on_where_it_was_left():
    cached, report, _ = run(error=lambda F, F_dot: 3.0 + 0.0 * F[:, 0, 0])
    again = CachedLaw(Learnt(shear_error(0.0), sound_bound), Truth(), cached.settings)
    again.from_arrays(cached.to_arrays(CachedState(1)))
    assert again.history()["trust"]["off"]
    assert again.counts == cached.counts
    assert again.report()["audit"] == report["audit"]
    assert again.report()["trust"] == report["trust"]


def test_a_cache_that_answered_nothing_does_not_claim_to_pay(monkeypatch):
    """Whatever a timing of the true law would say: the run itself has timed it."""

    def dear(meter, *where):
        meter.true = 1e6

    monkeypatch.setattr("surrofe2.cache.cost.Meter.sample", dear)
    assert run()[1]["cost"]["pays"]
    cached, report, _ = run(outside=lambda F: np.ones(len(F), dtype=bool))
    assert cached.counts["hits"] == 0
    assert not report["cost"]["pays"]
    assert report["cost"]["true"] <= report["cost"]["cached"]
