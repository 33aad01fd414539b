"""Shapes of Voronoi cells: variation of areas and elongation are reached, and reported."""

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.plant_cell.tessellation import aspect_ratio


def voronoi(cells=16, **changes):
    return CellParameters(arrangement="voronoi", cells=cells, **changes)


@pytest.mark.parametrize("wanted", [0.1, 0.3, 0.6])
@pytest.mark.parametrize("seed", [1, 2])
def test_areas_vary_as_wanted(wanted, seed):
    made = voronoi(area_variation=wanted, arrangement_seed=seed).tessellation
    assert made.area_variation == pytest.approx(wanted, abs=1e-4)
    assert made.areas.std() / made.areas.mean() == pytest.approx(wanted, abs=1e-4)
    assert made.areas.sum() == pytest.approx(16 * 625.0, rel=1e-12)
    assert len(made.vertices) - len(made.edges) + len(made.polygons) == 0  # Euler on a torus


@pytest.mark.parametrize("direction", [0.0, 35.0, -90.0])
def test_cells_are_as_long_as_wanted_along_the_direction(direction):
    cell = voronoi(elongation=2.0, elongation_direction=direction)
    made, plain = cell.tessellation, voronoi().tessellation
    assert made.elongation == pytest.approx(2.0, abs=1e-4)
    np.testing.assert_allclose(made.areas, plain.areas, rtol=1e-9)
    assert np.linalg.det(made.lattice) == pytest.approx(16 * 625.0, rel=1e-12)
    along = np.array([np.cos(np.deg2rad(direction)), np.sin(np.deg2rad(direction))])
    across = np.array([-along[1], along[0]])
    widths = [[np.ptp(made.corners(k) @ axis) for axis in (along, across)] for k in range(16)]
    assert np.mean(widths, axis=0)[0] > 1.6 * np.mean(widths, axis=0)[1]


def test_aspect_ratios_of_known_polygons():
    box = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 1.0], [0.0, 1.0]])
    assert aspect_ratio(box + 7.0) == pytest.approx(3.0, rel=1e-12)
    angle = np.arange(6) * np.pi / 3.0
    hexagon = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    assert aspect_ratio(hexagon) == pytest.approx(1.0, rel=1e-7)
    assert aspect_ratio(hexagon * np.array([2.0, 0.5])) == pytest.approx(4.0, rel=1e-9)


def test_cells_that_are_not_shaped_are_as_before():
    plain = voronoi(9)
    assert plain.fingerprint == voronoi(9, elongation_direction=30.0).fingerprint
    shaped = voronoi(9, area_variation=0.3), voronoi(9, elongation=2.0)
    turned = voronoi(9, elongation=2.0, elongation_direction=30.0)
    assert len({each.fingerprint for each in (plain, *shaped, turned)}) == 4
    assert CellParameters().fingerprint == "c9558db4e65f7203"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"area_variation": 0.3, "arrangement": "hexagon"},
            "with arrangement hexagon it must be 0",
        ),
        ({"elongation": 2.0, "arrangement": "square"}, "with arrangement square it must be 1"),
        (
            {"elongation_direction": 30.0, "arrangement": "hexagon"},
            "elongation_direction: 30.0; with arrangement hexagon it must be 0",
        ),
        ({"area_variation": 0.05}, "area_variation: 0.05; it must be 0, or 0.1 to 0.6"),
        ({"area_variation": 0.7}, r"area_variation: 0.7; it must be within \[0, 0.6\]"),
        ({"elongation": 1.05}, "elongation: 1.05; Voronoi cells have 1.* without being stretched"),
    ],
)
def test_shapes_that_cannot_be_are_refused(changes, message):
    with pytest.raises(InputError, match=message):
        CellParameters(**{"arrangement": "voronoi", "cells": 16} | changes).tessellation  # noqa: B018
