"""Nearly incompressible tissue bends as mixed elements say; what locks is seen to lock."""

import numpy as np
import pytest
import skfem

from surrofe2.problem import Fixed, Problem
from validation.locking import (
    LOCKING_QUADRILATERAL,
    LOCKING_TRIANGLE,
    OWN,
    PROBLEMS,
    SHEAR_MODULUS,
    SIX_NODES,
    LinearLaw,
    by_mixed_elements,
    measure,
)

REFERENCE = {"Cook's membrane": 24, "cantilever": 8}


@pytest.mark.parametrize("name", PROBLEMS)
def test_elements_do_not_lock_and_those_of_one_field_and_first_order_do(name):
    off = {
        (row.element, row.ratio): row.off
        for ratio in (400.0, 3500.0)
        for row in measure(name, ratio, (4,), REFERENCE[name])
    }
    for element in OWN:
        assert abs(off[element, 3500.0]) < 15.0
        assert off[element, 3500.0] == pytest.approx(off[element, 400.0], abs=0.5)
    for element in (LOCKING_QUADRILATERAL, LOCKING_TRIANGLE):
        assert off[element, 3500.0] < -45.0
        assert off[element, 3500.0] < off[element, 400.0]


def test_the_mixed_reference_is_that_of_displacements_where_nothing_locks():
    """Quadratic triangles of one field and Taylor–Hood agree for K = 2 G."""
    law = LinearLaw(2.0 * SHEAR_MODULUS)
    reference = by_mixed_elements("cantilever", law, 8)
    ours = measure("cantilever", 2.0, (8,), 8)
    assert reference > 0.0
    off = {row.element: row.off for row in ours}
    assert abs(off[SIX_NODES]) < 0.1


def test_three_node_triangles_of_a_mesh_become_six_node_ones():
    mesh = skfem.MeshTri1().refined(1).with_boundaries({"left": lambda x: x[0] == 0.0})
    problem = Problem(mesh=mesh, conditions=(Fixed(on="left", components="xy"),))
    assert problem.mesh.dofs.element_dofs.shape[0] == 6


def test_the_law_is_linear_with_its_moduli():
    """Under a pure dilation P = 2 K ε I, under a pure shear P = 2 G ε."""
    law = LinearLaw(4000.0)
    size = 1e-7
    F = np.eye(2) + size * np.array([np.eye(2), [[0.0, 1.0], [1.0, 0.0]]])
    answer = law.respond(F, 0.0 * F, tangents=True)
    P = answer.first_piola(F)
    np.testing.assert_allclose(P[0], 2.0 * 4000.0 * size * np.eye(2), rtol=1e-6)
    np.testing.assert_allclose(P[1, 0, 1], 2.0 * SHEAR_MODULUS * size, rtol=1e-6)
