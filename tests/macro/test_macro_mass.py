"""The inverse of a large mass; and frames that grow."""

from __future__ import annotations

import numpy as np

from surrofe2 import LoadCase
from surrofe2.macro.system import DENSE_LIMIT, make_system


def test_a_large_mass_is_inverted(rng):
    """Sparse, of uneven density."""
    density = np.full((24 * 18, 5), 0.08)
    density[0] = 0.2
    system = make_system(LoadCase(elements=(24, 18)), density.ravel())
    assert system.free.size > DENSE_LIMIT
    x = rng.uniform(-1.0, 1.0, system.free.size)
    np.testing.assert_allclose(system.solve_mass(system.free_mass @ x), x, rtol=0.0, atol=1e-13)
