"""The plain variant of the force evaluation: one RVE at a time, one pair at a time, branches.

Particles lie one after another, (local, 2); every pair reads and writes where its indices point,
and looks whether it is within the cut-off. numba compiles it with the flags of the kernels.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.compilation import compiled

plain = compiled(cache=False)
SIGMA = 10.0 / (7.0 * math.pi)


class PlainWorkspace(NamedTuple):
    """Scratch of one RVE: x, v, f (local, 2) and density (fluid,)."""

    x: NDArray[np.float64]
    v: NDArray[np.float64]
    f: NDArray[np.float64]
    density: NDArray[np.float64]


@plain
def make_plain_workspace(topology: Any) -> Any:
    """Uninitialised scratch for one RVE."""
    local = topology.particles + topology.owner.shape[0]
    return PlainWorkspace(
        np.empty((local, 2)),
        np.empty((local, 2)),
        np.empty((local, 2)),
        np.empty(topology.particles - topology.walls),
    )


@plain
def evaluate_plainly(work: Any, z: Any, F: Any, rate: Any, topology: Any, c: Any, area: Any) -> Any:
    """Forces into work.f (folded); Cauchy stress (2, 2) and mean force. z: (own, 2)."""
    _place(work, z, F, rate, topology)
    work.f[:] = 0.0
    _add_walls(work, topology, c)
    _add_contacts(work, topology, c)
    _add_fluid(work, topology, c)
    det = F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0]
    stress = np.zeros((2, 2))
    for k in range(work.x.shape[0]):
        for i in range(2):
            for j in range(2):
                stress[i, j] -= work.f[k, i] * work.x[k, j] / (area * det)
    own = topology.particles
    for k in range(topology.owner.shape[0]):
        for i in range(2):
            work.f[topology.owner[k], i] += work.f[own + k, i]
    mean = 0.0
    for k in range(own):
        mean += math.sqrt(work.f[k, 0] ** 2 + work.f[k, 1] ** 2) / own
    return stress, mean


@plain
def _place(work: Any, z: Any, F: Any, rate: Any, topology: Any) -> None:
    own = topology.particles
    for k in range(work.x.shape[0]):
        if k < own:
            zx, zy = z[k, 0], z[k, 1]
        else:
            i = topology.owner[k - own]
            zx = z[i, 0] + topology.image_offset[k - own, 0]
            zy = z[i, 1] + topology.image_offset[k - own, 1]
        for axis in range(2):
            work.x[k, axis] = F[axis, 0] * zx + F[axis, 1] * zy
            work.v[k, axis] = rate[axis, 0] * zx + rate[axis, 1] * zy


@plain
def _pair(work: Any, i: int, j: int) -> Any:
    """r, w, |r| and n·w of a pair."""
    rx, ry = work.x[j, 0] - work.x[i, 0], work.x[j, 1] - work.x[i, 1]
    wx, wy = work.v[j, 0] - work.v[i, 0], work.v[j, 1] - work.v[i, 1]
    length = math.sqrt(rx * rx + ry * ry)
    return rx, ry, wx, wy, length, (rx * wx + ry * wy) / length


@plain
def _add(f: Any, i: int, j: int, fx: float, fy: float) -> None:
    f[i, 0] += fx
    f[i, 1] += fy
    f[j, 0] -= fx
    f[j, 1] -= fy


@plain
def _add_walls(work: Any, topology: Any, c: Any) -> None:
    for k in range(topology.bonds.shape[0]):
        i, j = topology.bonds[k]
        rx, ry, _, _, length, rate = _pair(work, i, j)
        tension = c.wall_stiffness * (length - c.rest_length) + c.wall_damping * rate
        _add(work.f, i, j, tension * rx / length, tension * ry / length)


@plain
def _add_contacts(work: Any, topology: Any, c: Any) -> None:
    for k in range(topology.contacts.shape[0]):
        i, j = topology.contacts[k]
        rx, ry, _, _, length, rate = _pair(work, i, j)
        if length < c.cutoff:
            cube = length * length * length
            damping = c.contact_damping / (cube * math.sqrt(length))
            damping *= 1.0 - cube * cube / c.cutoff**6
            tension = damping * rate - c.repulsion * (1.0 / (cube * cube) - 1.0 / c.cutoff**6)
            _add(work.f, i, j, tension * rx / length, tension * ry / length)


@plain
def _add_fluid(work: Any, topology: Any, c: Any) -> None:
    first, h, m = topology.walls, c.smoothing_length, c.fluid_mass
    work.density[:] = m * _spline(0.0, h)
    for k in range(topology.fluid_pairs.shape[0]):
        i, j = topology.fluid_pairs[k]
        _, _, _, _, length, _ = _pair(work, i, j)
        if length < 2.0 * h:
            weight = m * _spline(length / h, h)
            work.density[i - first] += weight
            work.density[j - first] += weight
    for k in range(topology.fluid_pairs.shape[0]):
        i, j = topology.fluid_pairs[k]
        rx, ry, wx, wy, length, _ = _pair(work, i, j)
        if length < 2.0 * h:
            slope = m * m * _spline_slope(length / h, h) / length
            per_i, per_j = 1.0 / work.density[i - first], 1.0 / work.density[j - first]
            a = slope * c.sound_speed_squared * (per_i + per_j)
            b = -2.0 * slope * c.viscosity * per_i * per_j
            _add(work.f, i, j, a * rx + b * wx, a * ry + b * wy)


@plain
def _spline(s: float, h: float) -> float:
    if s < 1.0:
        return SIGMA / h**2 * (1.0 - 1.5 * s**2 + 0.75 * s**3)
    return SIGMA / h**2 * 0.25 * (2.0 - s) ** 3 if s < 2.0 else 0.0


@plain
def _spline_slope(s: float, h: float) -> float:
    if s < 1.0:
        return SIGMA / h**3 * (-3.0 * s + 2.25 * s**2)
    return SIGMA / h**3 * -0.75 * (2.0 - s) ** 2 if s < 2.0 else 0.0
