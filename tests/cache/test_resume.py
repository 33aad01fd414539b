"""A cached run that is interrupted and resumes equals one that was not, to the bit."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2 import LoadCase
from surrofe2.base.sampling import SamplingRange
from surrofe2.cache import CachedLaw, CacheSettings, StressTable
from surrofe2.law.regional_law import RegionalLaw
from surrofe2.macro import MacroSettings, simulate
from surrofe2.report.comparison import audit_sentence, closing_sentence
from surrofe2.run.displacement_curve import difference
from surrofe2.store.run_folder import caches_of
from tests.cache.tables import cached, keeping, resumed, rising
from tests.folders import assert_equal
from tests.laws import Truth, failing, shear_error
from tests.macro.bars import assert_same_run

LOAD_CASE = LoadCase(
    width=100.0, height=100.0, body_force=(0.0, -0.1), watched=(100.0, 50.0), elements=(2, 2),
    duration=20.0,
    output_interval=1.0,
)  # fmt: skip
SETTINGS = MacroSettings()
RANGE = SamplingRange(stretch=(0.92, 1.08), shear=0.08, rate=0.01)
BOUND = rising(0.02, 3.0)


def untrustworthy():
    """Off by more than its bound says, so that audits tighten and switch it off."""
    return cached(shear_error(0.3), BOUND, 0.3)


def falling_back():
    return cached(shear_error(0.02), BOUND, 0.05, tolerance=0.008)


def learning():
    table = StressTable(Truth(), 0.02, RANGE, 10.0)
    settings = CacheSettings(tolerance=0.006, audit=0.05)
    return CachedLaw(table, Truth(), settings)


def interrupted(make, steps):
    """The arrays of the checkpoint of a run that is stopped after so many steps."""
    law, kept, left = make(), [], [steps]

    def stop(t, duration):
        left[0] -= 1
        if left[0] == 0:
            raise KeyboardInterrupt

    checkpoints = {"checkpoint": keeping(law, kept), "checkpoint_interval": 1e9}
    with pytest.raises(KeyboardInterrupt):
        simulate(LOAD_CASE, law, SETTINGS, progress=stop, **checkpoints)
    return kept[-1]


@pytest.mark.parametrize("is_regional", [False, True])
@pytest.mark.parametrize("stop", [1, 12])
def test_a_run_resumes_cold_and_rolls_back_to_where_it_did(is_regional, stop):
    """Nothing but the macro state is kept: the law begins anew, and finds the fault again."""
    points = {"left": np.arange(0, 10), "right": np.arange(10, 20)}

    def make():
        if is_regional:
            return RegionalLaw({name: untrustworthy() for name in points}, points)
        return untrustworthy()

    kept, left = [], [stop]

    def interrupt(t, duration):
        left[0] -= 1
        if left[0] == 0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate(LOAD_CASE, make(), SETTINGS, progress=interrupt, checkpoint=kept.append,
                 checkpoint_interval=1e9)  # fmt: skip
    state, law, states = replace(kept[-1], law_state=None), make(), []
    run = simulate(LOAD_CASE, law, SETTINGS, resume=state, checkpoint_interval=0.0,
                   checkpoint=keeping(law, states))  # fmt: skip
    assert run.finished
    assert {part["since"] for part in caches_of(run.cache).values()} == {state.t}
    back = [line for line in law.decisions if line["decision"] == "rolled back"]
    assert back[0]["from_t"] == state.t
    true = simulate(LOAD_CASE, Truth(), SETTINGS)
    assert difference(run.curve, true.curve).largest < 2e-3
    # A checkpoint that was taken right after the law went back to there is whole.
    first = next(each for each in states if each[0]["t"] == state.t)
    again = resumed(LOAD_CASE, make(), SETTINGS, first)
    assert_same_run(again, run)
    assert_equal(again.cache, run.cache, exact=True)


def test_a_run_that_resumed_cold_states_its_bound_since_then():
    kept = []
    simulate(LOAD_CASE, falling_back(), SETTINGS, checkpoint=kept.append, checkpoint_interval=0.0)
    state = replace(next(each for each in kept if each.t > 1.0), law_state=None)
    law = falling_back()
    run = simulate(LOAD_CASE, law, SETTINGS, resume=state)
    answered = run.cache["accepted"]["hits"]
    assert run.cache["since"] == state.t
    assert run.cache["closing_audit"]["answers"] == answered
    since = f"since t = {state.t:.3g} µs, where the run resumed without the state of its law"
    sentence = closing_sentence(run.cache)
    assert sentence.startswith(f"all {answered:,} answers that stand {since};")
    assert sentence.endswith(" of these")
    assert f" of {answered:,} accepted answers {since}" in audit_sentence(run.cache)


def told(law):
    """All it has to say but seconds."""
    history = law.history()
    told = {name: history[name] for name in ("tolerance", "accepted", "audit", "trust")}
    return told | {"decisions": law.decisions}


@pytest.mark.parametrize("make", [untrustworthy, falling_back, learning])
def test_a_resumed_run_is_the_uninterrupted_one(make):
    law = make()
    whole = simulate(LOAD_CASE, law, SETTINGS)
    steps = whole.counts["steps"]
    assert law.counts["fallbacks"] > 0
    assert law.counts["hits"] > 0
    waited = remembered = False
    for stop in (1, steps // 3, steps // 2, steps - 3):
        again, kept = make(), interrupted(make, stop)
        waited |= any(name.startswith("audit.waiting") for name in kept[1])
        remembered |= any(name.startswith("audit.spare") for name in kept[1])
        run = resumed(LOAD_CASE, again, SETTINGS, kept)
        assert_same_run(run, whole)
        assert_equal(run.effort, whole.effort, exact=True)
        assert_equal(told(again), told(law), exact=True)
    assert waited
    assert remembered or make is untrustworthy
    if make is untrustworthy:
        assert [event["action"] for event in told(law)["trust"]["events"]]
        assert "rolled back" in [line["decision"] for line in law.decisions]
    if make is learning:
        assert again.surrogate.counts == law.surrogate.counts
        assert law.surrogate.size > 0


def test_an_interrupt_while_the_law_commits_leaves_no_checkpoint_of_half_a_step():
    def stop(F, F_dot):
        """Ctrl-C within the first audit."""
        raise KeyboardInterrupt

    truth, kept = failing(Truth(), refuses=stop), []
    law = cached(shear_error(0.02), BOUND, 1.0, truth=truth)
    with pytest.raises(KeyboardInterrupt):
        simulate(LOAD_CASE, law, SETTINGS, checkpoint=kept.append, checkpoint_interval=1e9)
    assert not kept
