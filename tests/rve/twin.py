"""Constrained runs and slow manifold in plain numpy: Newton on the particles of one RVE.

Forces are those of the plain twin over all images; Jacobians are dense central differences;
nothing is kept from one solve to the next. Formulas from docs/theory.md.
"""

import numpy as np

from tests.plant_cell.twin import Twin

STEP = 1e-4
"""Half width of the differences, µm."""


class Solver:
    """Newton for one cell; z (n, 2) material positions, the corner z[0] held at the origin."""

    def __init__(self, cell, rest_length):
        self.twin = Twin(cell, rest_length)

    def forces(self, z, F, F_dot, beyond=0.0):
        return self.twin.evaluate(z, F, F_dot, beyond)[0]

    def stress(self, z, F, F_dot, beyond=0.0):
        return self.twin.evaluate(z, F, F_dot, beyond)[2]

    def slope(self, residual, z):
        """∂ residual/∂z of the free particles, (2 n − 2, 2 n − 2)."""
        columns = []
        for k in range(2, z.size):
            shift = np.zeros(z.size)
            shift[k] = STEP
            shift = shift.reshape(z.shape)
            columns.append((residual(z + shift) - residual(z - shift))[1:].ravel() / (2 * STEP))
        return np.transpose(columns)

    def solve(self, residual, z, slope=None, tolerance=1e-11):
        """z at which residual(z) (n, 2) vanishes, with a new Jacobian where one serves badly."""
        slope = self.slope(residual, z) if slope is None else slope
        before = np.inf
        while (size := np.linalg.norm(residual(z), axis=1).mean()) > tolerance:
            if size > 0.3 * before:
                slope = self.slope(residual, z)
            before = size
            z = z.copy()
            z[1:] -= np.linalg.solve(slope, residual(z)[1:].ravel()).reshape(-1, 2)
        return z

    def constrained_runs(self, F, F_dot, start):
        """z and σ where f(F z, Ḟ z) = 0."""
        z = self.solve(lambda z: self.forces(z, F, F_dot), start)
        return z, self.stress(z, F, F_dot)

    def elastic(self, F, F_dot, start):
        """z where f(F z, 0) = 0, and σ there with velocities Ḟ z."""
        z = self.solve(lambda z: self.forces(z, F, np.zeros((2, 2))), start)
        return z, self.stress(z, F, F_dot)

    def slow_manifold(self, F, F_dot, start):
        """z and σ where f(F z, v) = 0 with v = Ḟ z_el + F (∂z_el/∂F : Ḟ).

        The rate of z_el solves the linear equation J y = −ḟ_el at fixed z, with ḟ_el along Ḟ by a
        central difference of fourth order.
        """
        still = np.zeros((2, 2))
        elastic, _ = self.elastic(F, F_dot, start)

        def along(h):
            return self.forces(elastic, F + h * F_dot, still)

        h = 0.02
        load = (8.0 * (along(h) - along(-h)) - (along(2 * h) - along(-2 * h))) / (12.0 * h)
        slope = self.slope(lambda z: self.forces(z, F, still), elastic)
        y = np.zeros_like(elastic)
        y[1:] = -np.linalg.solve(slope, load[1:].ravel()).reshape(-1, 2)
        v = elastic @ F_dot.T + y @ F.T
        z = self.solve(lambda z: self.forces(z, F, F_dot, v - z @ F_dot.T), elastic, slope)
        return z, self.stress(z, F, F_dot, v - z @ F_dot.T)
