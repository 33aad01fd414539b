"""Selective reduced integration: where the stress law is asked, and with what weight.

Each element has five points, numbered 5 e + q over the mesh:

    q = 0..3   2 × 2 Gauss points: the deviator σ − tr(σ)/2 I
    q = 4      element centre:     the pressure part tr(σ)/2 I

Every array over points has this order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import skfem
from numpy.typing import NDArray
from skfem.quadrature import get_quadrature
from skfem.refdom import RefQuad

Array = NDArray[np.float64]

N_GAUSS = 4
CENTRE = 4
N_POINTS = 5


@dataclass(frozen=True, slots=True)
class SelectiveQuadrature:
    """Reference gradients and weights.

    Attributes:
        gradients: (n_el, 5, 4, 2) ∇N of node a by the reference position, 1/µm.
        weights: (n_el, 5) reference area of each point, µm²: the four Gauss points together
            cover the element once, and so does the centre.
        shape: (5, 4) shape functions at the points.
    """

    gradients: Array
    weights: Array
    shape: Array


def make_quadrature(mesh: skfem.MeshQuad) -> SelectiveQuadrature:
    """Tabulate the bilinear shape functions of `mesh` at the five points of each element."""
    gauss_points, gauss_weights = get_quadrature(RefQuad, 3)
    local = np.concatenate([gauss_points, [[0.5], [0.5]]], axis=1)
    weights = np.append(gauss_weights, 1.0)
    basis = skfem.Basis(mesh, skfem.ElementQuad1(), quadrature=(local, weights))
    shape = np.stack([np.asarray(basis.basis[a][0])[0] for a in range(4)], axis=1)
    gradients = np.stack([basis.basis[a][0].grad for a in range(4)])
    return SelectiveQuadrature(
        gradients=np.ascontiguousarray(gradients.transpose(2, 3, 0, 1)),
        weights=np.ascontiguousarray(basis.dx),
        shape=shape,
    )
