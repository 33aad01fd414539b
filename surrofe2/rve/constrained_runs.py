"""Constrained runs as the paper iterates them: Euler step, then rescaling (eqs. 69 to 72).

Under periodic boundaries the three corners are images of one particle, so they move alike but
for the lattice: after the step the lattice is (F + Δt Ḟ) A₀, hence P = F (F + Δt Ḟ)⁻¹ in (70)
and Q = 0 in (71), and the corner is shifted back to the origin at rest.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from surrofe2.base.compilation import kernel, loop_body, parallel_kernel
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
    """Settings of the iteration.

    dt: length of an Euler step, µs. stop: mean force at which it ends, µN. limit: most steps.
    """

    dt: float
    stop: float
    limit: int


@parallel_kernel
def iterate(drive, x, v, mass, topology, constants, stepping, answer):
    """Iterate x, v (tiles, 2, own, TILE) in place until particles rest on the slow manifold.

    drive: F and Ḟ of all tiles. mass: (own,) ng. answer.iterations becomes the number of Euler
    steps, or OPEN where the limit was reached or forces are not finite.
    """
    for t in numba.prange(x.shape[0]):
        _iterate_tile(
            drive_of(drive, t),
            x[t],
            v[t],
            mass,
            topology,
            constants,
            stepping,
            answer_of(answer, t),
        )


@loop_body
def _iterate_tile(drive, x, v, mass, topology, constants, stepping, answer):
    """Do as `iterate` for one tile."""
    F = drive.F
    rate = drive.rate
    dt = stepping.dt
    stop = stepping.stop
    workspace = make_workspace(topology)
    sigma = np.empty((2, 2, TILE))
    mean = np.empty((1, TILE))
    rescale = _rescaling(F, rate, dt)
    copy_particles(x, workspace.x)
    copy_particles(v, workspace.v)
    done = np.zeros(TILE, dtype=np.bool_)
    # one evaluation more than steps
    for count in range(stepping.limit + 1):
        set_moving_images(F, rate, workspace.x, workspace.v, topology)
        measure(workspace, F, topology, constants, sigma, mean)
        under_way = 0
        for lane in range(TILE):
            if done[lane]:
                continue
            is_at_rest = mean[0, lane] < stop
            has_diverged = not mean[0, lane] < np.inf  # True for NaN, too
            if is_at_rest or has_diverged or count == stepping.limit:
                done[lane] = True
                answer.iterations[lane] = count if is_at_rest else OPEN
                answer.residual[0, lane] = mean[0, lane]
                keep_lane(sigma, lane, answer.stress)
                keep_lane(workspace.x, lane, x)
                keep_lane(workspace.v, lane, v)
            else:
                under_way += 1
        if under_way == 0:
            break
        _euler_step(workspace, mass, rescale, topology.particles, dt)


@kernel
def _rescaling(F, rate, dt):
    """Return P = F (F + Δt Ḟ)⁻¹ (eq. 70), (2, 2, TILE)."""
    xx, xy, yx, yy = inverse(entries(F + dt * rate))
    P = np.empty((2, 2, TILE))
    for i in range(2):
        store(load(F, i, 0) * xx + load(F, i, 1) * yx, P, i, 0)
        store(load(F, i, 0) * xy + load(F, i, 1) * yy, P, i, 1)
    return P


@kernel
def set_moving_images(F, rate, x, v, topology):
    """Fill the images in x and v (2, local, TILE), with s the offset of an image from its owner.

    x of an image is that of its owner plus F s, v is that of its owner plus Ḟ s.
    """
    particles = topology.particles
    for image in range(topology.owner.shape[0]):
        i = topology.owner[image]
        sx = topology.image_offset[image, 0]
        sy = topology.image_offset[image, 1]
        for axis in range(2):
            offset = load(F, axis, 0) * sx + load(F, axis, 1) * sy
            store(load(x, axis, i) + offset, x, axis, particles + image)
            drift = load(rate, axis, 0) * sx + load(rate, axis, 1) * sy
            store(load(v, axis, i) + drift, v, axis, particles + image)


@kernel
def _euler_step(workspace, mass, P, particles, dt):
    """Make an Euler step of own particles, (69), and rescale it, (72), in the workspace.

    With x̂ = x + Δt v and v̂ = v + Δt f/m, and x̂₁, v̂₁ those of the corner, which is particle 0:
    x ← P (x̂ − x̂₁), v ← v̂ − v̂₁.
    """
    x = workspace.x
    v = workspace.v
    f = workspace.f
    # read before the loop, which overwrites the corner first
    corner_x = load(x, 0, 0) + dt * load(v, 0, 0)
    corner_y = load(x, 1, 0) + dt * load(v, 1, 0)
    corner_dt_per_mass = dt / mass[0]
    corner_vx = load(v, 0, 0) + corner_dt_per_mass * load(f, 0, 0)
    corner_vy = load(v, 1, 0) + corner_dt_per_mass * load(f, 1, 0)
    xx, xy, yx, yy = entries(P)
    for i in range(particles):
        from_corner_x = load(x, 0, i) + dt * load(v, 0, i) - corner_x
        from_corner_y = load(x, 1, i) + dt * load(v, 1, i) - corner_y
        dt_per_mass = dt / mass[i]
        store(load(v, 0, i) + dt_per_mass * load(f, 0, i) - corner_vx, v, 0, i)
        store(load(v, 1, i) + dt_per_mass * load(f, 1, i) - corner_vy, v, 1, i)
        store(xx * from_corner_x + xy * from_corner_y, x, 0, i)
        store(yx * from_corner_x + yy * from_corner_y, x, 1, i)
