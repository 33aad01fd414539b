"""A slab's forces in plain numpy, pair by pair over its images, by the rules of a tissue."""

import numpy as np

from tests.plant_cell.twin import Twin, spline


class SlabTwin(Twin):
    """Forces of a column of square plant cells with single walls above and below.

    Particles are owned by one column or by the next, so their images reach two columns far.
    """

    def __init__(self, cell, rest_length, start, rows):
        self.rows = rows
        self.start, self.per_side = start, cell.wall_springs_per_side
        self.is_wall = np.arange(len(start)) < rows * (2 * self.per_side - 1) + self.per_side
        super().__init__(cell, rest_length)
        self.walls, self.particles = int(self.is_wall.sum()), len(start)
        every = [
            (i, j, a)
            for i in range(self.particles)
            for j in range(self.particles)
            for a in (0, 1, 2)
            if (a > 0 or (a == 0 and i < j))
        ]
        self.pairs = [(*pair, *kind) for pair in every if (kind := self._slab_kind(*pair))]

    def _pairs(self):
        return []

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
        c, side = self.cell, self.cell.cell_side
        f, resultant, moment, density = np.zeros_like(x), 0.0, 0.0, np.zeros(len(x))
        middle = 0.5 * (x[:, 1].min() + x[:, 1].max())
        for i in np.flatnonzero(~self.is_wall):
            mine = [j for j in np.flatnonzero(~self.is_wall) if self._row(j) == self._row(i)]
            r = np.linalg.norm(x[mine] - x[i], axis=1)
            density[i] = c.fluid_particle_mass * spline(r, c.smoothing_length).sum()
        for i, j, a, kind, share in self.pairs:
            r = x[j] - x[i] + (a * stretch * side, 0.0)
            w = v[j] - v[i] + (a * rate * side, 0.0)
            length = np.linalg.norm(r)
            if kind == "contact" and length >= c.repulsion_cutoff:
                continue
            force = share * getattr(self, f"_{kind}")(r, w, length, density[i], density[j])[0]
            f[i] += force
            f[j] -= force
            resultant += a * force[0]
            apart = abs(x[i, 1] + 0.5 * r[1] - middle)
            moment += force[0] * r[0] * apart / (stretch * side)
        return f, resultant, moment
