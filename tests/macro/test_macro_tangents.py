"""Assembled tangents against central differences of the internal force."""

import pytest

from surrofe2 import LoadCase
from surrofe2.macro.elements import (
    deformation_gradient,
    gradient_matrix,
    internal_force,
    point_tangents,
    summed,
    with_transpose,
)
from surrofe2.macro.equations_of_motion import EquationsOfMotion
from surrofe2.macro.system import make_system
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.problem import Fixed, Foundation, Problem
from surrofe2.rve import RveLaw, RveSettings
from tests.laws import Fibres, KelvinVoigt, LinearFirstPiola
from tests.macro.bars import distorted_bar, random_state, state_vector
from tests.macro.meshes import plate
from tests.numerics import assert_near, differences


def force_of(bar, law, u, v, state=None):
    F, F_dot, _ = deformation_gradient(bar.discretisation, u, v)
    stress = law.respond(F, F_dot, state).stress
    return bar.pick(internal_force(bar.discretisation, F, stress))


def exact(bar, law, u, v):
    F, F_dot, _ = deformation_gradient(bar.discretisation, u, v)
    answer = law.respond(F, F_dot, tangents=True)
    space, P, slopes = bar.discretisation, answer.first_piola(F), answer.tangents
    S = with_transpose(gradient_matrix(space, bar.n_rows)[:, bar.free])
    by_u = point_tangents(space, F, P, slopes.P_by_F)
    by_v = point_tangents(space, F, 0.0 * P, slopes.P_by_F_dot)
    return (summed(S, by_u), summed(S, by_v)), answer.state


def assert_slopes(bar, law, u, v, step, share):
    """Tangents are ∂f/∂u and ∂f/∂v of the free unknowns; the largest entries."""
    tangents, state = exact(bar, law, u, v)
    slopes = (
        differences(lambda at: force_of(bar, law, at, v, state), u, step),
        differences(lambda at: force_of(bar, law, u, at, state), v, step),
    )
    slopes = [slope.reshape(bar.free.size, -1)[:, bar.free] for slope in slopes]
    for tangent, slope in zip(tangents, slopes, strict=True):
        assert_near(tangent.toarray(), slope, share)
    return [abs(slope).max() for slope in slopes]


@pytest.mark.parametrize("law", [KelvinVoigt(), LinearFirstPiola(), Fibres()], ids=repr)
@pytest.mark.parametrize("kind", ["distorted", "triangles", "curved triangles"])
def test_tangents_are_the_slopes_of_the_internal_force(rng, kind, law):
    """At random displacement and velocity."""
    if kind == "distorted":
        system = distorted_bar(rng, elements=(3, 2))
    else:
        problem = Problem(mesh=plate(kind, rng, (2, 2)), conditions=(Fixed(on="left"),))
        system = make_system(problem, 1.0)
    u, v = random_state(system, rng)
    assert_slopes(system, law, u, v, 1e-5, 1e-7)


@pytest.mark.parametrize("initialisation", ["elastic", "constrained-runs", "slow-manifold"])
def test_tangents_of_rves_are_the_slopes_of_the_internal_force(rng, initialisation):
    law = RveLaw(
        CellParameters.preset("printed"),
        RveSettings(initialisation=initialisation, tolerance=1e-10),
    )
    load_case = LoadCase(width=50.0, height=50.0, watched=(50.0, 25.0), elements=(2, 1))
    bar = make_system(load_case, law.density)
    u, v = random_state(bar, rng, 0.4)
    v *= 0.2
    assert min(assert_slopes(bar, law, u, v, 2e-5, 1e-6)) > 1.0


def test_tangents_over_a_step_are_stiffness_and_damping_together(rng):
    """With forces that have slopes of both kinds."""
    held = Fixed(on="left"), Foundation(on="bottom", stiffness=0.3, damping=0.7)
    problem = Problem(mesh=plate("quads", rng, (3, 2)), conditions=held)
    system = make_system(problem, 0.08)
    equations = EquationsOfMotion(system, KelvinVoigt())
    y = state_vector(system, *random_state(system, rng))
    now = equations.evaluate(0.0, y, tangents=True)
    K, C = equations.tangents(now)
    whole = equations.tangents_over_step(now, 0.2)
    assert abs(whole - K - C / 0.2).max() < 1e-13 * abs(whole).max()
