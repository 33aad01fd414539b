"""A surface law by slabs: what it is by identities, and what the tissue says of it."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import brentq

from surrofe2.base.errors import InputError, MismatchError
from surrofe2.base.simd import unpack
from surrofe2.plant_cell.arrangement import make_slab_arrangement
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import INITIALISATIONS, RveLaw
from surrofe2.rve.rve_state import stored_energy
from surrofe2.surface import SlabLaw
from surrofe2.surface.slab import GAP, TURN, bend, make_slab
from surrofe2.surface.slab_law import rows_across, side_free
from surrofe2.tissue import TissueDynamics, make_tissue, relax
from tests.numerics import slope_along
from tests.surface.slab_twin import SlabTwin

SLOW = "slow-manifold"
STRETCH = np.array([0.971, 0.988, 1.0, 1.012, 1.027])
RATE = np.array([0.004, -0.003, 0.002, 0.001, -0.005])


@cache
def slab(preset="water", initialisation=SLOW, rows=4, **changes):
    cell = CellParameters.preset(preset, **changes)
    return SlabLaw(cell, initialisation=initialisation, rows=rows)


def starts(law):
    """(n, 2) where a slab's particles are before they relax."""
    cell, rows = law.cell, law.rows
    made = make_slab_arrangement(cell, rows, GAP * cell.repulsion_cutoff)
    fluid = law.law.reference.position[2 * cell.wall_springs_per_side - 1 :]
    up = [fluid + np.array([0.0, k * cell.cell_side]) for k in range(rows)]
    return np.concatenate([made.wall_position, *up])


def moving(law, stretch, rate):
    """x and v (n, 2) of a slab at one point."""
    at = law.point(np.array([stretch]), np.array([rate]))
    state, F, F_dot = at.solution.state, at.bulk.F[0], at.bulk.F_dot[0]
    z, beyond = (unpack(each, 1)[0].T for each in (state.z, state.beyond_affine))
    return z @ F.T, z @ F_dot.T + beyond, at.resultant[0]


@pytest.mark.parametrize("outer_wall", [1.7, pytest.param(1.0, marks=pytest.mark.slow)])
def test_columns_pull_each_other_with_the_resultant_and_every_particle_is_in_balance(outer_wall):
    law = slab(rows=2, outer_wall=outer_wall)
    x, v, resultant = moving(law, 0.985, 0.004)
    f, pull, _ = SlabTwin(law.cell, law.law.rest_length, starts(law), 2).forces(x, v, 0.985, 0.004)
    assert np.hypot(*f.T).max() < 1e-6
    assert resultant == pytest.approx(pull, rel=1e-9)


@pytest.mark.parametrize(
    ("preset", "depth"),
    [("water", 4.79), pytest.param("printed", 13.52, marks=pytest.mark.slow)],
)
def test_what_a_side_lacks_of_stiffness_lies_within_the_outer_plant_cell(preset, depth):
    law, moments, d = slab(preset, rows=6), [], 1e-4
    half, twin = 0.5 * law.thickness, SlabTwin(law.cell, law.law.rest_length, starts(law), 6)
    for stretch in (1.0 - d, 1.0 + d):
        x, v, _ = moving(law, stretch, 0.0)
        bulk = side_free(law.law, np.array([stretch]), np.zeros(1))
        moment = twin.forces(x, v, stretch, 0.0)[2] / bulk.F[0, 1, 1]
        moments.append(moment - half**2 * bulk.P[0])
    by_stretch = law.respond(np.ones(1), np.zeros(1), tangents=True).tangent[0]
    arm = np.diff(moments)[0] / (2.0 * d) / (2.0 * by_stretch)
    assert half - arm == pytest.approx(depth, abs=0.02)


@pytest.mark.parametrize("preset", ["water", pytest.param("printed", marks=pytest.mark.slow)])
def test_a_bent_slab_says_where_its_sides_act(preset):
    """Walls stand in lines: that resists bending by some α E h³ for each plant cell across, which
    lumped with the sides shifts the depth at which they act by α E h²/(−2 P_s′), whatever m.
    """
    excess, at = [], (4, 6, 8)
    for m in at:
        law = slab(preset, rows=m)
        _, surface, bulk = law.rest(m)
        half, lever = 0.5 * m * 25.0, 4.79 if preset == "water" else 13.52
        shift = (half - law.depth) ** 2 - (half - lever) ** 2
        excess.append(2.0 * surface.tangent[0] * shift / (bulk.slopes[0, 0] * 25.0**3))
    alpha = np.diff(excess) / np.diff(at)
    assert 0.0 < alpha.min() < alpha.max() < 1.0 / 6.0  # what lines alone have
    assert np.ptp(alpha) < 0.1 * alpha.max()
    assert np.ptp([slab(preset, rows=m).depth for m in at]) < 3.0


def test_a_slab_of_a_uniform_fluid_bends_too():
    """It finds its rest, bent, and its sides act between the outline and the middle."""
    law = slab("printed", rows=4, fluid="uniform")
    assert 0.0 < law.depth <= 0.5 * law.thickness


def columns_of(law, columns):
    """A tissue as wide as the slab: its dynamics, and of each particle column and slab's number."""
    cell, start = law.cell, starts(law)
    tissue = make_tissue([cell], [law.law.reference], np.zeros((columns, law.rows), dtype=int))
    place = tissue.to_particles(tissue.start)
    column = np.floor(place[:, 0] / cell.cell_side + 1e-6)
    start[:, 0] -= np.floor(start[:, 0] / cell.cell_side + 1e-6) * cell.cell_side
    along = np.stack([column * cell.cell_side, 0.0 * column], axis=1)
    nearest = np.linalg.norm((place - along)[:, None] - start, axis=2).argmin(axis=1)
    return TissueDynamics(tissue), column, nearest


@pytest.mark.slow
def test_bent_columns_are_at_rest_inside_a_tissue_and_turn_each_other():
    """The torque across a cut, by the forces on all that lies to one side of it."""
    law = slab(rows=3)
    stretch, _, bulk = law.rest(3)
    z = unpack(law.point(stretch, 0.0 * stretch).solution.state.z, 1)[0].T
    stiffness, x = bend(law.unit, bulk.F[0], z)
    dynamics, column, nearest = columns_of(law, 6)
    own = np.floor(starts(law)[:, 0] / law.cell.cell_side + 1e-6)
    radius = stretch[0] * law.cell.cell_side / TURN
    turn = TURN * (column - own[nearest] - 3.0)
    x, centre = x[nearest], np.array([0.0, radius])
    cos, sin = np.cos(turn), np.sin(turn)
    x = np.stack([
        cos * x[:, 0] - sin * x[:, 1] + radius * sin,
        sin * x[:, 0] + cos * x[:, 1] + 2.0 * radius * np.sin(0.5 * turn) ** 2,
    ], axis=1)  # fmt: skip
    dynamics.place(x)
    f, left = dynamics.forces(), column < 3
    assert abs(f[(column == 2) | (column == 3)]).max() < 1e-5
    arm = x[left] - centre
    torque = (arm[:, 0] * f[left, 1] - arm[:, 1] * f[left, 0]).sum()
    moment = torque - radius * f[left].sum(axis=0)[0]
    assert law.cell.cell_side * moment / TURN == pytest.approx(stiffness, rel=1e-3)


@pytest.mark.parametrize("outer_wall", [1.0, 1.7])
def test_a_slab_repeated_along_a_tissue_is_at_rest_inside_it(outer_wall):
    law, stretch = slab(rows=3, outer_wall=outer_wall), 0.99
    x, _, _ = moving(law, stretch, 0.0)
    dynamics, column, nearest = columns_of(law, 6)
    side = law.cell.cell_side
    own = np.floor(starts(law)[:, 0] / side + 1e-6)  # column of each of the slab's particles
    along = np.stack([(column - own[nearest]) * stretch * side, 0.0 * column], axis=1)
    dynamics.place(x[nearest] + along)
    middle = (column >= 2) & (column < 4)
    assert np.abs(dynamics.forces()[middle]).max() < 1e-6
    assert np.abs(dynamics.forces()).max() > 1.0  # at the ends


FLUIDS = {
    "sph": {},
    "uniform": {"fluid": "uniform"},
    "undrained": {"fluid": "uniform", "sap_bulk_modulus": 20.0},
}


@pytest.mark.parametrize("fluid", FLUIDS)
def test_tension_is_the_slope_of_the_energy_beyond_that_of_the_bulk(fluid):
    law, d, one = slab(**FLUIDS[fluid]), 4e-4, np.zeros(1)
    for stretch in (0.98, 1.0, 1.02):
        along = stretch + d * np.array([-2.0, -1.0, 1.0, 2.0])
        at = law.point(along, np.zeros(4))
        settled = law.law.respond(at.bulk.F, np.zeros((4, 2, 2)))
        of_slab, of_cell = (
            stored_energy(at.bulk.F, unpack(state.relaxed, 4), unit.topology, unit.constants)
            for unit, state in ((law.unit, at.solution.state), (law.law.unit_cell, settled.state))
        )
        beyond = of_slab - law.rows * of_cell
        slope = np.array([1.0, -8.0, 8.0, -1.0]) @ beyond / (12.0 * d)
        wanted = law.respond(np.array([stretch]), one).tension[0]
        assert 0.5 * slope / law.cell.cell_side == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parametrize(
    ("initialisation", "fluid"),
    [
        *((each, "sph") for each in INITIALISATIONS),
        ("constrained-runs", "undrained"),
        (SLOW, "uniform"),
    ],
)
def test_tangents_are_the_slopes(initialisation, fluid):
    law = slab(initialisation=initialisation, **FLUIDS[fluid])
    found = law.respond(STRETCH, RATE, tangents=True)
    assert found.valid.all()
    slope = slope_along(lambda at: law.respond(at, RATE).tension, STRETCH, 1.0, 2e-6)
    np.testing.assert_allclose(found.tangent, slope, rtol=1e-5)
    slope = slope_along(lambda at: law.respond(STRETCH, at).tension, RATE, 1.0, 1e-6)
    np.testing.assert_allclose(found.rate_tangent, slope, rtol=1e-4, atol=0.01)


@pytest.mark.parametrize("preset", ["water", pytest.param("printed", marks=pytest.mark.slow)])
def test_the_law_does_not_depend_on_the_thickness(preset):
    along, rate = np.linspace(0.96, 1.04, 9), 0.005 * np.cos(np.arange(9.0))
    few, *found = [slab(preset, rows=m).respond(along, rate).tension for m in (4, 6, 8, 10)]
    spread = np.ptp(found[0])
    assert np.ptp(found, axis=0).max() < 1e-3 * spread
    # The sides of few plant cells feel each other, by a fifth with each more.
    assert 5.0 * np.abs(found[0] - found[-1]).max() < np.abs(few - found[-1]).max() < 0.02 * spread


def test_images_of_a_slab_do_not_see_each_other():
    unit = slab().unit
    assert not unit.neighbours.shift[:, 1].any()
    height = np.ptp(unit.position[:, 1])
    assert unit.reference.lattice[1, 1] - height > 3.0 * unit.cell.repulsion_cutoff


def test_a_side_that_is_free_has_no_stress_across():
    for initialisation in INITIALISATIONS:
        law = RveLaw(CellParameters.preset("water"), initialisation=initialisation)
        rate = 0.0 * RATE if initialisation == "elastic" else RATE
        found = side_free(law, STRETCH, rate)
        stress = law.respond(found.F, found.F_dot).stress
        assert np.abs(stress[:, 1, 1]).max() < 1e-8
        np.testing.assert_allclose(found.P, stress[:, 0, 0] * found.F[:, 1, 1], rtol=1e-12)


@pytest.mark.parametrize(
    ("preset", "forces"),
    [
        ("water", {4: 1244.8, 8: 2614.2}),
        pytest.param("printed", {4: 2445.5, 8: 5004.7}, marks=pytest.mark.slow),
    ],
)
def test_a_strip_pulled_between_grips_has_the_force_of_slab_and_surface(preset, forces):
    # Tensile strips of docs/validation/tissue.md: force at a stretch of 1.03 beyond that at 1.
    law = slab(preset, rows=8)
    along, still = np.array([1.0, 1.03]), np.zeros(2)
    surface = np.diff(law.respond(along, still).tension)[0]
    bulk = np.diff(side_free(law.law, along, still).P)[0]
    for across, force in forces.items():
        resultant = np.diff(slab(preset, rows=across).point(along, still).resultant)[0]
        assert resultant == pytest.approx(force, rel=6e-4)
        by_law = across * law.cell.cell_side * bulk + 2.0 * surface
        assert by_law == pytest.approx(force, rel=1e-3)


def test_outer_rows_of_a_relaxed_tissue_shrink_as_those_of_the_slab():
    law, n, m = slab(rows=4), 14, 4
    at_rest = brentq(lambda at: law.point(np.array([at]), np.zeros(1)).resultant[0], 0.98, 1.0)
    x, start = moving(law, at_rest, 0.0)[0], starts(law)
    side = law.cell.cell_side
    along = np.abs((start[:, 0] + 1.0) % side - 1.0)  # corners may lie in the next column
    rows = [np.abs(along + np.abs(start[:, 1] - k * side)).argmin() for k in (0, 1)]
    tissue = make_tissue([law.cell], [law.law.reference], np.zeros((n, m), dtype=int))
    relaxed = relax(TissueDynamics(tissue), 1e-3)
    grid = [np.array([n // 2 * side, k * side]) for k in (0, 1)]
    at = [np.abs(tissue.laid_out - place).sum(axis=1).argmin() for place in grid]
    shrinks = side - np.diff(relaxed[at, 1])[0]
    assert side - np.diff(x[rows, 1])[0] == pytest.approx(shrinks, rel=0.1)


def missing_cells(law, across):
    """By how many plant cells a strip at rest is softer than as much bulk at stretch 1."""
    side = law.cell.cell_side
    stiff = side_free(law.law, np.ones(1), np.zeros(1)).slopes[0]
    _, surface, bulk = law.rest(across)
    slope = across * side * bulk.slopes[0] + 2.0 * surface.tangent
    return float(across - slope[0] / (side * stiff[0]))


@pytest.mark.parametrize(
    ("preset", "missing"), [("water", 0.48), pytest.param("printed", 0.21, marks=pytest.mark.slow)]
)
def test_plant_cells_that_a_strip_of_four_lacks_are_those_of_its_period(preset, missing):
    """c = n (1 − FE²/tissue) of strips of four plant cells, from squared ratios of periods."""
    assert missing_cells(slab(preset, rows=8), 4) == pytest.approx(missing, rel=0.05)


def test_the_sides_of_two_plant_cells_feel_each_other():
    """c of strips of two plant cells from squared ratios of periods: 0.47 and 0.22."""
    assert missing_cells(slab(rows=rows_across(2.0)), 2) == pytest.approx(0.47, rel=0.05)
    assert missing_cells(slab(rows=8), 2) > 0.6


def test_thin_tissue_has_the_law_of_its_own_thickness():
    assert [rows_across(n) for n in (0.5, 2.0, 3.4, 8.0, 40.0)] == [1, 2, 3, 8, 8]


def test_an_outer_wall_weighs_in_tissue_and_surface_alike():
    cell = CellParameters.preset("water", outer_wall=1.5)
    n, m, per_side = 3, 2, cell.wall_springs_per_side
    reference = RveLaw(cell).reference
    beyond = (
        make_tissue([cell], [reference], np.zeros((n, m), dtype=int)).mass.sum() - n * m * cell.mass
    )
    per_length = slab(outer_wall=1.5).mass
    around = 2 * (n + m) * cell.cell_side
    corners = 0.5 * cell.wall_particle_mass  # a corner has a quarter of a particle, not a half
    assert beyond == pytest.approx(around * per_length - corners, rel=1e-12)
    assert slab().mass == 0.0
    assert per_length == pytest.approx(0.25 * per_side * cell.wall_particle_mass / 25.0)


def test_plant_cells_that_have_no_surface_law_are_refused():
    voronoi = CellParameters(arrangement="voronoi", cells=4)
    reference = RveLaw(CellParameters.preset("water")).reference
    with pytest.raises(InputError, match=r"cell.arrangement: 4 of voronoi"):
        make_slab(voronoi, reference, 4)
    with pytest.raises(InputError, match=r"rve.solver: 'iterated'"):
        SlabLaw(CellParameters(), replace(slab().law.settings, initialisation="elastic",
                                          solver="iterated"))  # fmt: skip
    with pytest.raises(MismatchError, match="reference"):
        make_slab(CellParameters(), reference, 4)
