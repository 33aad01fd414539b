"""Rest by caches: load steps that audits find wrong are made again, tables learn on the way."""

import logging
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.base.sampling import SamplingRange
from surrofe2.cache import CachedLaw, CacheSettings, StressTable
from surrofe2.law.regional_law import RegionalLaw
from surrofe2.macro import MacroSettings, find_rest
from surrofe2.macro.rest import RestState
from tests.cache.tables import LOAD_CASE, Kept, cached, rising
from tests.laws import PointStates, Truth

SETTINGS = MacroSettings(newton_tolerance=1e-8)
ALLOWED = 0.1
BOUND = rising(0.01, 0.2)
LOADING = {"factor": 2.0, "load_steps": 8}


def bad_beyond(shear):
    """Errors within the bound below a shear, and five times the tolerance above; smooth, for
    Newton's method."""

    def error(F, F_dot):
        beyond = np.clip((abs(F[:, 1, 0]) - shear) / shear, 0.0, 1.0)
        return 0.5 * BOUND(F, F_dot) + 5.0 * ALLOWED * beyond**2 * (3.0 - 2.0 * beyond)

    return error


def untrustworthy(kind=CachedLaw):
    return cached(bad_beyond(0.01), BOUND, 1.0, kind=kind)


def learning():
    wide = SamplingRange(stretch=(0.9, 1.1), shear=0.1, rate=0.01)
    table = StressTable(Truth(), 0.02, wide, 10.0)
    return CachedLaw(table, Truth(), CacheSettings(tolerance=0.006, audit=0.1))


def in_two_regions(make=untrustworthy):
    points = {"left": np.arange(0, 30), "right": np.arange(30, 60)}
    return RegionalLaw({name: make() for name in points}, points)


@pytest.fixture(scope="module")
def true():
    return find_rest(LOAD_CASE, Truth(), SETTINGS, **LOADING)


def test_load_steps_that_audits_find_wrong_are_made_again(true):
    law = untrustworthy(Kept)
    rest = find_rest(LOAD_CASE, law, SETTINGS, **LOADING)
    assert rest.rolled_back["load_steps"] > 0
    assert rest.counts["load_steps"] == len(rest.path) - 1 == 8
    assert max(law.wrong_shares(Truth(), ALLOWED), default=0.0) <= 0.02
    wrong = find_rest(LOAD_CASE, cached(bad_beyond(0.01), BOUND), SETTINGS, **LOADING)
    off = abs(wrong.u - true.u).max()
    assert abs(rest.u - true.u).max() < min(0.2 * off, 2e-3 * abs(true.u).max())
    assert rest.cache["closing_audit"]["audited"] > 0
    assert "rolled back" in [each["decision"] for each in rest.decisions]
    spent = Counter({**rest.counts, **rest.effort})
    assert 0 < spent["stress_points"] == spent["hits"] + spent["fallbacks"]


@pytest.mark.parametrize("make", [untrustworthy, learning, in_two_regions])
def test_a_rest_resumes_to_the_bit(make):
    """From every equilibrium on the way, as a checkpoint keeps it."""
    kept, law = [], make()

    def keep(rest):
        kept.append((rest.to_arrays(), law.state_to_arrays(rest.law_state)))

    whole = find_rest(LOAD_CASE, law, SETTINGS, **LOADING, checkpoint=keep, checkpoint_interval=0.0)
    assert len(kept) > len(whole.path)
    for arrays, of_law in kept[1 :: max(1, len(kept) // 4)]:
        again = make()
        state = RestState.from_arrays(arrays)
        state = replace(state, law_state=again.state_from_arrays(of_law))
        rest = find_rest(LOAD_CASE, again, SETTINGS, **LOADING, resume=state)
        np.testing.assert_array_equal(rest.u, whole.u)
        np.testing.assert_array_equal(rest.journal["rows"], whole.journal["rows"])
        assert rest.counts == whole.counts
        assert rest.effort == whole.effort
        assert rest.rolled_back == whole.rolled_back
        assert rest.cache == whole.cache


class TellingTruth(Truth):
    """Says that points sheared by more than a bound are beyond a bifurcation."""

    def respond(self, F, F_dot, state=None, *, tangents=False):
        answer = super().respond(F, F_dot, tangents=tangents)
        return replace(answer, state=PointStates(F, 2.0))

    def beyond_bifurcation(self, state):
        return abs(state.F[:, 1, 0]) > 0.056


def test_points_beyond_a_bifurcation_are_those_of_the_fallback():
    """None is where the cache answers, also where it answers everywhere."""
    law = cached(lambda F, F_dot: 0.0 * F[:, 0, 0], rising(0.01, 1.5), truth=TellingTruth())
    rest = find_rest(LOAD_CASE, law, SETTINGS, **LOADING)
    known = rest.law_state.on_fallback.points
    assert 0 < len(known) < len(rest.F)
    beyond = abs(rest.F[known, 1, 0]) > 0.056
    assert rest.history["beyond bifurcation"][-1] == beyond.sum() > 0
    assert rest.history["beyond bifurcation"][0] == 0.0
    assert "beyond bifurcation" not in find_rest(LOAD_CASE, learning(), SETTINGS).history


def test_a_table_learns_within_a_load_step_instead_of_leaving_points_to_rves():
    """One load step is as good as eight, and far fewer RVEs are solved than there are points."""
    law = learning()
    law.table.learn_rest()
    rest = find_rest(LOAD_CASE, law, SETTINGS, factor=2.0, load_steps=1)
    assert law.counts["fallbacks"] == 0
    assert rest.effort["fallbacks"] == 0  # nor in trials before the table had learnt
    assert 0 < law.table.counts["table_rve_solves"] < 9 * 40
    assert law.table.size < 40
    true = find_rest(LOAD_CASE, Truth(), SETTINGS, factor=2.0, load_steps=1)
    assert abs(rest.u - true.u).max() < 2e-3 * abs(true.u).max()


def test_trials_that_tables_of_two_regions_do_not_answer_yet_cost_no_rves():
    law = in_two_regions(learning)
    for each in law.laws.values():
        each.table.learn_rest()
    rest = find_rest(LOAD_CASE, law, SETTINGS, factor=2.0, load_steps=1)
    assert rest.effort["fallbacks"] == 0
    assert rest.effort["hits"] == rest.counts["stress_points"] > 0
    state = rest.law_state
    F_dot = np.zeros_like(rest.F)
    far = rest.F + 0.02 * np.eye(2)
    expected = law.respond(far, F_dot, state).switched
    np.testing.assert_array_equal(law.leaving(far, F_dot, state), expected)
    assert expected.any()
    assert law.leaving(rest.F, F_dot, state) is None
    assert law.leaving(far, F_dot, None) is None
    part = law.laws["left"]
    of_part = far[:30], F_dot[:30], state[0]
    np.testing.assert_array_equal(part.leaving(*of_part), expected[:30])
    for law_asked, foreign in ((law, "nothing"), (law, state[:1]), (part, state)):
        with pytest.raises(InputError, match="state: not"):
            law_asked.leaving(*of_part[:2], foreign)


def test_points_where_nothing_can_be_learnt_are_left_to_rves():
    """Beyond a bifurcation the table takes no answer in."""
    wide = SamplingRange(stretch=(0.9, 1.1), shear=0.1, rate=0.01)
    truth = TellingTruth()
    truth.respond = lambda F, F_dot, state=None, tangents=False: replace(
        Truth.respond(truth, F, F_dot, tangents=tangents), state=PointStates(F, 0.999)
    )
    table = StressTable(Truth(), 0.02, wide, 10.0)
    law = CachedLaw(table, truth, CacheSettings(tolerance=0.006, audit=0.0))
    rest = find_rest(LOAD_CASE, law, SETTINGS, factor=2.0, load_steps=2)
    assert law.counts["fallbacks"] > 0
    true = find_rest(LOAD_CASE, Truth(), SETTINGS, factor=2.0, load_steps=2)
    assert abs(rest.u - true.u).max() < 2e-3 * abs(true.u).max()


def test_the_line_of_progress_ends_once(capsys, caplog):
    """The closing audit takes several batches at the end of the load."""
    # The warnings of this untrustworthy law would end lines of their own on the same stream.
    caplog.set_level(logging.ERROR)
    find_rest(LOAD_CASE, untrustworthy(), SETTINGS, **LOADING, progress=True)
    shown = capsys.readouterr().err
    assert shown.count("100.0 % of 2 in ") > 2
    assert shown.count("\n") == 1


def test_a_table_that_learns_comes_to_the_true_rest(true):
    """By tangents of its own answers: as many Newton corrections as by the true law, about."""
    law = learning()
    rest = find_rest(LOAD_CASE, law, SETTINGS, **LOADING)
    assert rest.residuals[-1] <= SETTINGS.newton_tolerance
    assert abs(rest.u - true.u).max() < 2e-3 * abs(true.u).max()
    assert law.counts["hits"] > 3 * law.counts["fallbacks"]
    assert rest.counts["factorisations"] < 2 * true.counts["factorisations"]
    assert rest.cache["audit"]["violations"] == 0
