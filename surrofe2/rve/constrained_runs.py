"""Constrained runs as the paper iterates them: Euler step, then rescaling (eqs. 69 to 72).

Under periodic boundaries the three corners are images of one particle, so they move alike but
for the lattice: after the step the lattice is (F + Δt Ḟ) A₀, hence P = F (F + Δt Ḟ)⁻¹ in (70)
and Q = 0 in (71), and the corner is shifted back to the origin at rest.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from surrofe2.base.compilation import kernel, parallel_kernel
from surrofe2.base.simd import TILE, load, store
from surrofe2.plant_cell.pair_sums import make_workspace
from surrofe2.rve.rve_state import (
    OPEN,
    answer_of,
    copy_particles,
    drive_of,
    entries,
    inverse,
    keep_lane,
    measure,
)


class Stepping(NamedTuple):
    """Euler steps of dt, µs, until the mean force is below `stop`, µN, at most `limit`."""

    dt: float
    stop: float
    limit: int


@parallel_kernel
def iterate(drive, x, v, mass, topology, c, stepping, answer):
    """Iterate x, v (tiles, 2, own, TILE) in place; iterations: Euler steps, OPEN at the limit."""
    for t in numba.prange(x.shape[0]):
        _iterate_tile(
            drive_of(drive, t), x[t], v[t], mass, topology, c, stepping, answer_of(answer, t)
        )


@kernel
def _iterate_tile(drive, x, v, mass, topology, c, stepping, answer):
    F = drive.F
    rate = drive.rate
    dt = stepping.dt
    stop = stepping.stop
    work = make_workspace(topology)
    sigma = np.empty((2, 2, TILE))
    mean = np.empty((1, TILE))
    rescale = _rescaling(F, rate, dt)
    copy_particles(x, work.x)
    copy_particles(v, work.v)
    done = np.zeros(TILE, dtype=np.bool_)
    for count in range(stepping.limit + 1):
        set_moving_images(F, rate, work.x, work.v, topology)
        measure(work, F, topology, c, sigma, mean)
        open_lanes = 0
        for k in range(TILE):
            if done[k]:
                continue
            if mean[0, k] < stop or not mean[0, k] < np.inf or count == stepping.limit:
                done[k] = True
                answer.iterations[k] = count if mean[0, k] < stop else OPEN
                answer.residual[0, k] = mean[0, k]
                keep_lane(sigma, k, answer.stress)
                keep_lane(work.x, k, x)
                keep_lane(work.v, k, v)
            else:
                open_lanes += 1
        if open_lanes == 0:
            break
        _euler_step(work, mass, rescale, topology.particles, dt)


@kernel
def _rescaling(F, rate, dt):
    """P = F (F + Δt Ḟ)⁻¹ (eq. 70), (2, 2, TILE)."""
    xx, xy, yx, yy = inverse(entries(F + dt * rate))
    P = np.empty((2, 2, TILE))
    for i in range(2):
        store(load(F, i, 0) * xx + load(F, i, 1) * yx, P, i, 0)
        store(load(F, i, 0) * xy + load(F, i, 1) * yy, P, i, 1)
    return P


@kernel
def set_moving_images(F, rate, x, v, topology):
    """Images at x and v of their owners and the lattice's, which moves with (F, Ḟ)."""
    particles = topology.particles
    for m in range(topology.owner.shape[0]):
        i = topology.owner[m]
        sx = topology.image_offset[m, 0]
        sy = topology.image_offset[m, 1]
        for axis in range(2):
            offset = load(F, axis, 0) * sx + load(F, axis, 1) * sy
            store(load(x, axis, i) + offset, x, axis, particles + m)
            drift = load(rate, axis, 0) * sx + load(rate, axis, 1) * sy
            store(load(v, axis, i) + drift, v, axis, particles + m)


@kernel
def _euler_step(work, mass, P, particles, dt):
    """(69), then (72): x ← P (x̂ − x̂₁), v ← v̂ − v̂₁."""
    x = work.x
    v = work.v
    f = work.f
    corner_x = load(x, 0, 0) + dt * load(v, 0, 0)
    corner_y = load(x, 1, 0) + dt * load(v, 1, 0)
    pull = dt / mass[0]
    corner_u = load(v, 0, 0) + pull * load(f, 0, 0)
    corner_v = load(v, 1, 0) + pull * load(f, 1, 0)
    xx, xy, yx, yy = entries(P)
    for i in range(particles):
        hx = load(x, 0, i) + dt * load(v, 0, i) - corner_x
        hy = load(x, 1, i) + dt * load(v, 1, i) - corner_y
        push = dt / mass[i]
        store(load(v, 0, i) + push * load(f, 0, i) - corner_u, v, 0, i)
        store(load(v, 1, i) + push * load(f, 1, i) - corner_v, v, 1, i)
        store(xx * hx + xy * hy, x, 0, i)
        store(yx * hx + yy * hy, x, 1, i)
