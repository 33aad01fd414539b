"""What the cache does wrong is measured, and what it learns from."""

import json

import numpy as np
import pytest

from surrofe2.base.simd import TILE
from surrofe2.base.tensors import stress_error
from surrofe2.cache.audit import BATCH, Audit
from surrofe2.cache.trust import AUDITS
from surrofe2.law.stress_law import Status
from tests.cache.tables import observed
from tests.laws import Learnt, Remembering, Surrogate, TrueLaw, Truth, failing, stretched

SIZE = 0.05


def law(audit, error=lambda F, F_dot: SIZE * np.ones(len(F)), truth=None):
    """With what it hands to be kept and to be learnt."""
    surrogate = Learnt(error, bound=lambda F, F_dot: 0.07 + 0.01 * F[:, 0, 1])
    return observed(truth or Truth(), surrogate, tolerance=0.01, audit=audit, seed=5)


def walk(cached, steps, points=40, seed=0, start=0.0):
    """Accepted steps of points that shear along; the (F, Ḟ) of each."""
    random = np.random.default_rng(seed)
    slope = random.uniform(-1.0, 1.0, points)
    state, asked = None, []
    for k in range(steps):
        F = np.eye(2) * np.ones((points, 1, 1))
        F[:, 0, 1] = start + 0.002 * k * slope
        F_dot = np.zeros_like(F)
        accepted = cached.accept(F, F_dot, cached.respond(F, F_dot, state))
        assert not accepted.status.any()
        state = accepted.state
        asked.append((F, F_dot))
    return asked


def test_all_are_audited_and_every_error_is_found():
    cached, *_ = law(audit=1.0, error=lambda F, F_dot: SIZE * abs(F[:, 0, 1]))
    asked = walk(cached, 10)
    audit = cached.report()["audit"]
    assert audit["audited"] == 400
    assert audit["violations"] == audit["unsolved"] == 0
    errors = SIZE * abs(np.concatenate([F for F, _ in asked])[:, 0, 1])
    assert audit["largest"] == pytest.approx(errors.max(), rel=1e-6)
    assert audit["rms"] == pytest.approx(np.sqrt(np.mean(errors**2)), rel=1e-6)
    for share in (0.5, 0.9, 0.99):
        exact = np.quantile(errors, share, method="inverted_cdf")
        assert exact * (1 - 1e-6) <= audit["quantiles"][f"{share:g}"] <= 1.05 * exact
    worst = audit["worst"]
    assert stress_error(np.array([worst["stress"]]), np.array([worst["true_stress"]]))[
        0
    ] == pytest.approx(worst["error"])
    assert abs(worst["F"][0][1]) == pytest.approx(abs(asked[-1][0][:, 0, 1]).max())
    assert (worst["step"], worst["risk"]) == (10, pytest.approx(0.7 + 0.1 * worst["F"][0][1]))
    json.dumps(cached.report(), allow_nan=False)


class Warm(Remembering):
    """The truth, which notes what it was given to start from."""

    stress = Truth().stress

    def __init__(self):
        super().__init__(initialisation="elastic")


def test_audits_wait_for_each_other_and_none_is_forgotten():
    truth = Warm()
    cached, *_ = law(audit=0.05, truth=truth)
    walk(cached, 30)

    def sizes():
        return [len(F) for F, _ in truth.asked]

    assert min(sizes()) >= BATCH
    assert not any(size % TILE for size in sizes())
    before = sum(sizes())
    report = cached.report()
    audited, closing = (report[name]["audited"] for name in ("audit", "closing_audit"))
    assert audited + closing == sum(sizes()) > before


@pytest.mark.parametrize(("points", "batch"), [(40, BATCH), (8192, 32), (10**5, 64)])
def test_more_audits_of_a_large_tissue_wait_for_each_other(points, batch):
    audit = Audit(Surrogate(), Truth(), fraction=8 / points, seed=0, tolerance=1.0)
    F = np.eye(2) * np.ones((points, 1, 1))
    numbers = np.arange(points)
    is_due = False
    step = 0
    while not is_due:
        is_due = audit.choose(step, numbers, F, 0 * F, F, np.zeros(points), wanted=0)
        step += 1
    waiting = len(audit.run().asked.step)
    assert batch <= waiting < batch + 30  # those of one step are 8, give or take


@pytest.mark.parametrize("steps", [5, 40, 200])
def test_a_run_of_any_length_has_the_audits_of_the_plan(steps):
    """Of fewer answers all, of more the answers with the smallest draws, each as likely."""
    cached, kept, _ = law(audit=0.005)
    asked = walk(cached, steps)
    answers = 40 * steps
    assert cached.report()["audit"]["audited"] == min(AUDITS, answers)
    shears = np.concatenate([F for F, _ in asked])[:, 0, 1]
    audited = np.concatenate([F for F, *_ in kept])[:, 0, 1]
    assert np.isin(audited, shears).all()
    if answers > AUDITS:
        # Mean and spread are those of a random sample of the answers.
        scatter = shears.std() / np.sqrt(AUDITS)
        assert abs(audited.mean() - shears.mean()) < 3.0 * scatter
        assert audited.std() == pytest.approx(shears.std(), rel=0.15)


def test_every_answer_is_audited_with_the_same_probability():
    """2,000 answers of four steps, over many seeds: as many audits of each step."""
    F = np.tile(np.eye(2), (500, 1, 1))
    zero, bound, by_step = 0.0 * F, np.zeros(500), np.zeros(4)
    for seed in range(50):
        audit = Audit(Surrogate(), Truth(), fraction=0.05, seed=seed, tolerance=1.0)
        for step in range(4):
            audit.choose(step, np.arange(500), F, zero, zero, bound, wanted=AUDITS)
        audit.end(AUDITS)
        asked = audit.run().asked
        assert len(asked.step) == AUDITS
        assert len({*zip(asked.step.tolist(), asked.points.tolist(), strict=True)}) == AUDITS
        by_step += np.bincount(asked.step, minlength=4)
    # Hypergeometric: 90 of each step with a variance of 360 · ¼ · ¾ · 1,640/1,999 a seed.
    scatter = np.sqrt(50 * 360 * 3 / 16 * 1640 / 1999)
    assert (abs(by_step - 50 * 90) < 4.0 * scatter).all()


def test_an_audit_of_other_points_starts_from_the_nearest_of_the_last_batch():
    truth = Warm()
    audit = Audit(Surrogate(), truth, fraction=1.0, seed=0, tolerance=1.0)

    def asked(points, shears):
        F = np.eye(2) * np.ones((len(points), 1, 1))
        F[:, 0, 1] = shears
        whole = np.tile(np.eye(2), (10, 1, 1))
        whole[points] = F
        zero = 0.0 * whole
        audit.choose(1, np.array(points), whole, zero, zero, np.zeros(10), wanted=AUDITS)
        audit.run()

    asked([3, 5, 9], [0.1, 0.2, 0.4])
    asked([7, 5, 2], [0.39, 0.5, 0.11])
    asked([7, 5, 2], [0.5, 0.1, 0.3])
    (_, first), (_, second), (_, third) = truth.asked
    assert first is None
    assert second.F[:, 0, 1].tolist() == [0.4, 0.4, 0.1]
    assert third.F[:, 0, 1].tolist() == [0.39, 0.5, 0.11]  # the same points: each from its own


def test_fallback_and_audit_answers_are_kept_and_learnt():
    cached, kept, learnt = observed(TrueLaw(), audit=1.0)
    F, F_dot = stretched(*np.linspace(1.0, 1.4, 16), 1.6)
    answer = cached.respond(F, F_dot)
    assert not kept
    assert not learnt
    cached.accept(F, F_dot, answer)
    (fallback, audit) = kept
    assert np.array_equal(fallback[0], F[[16]])
    assert fallback[4].tolist() == [0]
    assert np.array_equal(audit[0], F[:16])
    assert audit[4].tolist() == [1] * 16
    np.testing.assert_allclose(audit[2], cached.fallback.respond(F[:16], F_dot[:16]).stress)
    assert not audit[3].any()
    # Only what the surrogate did not know is learnt: its answers were within the tolerance.
    ((at, _, stress, state),) = learnt
    assert np.array_equal(at, F[[16]])
    assert np.array_equal(state.F, F[[16]] + 100.0)
    np.testing.assert_array_equal(stress, answer.stress[[16]])


def test_what_an_audit_finds_wrong_is_learnt():
    error = lambda F, F_dot: np.where(F[:, 0, 1] > 0.002, 0.2, 0.01)  # noqa: E731
    cached, _, learnt = law(audit=1.0, error=error)
    walked = walk(cached, 3, points=20)
    (F, _, stress, _), *_ = learnt
    wrong = walked[2][0][:, 0, 1] > 0.002
    assert 0 < wrong.sum() < 20
    assert np.array_equal(F, walked[2][0][wrong])
    np.testing.assert_allclose(stress, Truth().stress(F, 0.0 * F), rtol=1e-14)


def test_an_answer_where_the_truth_has_none_is_a_violation():
    brittle = failing(Truth(), fails=lambda F, F_dot: F[:, 0, 1] > 0.003, code=Status.UNSTABLE)
    cached, *_ = law(audit=1.0, truth=brittle)
    walk(cached, 3, points=20)
    audit = cached.report()["audit"]
    assert audit["unsolved"] == audit["violations"] > 0
