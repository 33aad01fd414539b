"""The part of a mesh whose mean stretch a side's surface law takes: its outer plant cell.

A law acts at the depth d below the outline and takes the mean stretch over the width w of a plant
cell along it. Of the points q of a mesh, with areas A_q and depths y_q below a side, those count
that are within w/2 of its middle and above 2d, and all of the element beside it:

    F̄ = Σ_q A_q (1 + β (y_q − ȳ)) F_q / Σ_q A_q,    β = (d − ȳ) / (mean of (y_q − ȳ)²)

with ȳ the mean depth. So F̄ is F at the depth d where F is linear across, whatever the mesh. In
elements finer than w the mean keeps waves of an element's length from buckling.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surrofe2.macro.discretisation import Discretisation
from surrofe2.macro.free_sides import FreeSides

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_EVEN = 1e-12
"""Squared spread of depths over that of the patch, below which they are all the same."""


def stretched_nodes(sides: FreeSides, space: Discretisation) -> tuple[Index, Array]:
    """(m, k) nodes and D_a, 1/µm, of F̄ T = T + Σ_a u_a D_a of all sides; D is 0 where k is less."""
    n_q = space.points_per_element - space.pressure_apart
    position = space.point_positions().reshape(len(space.elements), -1, 2)[:, :n_q]
    corners = space.nodes[sides.nodes[:, :2]]
    found = []
    for p, element in enumerate(sides.elements):
        law = sides.laws[sides.law[p]]
        middle, along = corners[p].mean(axis=0), corners[p, 1] - corners[p, 0]
        along = along / np.linalg.norm(along)
        inward = np.array([-along[1], along[0]])
        if inward @ (position[element].mean(axis=0) - middle) < 0.0:
            inward = -inward
        ahead, depth = (position - middle) @ along, (position - middle) @ inward
        taken = (abs(ahead) <= 0.5 * law.width) & (depth >= 0.0) & (depth <= 2.0 * law.depth)
        taken[element] = True
        own, q = np.nonzero(taken)
        weights = _weights(space.weights[own, q], depth[taken], law.depth)
        slopes = weights[:, None] * (space.gradients[own, q] @ along)
        nodes, place = np.unique(space.elements[own], return_inverse=True)
        found.append((nodes, np.bincount(place.ravel(), slopes.ravel())))
    most = max(len(nodes) for nodes, _ in found)
    every, by_node = np.zeros((len(found), most), np.int64), np.zeros((len(found), most))
    for p, (nodes, slopes) in enumerate(found):
        every[p], every[p, : len(nodes)] = nodes[0], nodes
        by_node[p, : len(nodes)] = slopes
    return every, by_node


def _weights(areas: Array, depths: Array, wanted: float) -> Array:
    """Those of points, whose mean depth is the wanted one."""
    shares = areas / areas.sum()
    apart = depths - shares @ depths
    spread = float(shares @ apart**2)
    if spread <= _EVEN * areas.sum():
        return shares
    weights: Array = shares * (1.0 + (wanted - shares @ depths) / spread * apart)
    return weights
