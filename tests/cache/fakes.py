"""True laws and surrogates of which everything is known beforehand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from surrofe2.errors import InputError
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.stress_law import Acceptance, Status, StressResponse, Tangents, require_tangents
from surrofe2.tensors import det
from tests.macro.analytic_laws import KelvinVoigt

CELL = CellParameters.preset("printed")
ZERO = np.zeros((1, 2, 2))


def exact(F, F_dot):
    return F - np.swapaxes(np.linalg.inv(F), 1, 2) + 3.0 * F_dot


@dataclass(frozen=True)
class Warmth:
    """A state that knows F of each of its points."""

    F: np.ndarray

    def take(self, indices):
        return Warmth(self.F[indices])

    def put(self, indices, state):
        F = self.F.copy()
        F[indices] = state.F
        return Warmth(F)

    @property
    def left_points(self):
        return np.zeros(len(self.F), dtype=bool)


class TrueLaw:
    """Exact, remembers F, fails where F₁₁ > 2, notes what it was asked."""

    has_tangents = False

    def __init__(self, cell=CELL, initialisation="elastic"):
        self.cell, self.initialisation, self.density = cell, initialisation, cell.density
        self.asked, self.accepted = [], []

    def respond(self, F, F_dot, state=None, *, tangents=False):
        if tangents:
            require_tangents(self)
        self.asked.append((F.copy(), state))
        stress, status = exact(F, F_dot), np.zeros(len(F), dtype=np.int8)
        status[F[:, 0, 0] > 2.0] = Status.UNSTABLE
        stress[status != 0] = np.nan
        return StressResponse(stress, status, Warmth(F.copy()), {"rve_solves": len(F)})

    def accept(self, F, F_dot, response):
        self.accepted.append((F.copy(), response))
        status = response.status.copy()
        status[F[:, 0, 0] > 1.8] = Status.UNSTABLE
        return Acceptance(status, Warmth(response.state.F + 100.0))


class Untaught:
    """What a surrogate has that neither learns nor gives tangents."""

    has_bound, has_tangents, learns, stress_spread = True, False, False, 1.0

    def status_and_bound(self, F, F_dot, tolerance=np.inf):
        return self.lookup(F, F_dot, tolerance)[1:]

    def tangents(self, F, F_dot):
        raise InputError("tangents: none")

    def learn(self, F, F_dot, stress, state=None):
        pass


class Surrogate(Untaught):
    """Knows no bound. Off by one, to be told apart; out of range from F₁₁ = 1.5, NaN below 0.5."""

    has_bound = False

    def __init__(self, cell=CELL, initialisation="elastic"):
        self.cell, self.initialisation, self.density = cell, initialisation, cell.density

    def lookup(self, F, F_dot, tolerance=np.inf):
        with np.errstate(invalid="ignore"):
            stress = exact(F, F_dot) + 1.0
        status = np.zeros(len(F), dtype=np.int8)
        status[F[:, 0, 0] >= 1.5] = Status.OUT_OF_RANGE
        status[F[:, 0, 0] < 0.5] = Status.NOT_FINITE
        status[~(det(F) > 0.0)] = Status.OUT_OF_RANGE
        stress[status != 0] = np.nan
        return stress, status, np.full(len(F), 1.0)


def stretched(*stretches):
    F = np.eye(2) * np.ones((len(stretches), 1, 1))
    F[:, 0, 0] = stretches
    return F, np.full_like(F, 0.01)


class Truth(KelvinVoigt):
    """A viscoelastic solid in closed form as the true law of a cell."""

    cell, initialisation = CELL, "elastic"


class Learnt(Untaught):
    """`Truth` with an error of 1 in direction and size `error(F, F_dot)` (n,), and a bound.

    Trusted where `bound(F, F_dot)` (n,) is at most the tolerance; out of range where `outside`.
    """

    cell, initialisation, density = CELL, "elastic", Truth().density
    stress_spread, has_tangents = 10.0, True

    def __init__(self, error, bound, outside=lambda F: np.zeros(len(F), dtype=bool)):
        self.truth, self.error, self.bound, self.outside = Truth(), error, bound, outside
        self.looked_up = 0

    def lookup(self, F, F_dot, tolerance=np.inf):
        self.looked_up += len(F)
        direction = np.array([[0.8, 0.0], [0.0, -0.6]])
        stress = self.truth.stress(F, F_dot) + self.error(F, F_dot)[:, None, None] * direction
        bound = self.bound(F, F_dot)
        status = np.where(bound <= tolerance, 0, Status.NOT_TRUSTED).astype(np.int8)
        status[self.outside(F)] = Status.OUT_OF_RANGE
        stress[status != 0] = np.nan
        return stress, status, bound

    def tangents(self, F, F_dot):
        """Of its own stress, error and all, by central differences."""
        by_F, by_F_dot = np.empty((2, len(F), 2, 2, 2, 2))
        for k in np.ndindex(2, 2):
            step = np.zeros((2, 2))
            step[k] = 1e-6
            by_F[:, :, :, *k] = self._nominal(F + step, F_dot) - self._nominal(F - step, F_dot)
            by_F_dot[:, :, :, *k] = self._nominal(F, F_dot + step) - self._nominal(F, F_dot - step)
        return Tangents(by_F / 2e-6, by_F_dot / 2e-6)

    def _nominal(self, F, F_dot):
        """P = det F σ F⁻ᵀ."""
        stress = Learnt.lookup(self, F, F_dot)[0]
        return det(F)[:, None, None] * stress @ np.swapaxes(np.linalg.inv(F), 1, 2)


def shear_error(size):
    """An error that changes its sign with position, up to `size`, µN/µm."""
    return lambda F, F_dot: size * np.sin(60.0 * F[:, 0, 1] + 40.0 * F[:, 1, 1])
