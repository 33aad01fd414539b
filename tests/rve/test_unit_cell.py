"""The undeformed RVE, its reference state that is kept, and a look into deformed RVEs."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2.base.errors import InputError, MismatchError
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import ReferenceState, RveLaw, unit_cell
from surrofe2.rve.unit_cell import make_unit_cell, settle_reference
from tests.plant_cell.twin import Twin
from tests.rve import rves
from tests.rve.rves import assert_balanced, deformations


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


@pytest.mark.parametrize("fluid", ["sph", "uniform"])
def test_a_seed_without_a_rest_is_named_and_no_constant_of_the_cell(fluid, monkeypatch):
    """Its constants may be those of a preset, and square plant cells come to rest with them."""
    cell = CellParameters(arrangement="voronoi", cells=4, arrangement_seed=7, fluid=fluid)
    settle_reference(replace(cell, arrangement="square", cells=1, arrangement_seed=1))
    solved = unit_cell.relax

    def none(topology, *entries):
        answer = solved(topology, *entries)
        nowhere = np.zeros_like(answer.is_solved)
        return answer._replace(is_solved=nowhere, stable=nowhere)

    monkeypatch.setattr(unit_cell, "relax", none)
    monkeypatch.setattr(unit_cell, "_SETTLING_LIMIT", 30_000)
    with pytest.raises(InputError) as refused:
        settle_reference.__wrapped__(cell)
    message = str(refused.value)
    assert "take another arrangement_seed than 7, or more cells" in message
    assert ('fluid = "uniform"' in message) == (fluid == "sph")
    for name in ("fluid_particle_mass", "wall_stiffness", "repulsion_strength"):
        assert name not in message


def test_turgor_that_no_wall_can_balance_is_refused():
    with pytest.raises(InputError, match="turgor needs a wall rest length"):
        RveLaw(CellParameters.preset("printed", wall_stiffness=400.0))


@pytest.fixture(scope="module")
def law():
    return RveLaw(CellParameters.preset("water"))


@pytest.mark.parametrize(
    "cell",
    [
        CellParameters.preset("water"),
        CellParameters(arrangement="square", cells=4),
        pytest.param(CellParameters(arrangement="voronoi", cells=4), marks=pytest.mark.slow),
    ],
    ids=lambda cell: f"{cell.cells} {cell.arrangement}",
)
def test_law_from_a_kept_reference_answers_with_the_same_bits(cell):
    F, F_dot = deformations("water", 9, corners=False)
    settled = RveLaw(cell)
    kept = ReferenceState.from_arrays(settled.reference.to_arrays())
    law = RveLaw(cell, reference=kept)
    assert law.reference is kept
    assert law.rest_length == settled.rest_length
    np.testing.assert_array_equal(law.unit_cell.position, settled.unit_cell.position)
    answers = [this.respond(F, F_dot) for this in (settled, law)]
    assert np.isfinite(answers[0].stress).all()
    np.testing.assert_array_equal(answers[0].stress, answers[1].stress)
    np.testing.assert_array_equal(answers[0].state.z, answers[1].state.z)


def test_reference_of_another_cell_is_refused(law):
    other = replace(law.cell, wall_stiffness=3999.0)
    with pytest.raises(MismatchError, match=r"^reference: it belongs to plant cells [0-9a-f]{16},"):
        RveLaw(other, reference=law.reference)


def test_reference_that_is_no_stable_equilibrium_is_refused(law):
    position = law.reference.position.copy()
    position[19:] = position[19]  # all fluid in one place
    position[19:] += 1e-3 * np.arange(32).reshape(16, 2)
    with pytest.raises(InputError, match="reference: not a stable equilibrium"):
        RveLaw(law.cell, reference=replace(law.reference, position=position))


@pytest.mark.parametrize(
    "change",
    [{"lattice": None}, {"position": np.zeros((3, 3))}, {"rest_length": np.array([np.nan])}],
)
def test_incomplete_arrays_are_refused(law, change):
    arrays = {k: v for k, v in (law.reference.to_arrays() | change).items() if v is not None}
    with pytest.raises(InputError, match=r"^reference: arrays are missing, not finite or of oth"):
        ReferenceState.from_arrays(arrays)


F = np.eye(2) + 0.02 * np.random.default_rng(3).normal(size=(5, 2, 2))
F_DOT = 0.004 * np.random.default_rng(4).normal(size=(5, 2, 2))


@pytest.mark.parametrize(
    "initialisation", ["slow-manifold", "constrained-runs", "elastic", "cauchy-born"]
)
@pytest.mark.parametrize("preset", ["printed", "water"])
def test_virial_of_the_particles_is_the_stress_of_the_law(preset, initialisation):
    law = rves.law(preset, initialisation)
    stress, seen = law.respond(F, F_DOT).stress, law.particles(F, F_DOT)
    np.testing.assert_allclose(seen.stress, stress, rtol=0, atol=1e-10 * abs(stress).max())


@pytest.mark.parametrize("preset", ["printed", "water"])
def test_particles_are_in_equilibrium(preset):
    law = rves.law(preset, "slow-manifold")
    seen = law.particles(F, F_DOT)
    mean = np.linalg.norm(seen.force, axis=2).mean(axis=1)
    assert (mean < 2.0 * law.settings.tolerance).all()
    assert abs(seen.force.sum(axis=1)).max() < 1e-9 * seen.tension.max()


def test_area_of_cells_follows_the_deformation():
    law = RveLaw(CellParameters.preset("water", cells=4))
    seen = law.particles(F, 0.0 * F_DOT)
    assert seen.area_ratio.shape == (5, 4)
    np.testing.assert_allclose(seen.area_ratio.mean(axis=1), np.linalg.det(F), rtol=1e-2)


def test_fluid_pushes_on_the_walls_with_what_their_tension_carries():
    """At rest half a square cell is in balance: wall tension T, fluid on the opposite side p L."""
    law = rves.law("water", "slow-manifold")
    still = np.eye(2)[None]
    seen = law.particles(still, 0.0 * still)
    assert seen.area_ratio == pytest.approx(1.0, rel=1e-9)
    pushes = seen.contact_pressure[0, 1:]  # without the corner, which four plant cells push
    side = law.cell.cell_side * law.cell.tissue_thickness  # µm²; µN/µm² is MPa
    assert pushes.mean() == pytest.approx(seen.tension.mean() / side, rel=0.15)
    assert seen.extremes()["highest_fluid_pressure_MPa"] >= seen.pressure.mean()


def test_a_point_without_stress_is_named():
    with pytest.raises(InputError, match="point 1: the RVE"):
        rves.law("water").particles(np.stack([np.eye(2), np.diag([1.9, 0.4])]), np.zeros((2, 2, 2)))
