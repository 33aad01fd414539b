import numpy as np
import pytest

from surrofe2.errors import InputError
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import RveLaw
from surrofe2.rve.unit_cell import make_unit_cell
from tests.plant_cell.twin import Twin


@pytest.mark.parametrize(("preset", "rest_length"), [("printed", 1.38), ("water", 2.32)])
def test_rest_length_frees_the_cell_of_stress(preset, rest_length):
    cell = CellParameters.preset(preset)
    unit = make_unit_cell(cell)
    assert unit.rest_length == pytest.approx(rest_length, abs=0.005)  # model.md
    f, _, stress = Twin(cell, unit.rest_length).evaluate(unit.position, np.eye(2), np.zeros((2, 2)))
    assert abs(f).max() < 1e-9
    assert abs(stress).max() < 1e-10


def test_fourth_wall_neighbours_sit_at_the_cut_off():
    """model.md: at F = I between 9.93 and 10.10 µm (`water`)."""
    wall = make_unit_cell(CellParameters.preset("water")).position[:10, 0]
    fourth = np.diff(np.concatenate([wall, wall + 25.0])[np.arange(10)[:, None] + [0, 4]])
    assert fourth.min() == pytest.approx(9.93, abs=0.01)
    assert fourth.max() == pytest.approx(10.10, abs=0.01)


def test_reference_has_the_symmetry_of_the_square():
    position = make_unit_cell(CellParameters.preset("printed")).position[19:] - 12.5
    for image in (position[:, ::-1], position * [1, -1], position * [-1, 1]):
        distance = np.linalg.norm(image[:, None] - position, axis=2).min(axis=1)
        assert distance.max() < 1e-9


def test_turgor_that_no_wall_can_balance_is_refused():
    with pytest.raises(InputError, match="turgor needs a wall rest length"):
        RveLaw(CellParameters.preset("printed", wall_stiffness=400.0))
