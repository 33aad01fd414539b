"""Points that the law moves to another equilibrium at accepted steps: the bar follows."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2 import LoadCase
from surrofe2.law.stress_law import Tangents
from surrofe2.macro import MacroSettings, find_rest, simulate
from surrofe2.macro.elements import internal_force
from tests.laws import KelvinVoigt

LOAD_CASE = LoadCase(width=60.0, height=60.0, watched=(60.0, 30.0), duration=12.0, elements=(2, 2))
SETTINGS = MacroSettings(newton_tolerance=1e-10)


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


def test_rest_is_that_of_the_branches_reached():
    law, plain = Softens(), find_rest(LOAD_CASE, KelvinVoigt(), SETTINGS)
    law.limit, law.share = np.quantile(abs(plain.F[:, 1, 0]), 0.8), 0.97
    rest = find_rest(LOAD_CASE, law, SETTINGS)
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
    settings = replace(SETTINGS, integrator=integrator, relative_tolerance=1e-5)
    run = simulate(LOAD_CASE, Softens(), settings)
    plain = simulate(LOAD_CASE, KelvinVoigt(), settings)
    assert plain.effort.get("left_bifurcation", 0) == 0
    assert 1 < run.effort["left_bifurcation"] <= 20
    assert run.counts["failed_trials"] == 0
    lower = run.curve.displacement[:, 1].min()
    assert lower < 1.02 * plain.curve.displacement[:, 1].min()


def test_explicit_and_implicit_steps_agree():
    fine = replace(SETTINGS, absolute_tolerance=1e-8, relative_tolerance=1e-6)
    fine = replace(fine, largest_step=0.05)
    curves = [
        simulate(LOAD_CASE, Softens(), replace(fine, integrator=name)).curve.displacement
        for name in ("explicit", "implicit")
    ]
    assert abs(curves[0] - curves[1]).max() < 5e-3 * abs(curves[0]).max()
