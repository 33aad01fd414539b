"""Presets of living tissue: turgor by two ways, range of stability, translation and sources."""

import itertools
from dataclasses import asdict, fields, replace

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.plant_cell.measurements import DETERMINED, living_cell, measurements_of, overruled
from surrofe2.plant_cell.parameters import (
    LIVING,
    PRESETS,
    CellParameters,
    LivingTissue,
    sources,
)
from surrofe2.questions.moduli import cell_moduli, turgor
from surrofe2.questions.stability import LEFT, STABLE, WAYS, categories, find_onset
from surrofe2.rve import RveLaw
from surrofe2.surface.slab_law import SlabLaw
from tests.plant_cell.twin import Twin

STABLE_WITHIN = {"apple": 0.1, "potato": 0.07}


def virials(cell):
    """MPa that wall pairs, wall and fluid, and fluid pairs add to the pressure, over all images."""
    law = RveLaw(cell)
    twin, z, still = Twin(cell, law.rest_length), law.unit_cell.position, np.zeros((2, 2))
    pairs, found = twin.pairs, {}
    for name, wanted in (
        ("walls", lambda i, j: j < twin.walls),
        ("contact", lambda i, j: (i < twin.walls) & (j >= twin.walls)),
        ("fluid", lambda i, j: i >= twin.walls),
    ):
        twin.pairs = {
            kind: (i, j, share * wanted(i, j), shift)
            for kind, (i, j, share, shift) in pairs.items()
        }
        stress = twin.evaluate(z, np.eye(2), still)[2]
        found[name] = -np.trace(stress) / 2.0 / cell.tissue_thickness
    return found


@pytest.mark.parametrize("preset", LIVING)
def test_walls_carry_the_measured_turgor(preset):
    cell, measured = CellParameters.preset(preset), LIVING[preset][0].turgor
    assert turgor(cell) == pytest.approx(measured, rel=1e-9)
    pressure = cell.fluid_density * cell.sound_speed**2 / cell.tissue_thickness
    assert pressure == pytest.approx(measured, rel=1e-12)


@pytest.mark.parametrize("preset", LIVING)
def test_walls_carry_the_measured_turgor_of_sph_fluid_and_contacts(preset):
    cell, measured = CellParameters.preset(preset, fluid="sph"), LIVING[preset][0].turgor
    found = virials(cell)
    assert -found["walls"] == pytest.approx(measured, rel=1e-3)
    assert found["fluid"] + found["contact"] == pytest.approx(-found["walls"], rel=1e-8)
    assert turgor(cell) == pytest.approx(-found["walls"], rel=1e-8)
    assert found["fluid"] < -found["walls"]


@pytest.mark.parametrize("preset", LIVING)
def test_every_corner_and_side_of_the_range_is_stable(preset):
    cell, within = CellParameters.preset(preset), STABLE_WITHIN[preset]
    grid = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=4))).reshape(-1, 2, 2)
    for entry in (0.04, within):
        assert (categories(cell, np.eye(2) + entry * grid) == STABLE).all()
    onset = find_onset(cell, *WAYS["equibiaxial compression"])
    assert within < onset < 1.25 * within
    beyond = (1.0 - 1.1 * onset) * np.eye(2)[None]
    assert categories(cell, beyond).tolist() == [LEFT]


def test_stiffer_walls_are_stretched_less_and_buckle_earlier():
    cell = CellParameters.preset("potato")
    stiff = replace(cell, wall_stiffness=2.0 * cell.wall_stiffness)
    way = WAYS["equibiaxial compression"]
    assert find_onset(stiff, *way) < 0.05 < find_onset(cell, *way)


@pytest.mark.parametrize("preset", LIVING)
def test_constants_are_what_was_measured(preset):
    tissue, cell = LIVING[preset][0], CellParameters.preset(preset)
    t = cell.tissue_thickness
    wall = 2.0 * tissue.wall_modulus * tissue.wall_thickness * t  # of both cells, per strain
    assert cell.wall_stiffness * cell.spring_length == pytest.approx(wall)
    assert cell.density / t == pytest.approx(1e-6 * tissue.density)
    assert cell.viscosity == pytest.approx(1e-3 * tissue.sap_viscosity * t)
    assert 15.0 < cell.sound_speed < 25.0
    young = cell_moduli(cell, "elastic").elastic[0, 0] / t
    assert young == pytest.approx(wall / t / cell.cell_side + tissue.turgor, rel=0.25)


def test_size_alone_does_not_change_the_tissue():
    tissue = LIVING["apple"][0]
    double = replace(tissue, cell_size=300.0, wall_thickness=1.6).parameters()
    once, twice = (cell_moduli(c, "elastic").elastic for c in (tissue.parameters(), double))
    np.testing.assert_allclose(twice, once, rtol=1e-6, atol=1e-8)


def test_dashpots_do_not_change_where_a_cell_rests():
    cell = CellParameters.preset("apple")
    viscous = replace(cell, wall_damping_ratio=300.0)
    assert RveLaw(viscous).rest_length == pytest.approx(RveLaw(cell).rest_length, rel=1e-10)
    eta = [cell_moduli(c, "elastic").viscous[0, 0] for c in (cell, viscous)]
    assert eta[1] > 100.0 * eta[0]


@pytest.mark.parametrize("preset", PRESETS)
def test_every_constant_or_measurement_has_a_source(preset):
    stated = LivingTissue if preset in LIVING else CellParameters
    found = sources(preset)
    assert set(found) == {item.name for item in fields(stated)}
    assert all(found.values())


def test_unknown_names_and_impossible_values_are_refused():
    for refused in (CellParameters.preset, sources):
        with pytest.raises(InputError, match="'pear'; it must be one of printed, water, apple"):
            refused("pear")
    apple = LIVING["apple"][0]
    with pytest.raises(InputError, match=r"tissue\.turgor: -0\.4; it must be positive"):
        replace(apple, turgor=-0.4)
    with pytest.raises(InputError, match=r"tissue\.turgor: 0.0; it must be positive"):
        replace(apple, turgor=0.0)
    with pytest.raises(InputError, match=r"cell\.turgor: 0; walls here do not resist bending"):
        living_cell("apple", turgor=0.0)
    with pytest.raises(InputError, match=r"cell\.fluid_particle_mass: -.*must be positive"):
        replace(apple, wall_thickness=60.0).parameters()


MEASURED = {
    "cell_size": 90.0,
    "turgor": 0.25,
    "wall_modulus": 120.0,
    "wall_thickness": 0.5,
    "sap_viscosity": 2.0,
    "density": 950.0,
}


@pytest.mark.parametrize("fluid", ["uniform", "sph"])
@pytest.mark.parametrize("name", MEASURED)
def test_each_measurement_is_taken_and_the_others_stay(fluid, name):
    cell = living_cell("apple", fluid=fluid, **{name: MEASURED[name]})
    before = measurements_of(living_cell("apple", fluid=fluid))
    assert measurements_of(cell) == pytest.approx({**before, name: MEASURED[name]}, rel=1e-12)


def test_all_measurements_are_the_tissue_made_of_them():
    assert living_cell("potato", **MEASURED) == LivingTissue(**MEASURED).parameters()


@pytest.mark.parametrize(
    "constants",
    [
        {"tissue_thickness": 25.0},
        {"wall_springs_per_side": 16},
        {"fluid_particles_per_side": 3},
        {"cell_side": 140.0},
        {"fluid_particle_mass": 4.0},
        {"arrangement": "hexagon"},
    ],
    ids=str,
)
def test_walls_carry_the_turgor_beside_any_constant(constants):
    cell = living_cell("apple", turgor=0.3, **constants)
    assert turgor(cell) == pytest.approx(0.3, rel=1e-8)
    for name, value in constants.items():
        assert getattr(cell, name) == value


@pytest.mark.parametrize("name", ["tissue_thickness", "wall_springs_per_side"])
def test_a_finer_or_thicker_layer_is_the_same_tissue(name):
    usual = living_cell("apple", turgor=0.3)
    finer = living_cell("apple", turgor=0.3, **{name: 2 * getattr(usual, name)})
    assert measurements_of(finer) == pytest.approx(measurements_of(usual), rel=1e-12)


def test_a_measurement_wins_over_the_constants_that_it_determines():
    for measured, constants in DETERMINED.items():
        alone = living_cell("apple", **{measured: MEASURED[measured]})
        for constant in constants:
            both = living_cell("apple", **{measured: MEASURED[measured], constant: 7.0})
            assert both == alone
    changes = {"turgor": 0.3, "sound_speed": 7.0, "viscosity": 3.0}
    assert overruled(changes) == {"sound_speed": "turgor"}
    assert living_cell("apple", **changes).viscosity == 3.0


def test_a_preset_of_constants_takes_no_measurements():
    with pytest.raises(InputError, match=r"cell\.turgor: 0\.4; preset water is made of constants"):
        living_cell("water", turgor=0.4)
    assert "turgor" not in measurements_of(living_cell("printed"))


def test_without_measurements_it_is_the_preset():
    for name, changes in (("apple", {"tissue_thickness": 20.0}), ("water", {"viscosity": 1.0})):
        assert living_cell(name, **changes) == CellParameters.preset(name, **changes)


def test_measurements_of_a_preset_are_those_that_it_is_made_of():
    for name, (tissue, _) in LIVING.items():
        for fluid in ("uniform", "sph"):
            cell = CellParameters.preset(name, fluid=fluid)
            assert measurements_of(cell) == pytest.approx(asdict(tissue), rel=1e-12)
            assert living_cell(name, fluid=fluid, turgor=tissue.turgor) == cell


def test_a_law_takes_the_name_of_a_preset():
    law = RveLaw("apple", initialisation="elastic")
    assert law.cell == living_cell("apple")
    assert SlabLaw("apple", rows=1).cell == law.cell
