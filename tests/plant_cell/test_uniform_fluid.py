"""The uniform fluid against identities and a plain numpy twin, on RVEs whose rims have images."""

from __future__ import annotations

import numpy as np
import pytest

from surrofe2.base.simd import TILE
from surrofe2.plant_cell.arrangement import make_arrangement, rim_areas, start_positions
from surrofe2.plant_cell.derivatives import add_stiffness_rates
from surrofe2.plant_cell.neighbours import make_neighbours
from surrofe2.plant_cell.parameters import CellParameters
from tests.numerics import assert_near, differences, fine_slope_along, slope_along
from tests.plant_cell.lanes_of_states import Patch

NONE = np.empty((0, 2), dtype=np.int32)
RVES = {
    "one square": {"arrangement": "square"},
    "four hexagons": {"arrangement": "hexagon", "cells": 4},
    "four Voronoi cells": {"arrangement": "voronoi", "cells": 4},
    "undrained": {"arrangement": "voronoi", "cells": 4, "sap_bulk_modulus": 5.0},
}


@pytest.fixture(params=RVES)
def patch(request):
    """All forces of an RVE."""
    return Patch("water", fluid="uniform", **RVES[request.param])


@pytest.fixture(params=["four hexagons", "four Voronoi cells", "undrained"])
def fluid(request):
    """The fluid's forces alone, with a viscosity that shows; in one plant cell they cancel."""
    patch = Patch("water", fluid="uniform", **RVES[request.param])
    patch.topology = patch.topology._replace(bonds=NONE, contacts=NONE)
    patch.constants = patch.constants._replace(viscosity=50.0)
    return patch


class FluidTwin:
    """Forces of the fluid, its energy and virial, rim by rim with images, by shoelace formulas."""

    def __init__(self, patch):
        cell, self.patch = patch.cell, patch
        arrangement = make_arrangement(cell)
        self.rims, areas = arrangement.rims, arrangement.tessellation.areas
        self.mass = cell.fluid_particle_mass * 16 / cell.cell_side**2 * areas
        self.stiffness = cell.sap_bulk_modulus * cell.tissue_thickness
        self.rest = areas  # the patch lays its rims out on the polygons

    def evaluate(self, z, F, F_dot):
        """(f (n, 2), energy, Σ f ⊗ y (2, 2) with images, power of viscous forces)."""
        f, energy, virial, power = np.zeros_like(z), 0.0, np.zeros((2, 2)), 0.0
        c2, viscosity = self.patch.cell.sound_speed**2, self.patch.constants.viscosity
        for rim, mass, rest in zip(self.rims, self.mass, self.rest, strict=True):
            material = z[rim[:, 0]] + rim[:, 1:] @ self.patch.lattice.T
            y, v = material @ F.T, material @ F_dot.T
            after, before = np.roll(y, -1, axis=0), np.roll(y, 1, axis=0)
            area = 0.5 * (y[:, 0] * after[:, 1] - y[:, 1] * after[:, 0]).sum()
            g = 0.5 * np.stack([(after - before)[:, 1], -(after - before)[:, 0]], axis=1)
            p = mass * c2 / area + self.stiffness * (rest / area - 1.0)
            L = v.T @ g / area
            tau = viscosity * (L + L.T - np.trace(L) * np.eye(2))
            force = g @ (p * np.eye(2) - tau).T
            np.add.at(f, rim[:, 0], force)
            energy += mass * c2 * np.log(mass / area)
            energy += self.stiffness * (area - rest - rest * np.log(area / rest))
            virial += force.T @ y
            power -= ((g @ tau) * v).sum()
        return f, energy, virial, power


def test_forces_and_energy_are_those_of_the_twin(fluid):
    twin, f, energy = FluidTwin(fluid), fluid.forces(), fluid.energy(fluid.z, fluid.F)
    for lane in range(3):
        expected, stored, *_ = twin.evaluate(fluid.z[lane], fluid.F[lane], fluid.F_dot[lane])
        assert_near(f[lane], expected, 1e-12)
        assert energy[lane] == pytest.approx(stored, rel=1e-12)


def test_forces_sum_to_zero(fluid):
    f = fluid.forces()
    assert abs(f.sum(axis=1)).max() < 1e-14 * abs(f).sum(axis=1).max()


def test_areas_add_up_to_that_of_the_rve(fluid):
    x = np.einsum("lab,lpb->lpa", fluid.F, fluid.z)
    rims = make_arrangement(fluid.cell).rims
    areas = rim_areas(rims, x, fluid.F @ fluid.lattice)
    expected = np.linalg.det(fluid.F) * np.linalg.det(fluid.lattice)
    np.testing.assert_allclose(areas.sum(axis=1), expected, rtol=1e-14)


def test_elastic_force_is_minus_the_slope_of_the_energy(fluid):
    f = fluid.forces(F_dot=np.zeros_like(fluid.F_dot))
    direction = np.random.default_rng(3).normal(size=fluid.z.shape)
    moved = np.einsum("lab,lpb->lpa", fluid.F, direction)
    slope = fine_slope_along(lambda z: fluid.energy(z, fluid.F), fluid.z, direction, 1e-2)
    assert_near(-slope, (f * moved).sum(axis=(1, 2)), 1e-8)


def test_virial_is_the_slope_of_the_energy_with_F(fluid):
    """−Σ f_k ⊗ y_k = ∂E/∂F Fᵀ, over local particles."""
    still = np.zeros_like(fluid.v)
    local = fluid.local_forces(fluid.x, still)
    virial = -np.einsum("apl,bpl->lab", local, fluid.x)
    by_F = by_entries(lambda F: fluid.energy(fluid.z, F), fluid.F, 1e-3)
    assert_near(virial, by_F @ np.swapaxes(fluid.F, 1, 2), 1e-8)


def test_virial_of_forces_is_area_times_stress(fluid):
    """Σ f_k ⊗ y_k = A (p I − τ) of each plant cell, viscous part included."""
    virial = np.einsum("apl,bpl->lab", fluid.local_forces(fluid.x, fluid.v), fluid.x)
    for lane in range(3):
        args = fluid.z[lane], fluid.F[lane], fluid.F_dot[lane]
        assert_near(virial[lane], FluidTwin(fluid).evaluate(*args)[2], 1e-12)


def by_entries(of, tensors, step):
    """Slopes of of(tensors) by the entries of all tensors (TILE, 2, 2) at once, (…, 2, 2)."""
    units = np.eye(4).reshape(4, 2, 2)
    slopes = [fine_slope_along(of, tensors, unit, step) for unit in units]
    return np.stack(slopes, axis=-1).reshape(*slopes[0].shape, 2, 2)


def viscous_power(patch, v):
    """(TILE,) power of what velocities add to the forces, of local particles with velocities v."""
    still = patch.local_forces(patch.x, np.zeros_like(v))
    return ((patch.local_forces(patch.x, v) - still) * v).sum(axis=(0, 1))


def test_viscosity_dissipates_in_any_motion(fluid):
    rng = np.random.default_rng(2)
    for _ in range(5):
        assert (viscous_power(fluid, rng.normal(size=fluid.v.shape)) < 0.0).all()


def test_spin_and_dilation_dissipate_nothing(fluid):
    turn = np.stack([-fluid.x[1], fluid.x[0]])
    scale = abs(viscous_power(fluid, fluid.x * np.array([1.0, -1.0])[:, None, None])).max()
    for v in (turn, fluid.x.copy()):
        assert abs(viscous_power(fluid, v)).max() < 1e-13 * scale


def test_forces_turn_with_the_rve(patch):
    """Superposed rotation with its spin: f(Q F, Q Ḟ + ω Q F) = Q f(F, Ḟ), contacts and all."""
    angle, rate = 0.7, 0.3
    Q = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    spin = rate * np.array([[0.0, -1.0], [1.0, 0.0]])
    turned = patch.forces(F=Q @ patch.F, F_dot=Q @ patch.F_dot + spin @ Q @ patch.F)
    assert_near(turned, patch.forces() @ Q.T, 1e-12)


def test_jacobian_and_load_are_the_derivatives_of_the_forces(patch):
    patch.constants = patch.constants._replace(viscosity=50.0)
    z, F, F_dot = patch.z, patch.F, patch.F_dot
    n, (J, load) = patch.topology.particles, patch.jacobian(F_dot)
    inverse = np.linalg.inv(F)
    for column in range(0, 2 * n - 2, 7):
        i, axis = divmod(column + 2, 2)
        shift = np.zeros_like(z)
        shift[:, i] = inverse[:, :, axis]
        slope = slope_along(patch.forces, z, shift, 1e-6).reshape(TILE, -1)[:, 2:]
        np.testing.assert_allclose(J[:, column].T, slope, rtol=0, atol=1e-7 * abs(J).max())
    by_F = differences(lambda at: patch.forces(z, at, F_dot), F, 1e-7)
    by_F_dot = differences(lambda at: patch.forces(z, F, at), F_dot, 1e-7)
    slopes = np.concatenate([each.reshape(TILE, 2 * n, 4) for each in (by_F, by_F_dot)], axis=2)
    for column in range(8):
        assert_near(slopes[:, :, column], load[:, column].T, 1e-6)


def test_elastic_jacobian_is_symmetric(patch):
    J, _ = patch.jacobian(np.zeros_like(patch.F_dot))
    assert abs(J - J.swapaxes(0, 1)).max() < 1e-12 * abs(J).max()


def test_load_and_gradients_are_the_slopes_of_the_fluid(fluid):
    """Without walls and contacts, whose slopes are larger by far."""
    rng, (n, z) = np.random.default_rng(7), (fluid.topology.particles, fluid.z)
    weights, others = rng.normal(size=(2, 4, *fluid.x.shape))
    by_x, by_v = fluid.gradients(weights)
    along = lambda first, second: np.einsum("mapl,mapl->ml", first, second)  # noqa: E731
    for forces_at, at, by in (
        (lambda x: fluid.local_forces(x, fluid.v), fluid.x, by_x),
        (lambda v: fluid.local_forces(fluid.x, v), fluid.v, by_v),
    ):
        expected = np.array([fine_slope_along(forces_at, at, each, 1e-3) for each in others])
        assert_near(along(weights, expected), along(by, others), 1e-8)
    load = fluid.jacobian(fluid.F_dot)[1]
    by_F = by_entries(lambda at: fluid.forces(z, at), fluid.F, 1e-3)
    assert_near(np.moveaxis(load[:, :4], -1, 0), by_F.reshape(TILE, 2 * n, 4), 1e-8)
    # an affine rate stresses all plant cells alike, which leaves no force on a wall between two
    assert abs(load[:, 4:]).max() < 1e-12 * fluid.constants.viscosity * abs(fluid.lattice).max()


def test_elastic_rates_and_stiffness_rates_are_slopes_along_a_motion(fluid):
    rng = np.random.default_rng(5)
    v, fields = rng.normal(size=fluid.v.shape), rng.normal(size=(4, *fluid.x.shape))
    still = np.zeros_like(v)
    f, rate = fluid.elastic_rates(fluid.x, v)
    assert_near(f, fluid.local_forces(fluid.x, still), 1e-12)
    moving = lambda t: fluid.local_forces(fluid.x + t * v, still)  # noqa: E731
    assert_near(fine_slope_along(moving, 0.0, 1.0, 1e-3), rate, 1e-8)
    work, rates = fluid.workspace(fluid.x, v), np.zeros_like(fields)
    add_stiffness_rates(work, fields, rates, fluid.topology, fluid.constants)
    rates_at = lambda x: fluid.elastic_rates(x, v)[1]  # noqa: E731
    for found, field in zip(rates, fields, strict=True):
        assert_near(fine_slope_along(rates_at, fluid.x, field, 1e-3), found, 1e-8)


@pytest.mark.parametrize(("arrangement", "cells"), [("square", 1), ("hexagon", 4), ("voronoi", 9)])
def test_mass_is_that_of_the_sph_tissue_and_lies_on_the_rims(arrangement, cells):
    uniform, sph = (
        CellParameters.preset("water", arrangement=arrangement, cells=cells, fluid=fluid)
        for fluid in ("uniform", "sph")
    )
    assert uniform.density == pytest.approx(sph.density, rel=1e-14)
    lattice = uniform.tessellation.lattice
    neighbours = make_neighbours(uniform, start_positions(uniform), lattice)
    assert neighbours.topology.particles == neighbours.topology.walls
    assert neighbours.mass.sum() == pytest.approx(uniform.mass * cells, rel=1e-14)
    density = neighbours.topology.fluid_mass / uniform.tessellation.areas
    np.testing.assert_allclose(density, uniform.fluid_density, rtol=1e-14)
