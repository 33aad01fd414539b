"""What moves particles besides their own forces: prescribed motion, the outline, rigid bodies.

Driven particles and bodies have in each step the mean velocity of their motion, so that they arrive
where it leads; other bodies move by leapfrog. Contact is that of FE² (`problem.contact_law`), point
by point: a particle has the pressure of its gap times L, the unloaded length of its part of the
boundary. Friction is that at the end of the kick, v₁ = v* − (kick/m) µ p L w₁/√(w₁² + s²), where v*
is what all other forces make of v, so that a particle may stick at any pressure without a shorter
step. Works are forces times the mean of the velocities before and after a kick, which closes its
energy balance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from surrofe2.base.arrays import Array, Index
from surrofe2.base.compilation import kernel
from surrofe2.problem.contact_law import friction, gap, pressure, stored

_ITERATIONS = 50


class DrivenParticles(NamedTuple):
    """Components of particles that follow a motion.

    Attributes:
        at: (d, 4) tile, axis, own particle, lane. motion: (d,) which.
        largest: (d,) µm at amplitude 1. mass: (d,) ng.
        before: (d,) velocity before a step, scratch. work: (1,) done so far, pJ.
    """

    at: Index
    motion: Index
    largest: Array
    mass: Array
    before: Array
    work: Array


class OutlineForces(NamedTuple):
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

    at: Index
    load: Index
    pressure: Array
    offset: Array
    home: Array
    stiffness: Array
    damping: Array
    force: Array
    before: Array
    total: Array
    work: Array


class BodyContacts(NamedTuple):
    """Rigid bodies b, and particles c that may touch them.

    Attributes:
        starts: (b + 1,) where the particles of each body begin.
        at: (c, 3) tile, own particle, lane. length: (c,) of the boundary, µm.
        offset: (c, 2) added to a particle's position, µm.
        outline: (b, 6) as `contact_law.gap` has it.
        law: (b, 5) stiffness k, smoothing δ, damping c, friction µ, slip speed s.
        rubs: whether any has friction.
        x, v: (b, 2) position and velocity, µm and µm/µs.
        force: (b, 2) on the tissue at the last step, µN; stored: (b,) energy, pJ; depth: (b,) µm.
        per_mass: (b,) 1/ng, 0 where the motion is prescribed; pull: (b, 2) acceleration of others.
        motion: (b,) which, −1 of one that rests or flies; largest: (b, 2) µm at amplitude 1.
        work: (3,) so far: of `pull`, of what moves bodies, and lost in contact, pJ.
        pressed: (c, 3) at the last step force along the normal, µN, and normal; lost: (c, 4) force
            of dashpot and friction, µN, and velocity relative to the body.
    """

    starts: Index
    at: Index
    length: Array
    offset: Array
    outline: Array
    law: Array
    rubs: bool
    x: Array
    v: Array
    force: Array
    stored: Array
    depth: Array
    per_mass: Array
    pull: Array
    motion: Index
    largest: Array
    work: Array
    pressed: Array
    lost: Array


_NO = np.zeros(0, np.int64)
_NONE = np.zeros(0)
_PAIRS = np.zeros((0, 2))
NO_DRIVEN = DrivenParticles(np.zeros((0, 4), np.int64), _NO, _NONE, _NONE, _NONE, np.zeros(1))
NO_OUTLINE = OutlineForces(
    np.zeros((0, 3), np.int64), _NO, _NONE, _PAIRS, _PAIRS, _PAIRS, _PAIRS, _PAIRS, _PAIRS,
    _PAIRS, _NONE,
)  # fmt: skip
NO_BODIES = BodyContacts(
    np.zeros(1, np.int64), np.zeros((0, 3), np.int64), _NONE, _PAIRS, np.zeros((0, 6)),
    np.zeros((0, 5)), False, _PAIRS, _PAIRS, _PAIRS, _NONE, _NONE, _NONE, _PAIRS, _NO, _PAIRS,
    np.zeros(3), np.zeros((0, 3)), np.zeros((0, 4)),
)  # fmt: skip


@kernel
def drive_particles(v, drive, speed):
    """Give driven particles the velocity of a step."""
    for k in range(drive.motion.shape[0]):
        t, axis, i, lane = drive.at[k]
        drive.before[k] = v[t, axis, i, lane]
        v[t, axis, i, lane] = speed[drive.motion[k]] * drive.largest[k]


@kernel
def add_driving_work(particles, drive, kick, amplitude):
    """Add the work of a step's drive: of the force that it takes besides all others."""
    for k in range(drive.motion.shape[0]):
        t, axis, i, lane = drive.at[k]
        before = drive.before[k]
        now = particles.v[t, axis, i, lane]
        force = particles.f[t, axis, i, lane]
        for n in range(particles.loads.shape[0]):
            force += amplitude[n] * particles.loads[n, t, axis, i, lane]
        impulse = drive.mass[k] * (now - before) - kick * force
        drive.work[0] += 0.5 * (before + now) * impulse


@kernel
def add_outline_forces(particles, outline, amplitude):
    """Add forces on the outline to f of own particles; set force, before and total."""
    x = particles.x
    v = particles.v
    f = particles.f
    at = outline.at
    outline.total[:] = 0.0
    bonds = outline.pressure.shape[0]
    for k in range(bonds):
        size = 0.5 * amplitude[outline.load[2 * k]] * outline.pressure[k]
        t, i, lane = at[2 * k]
        tile, j, other = at[2 * k + 1]
        for axis in range(2):
            along = outline.offset[2 * k + 1, axis] - outline.offset[2 * k, axis]
            along += x[tile, axis, j, other] - x[t, axis, i, lane]
            # The outward normal times length is (dy, −dx).
            along *= size if axis == 0 else -size
            outline.force[2 * k, 1 - axis] = outline.force[2 * k + 1, 1 - axis] = along
    for k in range(outline.home.shape[0]):
        t, i, lane = at[2 * bonds + k]
        for axis in range(2):
            held = outline.stiffness[k, axis] * (x[t, axis, i, lane] - outline.home[k, axis])
            held += outline.damping[k, axis] * v[t, axis, i, lane]
            outline.force[2 * bonds + k, axis] = -held
    for e in range(at.shape[0]):
        t, i, lane = at[e]
        for axis in range(2):
            outline.before[e, axis] = v[t, axis, i, lane]
            f[t, axis, i, lane] += outline.force[e, axis]
            outline.total[outline.load[e], axis] += outline.force[e, axis]


@kernel
def add_outline_work(particles, outline, kick):
    """Add the work that forces on the outline have done in a step."""
    for e in range(outline.at.shape[0]):
        t, i, lane = outline.at[e]
        for axis in range(2):
            mean = 0.5 * (outline.before[e, axis] + particles.v[t, axis, i, lane])
            outline.work[outline.load[e]] += kick * mean * outline.force[e, axis]


@kernel
def add_normal_contact(particles, bodies):
    """Add forces of springs and dashpots to f of own particles; set what the last step has."""
    x = particles.x
    v = particles.v
    f = particles.f
    bodies.force[:] = 0.0
    bodies.stored[:] = 0.0
    bodies.depth[:] = 0.0
    for b in range(bodies.x.shape[0]):
        k_contact, onset, damping, _, _ = bodies.law[b]
        for k in range(bodies.starts[b], bodies.starts[b + 1]):
            t, i, lane = bodies.at[k]
            px = x[t, 0, i, lane] + bodies.offset[k, 0] - bodies.x[b, 0]
            py = x[t, 1, i, lane] + bodies.offset[k, 1] - bodies.x[b, 1]
            distance, nx, ny, _ = gap(px, py, bodies.outline[b])
            bodies.pressed[k, 0] = 0.0
            if not distance < 0.0:
                continue
            vx = v[t, 0, i, lane] - bodies.v[b, 0]
            vy = v[t, 1, i, lane] - bodies.v[b, 1]
            length = bodies.length[k]
            closing = -(vx * nx + vy * ny)
            size = length * pressure(-distance, closing, (k_contact, onset, damping))[0]
            spring = length * pressure(-distance, 0.0, (k_contact, onset, 0.0))[0]
            dashpot = size - spring if damping > 0.0 else 0.0
            bodies.lost[k] = (dashpot * nx, dashpot * ny, vx, vy)
            bodies.pressed[k] = (size, nx, ny)
            f[t, 0, i, lane] += size * nx
            f[t, 1, i, lane] += size * ny
            bodies.force[b, 0] += size * nx
            bodies.force[b, 1] += size * ny
            bodies.stored[b] += length * stored(-distance, k_contact, onset)
            bodies.depth[b] = max(bodies.depth[b], -distance)


@kernel
def add_friction(particles, bodies, kick, amplitude, speed):
    """Add friction to f of own particles, which has all other forces, and to that of the bodies."""
    v = particles.v
    f = particles.f
    loads = particles.loads
    for b in range(bodies.x.shape[0]):
        law = bodies.law[b, 3], bodies.law[b, 4]
        if not law[0] > 0.0:
            continue
        begin = bodies.starts[b]
        end = bodies.starts[b + 1]
        moved = bodies.motion[b]
        of_body = (end - begin) * bodies.per_mass[b]
        for k in range(begin, end):
            size, nx, ny = bodies.pressed[k]
            if not size > 0.0:
                continue
            t, i, lane = bodies.at[k]
            sliding = 0.0
            mobility = of_body
            tangent = (-ny, nx)
            for axis in range(2):
                share = particles.per_mass[t, axis, i, lane]
                force = f[t, axis, i, lane]
                for n in range(loads.shape[0]):
                    force += amplitude[n] * loads[n, t, axis, i, lane]
                # a flying body has the velocity from before its kick: an error of first order
                base = bodies.v[b, axis]
                if moved >= 0 and kick > 0.0:
                    base = speed[moved] * bodies.largest[b, axis]
                sliding += tangent[axis] * (v[t, axis, i, lane] + kick * share * force - base)
                mobility += tangent[axis] * tangent[axis] * share
            drag = _drag(size, sliding, kick * mobility, law)
            for axis in range(2):
                f[t, axis, i, lane] -= drag * tangent[axis]
                bodies.force[b, axis] -= drag * tangent[axis]
                bodies.lost[k, axis] -= drag * tangent[axis]


@kernel
def _drag(size, sliding, yielding, law):
    """Friction at the sliding velocity w that it leaves, w + yielding · friction(w) = sliding.

    Friction is concave by w > 0, so Newton from 0 rises to the root.
    """
    w = 0.0 if yielding > 0.0 else sliding
    for _ in range(_ITERATIONS):
        drag, _, slope = friction(size, w, law)
        change = (sliding - w - yielding * drag) / (1.0 + yielding * slope)
        w += change
        if not abs(change) > 1e-14 * abs(w):
            break
    return friction(size, w, law)[0]


@kernel
def move_bodies(bodies, length, speed):
    """A step of the bodies under `force`; length: (2,) kick and drift, speed: (motions,)."""
    kick, drift = length
    for b in range(bodies.x.shape[0]):
        for axis in range(2):
            before = bodies.v[b, axis]
            force = bodies.force[b, axis]
            if bodies.per_mass[b] > 0.0:
                pull = bodies.pull[b, axis]
                now = before + kick * (pull - force * bodies.per_mass[b])
                mean = 0.5 * (before + now)
                bodies.work[0] += kick * mean * pull / bodies.per_mass[b]
            elif bodies.motion[b] >= 0:
                now = speed[bodies.motion[b]] * bodies.largest[b, axis]
                bodies.work[1] += kick * 0.5 * (before + now) * force
            else:
                now = 0.0
            bodies.v[b, axis] = now
            bodies.x[b, axis] += drift * now


@kernel
def add_contact_loss(particles, bodies, kick):
    """Add what dashpots and friction took in a step."""
    v = particles.v
    lost = bodies.lost
    for b in range(bodies.x.shape[0]):
        for k in range(bodies.starts[b], bodies.starts[b + 1]):
            if bodies.pressed[k, 0] > 0.0:
                t, i, lane = bodies.at[k]
                for axis in range(2):
                    now = v[t, axis, i, lane] - bodies.v[b, axis]
                    mean = 0.5 * (lost[k, 2 + axis] + now)
                    bodies.work[2] -= kick * mean * lost[k, axis]
