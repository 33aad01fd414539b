"""A smooth law with the symmetry of the square cell, not isotropic, and tangents; no cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.stress_law import Acceptance, Status, StressResponse, Tangents, check_deformation
from surrofe2.tensors import det, from_components, to_inputs, transpose

STEP = 1e-5


def square_stress(F, F_dot):
    """R S Rᵀ; sum, difference, shear, spin of S have the parities of D4."""
    x, R = to_inputs(F, F_dot)
    e, d, g, a, b, c, w = x.T
    s = np.stack(
        [
            40.0 * e + 90.0 * e**2 + 60.0 * d**2 + 30.0 * g**2 + 25.0 * a,
            30.0 * d + 80.0 * e * d + 20.0 * b + 15.0 * g * w,
            20.0 * g - 50.0 * e * g + 15.0 * c * (1.0 + e),
            35.0 * d * g + 2.0 * w * e,
        ],
        axis=1,
    )
    return R @ from_components(s) @ transpose(R)


def _first_piola(F, F_dot):
    inverse = transpose(np.linalg.inv(F))
    return det(F)[:, None, None] * square_stress(F, F_dot) @ inverse


def _tangents(F, F_dot):
    """Central differences: about 1e-9 of the values."""
    by_F, by_F_dot = (np.empty((len(F), 2, 2, 2, 2)) for _ in range(2))
    for i in range(2):
        for j in range(2):
            step = np.zeros((2, 2))
            step[i, j] = STEP
            ahead, behind = _first_piola(F + step, F_dot), _first_piola(F - step, F_dot)
            by_F[..., i, j] = (ahead - behind) / (2.0 * STEP)
            ahead, behind = _first_piola(F, F_dot + step), _first_piola(F, F_dot - step)
            by_F_dot[..., i, j] = (ahead - behind) / (2.0 * STEP)
    return Tangents(by_F, by_F_dot)


@dataclass(frozen=True)
class Points:
    """A state that only knows whose it is."""

    F: np.ndarray

    def take(self, index):
        return Points(self.F[index])

    def put(self, index, part):
        F = self.F.copy()
        F[index] = part.F
        return Points(F)

    @property
    def left_points(self):
        return np.zeros(len(self.F), dtype=bool)


class SquareLaw:
    """Not converged where F₁₁ is above `fails_above`; notes the states it was asked with."""

    rest_length = 1.5
    has_tangents = True

    def __init__(self, cell=None, initialisation="constrained-runs", fails_above=np.inf):
        self.cell = cell or CellParameters()
        self.initialisation, self.fails_above = initialisation, fails_above
        self.density = self.cell.density
        self.states, self.solves = [], 0

    def of(self, cell, settings=None):
        """Stand in for `RveLaw`."""
        self.cell, self.initialisation = cell, settings.initialisation
        return self

    def respond(self, F, F_dot, state=None, *, tangents=False):
        F, F_dot = check_deformation(F, F_dot)
        self.states.append(state)
        self.solves += len(F)
        stress = square_stress(F, F_dot)
        status = np.where(F[:, 0, 0] > self.fails_above, Status.NOT_CONVERGED, Status.OK)
        stress[status != 0] = np.nan
        slopes = _tangents(F, F_dot) if tangents else None
        effort = {"rve_solves": len(F)}
        return StressResponse(stress, status.astype(np.int8), Points(F.copy()), effort, slopes)

    def accept(self, F, F_dot, response):
        return Acceptance(response.status, response.state)
