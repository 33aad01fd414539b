"""Moduli by the symmetries and bounds that they obey."""

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.questions.moduli import (
    MODULI,
    cell_moduli,
    turgor,
    voigt,
    with_turgor,
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


def test_turgor_can_be_given_instead_of_mass():
    cell = with_turgor(CELLS["water"], 3.0)
    assert turgor(cell) == pytest.approx(3.0, rel=1e-8)
    back = with_turgor(CELLS["water"], turgor(CELLS["water"]))
    assert back.fluid_particle_mass == pytest.approx(0.27, rel=1e-8)
    with pytest.raises(InputError, match=r"turgor: -1\.0; it must be positive"):
        with_turgor(CELLS["water"], -1.0)
