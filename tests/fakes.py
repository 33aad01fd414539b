"""Laws without cells, for tests of everything that does not depend on physics."""

from __future__ import annotations

import numpy as np

from surrofe2.stress_law import (
    Acceptance,
    Status,
    StressResponse,
    check_deformation,
    require_tangents,
)
from surrofe2.tensors import rotation, transpose


class SoftLaw:
    """Isotropic σ = R (2 a (U − I) + b (A + Aᵀ)) Rᵀ with F = R U, A = RᵀḞ.

    Not converged where F₁₁ is above `fails_above`.
    """

    density, has_tangents = 0.084, False
    rest_length = 1.5

    def __init__(self, a=50.0, b=100.0, fails_above=np.inf):
        self.a, self.b, self.fails_above = a, b, fails_above
        self.calls = 0

    def of(self, cell, settings=None):
        """Stand in for `RveLaw`."""
        self.cell, self.initialisation = cell, settings.initialisation
        return self

    def respond(self, F, F_dot, state=None, *, tangents=False):
        if tangents:
            require_tangents(self)
        F, F_dot = check_deformation(F, F_dot)
        self.calls += 1
        R = rotation(F)
        U, A = transpose(R) @ F, transpose(R) @ F_dot
        S = 2.0 * self.a * (U - np.eye(2)) + self.b * (A + transpose(A))
        stress = R @ S @ transpose(R)
        status = np.where(F[:, 0, 0] > self.fails_above, Status.NOT_CONVERGED, Status.OK)
        stress[status != 0] = np.nan
        return StressResponse(stress, status.astype(np.int8), None, {"rve_solves": len(F)})

    def accept(self, F, F_dot, response):
        return Acceptance(response.status, response.state)


class StoppingLaw(SoftLaw):
    """Raises after so many calls, as Ctrl-C or a kill would."""

    def __init__(self, calls, error=KeyboardInterrupt, **settings):
        super().__init__(**settings)
        self.left, self.error = calls, error

    def respond(self, F, F_dot, state=None, *, tangents=False):
        if self.left == 0:
            raise self.error
        self.left -= 1
        return super().respond(F, F_dot, state)
