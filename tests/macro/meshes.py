"""Meshes of both kinds of elements, none of them regular, and integrals over them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from skfem.quadrature import get_quadrature
from skfem.refdom import RefQuad, RefTri

from surrofe2.macro import Box, Mesh
from surrofe2.macro.discretisation import reference_shapes

WIDTH, HEIGHT = 30.0, 20.0
KINDS = ("quads", "triangles", "curved triangles")


def plate(kind, rng, elements=(4, 3), size=(WIDTH, HEIGHT), *, distortion=0.15, bulge=0.0):
    """A rectangle with its sides named, inner nodes moved at random by a share of an element.

    Args:
        kind: one of KINDS; a curved triangle's inner sides are bent at random.
        bulge: by which the middles of the right and the top outer sides move out, µm.
    """
    width, height = size
    mesh = Mesh.rectangle(width, height, elements)
    spacing = np.divide(size, elements)
    moved = mesh.nodes + _inner(mesh.nodes, size) * spacing * rng.uniform(
        -distortion, distortion, mesh.nodes.shape
    )
    if kind == "quads":
        return replace(mesh, nodes=moved)
    corners = np.concatenate([mesh.elements[:, [0, 1, 2]], mesh.elements[:, [0, 2, 3]]])
    nodes, triangles = with_middles(moved, corners)
    middle = np.arange(len(nodes))[:, None] >= len(moved)
    if kind == "curved triangles":
        bend = 0.08 * spacing * rng.uniform(-1.0, 1.0, nodes.shape)
        nodes = nodes + middle * _inner(nodes, size) * bend
    sides = Mesh(nodes, triangles).with_boundaries(
        left=Box((0.0, 0.0), (0.0, height)),
        right=Box((width, 0.0), (width, height)),
        bottom=Box((0.0, 0.0), (width, 0.0)),
        top=Box((0.0, height), (width, height)),
    )
    outward = (np.isclose(nodes, size) & middle) * bulge
    return replace(sides, nodes=nodes + outward)


def with_middles(nodes, corners):
    """Six-node triangles: nodes and elements with the middle of every side."""
    ends = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    sides, number = np.unique(np.sort(ends, axis=1), axis=0, return_inverse=True)
    middles = len(nodes) + number.reshape(3, -1).T
    return np.concatenate([nodes, nodes[sides].mean(axis=1)]), np.hstack([corners, middles])


def quadrature(mesh, order=6):
    """Positions (e, q, 2), weights (e, q), shape functions (q, k), their slopes (e, q, k, 2)."""
    k = mesh.elements.shape[1]
    points, rule = get_quadrature(RefQuad if k == 4 else RefTri, order)
    shape, slopes = reference_shapes(k, points)
    corners = mesh.nodes[mesh.elements]
    jacobian = np.einsum("eai,qaj->eqij", corners, slopes)
    gradients = np.einsum("qaj,eqji->eqai", slopes, np.linalg.inv(jacobian))
    return shape @ corners, np.linalg.det(jacobian) * rule, shape, gradients


def weak_load(mesh, P):
    """(n, 2) ∫ P(x) : ∇N dV of a first Piola stress P of positions (..., 2): body force and
    tractions of a stress field at once."""
    x, weights, _, gradients = quadrature(mesh)
    load = np.zeros_like(mesh.nodes)
    np.add.at(load, mesh.elements, np.einsum("eq,eqij,eqaj->eai", weights, P(x), gradients))
    return load


def distance(mesh, u, exact):
    """L² norm of u (n, 2) − exact(x)."""
    x, weights, shape, _ = quadrature(mesh)
    return np.sqrt(np.sum(weights[..., None] * (shape @ u[mesh.elements] - exact(x)) ** 2))


def _inner(nodes, size):
    return ((nodes > 0.0) & (nodes < size)).all(axis=1)[:, None]
