"""Outer sides of the tissue that cross each other.

Nothing keeps them apart, since FE² has contact with rigid bodies alone; so their crossings are
counted and reported.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy  # scipy.spatial is loaded where sides are near each other
import skfem

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.problem.mesh import facet_nodes


@dataclass(frozen=True, slots=True)
class OuterSides:
    """The straight pieces between neighbouring nodes along all outer sides of the tissue.

    Attributes:
        nodes: (s, 2) both ends of each piece.
    """

    nodes: Index

    @staticmethod
    def of(mesh: skfem.Mesh) -> OuterSides:
        """Return the pieces of a mesh, two for each side that has a node in its middle."""
        sides = facet_nodes(mesh, mesh.boundary_facets())
        if sides.shape[1] == 3:
            # two pieces: both ends are joined to the node in the middle, which is the last
            sides = np.concatenate([sides[:, [0, 2]], sides[:, [2, 1]]])
        return OuterSides(sides)

    def crossings(self, x: Array) -> int:
        """Count the pairs of pieces that cross each other.

        Args:
            x: (n_nodes, 2) positions of the nodes, µm.
        """
        first = x[self.nodes[:, 0]]
        last = x[self.nodes[:, 1]]
        longest = float(np.linalg.norm(last - first, axis=1).max())
        # Pieces that cross have middles no farther apart than the longest of them is long.
        middles = scipy.spatial.cKDTree(0.5 * (first + last))
        near = middles.query_pairs(longest, output_type="ndarray")
        shares_no_node = np.ones(len(near), dtype=bool)
        for a in range(2):
            for b in range(2):
                shares_no_node &= self.nodes[near[:, 0], a] != self.nodes[near[:, 1], b]
        i, j = near[shares_no_node].T
        crosses = _parts(first[i], last[i], first[j], last[j])
        crosses &= _parts(first[j], last[j], first[i], last[i])
        return int(crosses.sum())


def _parts(a: Array, b: Array, p: Array, q: Array) -> Flags:
    """Return where the straight line through a and b has p and q on different sides, all (n, 2)."""
    along = b - a
    side_of_p = along[:, 0] * (p - a)[:, 1] - along[:, 1] * (p - a)[:, 0]
    side_of_q = along[:, 0] * (q - a)[:, 1] - along[:, 1] * (q - a)[:, 0]
    return np.asarray(side_of_p * side_of_q < 0.0)
