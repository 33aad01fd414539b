"""What moves particles besides their own forces: prescribed motion and rigid bodies, as kernels.

A body acts on particles i that may touch it, with the gap g to its outline, by the energy

    E = k Σ L_i Φ(−g_i),   Φ′(d) = φ(d) = 0 (d ≤ 0),  d²/2δ (0 < d < δ),  d − δ/2 (d ≥ δ),

L being the unloaded length of a particle's part of the boundary: the springs of FE², point by
point, without dashpot and friction. A body with a mass moves by leapfrog as particles do; others,
and particles that are driven, have in each step the mean velocity of their motion, so that they
arrive where it leads. The work of what drives them is that of the force it takes, at the mean of
the velocities before and after; at rest it is exact, else second order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.compilation import kernel

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


class Steps(NamedTuple):
    """n leapfrog steps.

    Attributes:
        length: (n, 2) by which v is kicked and x drifts, µs.
        amplitude: (n, loads). speed: (n, motions) mean rate of each amplitude in the step, 1/µs.
    """

    length: Array
    amplitude: Array
    speed: Array


class Drive(NamedTuple):
    """Components of particles that follow a motion.

    Attributes:
        at: (d, 4) tile, axis, own particle, lane. motion: (d,) which.
        largest: (d,) µm at amplitude 1. mass: (d,) ng.
        before: (d,) velocity before a step, scratch. work: (1,) done so far, pJ.
    """

    at: Ints
    motion: Ints
    largest: Array
    mass: Array
    before: Array
    work: Array


class Plates(NamedTuple):
    """Rigid planes and circles.

    Attributes:
        starts: (b + 1,) where the particles begin that may touch each body.
        at: (c, 3) tile, own particle, lane. length: (c,) of the boundary, µm.
        offset: (c, 2) added to a particle's position, µm.
        outline: (b, 3) unit normal out of a plane and 0, or for a circle 0, 0, radius.
        stiffness: (b,) k, µN/µm²; smoothing: (b,) δ, µm.
        x, v: (b, 2) position and velocity, µm and µm/µs.
        force: (b, 2) on the tissue at the last step, µN; stored: (b,) energy, pJ; depth: (b,) µm.
        per_mass: (b,) 1/ng, 0 where the motion is prescribed; pull: (b, 2) acceleration of others.
        motion: (b,) which, −1 of one that rests or flies; largest: (b, 2) µm at amplitude 1.
        work: (2,) so far: of what moves bodies, and of `pull`, pJ.
    """

    starts: Ints
    at: Ints
    length: Array
    offset: Array
    outline: Array
    stiffness: Array
    smoothing: Array
    x: Array
    v: Array
    force: Array
    stored: Array
    depth: Array
    per_mass: Array
    pull: Array
    motion: Ints
    largest: Array
    work: Array


NO_DRIVE = Drive(
    np.zeros((0, 4), np.int64), np.zeros(0, np.int64), np.zeros(0), np.zeros(0), np.zeros(0),
    np.zeros(1),
)  # fmt: skip
NO_PLATES = Plates(
    np.zeros(1, np.int64), np.zeros((0, 3), np.int64), np.zeros(0), np.zeros((0, 2)),
    np.zeros((0, 3)), np.zeros(0), np.zeros(0), np.zeros((0, 2)), np.zeros((0, 2)),
    np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros(0), np.zeros((0, 2)),
    np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros(2),
)  # fmt: skip


@kernel
def press(particles, plates):
    """Add contact forces to f of own particles; set force, stored and depth of the bodies."""
    x, f = particles.x, particles.f
    for b in range(plates.starts.shape[0] - 1):
        nx, ny, radius = plates.outline[b, 0], plates.outline[b, 1], plates.outline[b, 2]
        delta = plates.smoothing[b]
        sum_x, sum_y, stored, depth = 0.0, 0.0, 0.0, 0.0
        for k in range(plates.starts[b], plates.starts[b + 1]):
            t, i, lane = plates.at[k, 0], plates.at[k, 1], plates.at[k, 2]
            px = x[t, 0, i, lane] + plates.offset[k, 0] - plates.x[b, 0]
            py = x[t, 1, i, lane] + plates.offset[k, 1] - plates.x[b, 1]
            if radius > 0.0:
                distance = np.sqrt(px * px + py * py)
                nx, ny = px / distance, py / distance
                d = radius - distance
            else:
                d = -(px * nx + py * ny)
            if not d > 0.0:
                continue
            weight = plates.stiffness[b] * plates.length[k]
            if d < delta:
                size, energy = d * d / (2.0 * delta), d * d * d / (6.0 * delta)
            else:
                size = d - 0.5 * delta
                energy = 0.5 * d * d - 0.5 * delta * d + delta * delta / 6.0
            f[t, 0, i, lane] += weight * size * nx
            f[t, 1, i, lane] += weight * size * ny
            sum_x += weight * size * nx
            sum_y += weight * size * ny
            stored += weight * energy
            depth = max(depth, d)
        plates.force[b, 0], plates.force[b, 1] = sum_x, sum_y
        plates.stored[b], plates.depth[b] = stored, depth


@kernel
def move_bodies(plates, length, speed):
    """A step of the bodies under `force`; length: (2,) kick and drift, speed: (motions,)."""
    kick, drift = length[0], length[1]
    for b in range(plates.x.shape[0]):
        for axis in range(2):
            before, force = plates.v[b, axis], plates.force[b, axis]
            if plates.per_mass[b] > 0.0:
                pull = plates.pull[b, axis]
                now = before + kick * (pull - force * plates.per_mass[b])
                mean = 0.5 * (before + now)
                plates.work[1] += kick * mean * pull / plates.per_mass[b]
            elif plates.motion[b] >= 0:
                now = speed[plates.motion[b]] * plates.largest[b, axis]
                plates.work[0] += kick * 0.5 * (before + now) * force
            else:
                now = 0.0
            plates.v[b, axis] = now
            plates.x[b, axis] += drift * now


@kernel
def drive_particles(v, drive, speed):
    """Give driven particles the velocity of a step, in v (tiles + 1, 2, local, TILE)."""
    for k in range(drive.motion.shape[0]):
        t, axis, i, lane = drive.at[k, 0], drive.at[k, 1], drive.at[k, 2], drive.at[k, 3]
        drive.before[k] = v[t, axis, i, lane]
        v[t, axis, i, lane] = speed[drive.motion[k]] * drive.largest[k]


@kernel
def add_work(particles, loads, drive, kick, amplitude):
    """Add the work of a step's drive, with the forces that it was taken by.

    loads: (loads, tiles, 2, own, TILE); amplitude: (loads,).
    """
    work = 0.0
    for k in range(drive.motion.shape[0]):
        t, axis, i, lane = drive.at[k, 0], drive.at[k, 1], drive.at[k, 2], drive.at[k, 3]
        before, now = drive.before[k], particles.v[t, axis, i, lane]
        force = particles.f[t, axis, i, lane]
        for n in range(loads.shape[0]):
            force += amplitude[n] * loads[n, t, axis, i, lane]
        work += 0.5 * (before + now) * (drive.mass[k] * (now - before) - kick * force)
    drive.work[0] += work
