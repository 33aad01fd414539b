"""Elastic forces, stress and Hessian of one square cell in plain numpy, many points at once.

Written from the formulas of docs/theory.md, second derivatives of the energies of
`tests.plant_cell.twin` by hand: no pair lists, no kernels. A pair with stored energy φ(r) has the
stiffness

    K = φ″ n⊗n + φ′/r (1 − n⊗n)
"""

import numpy as np

from tests.plant_cell.twin import Twin, spline, spline_slope


def spline_bend(r, h):
    s, sigma = r / h, 10.0 / (7.0 * np.pi * h**4)
    inner, outer = -3.0 + 4.5 * s, 1.5 * (2.0 - s)
    return sigma * np.where(s < 1.0, inner, np.where(s < 2.0, outer, 0.0))


class Curvatures(Twin):
    """Of `cell` at material positions z (m, n, 2) under F (m, 2, 2), at rest."""

    def at(self, z, F):
        """Forces (m, n, 2), Cauchy stress (m, 2, 2), Hessian (m, 2n − 2, 2n − 2), corner held."""
        m, n = z.shape[:2]
        x, f, virial = z @ F.transpose(0, 2, 1), np.zeros_like(z), np.zeros((m, 2, 2))
        H = np.zeros((m, n, n, 2, 2))
        density, gradient = self._densities(x)
        for kind, (i, j, _, shift) in self.pairs.items():
            offset = self.cell.cell_side * shift @ F.transpose(0, 2, 1)
            r = x[:, j] + offset - x[:, i]
            length = np.linalg.norm(r, axis=2)
            slope, bend = getattr(self, f"_{kind}")(length, density, i, j)
            for p in np.flatnonzero((slope != 0.0).any(axis=0) | (bend != 0.0).any(axis=0)):
                direction = r[:, p] / length[:, p, None]
                force = slope[:, p, None] * direction
                virial += force[:, :, None] * r[:, p, None, :]
                nn = direction[:, :, None] * direction[:, None, :]
                across = (slope[:, p] / length[:, p])[:, None, None] * (np.eye(2) - nn)
                K = bend[:, p, None, None] * nn + across
                for a, b, sign in ((i[p], j[p], 1.0), (j[p], i[p], -1.0)):
                    f[:, a] += sign * force
                    H[:, a, a] += K
                    H[:, a, b] -= K
        H = H.transpose(0, 1, 3, 2, 4).reshape(m, 2 * n, 2 * n)
        scale = self.cell.fluid_particle_mass * self.cell.sound_speed**2
        weighted = gradient / density[:, :, None]
        H -= scale * weighted.transpose(0, 2, 1) @ weighted
        area = np.linalg.det(F) * self.cell.cell_side**2
        return f, virial / area[:, None, None], H[:, 2:, 2:]

    def _densities(self, x):
        """ρ (m, fluid) and ∂ρ/∂x (m, fluid, 2n)."""
        m, n = x.shape[:2]
        mass, h = self.cell.fluid_particle_mass, self.cell.smoothing_length
        fluid = x[:, self.walls :]
        r = fluid[:, None] - fluid[:, :, None]
        length = np.linalg.norm(r, axis=3)
        density = mass * spline(length, h).sum(axis=2)
        slope = mass * spline_slope(length, h) / np.where(length > 0.0, length, 1.0)
        by_other = slope[..., None] * r
        gradient = np.zeros((m, n - self.walls, n, 2))
        gradient[:, :, self.walls :] = by_other
        own = np.arange(n - self.walls)
        gradient[:, own, self.walls + own] -= by_other.sum(axis=2)
        return density, gradient.reshape(m, n - self.walls, 2 * n)

    def _bond(self, length, *_):
        k = self.cell.wall_stiffness
        return k * (length - self.rest_length), np.full_like(length, k)

    def _contact(self, length, *_):
        strength, cutoff = self.cell.repulsion_strength, self.cell.repulsion_cutoff
        inside = length < cutoff
        slope = strength * (cutoff**-6 - length**-6)
        return np.where(inside, slope, 0.0), np.where(inside, 6.0 * strength * length**-7, 0.0)

    def _fluid(self, length, density, i, j):
        mass, h = self.cell.fluid_particle_mass, self.cell.smoothing_length
        weight = 1.0 / density[:, i - self.walls] + 1.0 / density[:, j - self.walls]
        weight *= (mass * self.cell.sound_speed) ** 2
        return weight * spline_slope(length, h), weight * spline_bend(length, h)
