import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import RveLaw
from surrofe2.rve.unit_cell import make_unit_cell
from tests.plant_cell.twin import Twin
from tests.rve.rves import assert_balanced


@pytest.mark.parametrize(("preset", "rest_length"), [("printed", 1.38), ("water", 2.32)])
def test_rest_length_frees_the_cell_of_stress(preset, rest_length):
    cell = CellParameters.preset(preset)
    unit = make_unit_cell(cell)
    assert unit.rest_length == pytest.approx(rest_length, abs=0.005)  # docs/theory.md
    f, _, stress = Twin(cell, unit.rest_length).evaluate(unit.position, np.eye(2), np.zeros((2, 2)))
    assert abs(f).max() < 1e-9
    assert abs(stress).max() < 1e-10


def test_fourth_wall_neighbours_sit_at_the_cut_off():
    """docs/theory.md: at F = I between 9.93 and 10.10 µm (`water`)."""
    wall = make_unit_cell(CellParameters.preset("water")).position[:10, 0]
    fourth = np.diff(np.concatenate([wall, wall + 25.0])[np.arange(10)[:, None] + [0, 4]])
    assert fourth.min() == pytest.approx(9.93, abs=0.01)
    assert fourth.max() == pytest.approx(10.10, abs=0.01)


def test_reference_has_the_symmetry_of_the_square():
    position = make_unit_cell(CellParameters.preset("printed")).position[19:] - 12.5
    for image in (position[:, ::-1], position * [1, -1], position * [-1, 1]):
        distance = np.linalg.norm(image[:, None] - position, axis=2).min(axis=1)
        assert distance.max() < 1e-9


@pytest.mark.parametrize(("springs", "fluid"), [(9, 4), (12, 4)])
def test_other_numbers_of_particles(springs, fluid):
    """The fluid's mass is kept."""
    cell = CellParameters.preset(
        "water",
        wall_springs_per_side=springs,
        fluid_particles_per_side=fluid,
        fluid_particle_mass=0.27 * 16 / fluid**2,
    )
    law = RveLaw(cell)
    F = np.eye(2) + 0.01 * np.random.default_rng(0).uniform(-1, 1, (9, 2, 2))
    answer = law.respond(F, 0.1 * (F - np.eye(2)), tangents=True)
    assert (answer.status == 0).all()
    assert_balanced(law, answer, F, 0.1 * (F - np.eye(2)), [8])
    assert np.isfinite(answer.tangents.P_by_F).all()


@pytest.mark.parametrize("preset", ["printed", "water"])
def test_grid_of_fluid_that_is_no_stable_equilibrium_is_refused(preset):
    mass = CellParameters.preset(preset).fluid_particle_mass * 16 / 9
    cell = CellParameters.preset(preset, fluid_particles_per_side=3, fluid_particle_mass=mass)
    with pytest.raises(InputError, match="no stable equilibrium of the undeformed RVE was found"):
        RveLaw(cell)


def test_turgor_that_no_wall_can_balance_is_refused():
    with pytest.raises(InputError, match="turgor needs a wall rest length"):
        RveLaw(CellParameters.preset("printed", wall_stiffness=400.0))
