import pytest

from surrofe2.base.errors import InputError
from surrofe2.plant_cell.parameters import CellParameters


def test_density_is_all_masses_of_one_cell_over_its_area():
    assert CellParameters.preset("printed").density == pytest.approx(0.084, abs=5e-4)
    assert CellParameters.preset("water").density == pytest.approx((9.5 + 16 * 0.27) / 625)


def test_presets_differ_in_the_fluid_mass_alone():
    printed, water = (CellParameters.preset(n).to_dict() for n in ("printed", "water"))
    assert {k for k in printed if printed[k] != water[k]} == {"fluid_particle_mass"}


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
