"""Each safeguard sees its planted fault, and only that."""

import json
from contextlib import nullcontext
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.stats import binom

from surrofe2.base.errors import MismatchError
from surrofe2.base.sampling import SamplingRange
from surrofe2.cache import CachedLaw, CacheSettings, sampled_spread
from surrofe2.cache.branches import look_up
from surrofe2.cache.trust import (
    AUDITS,
    CONFIDENCE,
    VIOLATIONS,
    WRONG,
    Trust,
    Window,
    stands,
    wrong_at_most,
)
from surrofe2.law.stress_law import Status
from surrofe2.macro import MacroSettings, simulate
from tests.cache.tables import LOAD_CASE, cached, observed, rising
from tests.laws import Learnt, PointStates, Remembering, Truth, shear_error

LOAD_CASE = replace(LOAD_CASE, duration=6.0)
SETTINGS = MacroSettings(frames=5)
BOUND = rising(0.02, 0.4)
SMALL = shear_error(0.01)
LIE = lambda F, F_dot: 3.0 + 0.0 * F[:, 0, 0]  # noqa: E731


def run(error=SMALL, bound=BOUND, audit=0.05):
    """A bar on a cache with tolerance 0.1 µN/µm; the cache and what it reports."""
    law = cached(error, bound, audit)
    done = simulate(LOAD_CASE, law, SETTINGS)
    return law, law.report(), done


def test_a_sound_cache_is_left_alone(caplog):
    law, report, _ = run()
    assert report["trust"] == {"factor": 1.0, "reach": [], "off": False, "events": []}
    assert not caplog.records
    assert report["audit"]["audited"] > 50
    assert law.counts["fallbacks"] == 0


def test_a_biased_surrogate_is_tightened_until_it_keeps_its_word(caplog):
    """Errors three times the bound: the bound comes to count as often, and then holds."""
    biased = lambda F, F_dot: 3.0 * BOUND(F, F_dot)  # noqa: E731
    law, report, _ = run(error=biased, audit=0.2)
    trust = report["trust"]
    assert not trust["off"]
    assert trust["factor"] == pytest.approx(3.3, rel=0.01)
    assert [event["action"] for event in trust["events"]] == ["tightened"]
    assert "off by more than the tolerance;" in caplog.text
    assert law.counts["fallbacks_not_trusted"] > 0
    assert law.counts["hits"] > 0
    # From the window that failed on nothing is accepted that is off by more than the tolerance.
    F = np.eye(2) + np.linspace(0.0, 0.3, 50)[:, None, None] * [[0.0, 0.0], [1.0, 0.0]]
    answer = law.respond(F, 0.0 * F)
    error = np.linalg.norm(answer.stress - Truth().stress(F, 0.0 * F), axis=(1, 2))
    assert error.max() <= 0.1
    assert 0 < answer.effort["hits"] < 50


def test_a_surrogate_that_lies_grossly_is_switched_off_and_the_run_is_the_true_one(caplog):
    law, report, done = run(LIE, rising(5e-4, 0.4))
    assert law.history()["trust"]["off"]
    assert report["trust"]["events"][-1]["action"] == "off"
    assert "the cache is off from here on" in caplog.text
    last = report["trust"]["events"][-1]["step"]
    assert last < 0.2 * done.counts["steps"]
    looked_up = law.surrogate.looked_up
    law.respond(np.eye(2)[None], np.zeros((1, 2, 2)))
    assert law.surrogate.looked_up == looked_up
    # The steps were made again; only at rest, before the first, was it asked.
    assert done.rolled_back["steps"] == last - 1
    assert law.counts["hits"] == 60
    assert law.counts["fallbacks"] == 60 * done.counts["steps"]


@pytest.mark.parametrize(("times", "is_refused"), [(1.0, False), (3.0, True), (1e6, True)])
def test_a_scale_of_stress_that_is_not_the_rves_is_refused(times, is_refused):
    """Tolerances are shares of it, so no audit by the file's own scale would find the fault."""
    learnt = Learnt(SMALL, BOUND)
    learnt.range = SamplingRange(stretch=(0.95, 1.05), shear=0.05, rate=0.01)
    learnt.stress_spread = times * sampled_spread(Truth(), learnt.range)
    with pytest.raises(MismatchError, match="spread of stress") if is_refused else nullcontext():
        CachedLaw(learnt, Truth(), CacheSettings())


def test_audits_say_so_where_the_tolerance_is_larger_than_the_stress():
    learnt = Learnt(SMALL, BOUND)
    learnt.stress_spread = 1e6
    law = CachedLaw(learnt, Truth(), CacheSettings(audit=0.05))
    simulate(LOAD_CASE, law, SETTINGS)
    (event,) = law.report()["trust"]["events"]
    assert event["finding"].startswith("audits say little")
    assert law.history()["trust"]["events"] == [event]


def test_the_plan_is_the_smallest_that_keeps_both_risks():
    """0.1 % of wrong answers stands with 99 % at least, 2 % at the first try with 2.5 % at most."""

    def keeps(n, c):
        risk = 0.5 * (1.0 - CONFIDENCE)
        return binom.cdf(c, n, 0.001) >= 0.99 and binom.cdf(c, n, WRONG) <= risk

    n, c = next((n, c) for n in range(1, 1000) for c in range(10) if keeps(n, c))
    assert (n, c) == (359, VIOLATIONS)
    assert n <= AUDITS
    assert keeps(AUDITS, VIOLATIONS)
    # More violations stand only among so many more audits that the bound is kept.
    for n in (AUDITS, 500, 1000, 5000):
        most = max(k for k in range(n) if stands(k, n))
        risk = 0.5 * (1.0 - CONFIDENCE)
        assert binom.cdf(most, n, WRONG) <= risk
        assert binom.cdf(most + 1, n, WRONG) > risk or most == VIOLATIONS


@pytest.mark.parametrize(
    ("wrong", "stand"),
    [(0.001, 0.9941), (0.005, 0.7307), (0.01, 0.3013), (0.02, 0.0245), (0.05, 1.9e-6)],
)
def test_operating_curve(wrong, stand):
    """The probability that a window stands, as docs/explanation/cache.md has it; and met."""
    assert binom.cdf(VIOLATIONS, AUDITS, wrong) == pytest.approx(stand, rel=0.02)
    audits = np.random.default_rng(1).random((4000, AUDITS)) < wrong
    met = np.mean([stands(int(k), AUDITS) for k in audits.sum(axis=1)])
    assert met == pytest.approx(stand, abs=3.5 * np.sqrt(stand * (1.0 - stand) / 4000))


@pytest.mark.parametrize(("violations", "audits"), [(0, 320), (2, 320), (7, 1000)])
def test_upper_bound_on_the_wrong_share(violations, audits):
    share = wrong_at_most(violations, audits)
    assert binom.cdf(violations, audits, share) == pytest.approx(0.05, rel=1e-9)
    assert wrong_at_most(audits, audits) == 1.0


def window(risk=0.5, violations=3, audits=100, learnt=0):
    """One with errors twice the tolerance of 0.1 µN/µm, of which so many were learnt."""
    error = np.where(np.arange(audits) < violations, 0.2, 0.01)
    is_learnt = np.arange(audits) < learnt
    return window_of(error > 0.1, error, np.full(audits, risk), np.zeros((audits, 7)), is_learnt)


def window_of(is_wrong, error, risk, x, is_learnt=None):
    """One with these audits, of which the surrogate has learnt nothing unless said otherwise."""
    points = np.arange(len(is_wrong))
    if is_learnt is None:
        is_learnt = np.zeros(len(is_wrong), dtype=bool)
    rows = np.column_stack([points, is_wrong, error, is_learnt, risk, x])
    return Window(0.0, 0, 1.0, audits=rows.tolist())


def test_the_factor_is_raised_just_enough_and_never_falls_below_that():
    trust = Trust()
    failed = window(risk=0.4)
    assert not failed.stands
    trust.fail(1, failed)
    assert trust.factor == pytest.approx(2.75)  # 1.1/0.4
    assert trust.limit < 0.4
    assert trust.more_audits > 1.0
    trust.stand()
    assert trust.more_audits == 1.0
    for _ in range(20):
        trust.stand()
        assert trust.factor == pytest.approx(2.75)
    assert not trust.is_off


def test_a_factor_that_was_raised_farther_than_asked_comes_back_to_what_was_asked():
    """Asked for are 1.1/0.9 and then 1.1/0.6, less than twice the factor, the least raise."""
    trust, factors = Trust(), []
    trust.fail(1, window(risk=0.9))
    for _ in range(3):
        factors.append(trust.factor)
        trust.stand()
    trust.fail(2, window(risk=0.6))
    for _ in range(8):
        factors.append(trust.factor)
        trust.stand()
    asked, again = 1.1 / 0.9, 1.1 / 0.6
    later = [2.0 * asked] * 3 + [again] * 5
    assert factors == pytest.approx([2.0, 2.0, asked, *later])


@pytest.mark.parametrize("learnt", [3, 2])
def test_a_surrogate_that_learnt_what_it_was_wrong_about_gets_its_trust_back(learnt):
    """Of three wrong answers; one that was not learnt is not forgiven."""
    trust, failed = Trust(), window(risk=0.4, learnt=learnt)
    trust.fail(1, failed)
    factors = []
    for _ in range(6):
        trust.stand()
        factors.append(trust.factor)
    expected = [2.75, 1.375, 1.375, 1.0, 1.0, 1.0] if learnt == 3 else [2.75] * 6
    assert factors == pytest.approx(expected)


class Branching(Remembering):
    """The truth, with one branch of several where F₂₁ is above `several`, and no stress where it is
    above `unsolved`."""

    stress = Truth().stress

    def __init__(self, several=np.inf, unsolved=np.inf):
        super().__init__(initialisation="elastic")
        self.several, self.unsolved = several, unsolved

    def fails(self, F, F_dot):
        return F[:, 1, 0] > self.unsolved

    def respond(self, F, F_dot, state=None, *, tangents=False):
        answer = super().respond(F, F_dot, state, tangents=tangents)
        return replace(answer, state=Several(F.copy(), several=self.several))


@dataclass(frozen=True)
class Several(PointStates):
    """A state that lies on one of several branches where F₂₁ is above `several`."""

    several: float = np.inf

    @property
    def left_points(self):
        return self.F[:, 1, 0] > self.several


@pytest.mark.parametrize(
    ("truth", "is_forgiven"),
    [(Branching(), True), (Branching(several=0.05), False), (Branching(unsolved=0.05), False)],
)
@pytest.mark.parametrize("is_marked", [False, True])
def test_only_what_a_table_has_learnt_is_forgiven(truth, is_forgiven, is_marked):
    """Wrong answers where the RVE is on one of several branches, or has no stress, are not learnt:
    what they asked for holds for the rest of the run."""
    error = lambda F, F_dot: np.where(F[:, 1, 0] > 0.05, 0.2, 0.01)  # noqa: E731
    bound = lambda F, F_dot: np.where(F[:, 1, 0] > 0.05, 0.04, 0.001)  # noqa: E731
    surrogate = Learnt(error, bound)
    law, _, learnt = observed(truth, surrogate, tolerance=0.01, audit=1.0)
    if is_marked:
        law.mark(0.0, None)
    F = np.tile(np.eye(2), (20, 1, 1))
    F[:4, 1, 0] = 0.08
    while not law.history()["trust"]["events"]:
        accepted = law.accept(F, 0.0 * F, law.respond(F, 0.0 * F))
        if is_marked:
            law.verdict()
    values = law.state_to_arrays(accepted.state)["values"]
    least = json.loads(values.tobytes())["trust"]["least_factor"]
    assert least == pytest.approx(1.0 if is_forgiven else 2.75)  # 1.1/0.4
    assert bool(learnt) == is_forgiven


def test_a_fault_that_comes_again_makes_trust_return_more_slowly():
    trust, waited = Trust(), []
    for _ in range(3):
        trust.fail(1, window(learnt=3))
        waited.append(0)
        raised = trust.factor
        while trust.factor == raised:
            trust.stand()
            waited[-1] += 1
    assert waited == [2, 3, 4]


def test_a_narrowed_reach_is_never_widened():
    """By audits of answers from before it was narrowed, which lie farther out, neither."""
    trust, reached = Trust(), []
    for least in (0.3, 0.6, 0.2):
        x = np.zeros((100, 7))
        x[:, 3] = np.linspace(0.0, 1.0, 100)
        is_wrong = x[:, 3] > least
        trust.fail(1, window_of(is_wrong, np.where(is_wrong, 0.2, 0.01), np.full(100, 1e-4), x))
        reached.append(trust.reach[3])
    assert [event["action"] for event in trust.events] == ["narrowed"] * 3
    assert reached[0] == reached[1] == pytest.approx(0.3 / 1.1, rel=0.02)
    assert reached[2] == pytest.approx(0.2 / 1.1, rel=0.03)


def test_a_fault_that_no_risk_tells_narrows_one_input():
    """Beyond a difference of U the answers are wrong, and the risk is small all over."""
    random = np.random.default_rng(2)
    x, risk = random.uniform(-1.0, 1.0, (400, 7)), random.uniform(1e-4, 1e-3, 400)
    is_wrong = np.abs(x[:, 1]) > 0.6
    trust = Trust()
    trust.fail(1, window_of(is_wrong, np.where(is_wrong, 0.2, 0.01), risk, np.abs(x)))
    assert (trust.factor, trust.is_off) == (1.0, False)
    assert np.isfinite(trust.reach).tolist() == [False, True, *[False] * 5]
    assert 0.5 < trust.reach[1] < 0.6
    assert trust.events[0]["action"] == "narrowed"
    assert "with a difference of U − I of more than 0.5" in trust.events[0]["finding"]
    none = lambda F, F_dot: 0.0 * F[:, 0, 0]  # noqa: E731
    F = np.stack([np.diag([1.0 + d, 1.0]) for d in (0.1, 0.5, 0.7)])
    stress, status, risk = look_up(Learnt(none, none), F, 0.0 * F, 1.0, np.array(trust.reach))
    assert status.tolist() == [0, 0, Status.NOT_TRUSTED]
    assert np.isinf(risk).tolist() == np.isnan(stress[:, 0, 0]).tolist() == [False, False, True]


@pytest.mark.parametrize("risk", [0.0, 0.01, np.inf])
def test_a_risk_that_knows_nothing_of_the_error_switches_off(risk):
    trust = Trust()
    trust.fail(1, window(risk))
    assert trust.is_off
    assert trust.limit < 0.0


def test_windows_that_fail_again_and_again_switch_off():
    trust, steps = Trust(), 0
    while not trust.is_off:
        trust.fail(steps, window(risk=0.9 / trust.factor))
        steps += 1
    assert steps <= 7
    assert [event["action"] for event in trust.events] == ["tightened"] * (steps - 1) + ["off"]


def test_a_law_that_nobody_marks_is_more_cautious_after_a_window_that_failed():
    """As a caller without roll-back uses it."""
    law = cached(lambda F, F_dot: 3.0 * BOUND(F, F_dot), BOUND, 0.5)
    F = np.tile(np.eye(2), (60, 1, 1))
    F[:, 1, 0] = np.linspace(0.0, 0.12, 60)
    hits = []
    for _ in range(20):
        answer = law.respond(F, 0.0 * F)
        hits.append(answer.effort["hits"])
        law.accept(F, 0.0 * F, answer)
    trust = law.history()["trust"]
    assert trust["events"]
    assert not trust["off"]
    assert min(hits) < 0.5 * hits[0]
    assert not law.decisions


def test_a_surrogate_of_nan_leaves_all_to_the_fallback():
    def lookup(F, F_dot, limit):
        return np.full_like(F, np.nan), np.full(len(F), 4, dtype=np.int8), np.full(len(F), np.inf)

    law = cached(None, None)
    law.surrogate.lookup = lookup
    done = simulate(LOAD_CASE, law, SETTINGS)
    true = simulate(LOAD_CASE, Truth(), SETTINGS)
    np.testing.assert_allclose(done.curve.displacement, true.curve.displacement, rtol=1e-9)
    assert law.counts["hits"] == 0
