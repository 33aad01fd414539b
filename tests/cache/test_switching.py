"""Points that go to and fro between surrogate and true law do not disturb the macro scale."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.cache import CachedLaw, CacheSettings
from surrofe2.cache.branches import extrapolate
from surrofe2.macro import MacroSettings, find_rest, simulate
from surrofe2.macro.simulation import make_method
from surrofe2.macro.time_stepping import Stepper
from tests.cache.tables import cached, rising
from tests.laws import Learnt, Truth, shear_error
from tests.macro.bars import LOAD_CASE, equations_of_bar
from tests.numerics import assert_near

LOAD_CASE = replace(LOAD_CASE, duration=12.0)
SETTINGS = MacroSettings(frames=5)


def cached_law(limit=0.02, kind=CachedLaw, size=0.01):
    """Trusted up to a shear of `limit`, beyond which the bound rises above 0.1 µN/µm."""
    return cached(shear_error(size), rising(0.0, 0.1 / limit), kind=kind)


def blind(F, F_dot, before):
    """What `extrapolate` sees if it does not look."""
    return F, F_dot


@pytest.mark.parametrize("integrator", ["explicit", "implicit"])
def test_the_motion_is_the_true_one_at_nearly_its_cost(integrator):
    settings = replace(SETTINGS, integrator=integrator)
    true = simulate(LOAD_CASE, Truth(), settings)
    law = cached_law()
    run = simulate(LOAD_CASE, law, settings)
    assert_near(run.curve.displacement, true.curve.displacement, 2e-3)
    assert run.effort["hits"] > 0.2 * true.counts["stress_points"]
    assert run.effort["fallbacks_not_trusted"] > 0.2 * true.counts["stress_points"]
    assert law.counts["switched"] > 10
    assert run.counts["right_hand_sides"] <= 1.05 * true.counts["right_hand_sides"]


def test_energies_belong_to_the_branches_that_moved_the_bar():
    """Work of the internal force + kinetic energy = work of the load, whoever answered."""
    run = simulate(LOAD_CASE, cached_law(), SETTINGS)
    balance = run.energies["load"] - run.energies["internal"] - run.energies["kinetic"]
    assert abs(balance).max() < 5e-3 * run.energies["load"].max()


class Watched(CachedLaw):
    """Notes which points each stage had from the fallback, step by step."""

    def __init__(self, *parts):
        super().__init__(*parts)
        self.stages, self.steps, self.begun = [], [], []

    def respond(self, F, F_dot, state=None, *, tangents=False):
        answer = super().respond(F, F_dot, state, tangents=tangents)
        self.stages.append((frozenset(answer.state.on_fallback.points.tolist()), answer.switched))
        return answer

    def accept(self, F, F_dot, response):
        accepted = super().accept(F, F_dot, response)
        self.steps.append(self.stages)
        self.stages = []
        self.begun.append(frozenset(accepted.state.on_fallback.points.tolist()))
        return accepted

    def restart_step(self, F, F_dot, response, switched):
        accepted = super().restart_step(F, F_dot, response, switched)
        self.stages = []
        self.begun[-1] = frozenset(accepted.state.on_fallback.points.tolist())
        return accepted


def test_no_kept_step_mixes_branches(monkeypatch):
    """Without looking ahead, every point that leaves is found within a step."""
    monkeypatch.setattr("surrofe2.cache.branches.extrapolate", blind)
    watched = cached_law(kind=Watched)
    run = simulate(LOAD_CASE, watched, replace(SETTINGS, record_dissipation=False))
    assert run.counts["repeated_steps"] > 3
    assert len(watched.steps) == run.counts["steps"] + 1
    changes = 0
    for begun, stages in zip(watched.begun[:-1], watched.steps[1:], strict=True):
        assert len(stages) % 6 == 0 or begun is watched.begun[0]
        for on_fallback, switched in stages:
            assert switched is None
            assert on_fallback == begun
        changes += bool(begun)
    assert 0 < changes < run.counts["steps"]


def test_looking_ahead_saves_the_repeats(monkeypatch):
    ahead = simulate(LOAD_CASE, cached_law(), SETTINGS)
    monkeypatch.setattr("surrofe2.cache.branches.extrapolate", blind)
    without = simulate(LOAD_CASE, cached_law(), SETTINGS)
    assert ahead.counts["repeated_steps"] < 0.5 * without.counts["repeated_steps"]


def test_foresight_meets_cubics():
    """A point with F a cubic of time among many that move evenly, which tell the length h."""
    coefficients = np.zeros((4, 2000, 2, 2))
    coefficients[0], coefficients[1, 1:] = np.eye(2), 0.1
    coefficients[1:, 0] = np.random.default_rng(2).normal(size=(3, 2, 2)) * 0.1
    k = np.arange(4)

    def at(t):
        rates = k * np.power(t, np.maximum(k - 1, 0))
        return tuple(np.tensordot(weights, coefficients, 1) for weights in (t**k, rates))

    found, there, now = extrapolate(*at(0.3), at(0.2)), at(0.4), at(0.3)
    for a, b, c, scale in zip(found, there, now, (1e-6, 1e-5), strict=True):
        assert abs(a - b).max() < scale
        assert abs(b - c).max() > 1e-3


def test_foresight_without_rates_goes_straight_on():
    F, F_dot = np.tile(np.eye(2), (3, 1, 1)), np.zeros((3, 2, 2))
    for before, expected in ((None, F), ((F, F_dot), F), ((0.99 * F, F_dot), 1.01 * F)):
        found = extrapolate(F, F_dot, before)
        np.testing.assert_allclose(found[0], expected, rtol=1e-14)
        np.testing.assert_array_equal(found[1], F_dot)


def test_a_repeated_step_has_the_length_of_the_first_trial():
    """A point that cannot be foreseen: the surrogate gives up at its fourth lookup."""

    class Sudden(Learnt):
        calls = 0

        def lookup(self, F, F_dot, limit=np.inf):
            self.calls += 1
            stress, status, risk = super().lookup(F, F_dot, limit)
            if self.calls == 5:  # 1 at the start, 1 ahead, then stages 2 to 4
                status[4], stress[4] = 6, np.nan
            return stress, status, risk

    surrogate = Sudden(shear_error(0.0), lambda F, F_dot: np.full(len(F), 1e-9))
    steps, lengths = [], []
    for law in (Truth(), CachedLaw(surrogate, Truth(), CacheSettings(audit=0.0))):
        equations = equations_of_bar(LOAD_CASE, law)
        loose = replace(SETTINGS, absolute_tolerance=1e3)
        y = np.zeros(2 * equations.system.free.size)
        method = make_method(equations, loose)
        stepper = Stepper(equations, method, loose, 6.0, equations.begin(0.0, y), 0.4)
        steps.append(stepper.advance())
        lengths.append(stepper.next_length)
    assert equations.tally.counts["repeated_steps"] == 1
    assert [step.end.t for step in steps] == pytest.approx([0.4, 0.4], rel=1e-12)
    np.testing.assert_allclose(steps[1].end.y, steps[0].end.y, rtol=1e-9, atol=1e-14)
    assert lengths[1] == pytest.approx(lengths[0], rel=1e-9)


def test_at_rest_the_switching_bar_is_the_true_one():
    true = find_rest(LOAD_CASE, Truth(), SETTINGS, factor=2.0, load_steps=3)
    law = cached_law(limit=0.03)
    rest = find_rest(LOAD_CASE, law, SETTINGS, factor=2.0, load_steps=3)
    assert min(law.counts["fallbacks_not_trusted"], law.counts["hits"]) > 30
    np.testing.assert_allclose(rest.watched, true.watched, rtol=3e-3)
    assert rest.residuals[-1] < SETTINGS.newton_tolerance


def test_tangents_come_from_the_part_that_answers():
    law = cached_law(size=0.0)
    F = np.eye(2) + np.array([[[0.0, 0.0], [0.0, 0.0]], [[0.01, 0.0], [0.05, 0.0]]])
    F_dot = np.full_like(F, 0.001)
    answer = law.respond(F, F_dot, tangents=True)
    assert (answer.effort["hits"], answer.effort["fallbacks_not_trusted"]) == (1, 1)
    expected = Truth().slopes(F, F_dot)
    np.testing.assert_allclose(answer.tangents.P_by_F, expected[0], atol=1e-6)
    np.testing.assert_allclose(answer.tangents.P_by_F_dot, expected[1], atol=1e-6)
    law.surrogate.tangents = lambda F, F_dot: Learnt.tangents(law.surrogate, 1.1 * F, F_dot)
    other = law.respond(F, F_dot, tangents=True).tangents.P_by_F
    assert abs(other[0] - expected[0][0]).max() > 1.0
    np.testing.assert_allclose(other[1], expected[0][1], rtol=1e-12)


def test_a_surrogate_without_tangents_is_named():
    law = cached_law()
    law.surrogate.has_tangents = False
    with pytest.raises(InputError, match="CachedLaw has no tangents"):
        simulate(LOAD_CASE, law, replace(SETTINGS, integrator="implicit"))
    with pytest.raises(InputError, match="tangents: CachedLaw has no tangents"):
        law.respond(np.eye(2)[None], np.zeros((1, 2, 2)), tangents=True)
