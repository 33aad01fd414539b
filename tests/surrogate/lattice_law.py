"""An analytic stress with what the plant cell's has: stiff, viscous, objective, D4, unsymmetric.

Points of a square lattice follow F without fluctuation; each pair repels by r⁻⁶, is damped along
its line and, not centrally, against its relative velocity. Bonds to the nearest neighbours pull
with a rest length that makes σ(I, 0) = 0.
"""

from __future__ import annotations

import numpy as np

from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.sampling import SamplingRange, sample
from surrofe2.stress_samples import StressSamples

SPACING = 4.0
CELL = CellParameters.preset("printed")
RANGE = SamplingRange(stretch=(0.92, 1.08), shear=0.08, rate=0.01)
WELL_INSIDE = SamplingRange(stretch=(0.945, 1.055), shear=0.055, rate=0.006)
"""Within the domain of any few hundred samples of `RANGE`."""


def lattice_stress(F, F_dot):
    """(n, 2, 2) Cauchy stress."""
    unloaded, bonded = (_stress(np.eye(2)[None], np.zeros((1, 2, 2)), rest) for rest in (0.0, 1.0))
    rest_length = unloaded[0, 0, 0] / (unloaded - bonded)[0, 0, 0]
    return _stress(F, F_dot, rest_length)


def lattice_samples(count, seed=1, cell=CELL):
    """Samples of the lattice's stress over `RANGE`."""
    F, F_dot = sample(RANGE, count, seed)
    return StressSamples(
        F=F,
        F_dot=F_dot,
        stress=lattice_stress(F, F_dot),
        status=np.zeros(count, dtype=np.int8),
        cell=cell,
        initialisation="constrained-runs",
        range=RANGE,
        seed=seed,
        rest_length=1.375,
    )


def _stress(F, F_dot, rest_length):
    steps = np.arange(-2, 3)
    X = SPACING * np.array([(i, j) for i in steps for j in steps if (i, j) != (0, 0)], dtype=float)
    x, w = (np.einsum("nij,pj->npi", tensor, X) for tensor in (F, F_dot))
    r = np.linalg.norm(x, axis=2)
    along = x / r[..., None]
    closing = (along * w).sum(axis=2)
    bond = np.isclose(np.linalg.norm(X, axis=1), SPACING)
    force = -6e5 * r**-6.0 + 4e4 * r**-3.5 * closing
    force = force + bond * (300.0 * (r - rest_length) + 80.0 * closing)
    friction = 60.0 * np.exp(-((r / 5.0) ** 2))
    total = force[..., None] * along + friction[..., None] * w
    area = SPACING**2 * np.linalg.det(F)
    return 0.5 * np.einsum("npi,npj->nij", total, x) / area[:, None, None]
