"""RVEs with a uniform fluid: closed forms, exact tangents, stability, objectivity, one branch."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.base.simd import TILE, pack
from surrofe2.law.stress_law import Status
from surrofe2.plant_cell.arrangement import make_arrangement, rim_areas
from surrofe2.plant_cell.block_matrices import dense_pattern
from surrofe2.plant_cell.neighbours import make_neighbours
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import RveLaw
from surrofe2.rve.newton import CHECK, newton
from surrofe2.rve.particles import look_into
from surrofe2.rve.rve_state import Drive, Factors, empty_answer, stored_energy
from surrofe2.rve.unit_cell import relax, unit_around
from tests.numerics import assert_near, fine_slope_along, slope_along, turn

RVES = {
    "square": {"arrangement": "square"},
    "hexagon": {"arrangement": "hexagon"},
    "voronoi": {"arrangement": "voronoi", "cells": 4},
    "undrained": {"arrangement": "voronoi", "cells": 4, "sap_bulk_modulus": 200.0},
}


@cache
def law(name, initialisation="elastic", preset="printed"):
    cell = CellParameters.preset(preset, fluid="uniform", **RVES[name])
    return RveLaw(cell, initialisation=initialisation)


def deformations(count, size, seed=0):
    """F with entries of F − I, and Ḟ with entries (1/µs), up to `size` and a fifth of it."""
    rng = np.random.default_rng(seed)
    F = np.eye(2) + size * rng.uniform(-1, 1, (count, 2, 2))
    return F, 0.2 * size * rng.uniform(-1, 1, (count, 2, 2))


F, F_DOT = deformations(8, 0.04)


def piola(answer, F):
    """P of an answer at F."""
    return np.linalg.det(F)[:, None, None] * answer.stress @ np.linalg.inv(F).swapaxes(1, 2)


def test_a_square_without_contacts_has_the_moduli_of_its_walls_and_pressure():
    cell = CellParameters(fluid="uniform", repulsion_strength=1e-30)
    this = RveLaw(cell, initialisation="elastic")
    rest = np.eye(2)[None]
    C = this.respond(rest, 0.0 * rest, tangents=True).tangents.P_by_F[0]
    p = cell.fluid_density * cell.sound_speed**2
    assert cell.wall_stiffness * (cell.spring_length - this.rest_length) == pytest.approx(
        p * cell.cell_side, rel=1e-12
    )
    stretched = cell.wall_stiffness * cell.spring_length / cell.cell_side + p
    assert C[0, 0, 0, 0] == pytest.approx(stretched, rel=1e-12)
    assert C[0, 0, 1, 1] == pytest.approx(0.0, abs=1e-12 * stretched)
    assert C[0, 1, 0, 1] == pytest.approx(p, rel=1e-12)


@pytest.mark.parametrize("name", RVES)
def test_areas_of_a_relaxed_rve_add_up_to_its_own(name):
    this = law(name)
    z = this.respond(F, F_DOT).state.z
    lattice, rims = this.reference.lattice, this.particles(F, F_DOT).rims
    for k in range(len(F)):
        areas = rim_areas(rims, z[0, :, :, k].T @ F[k].T, F[k] @ lattice)
        expected = np.linalg.det(F[k]) * np.linalg.det(lattice)
        assert areas.sum() == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize("name", RVES)
def test_stress_is_the_slope_of_the_least_energy(name):
    this = law(name)
    unit, (direction,) = this.unit_cell, deformations(1, 1.0, seed=3)[0] - np.eye(2)

    def energy(F):
        state = this.respond(F, 0.0 * F).state
        z = np.moveaxis(state.z, -1, 1).reshape(-1, *state.z.shape[1:3])[: len(F)]
        return stored_energy(F, z, unit.topology, unit.constants) / unit.topology.area

    slope = fine_slope_along(energy, F, direction, 2e-4)
    power = (piola(this.respond(F, 0.0 * F), F) * direction).sum(axis=(1, 2))
    assert_near(slope, power, 1e-8)


@pytest.mark.parametrize("initialisation", ["elastic", "constrained-runs", "slow-manifold"])
@pytest.mark.parametrize("name", RVES)
def test_tangents_are_exact(name, initialisation):
    if initialisation == "slow-manifold" and name in ("square", "hexagon"):
        pytest.skip("the same with several plant cells")
    this = law(name, initialisation, "apple")
    F, F_dot = away_from_kinks(this, *deformations(24, 0.03, seed=7))
    tangents = this.respond(F, F_dot, tangents=True).tangents
    for exact, at in (
        (tangents.P_by_F, lambda h: (F + h, F_dot)),
        (tangents.P_by_F_dot, lambda h: (F, F_dot + h)),
    ):
        slope = [
            fine_slope_along(
                lambda h, at=at: piola(this.respond(*at(h)), at(h)[0]), 0.0, unit, 1e-4
            )
            for unit in np.eye(4).reshape(4, 2, 2)
        ]
        assert_near(np.stack(slope, axis=-1).reshape(exact.shape), exact, 1e-8)


def test_crushed_tissue_has_exact_tangents():
    """Walls that matrices hold no blocks for touch here; simple refinement does not converge."""
    cell = CellParameters.preset("apple", arrangement="voronoi", cells=9, arrangement_seed=1)
    this = RveLaw(cell, initialisation="elastic")
    F = np.array([[[0.84044, -0.04403], [-0.04403, 0.85671]]])
    answer = this.respond(F, 0.0 * F, tangents=True)
    assert answer.status[0] == Status.OK
    # beside others in its tile, which need fewer directions
    others = np.concatenate([np.eye(2)[None], F, 1.02 * np.eye(2)[None]])
    together = this.respond(others, 0.0 * others, tangents=True).tangents.P_by_F
    for k, at in enumerate(others):
        alone = this.respond(at[None], 0.0 * at[None], tangents=True).tangents.P_by_F
        assert_near(together[k], alone[0], 1e-9)
    tangents = answer.tangents.P_by_F.reshape(4, 4)
    assert_near(tangents.T, tangents, 1e-9)  # as of the slope of an energy
    for exact, unit in zip(tangents.T, np.eye(4).reshape(4, 2, 2), strict=True):
        slope = slope_along(
            lambda h: piola(this.respond(F + h, 0.0 * F, answer.state), F + h), 0.0, unit, 1e-4
        )
        assert_near(slope.reshape(4), exact, 3e-5)  # many pairs are near the cut-off


def away_from_kinks(this, F, F_dot):
    """The two of the points at which no pair is near the cut-off."""
    topology, z = this.unit_cell.topology, this.respond(F, F_dot).state.z
    z = np.moveaxis(z, -1, 1).reshape(-1, *z.shape[1:3])[: len(F)]
    local = np.concatenate([z, z[:, :, topology.owner] + topology.image_offset.T], axis=2)
    i, j = topology.contacts.T
    length = np.linalg.norm(F @ (local[:, :, j] - local[:, :, i]), axis=1)
    nearest = abs(length - this.cell.repulsion_cutoff).min(axis=1)
    chosen = np.argsort(nearest)[-2:]
    assert nearest[chosen].min() > 1e-4 * this.cell.repulsion_cutoff
    return F[chosen], F_dot[chosen]


@pytest.mark.parametrize("name", RVES)
def test_a_look_into_an_rve_agrees_with_the_kernels(name):
    this = law(name, "constrained-runs")
    answer, seen = this.respond(F, F_DOT), this.particles(F, F_DOT)
    assert_near(seen.stress, answer.stress, 1e-10)
    assert abs(seen.force).max() < 1e-6
    assert seen.pressure.shape == seen.density.shape == seen.area_ratio.shape
    assert (seen.contact_pressure > 0.0).all()
    assert seen.extremes()["highest_fluid_pressure_MPa"].shape == (8,)


def test_contact_pressure_is_the_pressure_beyond_the_wall():
    """Between plant cells of unequal pressures a wall bears the higher one; viscosity is off."""
    this = law("undrained")
    seen = this.particles(F, 0.0 * F_DOT)
    highest = np.zeros_like(seen.contact_pressure)
    for k, rim in enumerate(seen.rims):
        np.maximum.at(highest.T, rim[:, 0], np.tile(seen.pressure[:, k], (len(rim), 1)))
    np.testing.assert_allclose(seen.contact_pressure, highest, rtol=1e-12)


def test_constitutive_law_of_the_sap():
    """p A is constant where it is drained; K adds K (A₀/A − 1) from the area at rest."""
    drained, undrained = law("voronoi"), law("undrained")
    np.testing.assert_array_equal(drained.reference.position, undrained.reference.position)
    assert drained.reference.fingerprint != undrained.reference.fingerprint
    seen = undrained.particles(F, F_DOT)
    cell = undrained.cell
    osmotic = cell.sound_speed**2 * seen.density
    expected = osmotic / cell.tissue_thickness + 200.0 * (1.0 / seen.area_ratio - 1.0)  # MPa
    np.testing.assert_allclose(seen.pressure, expected, rtol=1e-10)
    assert abs(seen.area_ratio / np.linalg.det(F)[:, None] - 1.0).max() < 0.01
    with pytest.raises(
        InputError, match=r"cell.sap_bulk_modulus: 5.0; with fluid sph it must be 0"
    ):
        CellParameters(sap_bulk_modulus=5.0)


@pytest.mark.parametrize("name", RVES)
def test_stress_turns_with_the_rve(name):
    for initialisation in ("elastic", "constrained-runs"):
        this, Q = law(name, initialisation), turn(0.9)
        spin = np.array([[0.0, -0.01], [0.01, 0.0]])
        stress = this.respond(F, F_DOT).stress
        turned = this.respond(Q @ F, Q @ F_DOT + spin @ Q @ F).stress
        # dashpots of walls and contacts know no spin, and neither does the uniform fluid
        assert_near(turned, Q @ stress @ Q.T, 1e-11)
        np.testing.assert_allclose(
            stress, stress.swapaxes(1, 2), rtol=0, atol=1e-9 * abs(stress).max()
        )


def test_groups_with_pressures_solve_what_dense_matrices_do():
    this = law("voronoi")
    unit, sparse = this.unit_cell, this.unit_cell.topology
    assert len(sparse.width) > 1
    dense = sparse._replace(**dense_pattern(sparse.particles, sparse.pressures)._asdict())
    starts = np.broadcast_to(unit.position.T, (len(F), *unit.position.T.shape))
    mine, theirs = (relax(each, unit.constants, starts, F) for each in (sparse, dense))
    assert mine.stable.all()
    np.testing.assert_allclose(mine.z, theirs.z, rtol=0, atol=1e-10)
    np.testing.assert_array_equal(mine.iterations, theirs.iterations)


@pytest.mark.parametrize("pattern", ["groups", "dense"])
def test_stability_is_that_of_the_eigenvalues(pattern):
    """Of random states around the equilibrium, with and without unstable modes."""
    this = law("voronoi")
    unit, topology = this.unit_cell, this.unit_cell.topology
    dense = topology._replace(**dense_pattern(topology.particles, topology.pressures)._asdict())
    rng = np.random.default_rng(0)
    size = np.linspace(0.0, 0.6, 2 * TILE)[:, None, None]
    z = unit.position.T + size * rng.normal(size=(2 * TILE, 2, topology.particles))
    z[:, :, 0] = 0.0
    F = pack(np.broadcast_to(np.eye(2), (2 * TILE, 2, 2)))
    tiles, answer = pack(z), empty_answer(2)
    used = topology if pattern == "groups" else dense
    task = np.full(2, CHECK, dtype=np.int8)
    drive = Drive(F, 0.0 * F)
    addresses = Factors.empty(drive, tiles, used).address
    newton(drive, tiles, addresses, task, used, unit.constants, 0.0, answer)
    expected = [definite(unit, each) for each in z]
    assert 2 < sum(expected) < 2 * TILE - 2
    np.testing.assert_array_equal(answer.stable.ravel(), expected)


def definite(unit, z):
    """Whether the elastic Hessian is positive definite, by differences of the forces."""
    n = z.shape[1]

    def forces(x):
        each = x.reshape(-1, n, 2)
        F = np.broadcast_to(np.eye(2), (len(each), 2, 2))
        return look_into(unit, F, 0.0 * F, each, 0.0 * each).force.reshape(len(each), -1)

    units = 1e-6 * np.eye(2 * n)[2:]
    slopes = (forces(z.T.ravel() + units) - forces(z.T.ravel() - units))[:, 2:]
    return np.linalg.eigvalsh(-(slopes + slopes.T))[0] > 0.0


@pytest.mark.parametrize("preset", ["printed", "water", "apple"])
def test_random_states_of_irregular_cells_stay_on_their_branch(preset):
    F, _ = deformations(16, 0.04, seed=11)
    assert_on_one_branch(law("voronoi", "elastic", preset), F)


def assert_on_one_branch(this, F):
    """No state leaves its branch, and the stress is the same by way of the shear alone."""
    answer = this.respond(F, 0.0 * F)
    assert (answer.status == Status.OK).all()
    assert answer.left_bifurcation is None
    sheared = F.copy()
    sheared[:, 0, 0] = 1.0
    sheared[:, 1, 1] = 1.0
    there = this.respond(F, 0.0 * F, this.respond(sheared, 0.0 * F).state)
    pressure = this.cell.fluid_density * this.cell.sound_speed**2
    np.testing.assert_allclose(there.stress, answer.stress, rtol=0, atol=1e-9 * pressure)


def test_paths_from_moving_states_are_not_said_to_leave_their_branch():
    """Dashpots of constrained runs move walls farther than steps along a path are checked by."""
    this = law("voronoi", "constrained-runs", "water")
    near, _ = deformations(8, 0.02, seed=1)
    far, rate = deformations(8, 0.08, seed=2)
    moving = this.respond(near, 5.0 * rate).state
    answer = this.respond(far, 0.0 * rate, moving)
    assert answer.effort["newton_solves"] >= 8  # kept factors do not lead there
    assert answer.left_bifurcation is None
    expected = this.respond(far, 0.0 * rate)
    assert_near(answer.stress, expected.stress, 1e-9)


def test_cells_of_unequal_areas_and_long_cells_have_rves():
    """Equal walls make long cells rounder at rest: facts say what is left of what was laid out."""
    shaped = CellParameters(
        arrangement="voronoi",
        cells=9,
        area_variation=0.3,
        elongation=1.8,
        elongation_direction=90.0,
    )
    this = RveLaw(shaped, initialisation="elastic")
    F, _ = deformations(8, 0.02)
    answer = this.respond(F, 0.0 * F)
    assert (answer.status == Status.OK).all()
    assert answer.left_bifurcation is None
    facts = this.facts()
    assert 0.3 < float(facts["variation of areas"]) < 0.5
    assert 1.35 < float(facts["mean aspect ratio"]) < 1.8


@pytest.mark.parametrize("name", RVES)
def test_reference_is_free_of_stress(name):
    this, rest = law(name), np.eye(2)[None]
    stress = this.respond(rest, 0.0 * rest).stress
    assert abs(stress).max() < 1e-9 * this.cell.fluid_density * this.cell.sound_speed**2


WATER = {"arrangement": "voronoi", "cells": 9, "arrangement_seed": 2, "sap_bulk_modulus": 2200.0}


@cache
def undrained_water():
    """Walls pre-stretched by a little, and sap as stiff as water: the case that bends most."""
    cell = CellParameters.preset("water", **WATER)
    return RveLaw(cell, initialisation="elastic")


def mirrored(this):
    """The law of the mirror image of an RVE: x turned around, rims run the other way."""
    unit, flip = this.unit_cell, np.array([-1.0, 1.0])
    arrangement = make_arrangement(this.cell)
    turned_around = replace(arrangement, rims=tuple(rim[::-1] for rim in arrangement.rims))
    position, lattice = unit.position * flip, unit.reference.lattice * flip[:, None]
    neighbours = make_neighbours(this.cell, position, lattice, arrangement=turned_around)
    other = RveLaw(this.cell, this.settings, reference=this.reference)
    reference = replace(this.reference, position=position, lattice=lattice)
    other.unit_cell = unit_around(this.cell, reference, neighbours)
    return other


def test_large_steps_keep_to_the_branch():
    """From a state 8 % away kept factors lead to an equilibrium, but not always to this branch."""
    F, _ = deformations(24, 0.08, seed=2)
    assert_on_one_branch(undrained_water(), F)


@pytest.mark.slow
def test_rotated_and_mirrored_rves_take_the_rotated_and_mirrored_branch():
    """Far beyond where branches end; compared where they do and where they do not."""
    this, Q, M = undrained_water(), turn(0.7), np.diag([-1.0, 1.0])
    F, _ = deformations(24, 0.3, seed=3)
    answer = this.respond(F, 0.0 * F)
    assert answer.left_bifurcation.sum() >= 2
    pressure = this.cell.fluid_density * this.cell.sound_speed**2
    rotated, image = this.respond(Q @ F, 0.0 * F), mirrored(this).respond(M @ F @ M, 0.0 * F)
    for other, back in ((rotated, Q.T), (image, M)):
        np.testing.assert_array_equal(other.status, answer.status)
        np.testing.assert_array_equal(other.left_bifurcation, answer.left_bifurcation)
        stress = back @ other.stress @ back.T
        np.testing.assert_allclose(stress, answer.stress, rtol=0, atol=1e-9 * pressure)
