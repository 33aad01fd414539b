"""Of a long list of contacts those that can act while particles stay near where they are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.compilation import kernel
from surrofe2.plant_cell.tiles import Topology

Reals = NDArray[np.float64]


class NearContacts:
    """The contacts of a topology, and the topology with few of them.

    Those left out exert no force, so that what is computed with the others is the same to the bit.
    """

    def __init__(self, topology: Topology, cutoff: float) -> None:
        self.topology, self.cutoff = topology, cutoff
        owner = np.append(np.arange(topology.particles), topology.owner)
        moved = np.vstack([np.zeros((topology.particles, 2)), topology.image_offset])
        i, j = topology.contacts.T
        self._ends, self._offset = owner[topology.contacts], moved[j] - moved[i]

    def within(self, F: Reals, z: Reals, way: Reals) -> Topology:
        """Without contacts that none of m RVEs can have, z (m, 2, n), F (m, 2, 2).

        Args:
            way: (m,) µm, how far particles may move in space from x = F z.
        """
        near = np.empty(len(self._ends), dtype=np.bool_)
        mark_near(F, z, self._ends, self._offset, self.cutoff + 2.0 * way, near)
        return self.topology._replace(contacts=self.topology.contacts[near])


@kernel
def mark_near(F, z, ends, offset, reach, near):
    """near (k,): whether the particles `ends` (k, 2) are within `reach` (m,) in any RVE."""
    for k in range(ends.shape[0]):
        i, j = ends[k, 0], ends[k, 1]
        near[k] = False
        for p in range(z.shape[0]):
            dx = z[p, 0, j] - z[p, 0, i] + offset[k, 0]
            dy = z[p, 1, j] - z[p, 1, i] + offset[k, 1]
            rx, ry = F[p, 0, 0] * dx + F[p, 0, 1] * dy, F[p, 1, 0] * dx + F[p, 1, 1] * dy
            if rx * rx + ry * ry < reach[p] * reach[p]:
                near[k] = True
                break
