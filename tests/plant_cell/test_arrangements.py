"""Geometry of arrangements: polygons tile the plane, walls are shared, fluid fills by area."""

import numpy as np
import pytest

from surrofe2.errors import InputError
from surrofe2.plant_cell.arranged_patch import arranged_patch, candidates
from surrofe2.plant_cell.arrangements import make_arrangement, start_positions
from surrofe2.plant_cell.geometry import even_positions, square_patch
from surrofe2.plant_cell.parameters import CellParameters

CASES = (("square", 4, 38, 64), ("hexagon", 1, 17, 19), ("voronoi", 9, None, 144))


def arranged(arrangement, cells, seed=1):
    return CellParameters(arrangement=arrangement, cells=cells, arrangement_seed=seed)


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
    bonded = np.bincount([k for i, j, _ in made.bonds for k in (i, j)], minlength=made.walls)
    assert set(bonded[: len(t.vertices)]) == ({4} if arrangement == "square" else {3})
    assert set(bonded[len(t.vertices) :]) == {2}


def test_voronoi_fluid_follows_area_and_springs_are_near_those_of_the_square():
    made = make_arrangement(arranged("voronoi", 9))
    exact = made.tessellation.areas * 16.0 / 625.0
    assert np.abs(np.array(made.fluid_counts) - exact).max() < 1.0
    for edge in made.tessellation.edges:
        length = made.tessellation.length(edge)
        springs = max(1, round(length / 2.5))
        assert springs == 1 or abs(length / springs - 2.5) <= 0.5 * 2.5 / springs + 1e-12


def test_fluid_starts_inside_its_polygon():
    cell = arranged("voronoi", 9, seed=4)
    made = make_arrangement(cell)
    position = start_positions(cell, np.random.default_rng(0))
    for k in range(9):
        corners = made.tessellation.corners(k)
        first, last = made.walls + made.fluid_start[k : k + 2]
        side = np.roll(corners, -1, axis=0) - corners
        for point in position[first:last]:
            way = point - corners
            assert (side[:, 0] * way[:, 1] - side[:, 1] * way[:, 0] > 0.0).all()


def test_one_square_by_the_general_way_has_the_pairs_of_the_special_one():
    """Same particles at the same places, so the distances of every kind of pair agree."""
    cell = CellParameters()
    made = make_arrangement(cell)
    general = np.concatenate([made.wall_position, even_positions(cell)[19:]])
    lattice = 25.0 * np.eye(2)
    every = candidates(made, general, lattice, 30.0)
    mine, _ = arranged_patch(cell, made, general, lattice, every, 14.0, 14.0)
    theirs = square_patch(cell, reach=14.0)
    for kind in ("bonds", "contacts", "fluid_pairs"):
        np.testing.assert_allclose(
            lengths(mine, getattr(mine, kind)), lengths(theirs, getattr(theirs, kind)), atol=1e-9
        )


def lengths(patch, pairs):
    images = patch.position[patch.owner] + patch.shift @ patch.lattice.T
    local = np.concatenate([patch.position, images])
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


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"arrangement": "brick"}, "cell.arrangement: 'brick'; it must be one of square, hexagon"),
        ({"cells": 3}, "cell.cells: 3; with arrangement square it must be a square number"),
        ({"cells": 4.0}, "cell.cells: 4.0; it must be an integer"),
        ({"cells": 0}, "cell.cells: 0; it must be positive"),
        ({"arrangement": "voronoi", "cells": 3}, "cells: 3; with arrangement voronoi it must be"),
        ({"arrangement_seed": -1}, "cell.arrangement_seed: -1; it must be at least 0"),
    ],
)
def test_bad_arrangements_are_named(changes, message):
    with pytest.raises(InputError, match=r"^[^\n]*$") as caught:
        CellParameters.preset("printed", **changes)
    assert message in str(caught.value)


def test_fluid_may_reach_every_wall_around_it_from_wherever_it_is():
    cell = arranged("voronoi", 9)
    made = make_arrangement(cell)
    lattice = made.tessellation.lattice
    for k in range(2):
        position = start_positions(cell, np.random.default_rng(k))
        every = candidates(made, position, lattice, 12.0)
        patch, rest = arranged_patch(cell, made, position, lattice, every, np.inf, 12.0)
        owner = np.concatenate([np.arange(made.particles), patch.owner])[patch.contacts]
        with_fluid = (owner >= made.walls).any(axis=1)
        pairs = zip(made.rims, made.fluid_counts, strict=True)
        assert with_fluid.sum() == sum(len(rim) * count for rim, count in pairs)
        assert len(rest.pairs) == 0
