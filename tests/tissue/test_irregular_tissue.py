"""Full tissue of any arrangement and fluid: identities, the RVE within it, outlines, a bath."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import skfem

from surrofe2.base.errors import InputError
from surrofe2.base.simd import TILE
from surrofe2.plant_cell.arrangement import make_arrangement, rim_areas
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.problem import (
    BodyForce,
    Fixed,
    InitialVelocity,
    Pressure,
    Problem,
    Traction,
    rectangle,
)
from surrofe2.rve.particles import look_into
from surrofe2.rve.unit_cell import make_unit_cell
from surrofe2.tissue import TissueDynamics, TissueSettings, make_tissue, simulate_tissue
from surrofe2.tissue.outline import on_outline, outlines
from surrofe2.tissue.simulation import make_conditions, meet_bodies, plant_cells_within
from tests.numerics import assert_near, turn
from tests.tissue.motion import assert_force_is_minus_the_gradient_of_the_energy, placed, shaken

CELLS = {
    "voronoi": {"arrangement": "voronoi", "cells": 4},
    "undrained voronoi": {"arrangement": "voronoi", "cells": 4, "sap_bulk_modulus": 2200.0},
    "hexagon": {"arrangement": "hexagon"},
    "hexagons of sph": {"arrangement": "hexagon", "fluid": "sph"},
    "square": {"fluid": "uniform"},
    "four squares of sph": {"cells": 4},
}


@cache
def unit_of(name):
    return make_unit_cell(CellParameters.preset("printed", **CELLS[name]))


@pytest.fixture(params=CELLS)
def unit(request):
    return unit_of(request.param)


def tissue_of(unit, periods=(2, 2), missing=()):
    """Whole periods, but for the plant cells at the indices `missing`."""
    kind = np.zeros((*periods, unit.cell.cells), dtype=int)
    for cell in missing:
        kind[cell] = -1
    return make_tissue([unit.cell], [unit.reference], kind)


def test_mass_is_that_of_the_macro_scale(unit):
    tissue = tissue_of(unit, (3, 2))
    area = 6 * abs(np.linalg.det(unit.reference.lattice))
    assert tissue.mass.sum() == pytest.approx(unit.cell.density * area, rel=0.02)
    fluid = 6 * unit.cell.fluid_density * unit.cell.cells * unit.cell.cell_side**2
    walls = tissue.mass.sum() - fluid
    inner = unit.cell.wall_particle_mass * make_arrangement(unit.cell).walls
    assert walls == pytest.approx(6 * inner, rel=1e-12)


@pytest.mark.parametrize("missing", [(), ((0, 1, 0),), ((1, 1, 0), (2, 0, 0))])
def test_forces_sum_to_zero_and_are_minus_the_gradient_of_the_energy(unit, missing):
    """Of whole periods, and of a tissue with plant cells missing along its side and within."""
    tissue = tissue_of(unit, (3, 2), missing)
    x, v = shaken(tissue)
    f = placed(tissue, x, v).forces()
    assert abs(f.sum(axis=0)).max() < 1e-14 * abs(f).max() * len(f)
    assert_force_is_minus_the_gradient_of_the_energy(tissue, x, step=1e-5, directions=2)


def test_moved_and_turned_tissue_has_turned_forces(unit):
    """A motion of velocities turns with it; a spin of a uniform fluid takes no power."""
    tissue = tissue_of(unit)
    (x, v), Q = shaken(tissue), turn(0.7)
    here, there = placed(tissue, x, v), placed(tissue, x @ Q.T + [30.0, -700.0], v @ Q.T + 3.0)
    assert_near(there.forces(), here.forces() @ Q.T, 1e-10)
    assert there.elastic_energy() == pytest.approx(here.elastic_energy(), rel=1e-12)
    assert there.dissipation_rate() == pytest.approx(here.dissipation_rate(), rel=1e-9)
    if unit.cell.has_uniform_fluid:
        spin = placed(tissue, x, x @ np.array([[0.0, 0.01], [-0.01, 0.0]]))
        assert abs(spin.dissipation_rate()) < 1e-10 * here.dissipation_rate()


F = np.array([[1.04, 0.05], [-0.03, 0.97]])
F_DOT = np.array([[0.01, -0.004], [0.006, 0.008]])


def repeated(unit, tissue, z, F, F_dot):
    """Positions and velocities of a tissue whose periods are all the RVE z at F, F_dot."""
    at = tissue.column_row + tissue.lowest + tissue.origin
    tile, particle, lane = tissue.address.T
    places = z[particle] + (at @ unit.reference.lattice.T)[tile * TILE + lane]
    return places @ F.T, places @ F_dot.T


def test_a_tissue_that_moves_as_rves_has_their_forces_and_stress(unit):
    """Inside, forces of an RVE that is not at rest; of the virials of n × n periods the second
    difference by n, which no surface enters, is twice the RVE's stress times its area."""
    wobble = 0.1 * np.random.default_rng(1).uniform(-1, 1, unit.position.shape)
    z = unit.position + wobble
    rve = look_into(unit, F[None], F_DOT[None], z[None], 0.0 * z[None])
    virials = []
    for n in (4, 5, 6):
        tissue = tissue_of(unit, (n, n))
        x, v = repeated(unit, tissue, z, F, F_DOT)
        f = placed(tissue, x, v).forces()
        virials.append(-np.einsum("na,nb->ab", f, x))
    middle = tissue.place[tuple(np.array([3, 3]) - tissue.lowest)]
    inside = tissue.address[:, 0] * TILE + tissue.address[:, 2] == middle
    particle = tissue.address[inside, 1]
    assert_near(f[inside], rve.force[0, particle], 1e-10)
    stress = 0.5 * (virials[2] - 2.0 * virials[1] + virials[0])
    stress /= np.linalg.det(F) * abs(np.linalg.det(unit.reference.lattice))
    assert_near(stress, rve.stress[0], 1e-9)


def test_free_oscillation_keeps_its_energy():
    """Kinetic and stored energy fall by what is dissipated; the rest is of the step's order."""
    unit = unit_of("voronoi")
    lattice = unit.reference.lattice
    thrown = InitialVelocity(name="thrown", on="right", velocity=(2.0, 1.0))
    problem = Problem(
        mesh=rectangle(2.0 * lattice[0, 0], 2.0 * lattice[1, 1], (2, 2)),
        conditions=(thrown,), duration=2.0, output_interval=0.5, watched={"end": (100.0, 50.0)},
    )  # fmt: skip
    off = []
    for step in (1e-3, 5e-4):
        settings = TissueSettings(micro_step=step, frames=2, energy_steps=2, residual=1e-8)
        done = simulate_tissue(problem, unit.cell, settings, reference=unit.reference)
        energies = done.energies
        off.append(abs(energies["balance"]).max() / energies["kinetic"][0])
    assert energies["dissipated"][-1] > 0.05 * energies["kinetic"][0]
    assert off[1] < 2e-3
    assert 1.5 < off[0] / off[1] < 3.0


def test_undrained_sap_keeps_the_area_of_a_loaded_cell():
    pulled = {}
    for name in ("voronoi", "undrained voronoi"):
        unit = unit_of(name)
        lattice = unit.reference.lattice
        pull = Traction(name="pull", on="right", traction=(20.0, 0.0))
        problem = Problem(
            mesh=rectangle(2.0 * lattice[0, 0], 2.0 * lattice[1, 1], (2, 2)),
            conditions=(Fixed(name="clamp", on="left"), pull), duration=4.0, output_interval=1.0,
            watched={"end": (100.0, 50.0)},
        )  # fmt: skip
        settings = TissueSettings(frames=2)
        done = simulate_tissue(problem, unit.cell, settings, reference=unit.reference)
        ends = done.position, done.position + done.frames.displacement[-1]
        tissue = make_conditions(problem, unit.cell, unit.reference).tissue
        before, after = (areas_of(tissue, x) for x in ends)
        pulled[name] = abs(after / before - 1.0).max()
    assert pulled["undrained voronoi"] < 0.05 * pulled["voronoi"]


def areas_of(tissue, x):
    """(plant cells,) areas of a tissue whose particles are at x, by the shoelace formula."""
    areas = []
    for rim in rims_of(tissue):
        here = x[rim]
        there = np.roll(here, -1, axis=0)
        areas.append(0.5 * np.sum(here[:, 0] * there[:, 1] - here[:, 1] * there[:, 0]))
    return np.array(areas)


def rims_of(tissue):
    """Numbers of the wall particles around each plant cell, counter-clockwise."""
    number = tissue.number
    for a, b, c in np.argwhere(tissue.kind >= 0):
        rim = tissue.arrangement.rims[c]
        at = np.array([a, b]) - tissue.lowest + rim[:, 1:]
        yield number[tissue.place[tuple(at.T)], rim[:, 0]]


@pytest.mark.parametrize("name", ["voronoi", "hexagon", "square"])
def test_a_bath_is_the_pressure_on_the_outline(name):
    """An osmotic pressure around every plant cell, whose areas sum to that of the tissue: its work
    is that of the pressure on the outline, particle by particle."""
    unit = unit_of(name)
    lattice = unit.reference.lattice
    sides = 3 * lattice[0, 0], 4 * lattice[1, 1]
    around = tuple(
        Pressure(name=side, on=side, pressure=40.0) for side in ("left", "right", "bottom", "top")
    )
    problem = Problem(
        mesh=rectangle(*sides, (2, 2)), conditions=around, duration=1.0, output_interval=1.0,
        watched={"end": sides},
    )  # fmt: skip
    conditions = make_conditions(problem, unit.cell, unit.reference)
    tissue = conditions.tissue
    dynamics = TissueDynamics(tissue, loads=conditions.dead_loads())
    meet_bodies(dynamics, conditions, dynamics.x)
    x, _ = shaken(tissue, amount=0.3)
    dynamics.place(x)
    pushed = dynamics.forces(amplitudes=np.ones(4)) - dynamics.forces(with_outline=False)
    slope = np.zeros_like(x)
    for rim in rims_of(tissue):
        along = 0.5 * (x[np.roll(rim, -1)] - x[np.roll(rim, 1)])
        slope[rim] += np.stack([along[:, 1], -along[:, 0]], axis=1)
    assert_near(pushed, -40.0 * slope, 1e-12)
    assert abs(pushed).max() > 10.0


def test_plant_cells_at_rest_have_the_areas_of_the_rve():
    unit = unit_of("voronoi")
    tissue = tissue_of(unit, (2, 3))
    areas = areas_of(tissue, tissue.to_particles(tissue.start)).reshape(2, 3, -1)
    rims = make_arrangement(unit.cell).rims
    expected = rim_areas(rims, unit.position, unit.reference.lattice)
    np.testing.assert_allclose(areas, np.broadcast_to(expected, areas.shape), rtol=1e-12)


@pytest.mark.parametrize("name", ["voronoi", "hexagon"])
def test_sides_of_irregular_tissue_have_their_whole_length(name):
    """Tractions have the resultant of FE², and the particles of a side lie by it."""
    unit = unit_of(name)
    lattice = unit.reference.lattice
    width, height = 4 * lattice[0, 0], 4 * lattice[1, 1]
    loads = tuple(
        Traction(name=side, on=side, traction=(3.0, -2.0))
        for side in ("left", "right", "bottom", "top")
    )
    problem = Problem(
        mesh=rectangle(width, height, (2, 2)), conditions=loads, duration=1.0, output_interval=1.0,
        watched={"end": (width, height)},
    )  # fmt: skip
    conditions = make_conditions(problem, unit.cell, unit.reference)
    assert (conditions.tissue.kind >= 0).sum() == 16 * unit.cell.cells
    total = conditions.dead_loads().sum(axis=1)
    lengths = np.array([height, height, width, width])
    np.testing.assert_allclose(total, np.outer(lengths, [3.0, -2.0]), rtol=1e-12)
    places = conditions.outline_places
    start = conditions.tissue.to_particles(conditions.tissue.start)
    left = conditions.boundary("left")
    assert (abs(places[left, 0]) < 1e-9).all()
    assert abs(start[left, 0]).max() < unit.cell.cell_side
    assert abs(start[left, 1] - places[left, 1]).max() < unit.cell.cell_side


def test_places_on_an_outline_never_go_back():
    ring = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 4.0], [0.0, 4.0]])
    around = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    size = 1.0 + 0.2 * np.sin(11.0 * around)
    walls = [5.0, 2.0] + np.stack([5.0 * np.cos(around), 2.0 * np.sin(around)], 1) * size[:, None]
    places = on_outline(walls, [ring])
    steps = np.linalg.norm(np.roll(places, -1, axis=0) - places, axis=1)
    assert steps.sum() == pytest.approx(28.0, rel=1e-12)  # so that it goes round once, never back
    for corner in ring:
        there = np.sort(np.linalg.norm(places - corner, axis=1))
        assert there[0] < 1e-12
        assert there[1] > 1e-6  # so that no bond is on two sides


def test_a_round_tissue_has_the_plant_cells_whose_middles_it_holds():
    """A disc with a hole, of squares, by a mesh: its weight, its outlines, its loads."""
    mesh = skfem.MeshTri.init_circle(4)
    mesh = skfem.MeshTri(300.0 * mesh.p + 400.0, mesh.t)
    centres = mesh.p[:, mesh.t].mean(axis=1).T
    ring = mesh.restrict(np.flatnonzero(np.linalg.norm(centres - 400.0, axis=1) > 80.0))
    cell = CellParameters.preset("printed", fluid="uniform")
    unit = make_unit_cell(cell)
    weight = BodyForce(name="weight", acceleration=(0.0, -1.0))
    problem = Problem(
        mesh=ring, conditions=(weight,), duration=1.0, output_interval=1.0,
        watched={"end": (400.0, 680.0)},
    )  # fmt: skip
    assert len(outlines(problem.mesh)) == 2
    conditions = make_conditions(problem, cell, unit.reference)
    tissue = conditions.tissue
    radius = np.linalg.norm(tissue.middles[tissue.kind >= 0] - 400.0, axis=-1)
    assert 65.0 < radius.min() < radius.max() < 300.0
    area = (tissue.kind >= 0).sum() * 625.0
    assert conditions.dead_loads()[0, :, 1].sum() == pytest.approx(-cell.density * area, rel=1e-12)
    x, v = shaken(tissue)
    f = placed(tissue, x, v).forces()
    assert abs(f.sum(axis=0)).max() < 1e-14 * abs(f).max() * len(f)


def test_an_outline_that_holds_too_few_cells_is_named():
    unit = unit_of("voronoi")
    problem = Problem(mesh=rectangle(30.0, 30.0, (1, 1)), conditions=(), duration=1.0)
    with pytest.raises(InputError, match=r"^mesh: its 900 µm² hold the middles of .* whole RVEs"):
        plant_cells_within(problem, unit.cell, unit.reference)


def test_a_wall_between_two_types_is_half_of_each():
    """Forces and masses of A|B and B|A add up to those of A|A and B|B at the same particles."""
    one = unit_of("voronoi")
    other = replace(
        one.cell, wall_stiffness=5000.0, wall_particle_mass=0.7, viscosity=0.2, sound_speed=45.0,
        fluid_particle_mass=3.0,
    )  # fmt: skip
    at_rest = replace(one.reference, fingerprint=other.fingerprint, rest_length=1.2)
    first = np.array([[[0, 1, 1, 0]], [[1, 0, 0, 1]]])
    kinds = first, 1 - first, 0 * first, 0 * first + 1
    tissues = [make_tissue([one.cell, other], [one.reference, at_rest], kind) for kind in kinds]
    forces, masses = [], []
    for tissue in tissues:
        dynamics = placed(tissue, *shaken(tissues[0], amount=0.3))
        forces.append(dynamics.forces())
        masses.append(dynamics.mass)
    for ab, ba, aa, bb in (forces, masses):
        np.testing.assert_allclose(ab + ba, aa + bb, rtol=0, atol=1e-11 * abs(ab).max())
        assert abs(ab - ba).max() > 1e-3 * abs(ab).max()
