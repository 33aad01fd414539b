"""From motion to forces on the nodes of elements in one pass that stays in cache.

Elements are taken `_AT_ONCE` at a time: deformation gradients, the lookup of `compiled_lookup`, and
the forces of what it found.
"""

from __future__ import annotations

import numpy as np
from numba import prange
from numpy.typing import NDArray

from surrofe2.compilation import kernel, parallel_kernel
from surrofe2.element_kernels import ElementArrays, set_deformation, set_forces
from surrofe2.stress_law import Status
from surrofe2.surrogate.compiled_bound import BoundArrays
from surrofe2.surrogate.compiled_lookup import MANY, Answer, lookup_part
from surrofe2.surrogate.network_arrays import NetworkArrays

Array = NDArray[np.float64]

_AT_ONCE = 64
_OK = int(Status.OK)


def motion_to_forces(
    space: ElementArrays,
    motion: tuple[Array, Array],
    network: NetworkArrays,
    bounds: BoundArrays,
    tolerance: float,
    held: NDArray[np.intp],
) -> Array | None:
    """(n_el, k, 2) forces in µN by the stresses that `lookup` gives; None where it lacks one.

    motion: u and v (n, 2). held: points that give no force and need no stress.
    """
    forces = np.empty((*space.elements.shape, 2))
    is_held = np.zeros(space.weights.size, dtype=np.bool_)
    is_held[held] = True
    is_answered = np.empty(-(-len(forces) // _AT_ONCE), dtype=np.bool_)
    compute = _parallel if space.weights.size >= MANY else _serial
    compute(space, motion, network, bounds, float(tolerance), is_held, forces, is_answered)
    return forces if is_answered.all() else None


@kernel
def _serial(space, motion, network, bounds, tolerance, held, forces, answered):  # type: ignore[no-untyped-def]
    for part in range(answered.shape[0]):
        first = part * _AT_ONCE
        some = forces[first : first + _AT_ONCE]
        answered[part] = _forces_part(first, space, motion, network, bounds, tolerance, held, some)


@parallel_kernel
def _parallel(space, motion, network, bounds, tolerance, held, forces, answered):  # type: ignore[no-untyped-def]
    for part in prange(answered.shape[0]):
        first = part * _AT_ONCE
        some = forces[first : first + _AT_ONCE]
        answered[part] = _forces_part(first, space, motion, network, bounds, tolerance, held, some)


@kernel
def _forces_part(first, space, motion, network, bounds, tolerance, held, forces):  # type: ignore[no-untyped-def]
    """Set the forces (m, k, 2) of m elements; whether all points that are not held have one."""
    n_q = space.weights.shape[1]
    count = n_q * forces.shape[0]
    F, F_dot = np.empty((count, 2, 2)), np.empty((count, 2, 2))
    answer = Answer(np.empty((count, 2, 2)), np.empty(count, dtype=np.int8), np.empty(count))
    set_deformation(first, space, motion[0], motion[1], F, F_dot)
    lookup_part(0, count, F, F_dot, network, bounds, tolerance, answer)
    is_answered = True
    for p in range(count):
        if held[n_q * first + p]:
            answer.stress[p] = 0.0
            is_answered &= F[p, 0, 0] * F[p, 1, 1] - F[p, 0, 1] * F[p, 1, 0] > 0.0
        elif answer.status[p] != _OK:
            is_answered = False
    set_forces(first, space, F, answer.stress, forces)
    return is_answered
