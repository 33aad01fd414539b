"""Steps in time: turned back where the law fails, as long as error and stability allow, and over
bifurcations of points, where the bar follows.
"""

from dataclasses import replace
from itertools import count

import numpy as np
import pytest
from scipy.integrate import RK45

from surrofe2.base.errors import SimulationError
from surrofe2.law.stress_law import Status, Tangents
from surrofe2.macro import MacroSettings, find_rest, simulate
from surrofe2.macro.elements import internal_force
from surrofe2.macro.equations_of_motion import Evaluation
from surrofe2.macro.simulation import make_method
from surrofe2.macro.system import Works
from surrofe2.macro.time_stepping import NO_MEMORY, DormandPrince, Stepper
from tests.laws import KelvinVoigt, failing
from tests.macro.bars import LOAD_CASE, SETTINGS, SQUARE, equations_of_bar, with_load
from tests.numerics import rates


def refusing(questions=(), acceptances=()):
    """A law that fails at the questions, or refuses the acceptances, with these numbers from 0."""

    def at(numbers):
        calls = count()
        return lambda F, F_dot: (np.arange(len(F)) == 3) & (next(calls) in numbers)

    return failing(KelvinVoigt(), fails=at(questions), refuses=at(acceptances))


def stepper_of(law, integrator="explicit", first_step=0.4):
    equations = equations_of_bar(LOAD_CASE, law)
    y = np.zeros(2 * equations.system.free.size)
    loose = replace(SETTINGS, integrator=integrator, absolute_tolerance=1e3, relative_tolerance=1e6)
    method, start = make_method(equations, loose), equations.begin(0.0, y)
    return Stepper(equations, method, loose, 6.0, start, first_step), equations.tally


@pytest.mark.parametrize("integrator", ["explicit", "implicit"])
@pytest.mark.parametrize("trouble", [{"questions": [2]}, {"acceptances": [1]}], ids=str)
def test_a_failed_or_refused_trial_is_repeated_at_half_its_length(trouble, integrator):
    stepper, tally = stepper_of(refusing(**trouble), integrator)
    step = stepper.advance()
    assert step.start.t == 0.0
    assert step.end.t == pytest.approx(0.2, rel=1e-12)
    # Having failed, it does not grow at once.
    assert stepper.next_length == pytest.approx(0.2, rel=1e-12)
    assert tally.counts["failed_trials"] == 1
    plain, none = stepper_of(KelvinVoigt(), integrator, first_step=0.2)
    expected = plain.advance()
    np.testing.assert_array_equal(step.end.y, expected.end.y)
    np.testing.assert_array_equal(step.work(step.end.t), expected.work(expected.end.t))
    assert none.counts["failed_trials"] == 0
    assert stepper.advance().end.t == pytest.approx(0.4, rel=1e-12)


@pytest.mark.parametrize(
    ("role", "integrator"),
    [("fails", "explicit"), ("refuses", "explicit"), ("refuses", "implicit")],
)
def test_ten_halvings_end_the_run_with_what_was_computed(role, integrator):
    settings = replace(SETTINGS, integrator=integrator)

    def sheared(F, F_dot):
        return abs(F[:, 1, 0]) > 0.03

    law = failing(KelvinVoigt(), code=Status.UNSTABLE, **{role: sheared})
    with pytest.raises(SimulationError, match="10 halvings") as caught:
        simulate(LOAD_CASE, law, settings)
    message = str(caught.value)
    assert "\n" not in message
    for part in ("point ", "µm, t = ", "F = [[", "unstable"):
        assert part in message
    partial = caught.value.partial
    assert not partial.finished
    assert partial.counts["failed_trials"] >= 11
    whole = simulate(LOAD_CASE, KelvinVoigt(), settings)
    rows, u = partial.curve.t.size, whole.curve.displacement
    assert 3 < rows < len(u)
    allowed = 5e-3 * abs(u).max()
    np.testing.assert_allclose(partial.curve.displacement, u[:rows], atol=allowed)
    assert np.isfinite(partial.energies["dissipated"]).all()
    assert abs(partial.met.F[0][1, 0]) <= 0.03


def careless_stress(F, F_dot):
    stress = KelvinVoigt().stress(F, F_dot)
    stress[abs(F[:, 1, 0]) > 0.01] = np.nan
    return stress


SOFT = KelvinVoigt(shear_modulus=1e-3, lame=1e-3, shear_viscosity=0.0, bulk_viscosity=0.0)
SUDDEN = with_load(LOAD_CASE, acceleration=(-3.0, 0.0))
LOOSE = replace(SETTINGS, absolute_tolerance=1e6, relative_tolerance=1e6)


@pytest.mark.parametrize(
    ("problem", "law", "settings", "message"),
    [
        (LOAD_CASE, failing(KelvinVoigt(), fails=lambda F, F_dot: np.arange(len(F)) == 7), SETTINGS,
         r"cannot start: point 7 at .* did not converge"),
        (SUDDEN, SOFT, LOOSE, r"det F = -.*inverted"),
        (LOAD_CASE, failing(KelvinVoigt(), stress=careless_stress), SETTINGS, "NaN or infinite"),
    ],
    ids=["fails at the start", "inverted element", "stress that is not finite"],
)  # fmt: skip
def test_what_makes_trials_fail_is_named(problem, law, settings, message):
    with pytest.raises(SimulationError, match=message):
        simulate(problem, law, settings)


def test_step_length_settles_where_stability_limits_it():
    """Scipy's own control rejects every tenth trial of this stiff bar."""
    run = simulate(replace(LOAD_CASE, duration=40.0), KelvinVoigt(), SETTINGS)
    assert run.counts["steps"] > 100
    assert run.counts["rejected_steps"] <= 0.03 * run.counts["steps"]


def test_step_length_follows_the_error():
    """The next step keeps its length where the error is 0.27, 0.9^(1/0.08), of that allowed."""
    error = 0.9 ** (1.0 / 0.08)
    ratio = DormandPrince.control.ratio
    assert ratio(error) == pytest.approx(1.0)
    assert ratio(1.0) < 1.0 < ratio(0.0)
    assert ratio(0.0, may_grow=False) < 1.0
    assert ratio(2.0) == pytest.approx(0.9 * 2.0**-0.2)
    assert ratio(1e9) == 0.2


class Oscillator:
    """Evaluations of ẏ = (y₂, −y₁), exact y = (sin t, cos t); powers of y₁³ and of inertia."""

    def __call__(self, t, y):
        rate = np.array([y[1], -y[0]])
        powers = Works(3.0 * y[0] ** 2 * y[1], np.zeros(0), inertia=-y[0] * y[1])
        nothing = np.empty((0, 2, 2))
        return Evaluation(t, t, y, *[nothing] * 5, powers, rate, *[nothing] * 3)


def exact(t):
    return np.array([np.sin(t), np.cos(t)])


def test_dormand_prince_is_of_fifth_order_and_of_fourth_within_a_step():
    """Errors of one step go with h⁶ at its end, h⁵ within; the estimate is of the fourth order."""
    method, errors = DormandPrince(Oscillator(), 1.0, 1.0), []
    for h in (0.4, 0.2, 0.1):
        start = Oscillator()(0.5, exact(0.5))
        step = method.step(start, NO_MEMORY, 0.5 + h)
        middle = 0.5 + 0.4 * h
        work = exact(0.5 + h)[0] ** 3 - exact(0.5)[0] ** 3
        at_end = np.linalg.norm(step.end.y - exact(0.5 + h)), abs(step.work(0.5 + h)[0] - work)
        within = np.linalg.norm(step.interpolate(middle) - exact(middle))
        errors.append([*at_end, within, step.error])
    assert rates(errors)[-1] == pytest.approx([6.0, 6.0, 5.0, 5.0], abs=0.3)


def test_dormand_prince_takes_the_steps_of_scipy():
    """The same pair, first step and error: scipy's RK45, whose lengths are given to both."""
    tolerance = 1e-6
    reference = RK45(lambda t, y: np.array([y[1], -y[0]]), 0.0, exact(0.0), 9.0, rtol=tolerance)
    method = DormandPrince(Oscillator(), 1e-6, tolerance)
    start = Oscillator()(0.0, exact(0.0))
    assert method.first_length(start, 9.0) == pytest.approx(reference.h_abs, rel=1e-12)
    for _ in range(5):
        with np.errstate(under="ignore"):  # scipy looks for the number next to 0
            reference.step()
        step = method.step(start, NO_MEMORY, reference.t)
        np.testing.assert_allclose(step.end.y, reference.y, rtol=1e-14)
        middle = 0.3 * step.start.t + 0.7 * step.end.t
        within = reference.dense_output()(middle)
        np.testing.assert_allclose(step.interpolate(middle), within, rtol=1e-14)
        growth = reference.h_abs / step.length
        assert growth == pytest.approx(min(10.0, 0.9 * step.error**-0.2), rel=1e-9)
        start = step.end


def lost_at_fixed_step(step):
    loose = MacroSettings(absolute_tolerance=1e3, relative_tolerance=1e3, largest_step=step)
    run = simulate(replace(SQUARE, duration=6.4), KelvinVoigt(), loose)
    return abs(run.energies["numerical"][-1]) / run.energies["kinetic"].max()


def test_what_the_method_dissipates_is_of_fifth_order_in_the_step():
    """Work integrals and equations of motion are both fifth order at the ends of steps."""
    errors = [lost_at_fixed_step(step) for step in (0.2, 0.1, 0.05)]
    assert (rates(errors) > 4.6).all()


@pytest.mark.parametrize("role", ["questions", "acceptances"])
def test_failing_and_refused_trials_leave_the_motion_as_it_is(role):
    """Once the bar has picked up speed."""
    settings = replace(SETTINGS, absolute_tolerance=1e-8, relative_tolerance=1e-8)
    whole = simulate(LOAD_CASE, KelvinVoigt(), settings)
    run = simulate(LOAD_CASE, refusing(**{role: range(20, 400, 17)}), settings)
    assert run.finished
    assert run.counts["failed_trials"] > 5
    np.testing.assert_allclose(run.curve.displacement, whole.curve.displacement, atol=1e-6)
    for name in ("load", "internal"):
        allowed = 1e-6 * whole.energies["load"].max()
        np.testing.assert_allclose(run.energies[name], whole.energies[name], atol=allowed)


SOFTENING = replace(SQUARE, duration=12.0)
TIGHT = MacroSettings(newton_tolerance=1e-10)


class Softens(KelvinVoigt):
    """Loses part of its stress for good where an accepted step ends beyond a shear."""

    limit, share = 0.01, 0.8

    def respond(self, F, F_dot, state=None, *, tangents=False):
        answer = super().respond(F, F_dot, tangents=tangents)
        left = np.zeros(len(F), dtype=bool) if state is None else state
        share = np.where(left, self.share, 1.0)
        slopes = answer.tangents
        if slopes is not None:
            by = share[:, None, None, None, None]
            slopes = Tangents(by * slopes.P_by_F, by * slopes.P_by_F_dot)
        stress = share[:, None, None] * answer.stress
        return replace(answer, stress=stress, state=left, tangents=slopes)

    def accept(self, F, F_dot, response):
        left = response.state
        new = (abs(F[:, 1, 0]) > self.limit) & ~left
        if not new.any():
            return response
        stress = np.where(new[:, None, None], self.share, 1.0) * response.stress
        return replace(response, state=left | new, stress=stress, left_bifurcation=new)


class Tells(Softens):
    """Says which points are beyond the bifurcation."""

    def beyond_bifurcation(self, state):
        return state


def test_how_many_points_are_beyond_a_bifurcation_is_recorded():
    plain = find_rest(SOFTENING, KelvinVoigt(), TIGHT)
    law = Tells()
    law.limit, law.share = np.quantile(abs(plain.F[:, 1, 0]), 0.8), 0.97
    rest = find_rest(SOFTENING, law, TIGHT, load_steps=4)
    beyond = rest.history["beyond bifurcation"]
    assert beyond[0] == 0.0
    assert (np.diff(beyond) >= 0.0).all()
    assert beyond[-1] == (abs(rest.F[:, 1, 0]) > law.limit).sum() > 2
    marked = rest.journal["frames.beyond"]
    shares = len(rest.F) // marked.shape[1]
    of_elements = (abs(rest.F[:, 1, 0]) > law.limit).reshape(-1, shares).any(axis=1)
    np.testing.assert_array_equal(marked[-1], of_elements)
    assert not marked[0].any()
    run = simulate(SOFTENING, law, TIGHT)
    beyond = run.history["beyond bifurcation"]
    assert beyond[0] == 0.0
    assert beyond[-1] == beyond.max() == run.effort["left_bifurcation"] > 1
    assert "beyond bifurcation" not in plain.history, "a law that cannot tell"
    assert plain.journal["frames.beyond"].shape[1] == 0


def test_rest_is_that_of_the_branches_reached():
    law, plain = Softens(), find_rest(SOFTENING, KelvinVoigt(), TIGHT)
    law.limit, law.share = np.quantile(abs(plain.F[:, 1, 0]), 0.8), 0.97
    rest = find_rest(SOFTENING, law, TIGHT)
    left = abs(rest.F[:, 1, 0]) > law.limit
    assert 2 < left.sum() < len(left)
    answer = law.respond(rest.F, np.zeros_like(rest.F), left)
    np.testing.assert_allclose(rest.stress, answer.stress, rtol=0, atol=1e-9)
    force = rest.system.pick(internal_force(rest.system.discretisation, rest.F, rest.stress))
    load = rest.system.pick(rest.system.forces[0].dead)
    np.testing.assert_allclose(force, load, rtol=0, atol=1e-8 * abs(load).max())
    assert abs(rest.watched[1]) > 1.003 * abs(plain.watched[1])


@pytest.mark.parametrize("integrator", ["explicit", "implicit"])
def test_steps_go_on_from_the_branch_reached_and_count_who_left(integrator):
    settings = replace(TIGHT, integrator=integrator, relative_tolerance=1e-5)
    run = simulate(SOFTENING, Softens(), settings)
    plain = simulate(SOFTENING, KelvinVoigt(), settings)
    assert plain.effort.get("left_bifurcation", 0) == 0
    assert 1 < run.effort["left_bifurcation"] <= 20
    assert run.counts["failed_trials"] == 0
    lower = run.curve.displacement[:, 1].min()
    assert lower < 1.02 * plain.curve.displacement[:, 1].min()


def test_explicit_and_implicit_steps_agree():
    fine = replace(TIGHT, absolute_tolerance=1e-8, relative_tolerance=1e-6)
    fine = replace(fine, largest_step=0.05)
    curves = [
        simulate(SOFTENING, Softens(), replace(fine, integrator=name)).curve.displacement
        for name in ("explicit", "implicit")
    ]
    assert abs(curves[0] - curves[1]).max() < 5e-3 * abs(curves[0]).max()
