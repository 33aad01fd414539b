"""Meshes of both kinds of elements, none of them regular, and integrals over them."""

from dataclasses import replace

import numpy as np
import skfem

from surrofe2.problem import Box, rectangle, with_boundaries
from surrofe2.problem.mesh import boundary, element_nodes, facet_nodes

WIDTH, HEIGHT = 30.0, 20.0
KINDS = ("quads", "triangles", "curved triangles")


def plate(kind, rng, elements=(4, 3), size=(WIDTH, HEIGHT), *, distortion=0.15, bulge=0.0):
    """A rectangle with its sides named, inner nodes moved at random by a share of an element.

    Args:
        kind: one of KINDS; a curved triangle's inner sides are bent at random.
        bulge: by which the middles of the right and the top outer sides move out, µm.
    """
    width, height = size
    mesh = rectangle(width, height, elements)
    spacing = np.divide(size, elements)
    nodes = mesh.p.T
    shift = spacing * rng.uniform(-distortion, distortion, nodes.shape)
    moved = nodes + _inner(nodes, size) * shift
    if kind == "quads":
        return replace(mesh, doflocs=moved.T)
    mesh = triangles(moved, np.concatenate([mesh.t.T[:, [0, 1, 2]], mesh.t.T[:, [0, 2, 3]]]))
    nodes = mesh.p.T
    middle = np.arange(len(nodes))[:, None] >= len(moved)
    if kind == "curved triangles":
        bend = 0.08 * spacing * rng.uniform(-1.0, 1.0, nodes.shape)
        nodes = nodes + middle * _inner(nodes, size) * bend
    sides = with_boundaries(
        replace(mesh, doflocs=nodes.T),
        left=Box((0.0, 0.0), (0.0, height)),
        right=Box((width, 0.0), (width, height)),
        bottom=Box((0.0, 0.0), (width, 0.0)),
        top=Box((0.0, height), (width, height)),
    )
    outward = (np.isclose(nodes, size) & middle) * bulge
    return replace(sides, doflocs=(nodes + outward).T)


def triangles(nodes, corners):
    """Six-node triangles: nodes (n, 2), then the middles of all sides."""
    return skfem.MeshTri2.from_mesh(skfem.MeshTri1(nodes.T, corners.T, sort_t=False))


def sides_of(mesh, name):
    """Nodes of the sides of a boundary, the tissue on their left."""
    return facet_nodes(mesh, boundary(mesh, name))


def quadrature(mesh, order=6):
    """Positions (e, q, 2), weights (e, q), shape functions (q, k), their slopes (e, q, k, 2)."""
    basis = skfem.Basis(mesh, mesh.elem(), intorder=order)
    shape = np.stack([np.asarray(each[0])[0] for each in basis.basis], axis=1)
    gradients = np.stack([each[0].grad for each in basis.basis]).transpose(2, 3, 0, 1)
    return np.moveaxis(np.asarray(basis.global_coordinates()), 0, -1), basis.dx, shape, gradients


def weak_load(mesh, P):
    """(n, 2) ∫ P(x) : ∇N dV of a first Piola stress P of positions (..., 2): body force and
    tractions of a stress field at once."""
    x, weights, _, gradients = quadrature(mesh)
    load = np.zeros_like(mesh.p.T)
    np.add.at(load, element_nodes(mesh), np.einsum("eq,eqij,eqaj->eai", weights, P(x), gradients))
    return load


def distance(mesh, u, exact):
    """L² norm of u (n, 2) − exact(x)."""
    x, weights, shape, _ = quadrature(mesh)
    return np.sqrt(np.sum(weights[..., None] * (shape @ u[element_nodes(mesh)] - exact(x)) ** 2))


def _inner(nodes, size):
    return ((nodes > 0.0) & (nodes < size)).all(axis=1)[:, None]
