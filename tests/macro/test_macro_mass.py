"""The inverse of a large mass; and frames that grow."""

from __future__ import annotations

import numpy as np
import scipy.sparse

from surrofe2 import LoadCase
from surrofe2.macro.frames import Frames
from surrofe2.macro.mass import mass_solver
from surrofe2.macro.system import make_system
from surrofe2.problem.problem import bar


def test_a_large_mass_is_inverted(rng):
    """Both components at once, and one alone; sparse, of uneven density."""
    density = np.full((24 * 18, 5), 0.08)
    density[0] = 0.2
    system = make_system(bar(LoadCase(), (24, 18)), density.ravel())
    rows = system.free[::2] // 2
    part = system.mass[rows][:, rows]
    assert scipy.sparse.issparse(part)
    x = rng.uniform(-1.0, 1.0, system.free.size)
    r = (part @ x.reshape(-1, 2)).ravel()
    np.testing.assert_allclose(system.solve_mass(r), x, rtol=0.0, atol=1e-13)
    one = mass_solver(system.mass, system.free[::2])
    np.testing.assert_allclose(one(r[::2].copy()), x[::2], rtol=0.0, atol=1e-13)


def test_frames_grow_in_place_and_leave_what_was_there(rng):
    def frame(t):
        fields = (rng.uniform(size=(1, 3, 2)) for _ in range(2))
        kept = int(t % 3.0 == 0.0)
        points = np.full(kept, t), *(rng.uniform(size=(kept, 5)) for _ in range(3))
        tensors = (rng.uniform(size=(1, 4, 2, 2)) for _ in range(3))
        return Frames(np.array([t]), *fields, *tensors, *rng.uniform(size=(3, 1, 4)), *points)

    each = [frame(float(t)) for t in range(9)]
    states = [each[0]]
    for one in each[1:]:
        states.append(states[-1].followed_by(one))
    other = states[4].copy().followed_by(each[0])
    for k, state in enumerate(states):
        for name in Frames.__slots__:
            wanted = np.concatenate([getattr(one, name) for one in each[: k + 1]])
            assert np.array_equal(getattr(state, name), wanted), name
    assert other.t.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 0.0]
    assert states[8].stress.base is states[7].stress.base is not states[3].stress.base
