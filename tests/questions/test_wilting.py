"""Wilting: osmotic pressure, walls and moduli by closed forms, and by the tissue itself."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.questions.moduli import cell_moduli, turgor
from surrofe2.questions.wilting import wilt
from surrofe2.rve import RveLaw

APPLE = CellParameters.preset("apple")
IRREGULAR = CellParameters.preset("apple", arrangement="voronoi", cells=4)


@pytest.mark.parametrize("cell", [APPLE, IRREGULAR], ids=["square", "voronoi"])
def test_wilting_begins_at_rest_and_ends_where_walls_are_slack(cell):
    states = wilt(cell, 4)
    assert states.stable[0]
    assert states.turgor[0] == pytest.approx(turgor(cell), rel=1e-8)
    assert states.bath[0] == pytest.approx(0.0, abs=1e-8)
    at_rest = cell_moduli(cell, "elastic").elastic / cell.tissue_thickness
    np.testing.assert_allclose(states.elastic[0], at_rest, atol=1e-7 * abs(at_rest).max())
    ones = states.stable
    assert (np.diff(states.turgor[ones]) < 0.0).all()
    assert (np.diff(states.bath[ones]) > 0.0).all()


def test_sap_is_a_dilute_solution_in_the_bath():
    """Sap that keeps its solutes has the pressure T + Π in proportion to 1/area."""
    states = wilt(APPLE, 5)
    pressure = states.turgor + states.bath
    np.testing.assert_allclose(pressure * states.size**2, pressure[0], rtol=1e-8)


def test_walls_carry_the_turgor_by_their_stretch():
    """T L λ = 2 E d (l₀/a)(stretch − 1) of straight walls that do not repel each other."""
    cell = replace(APPLE, repulsion_strength=1e-9 * APPLE.repulsion_strength)
    states = wilt(cell, 5)
    slack = RveLaw(cell).rest_length / cell.spring_length
    tension = 2.0 * 300.0 * 0.8 * slack * (states.wall_stretch - 1.0)
    np.testing.assert_allclose(states.turgor * 150.0 * states.size, tension, rtol=1e-6)


def test_moduli_about_a_wilted_state_are_slopes_of_the_stress_there():
    states, law, step = wilt(APPLE, 4), RveLaw(APPLE, initialisation="elastic"), 1e-5
    ways = (np.diag([1.0, 0.0]), np.diag([0.0, 1.0]), np.array([[0.0, 1.0], [0.0, 0.0]]))
    for k in (1, 2):
        for column, way in enumerate(ways):
            both = np.array([np.eye(2) + sign * step * way for sign in (1.0, -1.0)])
            up, down = law.respond(both @ states.F[k], np.zeros((2, 2, 2))).stress
            slope = (up - down) / (2.0 * step) / APPLE.tissue_thickness
            numbers = slope[0, 0], slope[1, 1], slope[0, 1]
            scale = abs(states.elastic[k]).max()
            # minor symmetries: shear of one entry turns as well, which changes no pressure
            np.testing.assert_allclose(numbers, states.elastic[k][:, column], atol=1e-5 * scale)


def test_the_wilted_box_of_irregular_cells_bears_nothing_but_the_bath():
    states, law = wilt(IRREGULAR, 3), RveLaw(IRREGULAR, initialisation="elastic")
    ones = states.stable
    stress = law.respond(states.F[ones], np.zeros_like(states.F[ones])).stress
    pressure = -states.bath[ones][:, None, None] * IRREGULAR.tissue_thickness * np.eye(2)
    np.testing.assert_allclose(stress, pressure, atol=1e-8)


def test_less_water_is_softer():
    states = wilt(APPLE, 3)
    assert (np.diff(states.elastic[states.stable, 2, 2]) < 0.0).all()


def test_a_bath_is_a_bulk_modulus_of_the_sap():
    """Turgid in a bath of K MPa, the sap has K MPa more of solutes: `sap_bulk_modulus` K."""
    cells = APPLE, replace(APPLE, sap_bulk_modulus=1.0)
    dry, bathed = (cell_moduli(cell, "elastic").elastic / cell.tissue_thickness for cell in cells)
    assert bathed[:2, :2].sum() / 4.0 == pytest.approx(dry[:2, :2].sum() / 4.0 + 1.0, rel=1e-6)


def test_what_cannot_wilt_is_refused():
    with pytest.raises(InputError, match=r"cell\.fluid: 'sph'; wilting needs"):
        wilt(CellParameters.preset("apple", fluid="sph"))
    with pytest.raises(InputError, match=r"cell\.sap_bulk_modulus: 5\.0; cells that wilt lose"):
        wilt(replace(APPLE, sap_bulk_modulus=5.0))
    with pytest.raises(InputError, match="points: 1; wilting needs at least 2"):
        wilt(APPLE, 1)
