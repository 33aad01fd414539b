"""What a run guarantees of its answers, by a sample that has decided nothing."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, hypergeom

from surrofe2.cache import CachedLaw, CacheSettings, closing_audit
from surrofe2.cache.closing_audit import SAMPLE, ClosingAudit
from surrofe2.cache.trust import audits_of, stands, wrong_at_most
from surrofe2.law.regional_law import RegionalLaw
from surrofe2.macro import MacroSettings, simulate
from surrofe2.report.comparison import closing_sentence
from surrofe2.workflow.run import save_run, with_results
from tests.cache.tables import LOAD_CASE, Kept, cached, keeping, resumed, rising
from tests.folders import assert_equal
from tests.laws import Learnt, Memoryless, Surrogate, Truth, shear_error
from tests.macro.bars import assert_same_run

SETTINGS = MacroSettings(frames=2)
BOUND = rising(0.02, 0.4)


class Zero(Memoryless):
    """No stress at all: an answer is wrong by its own size."""

    def stress(self, F, F_dot):
        return 0.0 * F


def audit_of(seed=1, **options):
    surrogate = Surrogate()
    surrogate.local_tolerance = lambda F, F_dot: np.ones(len(F))
    return ClosingAudit(surrogate, Zero(), seed, 0.5, **options)


def offer(audit, step, is_wrong):
    """Answers of a step, one at each point; the wrong ones have a stress."""
    n = len(is_wrong)
    F = np.broadcast_to(np.eye(2), (n, 2, 2))
    stress = np.zeros((n, 2, 2))
    stress[:, 0, 0] = is_wrong
    audit.take(step, np.arange(n), F, np.zeros((n, 2, 2)), stress, np.zeros(n))


def closed(audit):
    while (solved := audit.next_batch()) is not None:
        audit.commit(solved)
    return audit.to_dict()


def sampled(audit):
    """(step, point) of the answers that RVEs solve."""
    pairs = []
    while (solved := audit.next_batch()) is not None:
        audit.commit(solved)
        pairs += zip(solved.asked.step.tolist(), solved.asked.points.tolist(), strict=True)
    return pairs


def test_each_answer_that_stands_is_as_likely_and_what_went_back_is_not_there():
    """Ten steps of 200 answers, of which 4 to 6 were made twice; over many seeds."""
    by_step, at_first = np.zeros(11), 0
    for seed in range(60):
        audit = audit_of(seed)
        none = np.zeros(200)
        for step in (1, 2, 3):
            offer(audit, step, none)
        audit.mark()
        for step in (4, 5, 6):
            offer(audit, step, none + 1.0)
        audit.go_back()
        for step in range(4, 11):
            offer(audit, step, none)
        pairs = sampled(audit)
        assert len(pairs) == len({*pairs}) == SAMPLE
        assert pairs == sorted(pairs, key=lambda pair: pair[0])
        by_step += np.bincount([step for step, _ in pairs], minlength=11)
        at_first += sum(point < 100 for _, point in pairs)
        record = audit.to_dict()
        assert (record["answers"], record["violations"]) == (2000, 0)
    # Hypergeometric: 32 of each step with a variance of 320 · 0.1 · 0.9 · 1,680/1,999 a seed.
    scatter = np.sqrt(60 * 320 * 0.09 * 1680 / 1999)
    assert (abs(by_step[1:] - 60 * 32) < 4.0 * scatter).all()
    assert abs(at_first - 60 * 160) < 4.0 * np.sqrt(60 * 320 * 0.25)


@pytest.mark.parametrize(("wrong", "answers"), [(0, 5000), (40, 5000), (3, 300), (0, 7), (0, 0)])
def test_the_bound_is_that_of_clopper_and_pearson_or_exact_where_all_are_solved(wrong, answers):
    audit = audit_of()
    offer(audit, 1, np.arange(answers) < wrong)
    assert audit.to_dict()["wrong_at_most"] is None
    record = closed(audit)
    found = record["violations"]
    assert record["sampled"] == record["audited"] == min(SAMPLE, answers)
    if not answers:
        assert record["wrong_at_most"] is None
    elif answers <= SAMPLE:
        assert record["wrong_at_most"] == wrong / answers == found / answers
        assert record["confidence"] == 1.0
    else:
        bound = record["wrong_at_most"]
        assert binom.cdf(found, SAMPLE, bound) == pytest.approx(0.05, rel=1e-9)
        assert record["confidence"] == 0.95
        if not wrong:
            assert bound == pytest.approx(1.0 - 0.05 ** (1.0 / SAMPLE), rel=1e-12)
            assert bound < 1.0 - 0.05 ** (1.0 / 313)


def test_a_report_in_between_does_not_end_the_sample():
    audit = audit_of()
    offer(audit, 1, np.ones(400))
    assert closed(audit)["violations"] == SAMPLE
    offer(audit, 2, np.zeros(40_000))
    record = closed(audit)
    assert record["audited"] == SAMPLE
    assert record["violations"] < 20


def test_none_is_wanted_where_nothing_is_audited():
    audit = audit_of(is_wanted=False)
    offer(audit, 1, np.ones(400))
    assert audit.next_batch() is None
    law = cached(shear_error(0.01), BOUND, 0.0)
    run = simulate(LOAD_CASE, law, SETTINGS)
    assert run.cache["closing_audit"]["wrong_at_most"] is None
    assert closing_sentence(run.cache) == ""


@pytest.mark.parametrize("tries", range(1, 8))
def test_tries_of_a_window_share_its_risk(tries):
    risk = 0.05 / 2**tries
    n = audits_of(tries)
    assert binom.cdf(2, n, 0.02) <= risk < binom.cdf(2, n - 8, 0.02)
    for audits in (n, 2 * n, 5 * n):
        most = max(k for k in range(audits) if stands(k, audits, tries))
        assert binom.cdf(most, audits, 0.02) <= risk


# Known faults: which answers (steps, points) of a window are wrong, at its try of a number.

POINTS, STEPS, MOST_TRIES = 100, 40, 12


def by_share(random, window, tries):
    """1 % of the answers, anywhere."""
    return random.random((STEPS, POINTS)) < 0.01


def by_place(random, window, tries):
    """One of 100 points, always."""
    return np.broadcast_to(np.arange(POINTS) == 17, (STEPS, POINTS))


def by_memory(random, window, tries):
    """Found out, it is gone; after a window it is back, with 2 % of the answers."""
    share = 0.02 if window % 2 == 0 and tries == 1 else 0.0
    return random.random((STEPS, POINTS)) < share


def simulated(fault, windows, seed):
    """(truth, bound of the closing audit, bound by the audits that stand) of a run whose windows
    are audited, judged and tried again as those of a cached law, which is off after so many
    failures."""
    random = np.random.default_rng([seed, 2])
    closing = audit_of(seed)
    standing, audited, violations, wrong = 0, 0, 0, 0
    closing.mark()
    for window in range(windows):
        for tries in range(1, MOST_TRIES + 1):
            is_wrong = fault(random, window, tries)
            for step, each in enumerate(is_wrong):
                offer(closing, step, each)
            n = audits_of(tries)
            found = int(random.choice(is_wrong.ravel(), n, replace=False).sum())
            if stands(found, n, tries):
                break
            closing.go_back()
        else:
            break
        closing.mark()
        standing += is_wrong.size
        wrong += int(is_wrong.sum())
        audited += n
        violations += found
    record = closed(closing)
    assert record["answers"] == standing
    if not standing:
        return 0.0, 0.0, 0.0
    return wrong / standing, record["wrong_at_most"], wrong_at_most(violations, audited)


@pytest.mark.slow
@pytest.mark.parametrize("windows", [1, 10])
@pytest.mark.parametrize("fault", [by_share, by_place, by_memory])
def test_the_stated_bound_holds_at_its_confidence(fault, windows, monkeypatch):
    """Of 200 or 60 runs with known faults it is below the truth in 5 % at most, but for noise. The
    audits by which windows stand would state one that is below it in far more."""
    monkeypatch.setattr(closing_audit, "BATCH", SAMPLE)
    runs = 200 if windows == 1 else 60
    truth, bound, of_windows = np.transpose([simulated(fault, windows, k) for k in range(runs)])
    noise = 3.0 * np.sqrt(0.05 * 0.95 / runs)
    assert np.mean(bound < truth) <= 0.05 + noise
    if fault is by_share:
        assert np.mean(of_windows < truth) > 0.08


def faulty():
    """A law that is off by five tolerances at some states, so that windows fail."""
    error = lambda F, F_dot: np.where(abs(F[:, 1, 0]) > 0.02, 0.5, 0.5 * BOUND(F, F_dot))  # noqa: E731
    return cached(error, BOUND, 0.3, kind=Kept)


def test_a_run_samples_what_stands_and_counts_the_time_of_its_closing_audit():
    law, calls = faulty(), []
    run = simulate(LOAD_CASE, law, SETTINGS, closing=lambda *done: calls.append(done))
    assert run.rolled_back["steps"] > 0
    record = run.cache["closing_audit"]
    assert record["answers"] == law.counts["hits"] == run.cache["accepted"]["hits"]
    standing = np.concatenate([F for window in law.standing for F, _, _ in window])
    assert record["answers"] == len(standing)
    assert calls[-1] == (SAMPLE, SAMPLE)
    assert [done for done, _ in calls] == sorted({done for done, _ in calls})
    assert record["wrong_at_most"] < 0.03


def test_regions_have_a_bound_each():
    points = {"sound": np.arange(0, 30), "wrong": np.arange(30, 60)}
    laws = {"sound": cached(shear_error(0.01), BOUND, 0.3), "wrong": faulty()}
    calls = []
    law = RegionalLaw(laws, points)
    run = simulate(LOAD_CASE, law, SETTINGS, closing=lambda *done: calls.append(done))
    assert calls[-1] == (2 * SAMPLE, 2 * SAMPLE)
    for name, part in run.cache["cells"].items():
        record = part["closing_audit"]
        assert record["audited"] == SAMPLE
        assert record["answers"] == laws[name].counts["hits"]
        assert closing_sentence(part)


@pytest.mark.parametrize("make", [faulty, lambda: cached(shear_error(0.01), BOUND, 0.05)])
def test_an_interruption_within_the_closing_audit_resumes_to_the_bit(make):
    law, kept = make(), []
    whole = simulate(LOAD_CASE, law, SETTINGS)

    def stop(done, of):
        raise KeyboardInterrupt

    begun = make()
    with pytest.raises(KeyboardInterrupt):
        simulate(LOAD_CASE, begun, SETTINGS, closing=stop, checkpoint=keeping(begun, kept),
                 checkpoint_interval=1e9)  # fmt: skip
    asked = []
    again = make()
    again.on_true_answer = lambda *answer: asked.extend(answer[0])
    run = resumed(LOAD_CASE, again, SETTINGS, kept[-1])
    assert_same_run(run, whole)
    assert_equal(run.cache, whole.cache, exact=True)
    assert run.decisions == whole.decisions
    assert len(asked) == SAMPLE - closing_audit.BATCH


def test_each_run_by_one_law_has_the_record_of_its_own(tmp_path):
    law = cached(shear_error(0.01), BOUND, 0.05)
    first = simulate(LOAD_CASE, law, SETTINGS)
    second = simulate(replace(LOAD_CASE, duration=6.0), law, SETTINGS)
    alone = simulate(LOAD_CASE, cached(shear_error(0.01), BOUND, 0.05), SETTINGS)
    assert_equal(first.cache, alone.cache, exact=True)
    assert second.cache["accepted"]["steps"] == second.counts["steps"] + 1
    assert second.cache["audit"]["audited"] < first.cache["audit"]["audited"]
    record = save_run(first, tmp_path / "first")
    assert_equal(dict(record.cache), first.cache, exact=False)
    assert first.cache["since"] == second.cache["since"] == 0.0
    assert "since" not in closing_sentence(record.cache)
    assert record.counts["audits"] == alone.cache["audit"]["audited"] + SAMPLE
    assert with_results(record, second).cache == second.cache


def test_a_second_run_by_a_law_keeps_what_the_first_one_showed_of_its_surrogate():
    law = faulty()
    first = simulate(LOAD_CASE, law, SETTINGS)
    known = first.cache["trust"]
    assert known["events"]
    second = simulate(LOAD_CASE, law, SETTINGS)
    for name in ("factor", "reach", "off"):
        assert second.cache["trust"][name] == known[name]
    event = second.cache["trust"]["events"][0]
    assert "an earlier run by this law found wrong answers" in event["finding"]
    assert not second.rolled_back
    law.reset_counts()
    third = simulate(LOAD_CASE, law, SETTINGS)
    assert third.cache["trust"] == first.cache["trust"]


def test_a_state_in_memory_resumes_by_a_law_that_never_knew_its_window():
    """As `checkpoint` gave it, without its way through arrays: another law, and the same one."""
    for again in (False, True):
        law, states = faulty(), []
        simulate(LOAD_CASE, law, SETTINGS, checkpoint=states.append, checkpoint_interval=0.0)
        state = next(each for each in states if each.t > 1.0)
        run = simulate(LOAD_CASE, law if again else faulty(), SETTINGS, resume=state)
        assert run.finished
        assert run.cache["accepted"]["steps"] == run.counts["steps"] - state.counts["steps"]


class Hidden(Learnt):
    """Wrong by five tolerances at a `share` of its answers, at random places, where its risk is a
    certain one, and else small."""

    def __init__(self, seed):
        self.random, self.share, self.risk = np.random.default_rng(seed), HIDDEN, 0.4
        error = lambda F, F_dot: np.where(self.is_wrong, 0.5, 0.0)  # noqa: E731
        bound = lambda F, F_dot: 0.1 * np.where(self.is_wrong, self.risk, 1e-4)  # noqa: E731
        super().__init__(error, bound)

    def lookup(self, F, F_dot, limit=np.inf):
        self.is_wrong = self.random.random(len(F)) < self.share
        return super().lookup(F, F_dot, limit)


class FoundOut(Kept):
    """A law whose fault, once it has been found out, is gone until the next window begins, where it
    is back at a risk that is trusted."""

    def mark(self, t, state):
        super().mark(t, state)
        self.surrogate.share = HIDDEN

    def roll_back(self, t):
        self.surrogate.share = 0.0
        self.surrogate.risk = 0.4 / self.history()["trust"]["factor"]
        return super().roll_back(t)


HIDDEN = 0.01
EVEN_STEPS = MacroSettings(frames=2, absolute_tolerance=1e3, largest_step=0.05)
"""Their errors are as random as the answers and would be called errors of time integration."""


@pytest.mark.slow
def test_the_sample_of_real_runs_is_one_of_what_stands():
    """Windows with many wrong answers go back, so what stands has fewer of them than what was
    answered. Each answer of a sample stands, and over all runs as many are wrong as of a random
    sample of what stands, by the hypergeometric distribution; bounds hold but for 5 % and noise.
    A sample that keeps an answer which went back, or prefers some that stand, is seen here.
    """
    runs, expected, variance, wrong_in_sample, below = 12, 0.0, 0.0, 0, 0
    for seed in range(runs):
        settings = CacheSettings(tolerance=0.01, audit=0.3, seed=seed)
        law, sample = FoundOut(Hidden(seed), Truth(), settings), []
        law.on_true_answer = lambda F, F_dot, stress, status, why, sample=sample: sample.extend(F)
        run = simulate(replace(LOAD_CASE, duration=5.0), law, EVEN_STEPS)
        record = run.cache["closing_audit"]
        steps = [step for window in law.standing for step in window]
        F, F_dot, stress = (np.concatenate(part) for part in zip(*steps, strict=True))
        is_wrong = np.linalg.norm(stress - Truth().stress(F, F_dot), axis=(1, 2)) > 0.1
        standing = {each.tobytes() for each in F}
        assert record["answers"] == len(F) > 2 * SAMPLE
        assert all(each.tobytes() in standing for each in sample[-SAMPLE:])
        drawn = hypergeom(len(F), int(is_wrong.sum()), SAMPLE)
        expected += drawn.mean()
        variance += drawn.var()
        wrong_in_sample += record["violations"]
        below += bool(record["wrong_at_most"] < is_wrong.mean())
    assert expected > 10.0
    assert abs(wrong_in_sample - expected) < 3.5 * np.sqrt(variance)
    assert below <= binom.ppf(0.999, runs, 0.05)


def test_a_law_that_is_asked_by_hand_has_a_closing_audit_too():
    law = CachedLaw(Learnt(shear_error(0.01), BOUND), Truth(), CacheSettings(tolerance=0.01))
    F = np.tile(np.eye(2), (50, 1, 1))
    for _ in range(20):
        law.accept(F, 0.0 * F, law.respond(F, 0.0 * F))
    record = law.report()["closing_audit"]
    assert (record["answers"], record["audited"], record["violations"]) == (1000, SAMPLE, 0)
