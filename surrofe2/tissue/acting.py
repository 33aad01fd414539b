"""What moves particles besides their own forces: prescribed motion and what acts on the outline.

Driven particles have in each step the mean velocity of their motion, so that they arrive where it
leads. The work of what drives them is that of the force it takes, at the mean of the velocities
before and after; at rest it is exact, else second order. Rigid bodies stand in `contact`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.compilation import kernel

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


class Edges(NamedTuple):
    """Follower pressures and foundations: forces on particles e of the outline.

    Attributes:
        at: (e, 3) tile, own particle, lane. load: (e,) which of the loads.
        pressure: (k,) µN/µm at amplitude 1, of the bond from particle 2k of them to 2k + 1, which
            has the tissue on its left. offset: (2k, 2) added to their positions, µm.
        home: (e − 2k, 2) where the springs of others are at rest, µm.
        stiffness, damping: (e − 2k, 2) of both components, µN/µm and µN µs/µm.
        force: (e, 2) at the last step, µN. before: (e, 2) velocity at that time, scratch.
        total: (loads, 2) forces at the last step, µN. work: (loads,) so far, pJ.
    """

    at: Ints
    load: Ints
    pressure: Array
    offset: Array
    home: Array
    stiffness: Array
    damping: Array
    force: Array
    before: Array
    total: Array
    work: Array


NO_DRIVE = Drive(
    np.zeros((0, 4), np.int64), np.zeros(0, np.int64), np.zeros(0), np.zeros(0), np.zeros(0),
    np.zeros(1),
)  # fmt: skip
NO_EDGES = Edges(
    np.zeros((0, 3), np.int64), np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 2)),
    np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 2)),
    np.zeros((0, 2)), np.zeros(0),
)  # fmt: skip


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


@kernel
def push_edges(particles, edges, amplitude):
    """Add forces on the outline to f of own particles; set force, before and total.

    amplitude: (loads,).
    """
    x, v, f, at = particles.x, particles.v, particles.f, edges.at
    edges.total[:] = 0.0
    bonds = edges.pressure.shape[0]
    for k in range(bonds):
        size = 0.5 * amplitude[edges.load[2 * k]] * edges.pressure[k]
        for axis in range(2):
            along = edges.offset[2 * k + 1, axis] - edges.offset[2 * k, axis]
            along += x[at[2 * k + 1, 0], axis, at[2 * k + 1, 1], at[2 * k + 1, 2]]
            along -= x[at[2 * k, 0], axis, at[2 * k, 1], at[2 * k, 2]]
            # The outward normal times length is (dy, −dx).
            along *= size if axis == 0 else -size
            edges.force[2 * k, 1 - axis] = edges.force[2 * k + 1, 1 - axis] = along
    for e in range(at.shape[0]):
        t, i, lane = at[e, 0], at[e, 1], at[e, 2]
        for axis in range(2):
            edges.before[e, axis] = v[t, axis, i, lane]
            if e >= 2 * bonds:
                away = x[t, axis, i, lane] - edges.home[e - 2 * bonds, axis]
                held = edges.stiffness[e - 2 * bonds, axis] * away
                held += edges.damping[e - 2 * bonds, axis] * v[t, axis, i, lane]
                edges.force[e, axis] = -held
            f[t, axis, i, lane] += edges.force[e, axis]
            edges.total[edges.load[e], axis] += edges.force[e, axis]


@kernel
def add_edge_work(particles, edges, kick):
    """Add the work that forces on the outline have done in a step."""
    for e in range(edges.at.shape[0]):
        t, i, lane = edges.at[e, 0], edges.at[e, 1], edges.at[e, 2]
        for axis in range(2):
            mean = 0.5 * (edges.before[e, axis] + particles.v[t, axis, i, lane])
            edges.work[edges.load[e]] += kick * mean * edges.force[e, axis]
