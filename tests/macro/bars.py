"""Small bars: a run, a mesh of elements that are no rectangles, states at random."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import skfem
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from surrofe2.load_case import LoadCase
from surrofe2.macro import MacroSettings
from surrofe2.macro.discretisation import at_points, make_discretisation

LOAD_CASE = LoadCase(
    width=60.0, height=40.0, watched=(60.0, 20.0), duration=6.0, output_interval=0.25
)
SETTINGS = MacroSettings(elements=(2, 3), frames=13)
PLATE = LoadCase(width=30.0, height=20.0, watched=(30.0, 10.0), body_force=(0.3, -0.2))


def make_mesh(load_case, elements):
    """The elements of a bar as scikit-fem has them."""
    bar = make_discretisation(load_case, elements, 1.0)
    return skfem.MeshQuad(bar.nodes.T.copy(), bar.quads.T.copy())


class SparseMatrix:
    """A matrix or the inverse of one, as a `GridMass` is applied."""

    def __init__(self, apply):
        self.apply = apply

    def __matmul__(self, field):
        return self.apply(field)


def distorted_bar(rng, elements=(5, 4), density=0.08):
    """Inner nodes moved at random: elements that are no rectangles."""
    bar, mesh = make_discretisation(PLATE, elements, density), make_mesh(PLATE, elements)
    nodes = bar.nodes.copy()
    inner = mesh.interior_nodes()
    nodes[inner] += rng.uniform(-0.8, 0.8, (inner.size, 2))
    gradients, weights, _ = at_points(nodes, bar.quads)
    mass, nodal_mass = scikit_fem_mass(nodes, bar.quads, density)
    mass = csc_matrix(mass[bar.free][:, bar.free])
    return replace(
        bar,
        nodes=nodes,
        gradients=gradients,
        weights=weights,
        mass=SparseMatrix(lambda field: mass @ field),
        inverse_mass=SparseMatrix(splu(mass).solve),
        load=np.outer(nodal_mass[bar.free], PLATE.body_force),
    )


def scikit_fem_mass(nodes, quads, density):
    """(mass matrix, its row sums) of all nodes by scikit-fem."""
    basis = skfem.Basis(skfem.MeshQuad(nodes.T.copy(), quads.T.copy()), skfem.ElementQuad1())
    mass = density * skfem.BilinearForm(lambda u, v, w: u * v).assemble(basis)
    return mass, density * skfem.LinearForm(lambda v, w: 1.0 * v).assemble(basis)


def random_state(bar, rng, size=0.5):
    u, v = rng.uniform(-size, size, (2, len(bar.free), 2))
    return u, v
