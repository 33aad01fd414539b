"""Shape functions, quadrature, areas and mass against scikit-fem's."""

import numpy as np
import pytest
import skfem
from scipy.sparse import csc_matrix
from skfem.quadrature import get_quadrature
from skfem.refdom import RefQuad, RefTri

from surrofe2.macro.discretisation import make_discretisation, quadrature, reference_shapes
from surrofe2.macro.mesh import Mesh

ELEMENTS = {4: skfem.ElementQuad1(), 6: skfem.ElementTriP2()}
DOMAINS = {4: RefQuad, 6: RefTri}


@pytest.mark.parametrize("k", ELEMENTS)
def test_shape_functions_are_those_of_scikit_fem(k):
    points = np.random.default_rng(1).uniform(0.0, 0.5, (2, 7))
    values, slopes = reference_shapes(k, points)
    for a in range(k):
        value, slope = ELEMENTS[k].lbasis(points, a)
        np.testing.assert_allclose(values[:, a], value, atol=1e-14)
        np.testing.assert_allclose(slopes[:, a], slope.T, atol=1e-14)


@pytest.mark.parametrize("k", ELEMENTS)
@pytest.mark.parametrize("order", [2, 4])
def test_quadrature_integrates_monomials_of_its_order(k, order):
    x, w = quadrature(k, order)
    exact_x, exact_w = get_quadrature(DOMAINS[k], 8)
    for i in range(order + 1):
        for j in range(order + 1 - i):
            exact = exact_w @ (exact_x[0] ** i * exact_x[1] ** j)
            assert w @ (x[0] ** i * x[1] ** j) == pytest.approx(exact, abs=1e-14)


@pytest.mark.parametrize("k", ELEMENTS)
def test_mass_is_that_of_scikit_fem(k):
    rng = np.random.default_rng(2)
    if k == 4:
        mesh = skfem.MeshQuad.init_tensor(np.linspace(0, 3, 4), np.linspace(0, 2, 3))
        mesh = skfem.MeshQuad(mesh.p + rng.uniform(-0.1, 0.1, mesh.p.shape), mesh.t[[0, 3, 2, 1]])
    else:
        mesh = skfem.MeshTri.init_tensor(np.linspace(0, 3, 4), np.linspace(0, 2, 3))
    basis = skfem.Basis(mesh, ELEMENTS[k], intorder=6)
    exact = 0.11 * skfem.BilinearForm(lambda u, v, w: u * v).assemble(basis)
    space = discretised(basis)
    entries, row, column = space.mass(0.11)
    found = csc_matrix((entries, (row, column)), shape=exact.shape)
    assert abs(found - exact).max() < 1e-13 * abs(exact).max()


def discretised(basis):
    """Ours on the nodes and elements of a basis of scikit-fem."""
    elements = basis.element_dofs.T.astype(np.int64)
    nodes, corner = basis.doflocs.T, elements[:, :3]
    x = nodes[corner]
    first, second = x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]
    turn = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    if elements.shape[1] == 6:
        elements[turn < 0] = elements[turn < 0][:, [0, 2, 1, 5, 4, 3]]
    else:
        elements[turn < 0] = elements[turn < 0][:, [0, 3, 2, 1]]
    return make_discretisation(Mesh(nodes, elements))
