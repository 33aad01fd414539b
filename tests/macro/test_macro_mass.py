"""The inverse of a large mass, quick where it is a Kronecker product; and frames that grow."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse

from surrofe2 import LoadCase
from surrofe2.macro.frames import Frames
from surrofe2.macro.mass import _factors_of_product, mass_solver
from surrofe2.macro.problem import bar
from surrofe2.macro.system import make_system

SHAPE = 24, 18


def masses():
    """(mass, whether it is a product) of a bar, and of one that is denser in an element."""
    system = make_system(bar(LoadCase(), SHAPE), 0.08)
    density = np.full(system.discretisation.n_points, 0.08)
    density[: system.discretisation.points_per_element] = 0.2
    denser = make_system(bar(LoadCase(), SHAPE), density)
    return {"even": (system, True), "uneven": (denser, False)}


@pytest.mark.parametrize("name", ["even", "uneven"])
def test_a_large_mass_is_inverted_and_a_product_known_as_one(name, rng):
    system, is_product = masses()[name]
    rows = system.free[::2] // 2
    part = system.mass[rows][:, rows]
    found = _factors_of_product(part)
    assert (found is not None) == is_product
    if found is not None:
        assert abs(scipy.sparse.kron(*found) - part).max() < 1e-14 * abs(part).max()
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
