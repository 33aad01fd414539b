"""Space alone: kernels against plain twins, patch test, balances, symmetries."""

import numpy as np
import pytest

from surrofe2 import LoadCase
from surrofe2.base.tensors import det
from surrofe2.macro.elements import (
    deformation_gradient,
    element_mean_F,
    element_mean_stress,
    internal_force,
    stress_power,
)
from surrofe2.macro.equations_of_motion import EquationsOfMotion
from surrofe2.macro.history import widen_extremes
from surrofe2.macro.mass import DENSE_LIMIT, mass_solver
from surrofe2.macro.system import make_system
from surrofe2.problem import Problem
from tests.laws import KelvinVoigt
from tests.macro.bars import PLATE, distorted_bar, random_state, state_vector
from tests.macro.meshes import plate
from tests.numerics import assert_near, turn


def unheld_state(bar, rng):
    """Displacement and velocity of all nodes, those on the left side as well."""
    return rng.uniform(-0.5, 0.5, (2, *bar.nodes.shape))


@pytest.fixture(params=["quads", "curved triangles"])
def space(request, rng):
    """Elements that are no rectangles, of five points each or of three."""
    if request.param == "quads":
        return distorted_bar(rng).discretisation
    problem = Problem(mesh=plate(request.param, rng), conditions=())
    return make_system(problem, 0.08).discretisation


def deformation_twin(space, u, v):
    nodal_u, nodal_v = u[space.elements], v[space.elements]
    F = np.eye(2) + np.einsum("eai,eqaj->eqij", nodal_u, space.gradients)
    F_dot = np.einsum("eai,eqaj->eqij", nodal_v, space.gradients)
    return F.reshape(-1, 2, 2), F_dot.reshape(-1, 2, 2)


def stress_times_area(space, F, stress):
    """(e, q, 2, 2) what counts of the stress at each point, times its current area: of
    quadrilaterals the deviator at the first four points, the pressure at the fifth, the middle."""
    points = space.weights.shape
    area = (det(F).reshape(points) * space.weights)[..., None, None]
    stress = stress.reshape(*points, 2, 2)
    if points[1] == 5:
        pressure = 0.5 * np.trace(stress, axis1=2, axis2=3)[..., None, None] * np.eye(2)
        stress = np.concatenate([(stress - pressure)[:, :4], pressure[:, 4:]], axis=1)
    return area * stress


def internal_force_twin(space, F, stress):
    """As it is written: current gradients F⁻ᵀ∇N, current areas det F w, dev and tr/2 apart."""
    inverse = np.linalg.inv(F).reshape(*space.weights.shape, 2, 2)
    current = np.einsum("eqaj,eqji->eqai", space.gradients, inverse)
    force = np.zeros_like(space.nodes)
    counted = stress_times_area(space, F, stress)
    np.add.at(force, space.elements, np.einsum("eqij,eqaj->eai", counted, current))
    return force


def extremes_twin(F, F_dot):
    U, RT_F_dot = np.empty_like(F), np.empty_like(F)
    for p in range(len(F)):
        left, _, right = np.linalg.svd(F[p])
        R = left @ right
        U[p], RT_F_dot[p] = R.T @ F[p], R.T @ F_dot[p]
    values = np.stack([F, F_dot, U, RT_F_dot])
    return values.min(axis=1), values.max(axis=1)


def test_kernels_agree_with_their_twins(space, rng):
    u, v = unheld_state(space, rng)
    F, F_dot, J = deformation_gradient(space, u, v)
    expected_F, expected_rate = deformation_twin(space, u, v)
    np.testing.assert_allclose(F, expected_F, rtol=0, atol=1e-13)
    np.testing.assert_allclose(F_dot, expected_rate, rtol=0, atol=1e-13)
    np.testing.assert_allclose(J, det(expected_F), rtol=0, atol=1e-13)
    stress = rng.normal(size=F.shape)
    expected = internal_force_twin(space, F, stress)
    assert_near(internal_force(space, F, stress), expected, 1e-12)


def test_extremes_kernel_agrees_with_its_twin(rng):
    F = np.eye(2) + rng.uniform(-0.4, 0.4, (50, 2, 2))
    F_dot = rng.normal(size=F.shape)
    extremes = np.stack([np.full((4, 2, 2), np.inf), np.full((4, 2, 2), -np.inf)])
    widen_extremes(extremes, F[:20], F_dot[:20])
    widen_extremes(extremes, F[20:], F_dot[20:])
    lowest, highest = extremes
    expected_low, expected_high = extremes_twin(F, F_dot)
    np.testing.assert_allclose(lowest, expected_low, atol=1e-12)
    np.testing.assert_allclose(highest, expected_high, atol=1e-12)


def test_kernels_keep_nan(rng):
    """What comes in as NaN must not leave as a number that passes for a deformation."""
    bar = make_system(LoadCase(**PLATE, elements=(2, 2)), 0.08).discretisation
    u, v = unheld_state(bar, rng)
    u[0, 0] = np.nan
    F, _, J = deformation_gradient(bar, u, v)
    assert np.isnan(F).any()
    assert np.isnan(J).any()
    assert not J.min() > 0.0


def test_rotating_unheld_body_feels_no_force(rng):
    bar, law = distorted_bar(rng).discretisation, KelvinVoigt()
    x = bar.nodes @ turn(0.7).T
    v = 0.3 * x @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    F, F_dot, _ = deformation_gradient(bar, x - bar.nodes, v)
    force = internal_force(bar, F, law.respond(F, F_dot).stress)
    assert abs(force).max() < 1e-12 * law.shear_modulus * PLATE["height"]
    # The same motion does make a force where the law minds: it is not zero for lack of stress.
    F, F_dot, _ = deformation_gradient(bar, 1.1 * x - bar.nodes, v)
    assert abs(internal_force(bar, F, law.respond(F, F_dot).stress)).max() > 1.0


def test_forces_of_unheld_body_balance_and_their_virial_is_the_stress(space, rng):
    """Σ f = 0, Σ f ⊗ x = ∫ σ dv and Σ f · v = ∫ σ : L dv, σ unsymmetric."""
    u, v = unheld_state(space, rng)
    F, F_dot, _ = deformation_gradient(space, u, v)
    stress = rng.normal(size=F.shape)
    force = internal_force(space, F, stress)
    assert abs(force.sum(axis=0)).max() < 1e-12 * abs(force).sum()
    counted = stress_times_area(space, F, stress)
    np.testing.assert_allclose(force.T @ (space.nodes + u), counted.sum(axis=(0, 1)), rtol=1e-11)
    L = (F_dot @ np.linalg.inv(F)).reshape(counted.shape)
    by_element = np.einsum("eqij,eqij->e", counted, L)
    assert np.vdot(force, v) == pytest.approx(by_element.sum(), rel=1e-10)
    np.testing.assert_allclose(stress_power(space, F, F_dot, stress), by_element, atol=1e-10)


def test_means_over_triangles_are_those_of_their_points(rng):
    problem = Problem(mesh=plate("curved triangles", rng), conditions=())
    space = make_system(problem, 0.08).discretisation
    F, _, J = deformation_gradient(space, *unheld_state(space, rng))
    stress, points = rng.normal(size=F.shape), (len(space.elements), 3)
    for found, values, weights in (
        (element_mean_stress(space, F, stress), stress, J.reshape(points) * space.weights),
        (element_mean_F(space, F), F, space.weights),
    ):
        whole = np.einsum("eq,eqij->eij", weights, values.reshape(*points, 2, 2))
        mean = whole / weights.sum(axis=1)[:, None, None]
        np.testing.assert_allclose(found, mean, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("seed", range(2))
def test_load_power_is_kinetic_rate_plus_internal_power(seed):
    """v·M a + Σ dev σ : L dv + Σ tr(σ)/2 tr L dv = load·v, dev at Gauss points, tr at centres."""
    rng = np.random.default_rng(seed)
    law, load_case = KelvinVoigt(), PLATE | {"amplitude": ((0.0, 0.7),)}
    system = distorted_bar(rng, load=load_case)
    bar = system.discretisation
    u, v = random_state(system, rng)
    now = EquationsOfMotion(system, law).evaluate(0.0, state_vector(system, u, v))
    np.testing.assert_array_equal(now.rate[: system.free.size], system.pick(v))
    kinetic_rate = system.pick(v) @ system.free_mass @ now.acceleration
    load_power = 0.7 * np.vdot(system.forces[0].dead, v)

    F, F_dot = deformation_twin(bar, u, v)
    counted = stress_times_area(bar, F, law.respond(F, F_dot).stress)
    L = F_dot @ np.linalg.inv(F)
    internal_power = np.vdot(counted, L)
    scale = abs(kinetic_rate) + abs(internal_power)
    assert abs(load_power - kinetic_rate - internal_power) < 1e-10 * scale
    powers = [internal_power, load_power, 0.0, kinetic_rate]
    np.testing.assert_allclose(now.powers.row, powers, rtol=1e-10)


def test_mass_and_load_are_consistent(rng):
    """½ v·M v for v = x is ρ H W³/6 exactly, and load·v for v = x is ρ g H W²/2."""
    bar = distorted_bar(rng, density=0.11)
    width, height = PLATE["width"], PLATE["height"]
    x = bar.discretisation.nodes[:, 0]
    v = np.stack([x, 0.0 * x], axis=1)
    kinetic = 0.5 * np.vdot(v, bar.inertia(v))
    assert kinetic == pytest.approx(0.11 * height * width**3 / 6.0, rel=1e-12)
    expected = 0.11 * np.array(PLATE["body_force"]) * height * width**2 / 2.0
    np.testing.assert_allclose(x @ bar.forces[0].dead, expected, rtol=1e-12)
    field = rng.normal(size=bar.free.size)
    np.testing.assert_allclose(bar.free_mass @ bar.solve_mass(field), field, atol=1e-12)


def test_watched_point_between_nodes_is_interpolated(rng):
    bar = make_system(LoadCase(**PLATE | {"watched": (13.0, 7.3)}, elements=(5, 3)), 0.08)
    x, y = bar.discretisation.nodes.T
    field = np.stack([2.0 * x + 0.3 * x * y, -x * y], axis=1)
    expected = [2.0 * 13.0 + 0.3 * 13.0 * 7.3, -13.0 * 7.3]
    np.testing.assert_allclose(bar.probes[0] @ field, expected, rtol=1e-12)


def test_a_large_mass_is_inverted(rng):
    """Sparse, of uneven density."""
    density = np.full((24 * 18, 5), 0.08)
    density[0] = 0.2
    system = make_system(LoadCase(elements=(24, 18)), density.ravel())
    assert system.free.size > DENSE_LIMIT
    x = rng.uniform(-1.0, 1.0, system.free.size)
    np.testing.assert_allclose(system.solve_mass(system.free_mass @ x), x, rtol=0.0, atol=1e-13)


def test_a_large_mass_is_inverted_where_x_and_y_are_held_apart(rng):
    system = make_system(LoadCase(elements=(12, 9)), 0.08)
    free = np.delete(system.free, [0, 31])
    assert free.size > DENSE_LIMIT
    mass = system.mass[free][:, free]
    x = rng.uniform(-1.0, 1.0, free.size)
    np.testing.assert_allclose(mass_solver(mass, free)(mass @ x), x, rtol=0.0, atol=1e-13)
