"""One pressurised cell and wilting tissue, by closed forms."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from surrofe2.plant_cell.parameters import LIVING, CellParameters
from surrofe2.questions.wilting import wilt
from validation.wilting import (
    between_plates,
    laplace_tension,
    mean_young,
    radius_of,
    ring_between_plates,
    volumetric,
)

APPLE = LIVING["apple"][0]


def test_a_cell_between_plates_is_the_limit_of_a_ring_of_springs():
    """Chords of a circle are shorter by the square of their number."""
    force, pressure = (values[0] for values in between_plates(APPLE, [0.2], drained=True))
    rings = [ring_between_plates(APPLE, 0.2, springs) for springs in (20, 40)]
    off = [ring[1] / pressure - 1.0 for ring in rings]
    assert off[0] == pytest.approx(4.0 * off[1], rel=0.15)
    assert rings[1][0] == pytest.approx(force, rel=0.01)


@pytest.mark.parametrize("drained", [True, False])
def test_plates_that_hardly_touch_find_the_turgor_and_no_force(drained):
    force, pressure = between_plates(APPLE, [1e-6], drained=drained)
    assert pressure[0] == pytest.approx(APPLE.turgor, rel=1e-5)
    assert force[0] == pytest.approx(0.0, abs=1e-3)


def test_force_on_plates_is_the_work_of_sap_and_wall():
    """Slow: −dU/dh of the wall's energy E d S₀ ε²/2 and the sap's p A ln(1/A), by the thickness."""
    heights = 0.8 + np.array([-1e-4, 0.0, 1e-4])
    force, pressure = between_plates(APPLE, 1.0 - heights, drained=True)
    radius, stiffness = radius_of(APPLE), APPLE.wall_modulus * APPLE.wall_thickness
    solutes = APPLE.turgor * np.pi * radius**2
    strain = pressure * radius * heights / stiffness
    slack = 2.0 * np.pi * radius / (1.0 + laplace_tension(APPLE) / stiffness)
    energy = 0.5 * stiffness * slack * strain**2 + solutes * np.log(pressure)
    slope = (energy[2] - energy[0]) / (2.0 * radius * (heights[2] - heights[0]))
    assert -slope == pytest.approx(force[1], rel=1e-5)


def test_stretch_of_a_wall_is_as_large_in_one_round_cell_as_in_squares():
    strain = laplace_tension(APPLE) / APPLE.wall_modulus / APPLE.wall_thickness
    in_squares = wilt(CellParameters.preset("apple"), 2).wall_stretch[0] - 1.0
    assert strain == pytest.approx(in_squares, rel=0.15)


def test_what_the_page_says_of_potato():
    """Hexagons: in proportion to the turgor, hardly by the walls; limp near −0.59 MPa."""
    hexagons = CellParameters.preset("potato", arrangement="hexagon")
    usual = wilt(hexagons, 6)
    stiffer = wilt(replace(hexagons, wall_stiffness=4.0 * hexagons.wall_stiffness), 6)
    assert usual.bath[-1] == pytest.approx(0.59, abs=0.01)
    assert np.interp(0.4, usual.bath, mean_young(usual)) == pytest.approx(1.0, abs=0.05)
    at_200 = [np.interp(-0.2, -each.turgor, mean_young(each)) for each in (usual, stiffer)]
    assert at_200[1] / at_200[0] == pytest.approx(1.06, abs=0.02)
    assert mean_young(usual)[0] == pytest.approx(2.39, abs=0.01)
    assert volumetric(usual).mean() == pytest.approx(2.85, abs=0.2)
    assert asdict(LIVING["potato"][0])["turgor"] == 0.5
