"""The inverse of a large mass; and frames that grow."""

from __future__ import annotations

import numpy as np
import scipy.sparse

from surrofe2 import LoadCase
from surrofe2.macro.system import make_system, mass_solver


def test_a_large_mass_is_inverted(rng):
    """Both components at once, and one alone; sparse, of uneven density."""
    density = np.full((24 * 18, 5), 0.08)
    density[0] = 0.2
    system = make_system(LoadCase(elements=(24, 18)), density.ravel())
    rows = system.free[::2] // 2
    part = system.mass[rows][:, rows]
    assert scipy.sparse.issparse(part)
    x = rng.uniform(-1.0, 1.0, system.free.size)
    r = (part @ x.reshape(-1, 2)).ravel()
    np.testing.assert_allclose(system.solve_mass(r), x, rtol=0.0, atol=1e-13)
    one = mass_solver(system.mass, system.free[::2])
    np.testing.assert_allclose(one(r[::2].copy()), x[::2], rtol=0.0, atol=1e-13)
