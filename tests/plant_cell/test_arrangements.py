"""Parameters and arrangements: polygons tile the plane, walls are shared, fluid fills by area."""

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.base.simd import pack
from surrofe2.plant_cell.arrangement import make_arrangement, start_positions
from surrofe2.plant_cell.neighbours import FARTHEST, make_neighbours
from surrofe2.plant_cell.parameters import CellParameters
from tests.plant_cell.twin import Twin

CASES = (("square", 4, 38, 64), ("hexagon", 1, 17, 19), ("voronoi", 9, None, 144))


def arranged(arrangement, cells, seed=1):
    """Plant cells of SPH fluid."""
    return CellParameters(arrangement=arrangement, cells=cells, arrangement_seed=seed, fluid="sph")


@pytest.mark.parametrize(("arrangement", "cells", "per_two", "fluid"), CASES)
def test_polygons_tile_the_box_and_share_every_edge(arrangement, cells, per_two, fluid):
    made = make_arrangement(arranged(arrangement, cells))
    t = made.tessellation
    assert t.areas.sum() == pytest.approx(625.0 * cells, rel=1e-12)
    assert abs(np.linalg.det(t.lattice)) == pytest.approx(625.0 * cells, rel=1e-12)
    assert sum(len(p) for p in t.polygons) == 2 * len(t.edges)
    assert len(t.vertices) - len(t.edges) + len(t.polygons) == 0  # Euler on a torus
    assert sum(made.fluid_counts) == fluid
    assert (made.wall_position[0] == 0.0).all()
    bonded = np.bincount(made.bonds[:, :2].ravel(), minlength=made.walls)
    assert set(bonded[: len(t.vertices)]) == ({4} if arrangement == "square" else {3})
    assert set(bonded[len(t.vertices) :]) == {2}


def test_voronoi_fluid_follows_area_and_springs_are_near_those_of_the_square():
    made = make_arrangement(arranged("voronoi", 9))
    exact = made.tessellation.areas * 16.0 / 625.0
    assert np.abs(np.array(made.fluid_counts) - exact).max() < 1.0
    for edge in made.tessellation.edges:
        length = np.linalg.norm(made.tessellation.vector(edge))
        springs = max(1, round(length / 2.5))
        assert made.tessellation.springs(edge, 2.5) == springs
        assert springs == 1 or abs(length / springs - 2.5) <= 0.5 * 2.5 / springs + 1e-12


def test_fluid_starts_inside_its_polygon():
    cell = arranged("voronoi", 9, seed=4)
    made = make_arrangement(cell)
    position = start_positions(cell)
    for k in range(9):
        corners = made.tessellation.corners(k)
        first, last = made.walls + made.fluid_start[k : k + 2]
        side = np.roll(corners, -1, axis=0) - corners
        for point in position[first:last]:
            way = point - corners
            assert (side[:, 0] * way[:, 1] - side[:, 1] * way[:, 0] > 0.0).all()


def test_one_square_has_the_particles_in_the_order_that_tissues_repeat():
    """Corner, bottom wall, left wall, fluid row by row."""
    position = start_positions(CellParameters())
    along = 2.5 * np.arange(1, 10)
    np.testing.assert_array_equal(position[0], [0.0, 0.0])
    np.testing.assert_array_equal(position[1:10], np.stack([along, 0.0 * along], axis=1))
    np.testing.assert_array_equal(position[10:19], np.stack([0.0 * along, along], axis=1))
    assert (position[19:] > 4.0).all()
    assert (position[19:] < 21.0).all()


def test_pairs_of_one_square_are_those_found_by_looking_at_every_image():
    """By the twin, of which walls and fluid within 14 µm of each other may touch."""
    cell = CellParameters()
    position, lattice = start_positions(cell), 25.0 * np.eye(2)
    every = make_neighbours(cell, position, lattice)
    listed = every.near(pack(np.eye(2)[None]), pack(position.T[None]), 4.0).topology
    found = {"bond": listed.bonds, "contact": listed.contacts, "fluid": listed.fluid_pairs}
    for kind, (i, j, _, shift) in Twin(cell, 1.0).pairs.items():
        expected = np.sort(np.linalg.norm(position[j] + 25.0 * shift - position[i], axis=1))
        expected = expected[expected <= 14.0] if kind == "contact" else expected
        np.testing.assert_allclose(lengths(position, listed, found[kind]), expected, atol=1e-9)


def lengths(position, topology, pairs):
    local = np.concatenate([position, position[topology.owner] + topology.image_offset])
    return np.sort(np.linalg.norm(local[pairs[:, 0]] - local[pairs[:, 1]], axis=1))


def test_all_arrangements_hold_the_same_fluid_per_area():
    one = CellParameters()
    for arrangement, cells, _, _ in CASES:
        cell = arranged(arrangement, cells)
        made = make_arrangement(cell)
        assert sum(made.fluid_counts) * cell.fluid_mass / cells == pytest.approx(16 * 2.7)
        assert cell.density == pytest.approx(one.density, rel=0.02)
    assert arranged("square", 9).density == pytest.approx(one.density, rel=1e-14)


def test_arrangements_have_fingerprints_and_symmetries_of_their_own():
    cells = [CellParameters(), *(arranged(a, n) for a, n, _, _ in CASES), arranged("voronoi", 9, 2)]
    assert len({cell.fingerprint for cell in cells}) == len(cells)
    assert CellParameters().fingerprint == "c9558db4e65f7203"  # as before there were arrangements
    assert [cell.symmetry for cell in cells] == ["D4", "D4", "D6", "none", "none"]
    assert CellParameters(**cells[3].to_dict()) == cells[3]


def test_fluid_may_reach_every_wall_around_it_from_wherever_it_is():
    cell = arranged("voronoi", 9)
    made = make_arrangement(cell)
    lattice = made.tessellation.lattice
    for k in range(2):
        position = start_positions(cell, k)
        topology = make_neighbours(cell, position, lattice).topology
        owner = np.append(np.arange(made.particles), topology.owner)[topology.contacts]
        with_fluid = (owner >= made.walls).any(axis=1)
        pairs = zip(made.rims, made.fluid_counts, strict=True)
        assert with_fluid.sum() == sum(len(rim) * count for rim, count in pairs)
        walls = lengths(position, topology, topology.contacts[~with_fluid])
        assert 29.0 < walls.max() <= FARTHEST * cell.repulsion_cutoff


def test_density_is_all_masses_of_one_cell_over_its_area():
    assert CellParameters.preset("printed").density == pytest.approx(0.084, abs=5e-4)
    assert CellParameters.preset("water").density == pytest.approx((9.5 + 16 * 0.27) / 625)


def test_presets_differ_in_the_fluid_mass_alone():
    printed, water = (CellParameters.preset(n).to_dict() for n in ("printed", "water"))
    assert {k for k in printed if printed[k] != water[k]} == {"fluid_particle_mass"}


def test_the_fluid_is_that_of_the_arrangement_or_the_preset_unless_it_is_named():
    fluid_of = lambda *preset, **changes: CellParameters.preset(*preset, **changes).fluid  # noqa: E731
    assert [fluid_of(name) for name in ("printed", "water", "apple", "potato")] == [
        "sph", "sph", "uniform", "uniform"
    ]  # fmt: skip
    assert fluid_of("printed", arrangement="hexagon") == "uniform"
    assert fluid_of("water", arrangement="voronoi", cells=4) == "uniform"
    assert fluid_of("water", arrangement="hexagon", fluid="sph") == "sph"
    assert fluid_of("water", fluid="uniform") == "uniform"
    assert CellParameters(arrangement="hexagon").fluid == "uniform"
    uniform, sph = (CellParameters.preset("apple", fluid=name) for name in ("auto", "sph"))
    assert (uniform.fluid, sph.fluid) == ("uniform", "sph")
    # the same turgor takes less pressure of SPH particles, which do not fill the cell
    assert (uniform.sound_speed / sph.sound_speed) ** 2 == pytest.approx(1.1484)
    assert uniform.fluid_particle_mass == sph.fluid_particle_mass
    with pytest.raises(InputError, match=r"cell.fluid: 'gas'; it must be one of auto, sph"):
        CellParameters.preset("apple", fluid="gas")


def test_fingerprints_tell_fluids_and_saps_apart():
    saps = [CellParameters(fluid="uniform", sap_bulk_modulus=K) for K in (0.0, 1.0, 2200.0)]
    assert len({each.fingerprint for each in (CellParameters(), *saps)}) == 4


def test_fingerprint_tells_parameters_apart_and_ignores_how_a_number_is_written():
    printed = CellParameters.preset("printed")
    assert printed.fingerprint == CellParameters(cell_side=25).fingerprint
    assert printed.fingerprint != CellParameters(wall_stiffness=4000.0001).fingerprint


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"wall_particle_mass": -0.5}, "cell.wall_particle_mass: -0.5; it must be positive"),
        ({"wall_stiffness": -1.0}, "cell.wall_stiffness: -1.0; it must be positive"),
        ({"wall_stiffness": float("nan")}, "cell.wall_stiffness: nan; it must be positive"),
        ({"viscosity": -0.1}, "cell.viscosity: -0.1; it must be at least 0"),
        ({"cell_side": "25"}, "cell.cell_side: '25'; it must be a number"),
        ({"fluid_particles_per_side": 2.5}, "fluid_particles_per_side: 2.5; it must be an integer"),
        ({"wall_springs_per_side": 3}, "wall_springs_per_side: 3; it must be an integer of at"),
        ({"wall_stifness": 1.0}, "cell.wall_stifness: unknown; known are"),
        ({"arrangement": "brick"}, "cell.arrangement: 'brick'; it must be one of square, hexagon"),
        ({"cells": 3}, "cell.cells: 3; with arrangement square it must be a square number"),
        ({"cells": 0}, "cell.cells: 0; it must be an integer of at least 1"),
        ({"arrangement": "voronoi", "cells": 3}, "cells: 3; with arrangement voronoi it must be"),
    ],
)
def test_bad_parameters_are_named_with_what_is_allowed(changes, message):
    with pytest.raises(InputError, match=r"^[^\n]*$") as caught:
        CellParameters.preset("printed", **changes)
    assert message in str(caught.value)
