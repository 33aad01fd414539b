"""Laws of RVEs made once, and deformations within their range."""

from __future__ import annotations

from functools import cache

import numpy as np

from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import RveLaw, RveSettings

SPREAD = {"printed": 0.08, "water": 0.04}
PRESETS = tuple(SPREAD)


@cache
def law(preset, initialisation="constrained-runs", solver="direct", **settings):
    wanted = RveSettings(initialisation=initialisation, solver=solver, **settings)
    return RveLaw(CellParameters.preset(preset), wanted)


def deformations(preset, n=48, seed=0, corners=True):
    """Random F (entries within SPREAD of I) and Ḟ (within 0.01/µs); some at the range's corners."""
    rng = np.random.default_rng(seed)
    F = rng.uniform(-1, 1, (n, 2, 2))
    if corners:
        F[: n // 4] = np.sign(F[: n // 4])
    return np.eye(2) + SPREAD[preset] * F, 0.01 * rng.uniform(-1, 1, (n, 2, 2))


def particles(answer, point):
    """(n, 2) material positions of one point."""
    tile, lane = divmod(point, 8)
    return answer.state.z[tile, :, :, lane].T
