"""Moduli by the symmetries and bounds that they obey."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.plant_cell.measurements import living_cell
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.questions.moduli import (
    MODULI,
    cell_moduli,
    experiment_table,
    poisson,
    shear_modulus,
    turgor,
    voigt,
    with_turgor,
    young,
)
from surrofe2.rve import INITIALISATIONS, RveLaw

CELLS = {name: CellParameters.preset(name) for name in ("printed", "water")}


@pytest.mark.parametrize("preset", CELLS)
@pytest.mark.parametrize("initialisation", INITIALISATIONS)
def test_a_square_cell_has_square_symmetry_and_positive_moduli(preset, initialisation):
    found = cell_moduli(CELLS[preset], initialisation)
    for C in (found.elastic, found.viscous):
        scale = np.abs(C).max()
        assert C[0, 0] == pytest.approx(C[1, 1], abs=1e-9 * scale)
        assert np.abs([C[0, 2], C[1, 2], C[2, 0], C[2, 1]]).max() < 1e-9 * scale
        assert min(MODULI[name](C) for name in ("bulk", "shear", "shear 45°", "young")) > 0.0


@pytest.mark.parametrize("preset", CELLS)
def test_affine_motion_is_the_stiffest(preset):
    born, elastic, slow = (
        cell_moduli(CELLS[preset], name) for name in ("cauchy-born", "elastic", "slow-manifold")
    )
    assert np.linalg.eigvalsh(born.elastic - elastic.elastic).min() > 0.0
    assert np.linalg.eigvalsh(elastic.viscous - slow.viscous).min() > 0.0


def test_elastic_moduli_are_slopes_of_the_stress():
    law, step = RveLaw(CELLS["water"], initialisation="elastic"), 1e-5
    F = np.eye(2) + step * np.array([np.diag([1.0, 0.0]), np.diag([-1.0, 0.0])])
    up, down = law.respond(F, 0.0 * F).stress
    slope = (up - down) / (2.0 * step)
    C = cell_moduli(CELLS["water"], "elastic").elastic
    np.testing.assert_allclose([slope[0, 0], slope[1, 1]], C[:2, 0], rtol=1e-4, atol=1e-2)


def test_voigt_of_an_isotropic_tangent():
    d = np.eye(2)
    shear = np.einsum("ac,bd->abcd", d, d) + np.einsum("ad,bc->abcd", d, d)
    C = voigt(3.0 * np.einsum("ab,cd->abcd", d, d) + 2.0 * shear)
    np.testing.assert_allclose(C, [[7, 3, 0], [3, 7, 0], [0, 0, 2]])


@pytest.mark.parametrize("preset", ["water", "apple"])
def test_a_wanted_turgor_is_what_walls_carry_at_the_same_density(preset):
    cell = CellParameters.preset(preset)
    changed = with_turgor(cell, 0.7)
    assert turgor(changed) == pytest.approx(0.7, rel=1e-8)
    assert changed.density == cell.density
    back = with_turgor(changed, turgor(cell))
    assert back.sound_speed == pytest.approx(cell.sound_speed, rel=1e-8)
    assert back.repulsion_strength == pytest.approx(cell.repulsion_strength, rel=1e-8)


def test_a_wanted_turgor_is_that_of_a_recipe():
    stated = living_cell("apple", turgor=0.8)
    wanted = with_turgor(CellParameters.preset("apple"), 0.8)
    assert wanted.sound_speed == pytest.approx(stated.sound_speed, rel=1e-12)
    assert wanted.repulsion_strength == pytest.approx(stated.repulsion_strength, rel=1e-12)
    constants = {"sound_speed": 1.0, "repulsion_strength": 1.0}
    assert replace(wanted, **constants) == replace(stated, **constants)


@pytest.mark.parametrize(
    ("pressure", "message"),
    [
        (-1.0, r"turgor: -1\.0; it must be positive"),
        (0.0, "turgor: 0; walls here do not resist bending"),
    ],
)
def test_no_cell_without_turgor(pressure, message):
    with pytest.raises(InputError, match=message):
        with_turgor(CELLS["water"], pressure)


def test_moduli_of_an_isotropic_tissue_are_the_same_in_every_direction():
    bulk, shear = 5.0, 2.0
    C = np.array([[bulk + shear, bulk - shear, 0], [bulk - shear, bulk + shear, 0], [0, 0, shear]])
    for degrees in (0.0, 20.0, 45.0, 90.0):
        assert shear_modulus(C, degrees) == pytest.approx(shear)
        assert young(C, degrees) == pytest.approx(4.0 * bulk * shear / (bulk + shear))
        assert poisson(C, degrees) == pytest.approx((bulk - shear) / (bulk + shear))


def test_directions_turn_with_the_tissue():
    """Moduli along a direction are those along x of the tissue turned back by it."""
    C, angle = np.array([[7.0, 2.0, 0.5], [2.0, 4.0, -0.3], [0.5, -0.3, 1.5]]), np.deg2rad(30.0)
    c, s = np.cos(angle), np.sin(angle)
    strain = np.array(
        [[c * c, s * s, c * s], [s * s, c * c, -c * s], [-2 * c * s, 2 * c * s, c * c - s * s]]
    )  # xx, yy, engineering xy of the turned axes
    turned = np.linalg.inv(strain).T @ C @ np.linalg.inv(strain)
    for of in (young, poisson, shear_modulus):
        assert of(C, 30.0) == pytest.approx(of(turned, 0.0))


def test_an_experiment_on_squares_finds_the_constants_of_their_walls():
    cell = CellParameters.preset("apple")
    rows = {row["quantity"]: row["value"] for row in experiment_table(cell).to_records()}
    C = cell_moduli(cell, "elastic").elastic / cell.tissue_thickness
    assert rows["Young's modulus along x"] == pytest.approx(MODULI["young"](C))
    assert rows["Young's modulus along y"] == pytest.approx(MODULI["young"](C))
    assert rows["shear modulus along the axes"] == pytest.approx(MODULI["shear"](C))
    assert rows["shear modulus at 45°"] == pytest.approx(MODULI["shear 45°"](C))
    assert rows["Poisson's ratio along x"] == pytest.approx(MODULI["poisson"](C))
    assert rows["turgor"] == pytest.approx(0.4)
    assert rows["stable in compression along x up to"] == pytest.approx(11.9, abs=0.1)
