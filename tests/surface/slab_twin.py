"""A slab's forces in plain numpy, pair by pair over its images, by the rules of a tissue."""

import numpy as np

from tests.plant_cell.twin import pair_forces


class SlabTwin:
    """Forces of a column of square plant cells with single walls above and below.

    Particles are owned by one column or by the next, so their images reach two columns far.
    """

    def __init__(self, cell, rest_length, start, rows):
        self.rows = rows
        self.start, self.per_side = start, cell.wall_springs_per_side
        self.is_wall = np.arange(len(start)) < rows * (2 * self.per_side - 1) + self.per_side
        self.cell, self.rest_length = cell, rest_length
        n, kinds = len(start), {"bond": [], "contact": [], "fluid": []}
        for i, j, a in np.ndindex(n, n, 3):
            if (a > 0 or i < j) and (kind := self._slab_kind(i, j, a)):
                kinds[kind[0]].append((i, j, kind[1], a))
        self.pairs = {kind: np.array(rows).T for kind, rows in kinds.items()}

    def _place(self, i, a=0):
        """On the grid of springs."""
        spacing = self.cell.cell_side / self.per_side
        column, row = np.round(self.start[i] / spacing).astype(int)
        return np.array([column + a * self.per_side, row])

    def _row(self, i):
        return int(self.start[i, 1] // self.cell.cell_side)

    def _slab_kind(self, i, j, a):
        """(kind, share), or None."""
        fluid = [k for k in (i, j) if not self.is_wall[k]]
        if len(fluid) == 2:
            return ("fluid", 1.0) if a == 0 and self._row(i) == self._row(j) else None
        if len(fluid) == 1:
            wall = self._place(i) if self.is_wall[i] else self._place(j, a)
            wall = wall - (0 if self.is_wall[j] else a * self.per_side, 0)
            wall = wall - (0, self._row(fluid[0]) * self.per_side)
            return ("contact", 1.0) if ((wall >= 0) & (wall <= self.per_side)).all() else None
        first, second = self._place(i), self._place(j, a)
        outer = first[1] == second[1] and first[1] in (0, self.rows * self.per_side)
        share = 0.5 * self.cell.outer_wall if outer else 1.0
        return "bond" if np.abs(second - first).sum() == 1 else "contact", share

    def forces(self, x, v, stretch, rate):
        """f (n, 2) at x and v, the force that neighbouring columns pull each other with, and its
        moment by the distance from the middle of the slab: the forces of both halves added up.
        """
        side, f, resultant, moment = self.cell.cell_side, np.zeros_like(x), 0.0, 0.0
        middle = 0.5 * (x[:, 1].min() + x[:, 1].max())
        pairs = {
            kind: (i.astype(int), j.astype(int), share,
                   *(a[:, None] * np.array([size * side, 0.0]) for size in (stretch, rate)))
            for kind, (i, j, share, a) in self.pairs.items()
        }  # fmt: skip
        for kind, i, j, r, force, *_ in pair_forces(self.cell, self.rest_length, x, v, pairs):
            np.add.at(f, i, force)
            np.add.at(f, j, -force)
            resultant += self.pairs[kind][3] @ force[:, 0]
            apart = abs(x[i, 1] + 0.5 * r[:, 1] - middle)
            moment += (force[:, 0] * r[:, 0]) @ apart / (stretch * side)
        return f, resultant, moment
