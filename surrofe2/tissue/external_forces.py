"""Motion of particles by other than their own forces: prescribed motion, outline, rigid bodies.

Driven particles and bodies have in each step the mean velocity of their motion, so that they arrive
where it leads; other bodies move by leapfrog. Contact is that of FE² (`problem.contact_law`), point
by point: the force on a particle is the pressure of its gap times L, the unloaded length of its
part of the boundary. Friction is that at the end of the kick, v₁ = v* − (kick/m) µ p L w₁/√(w₁² +
s²), where v* is the velocity by all other forces, so that a particle may stick at any pressure
without a shorter step. Works are forces times the mean of the velocities before and after a kick,
which closes the energy balance of the kick.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from surrofe2.base.arrays import Array, Index
from surrofe2.base.compilation import kernel
from surrofe2.problem.contact_law import friction, gap, pressure, stored

_ITERATIONS = 50
"""Most iterations for the sliding velocity that friction leaves."""
_STICK = 1e-14
"""Relative change of this velocity at which they end."""


class DrivenParticles(NamedTuple):
    """Components of particles that follow a motion.

    Attributes:
        at: (d, 4) tile, axis, own particle, lane.
        motion: (d,) number of the motion that a component follows.
        largest: (d,) displacement at amplitude 1, µm.
        mass: (d,) mass of the particle, ng.
        before: (d,) velocity before a step, scratch.
        work: (1,) work of the motions so far, pJ.
    """

    at: Index
    motion: Index
    largest: Array
    mass: Array
    before: Array
    work: Array


class OutlineForces(NamedTuple):
    """Follower pressures and foundations: forces on e places along the outline.

    The first 2k places are the ends of k bonds under pressure: bond b leads from place 2b to
    2b + 1, with the tissue on its left. The other e − 2k are particles on springs.

    Attributes:
        at: (e, 3) tile, own particle, lane.
        load: (e,) number of the load.
        pressure: (k,) pressure on each bond at amplitude 1, µN/µm.
        offset: (2k, 2) added to the positions of the ends of bonds, µm.
        home: (e − 2k, 2) positions at which springs are at rest, µm.
        stiffness, damping: (e − 2k, 2) constants of springs in both components, µN/µm and
            µN µs/µm.
        force: (e, 2) forces in the last step, µN.
        before: (e, 2) velocities before it, scratch.
        total: (loads, 2) total force of each load in the last step, µN.
        work: (loads,) work of each load so far, pJ.
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


STIFFNESS, SMOOTHING, DAMPING, FRICTION, SLIP_SPEED = range(5)
"""Columns of `BodyContacts.law`."""
BY_PULL, BY_MOTION, LOST = range(3)
"""Entries of `BodyContacts.work`."""
NO_MOTION = -1
"""Motion of a body that rests or moves freely."""


class BodyContacts(NamedTuple):
    """Rigid bodies b, and particles c that may touch them.

    Attributes:
        starts: (b + 1,) where the particles of each body begin.
        at: (c, 3) tile, own particle, lane.
        length: (c,) length of the boundary that a particle stands for, µm.
        offset: (c, 2) added to a particle's position, µm.
        outline: (b, 6) outline of a body, as `contact_law.gap` takes it.
        law: (b, 5) contact law of a body: stiffness, smoothing, damping, friction, slip speed; the
            columns STIFFNESS to SLIP_SPEED.
        rubs: whether any body has friction.
        x, v: (b, 2) position and velocity, µm and µm/µs.
        force: (b, 2) force on the tissue in the last step, µN.
        impulse: (b, 2) impulse on the tissue so far, µN µs.
        stored: (b,) energy stored in contact, pJ.
        depth: (b,) largest penetration, µm.
        per_mass: (b,) 1/mass, 1/ng; 0 where the motion is prescribed.
        pull: (b, 2) acceleration of bodies that move freely, µm/µs².
        motion: (b,) number of the prescribed motion, or NO_MOTION.
        largest: (b, 2) displacement at amplitude 1, µm.
        work: (3,) works so far, pJ, in BY_PULL, BY_MOTION and LOST: of `pull`, of what prescribes
            motion, and lost in contact.
        pressed: (c, 3) force along the normal in the last step, µN, and the normal.
        lost: (c, 4) force of dashpot and friction, µN, and velocity relative to the body, µm/µs.
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
    impulse: Array
    stored: Array
    depth: Array
    per_mass: Array
    pull: Array
    motion: Index
    largest: Array
    work: Array
    pressed: Array
    lost: Array


_NO_INDICES = np.zeros(0, np.int64)
_NO_NUMBERS = np.zeros(0)
_NO_VECTORS = np.zeros((0, 2))
NO_DRIVEN = DrivenParticles(
    at=np.zeros((0, 4), np.int64),
    motion=_NO_INDICES,
    largest=_NO_NUMBERS,
    mass=_NO_NUMBERS,
    before=_NO_NUMBERS,
    work=np.zeros(1),
)
NO_OUTLINE = OutlineForces(
    at=np.zeros((0, 3), np.int64),
    load=_NO_INDICES,
    pressure=_NO_NUMBERS,
    offset=_NO_VECTORS,
    home=_NO_VECTORS,
    stiffness=_NO_VECTORS,
    damping=_NO_VECTORS,
    force=_NO_VECTORS,
    before=_NO_VECTORS,
    total=_NO_VECTORS,
    work=_NO_NUMBERS,
)
NO_BODIES = BodyContacts(
    starts=np.zeros(1, np.int64),
    at=np.zeros((0, 3), np.int64),
    length=_NO_NUMBERS,
    offset=_NO_VECTORS,
    outline=np.zeros((0, 6)),
    law=np.zeros((0, 5)),
    rubs=False,
    x=_NO_VECTORS,
    v=_NO_VECTORS,
    force=_NO_VECTORS,
    impulse=_NO_VECTORS,
    stored=_NO_NUMBERS,
    depth=_NO_NUMBERS,
    per_mass=_NO_NUMBERS,
    pull=_NO_VECTORS,
    motion=_NO_INDICES,
    largest=_NO_VECTORS,
    work=np.zeros(3),
    pressed=np.zeros((0, 3)),
    lost=np.zeros((0, 4)),
)


@kernel
def drive_particles(v, drive, speed):
    """Give driven particles the velocities of a step; v as of `Particles`.

    speed: (motions,) mean rate of each amplitude in the step, 1/µs.
    """
    for k in range(drive.motion.shape[0]):
        t, axis, i, lane = drive.at[k]
        drive.before[k] = v[t, axis, i, lane]
        v[t, axis, i, lane] = speed[drive.motion[k]] * drive.largest[k]


@kernel
def add_driving_work(particles, drive, kick, amplitude):
    """Add the work by which driven particles got their velocities in a step to `drive.work`.

    The impulse that this takes is m Δv, less that of all other forces.
    """
    for k in range(drive.motion.shape[0]):
        t, axis, i, lane = drive.at[k]
        v_before = drive.before[k]
        v_after = particles.v[t, axis, i, lane]
        force = particles.f[t, axis, i, lane]
        for n in range(particles.loads.shape[0]):
            force += amplitude[n] * particles.loads[n, t, axis, i, lane]
        impulse = drive.mass[k] * (v_after - v_before) - kick * force
        drive.work[0] += 0.5 * (v_before + v_after) * impulse


@kernel
def add_outline_forces(particles, outline, amplitude):
    """Add pressures and foundations to f of own particles; set outline.force, before and total.

    amplitude: (loads,) current amplitude of each load.
    """
    x = particles.x
    v = particles.v
    f = particles.f
    outline.total[:] = 0.0
    bonds = outline.pressure.shape[0]
    for k in range(bonds):
        begin = 2 * k
        end = 2 * k + 1
        # half of the pressure for each end; it pushes along the inward normal (−dy, dx)
        size = 0.5 * amplitude[outline.load[begin]] * outline.pressure[k]
        t_begin, i, lane_i = outline.at[begin]
        t_end, j, lane_j = outline.at[end]
        for axis in range(2):
            push = outline.offset[end, axis] - outline.offset[begin, axis]
            push += x[t_end, axis, j, lane_j] - x[t_begin, axis, i, lane_i]
            push *= size if axis == 0 else -size
            outline.force[begin, 1 - axis] = push
            outline.force[end, 1 - axis] = push
    for k in range(outline.home.shape[0]):
        place = 2 * bonds + k
        t, i, lane = outline.at[place]
        for axis in range(2):
            spring = outline.stiffness[k, axis] * (x[t, axis, i, lane] - outline.home[k, axis])
            spring += outline.damping[k, axis] * v[t, axis, i, lane]
            outline.force[place, axis] = -spring
    for e in range(outline.at.shape[0]):
        t, i, lane = outline.at[e]
        for axis in range(2):
            outline.before[e, axis] = v[t, axis, i, lane]
            f[t, axis, i, lane] += outline.force[e, axis]
            outline.total[outline.load[e], axis] += outline.force[e, axis]


@kernel
def add_outline_work(particles, outline, kick):
    """Add the work that forces on the outline do in a step to `outline.work`."""
    for e in range(outline.at.shape[0]):
        t, i, lane = outline.at[e]
        for axis in range(2):
            mean = 0.5 * (outline.before[e, axis] + particles.v[t, axis, i, lane])
            outline.work[outline.load[e]] += kick * mean * outline.force[e, axis]


@kernel
def add_normal_contact(particles, bodies):
    """Add the contact's springs and dashpots to f of own particles.

    It sets force, stored, depth, pressed and lost of the bodies, friction left out.
    """
    x = particles.x
    v = particles.v
    f = particles.f
    bodies.force[:] = 0.0
    bodies.stored[:] = 0.0
    bodies.depth[:] = 0.0
    for b in range(bodies.x.shape[0]):
        stiffness = bodies.law[b, STIFFNESS]
        smoothing = bodies.law[b, SMOOTHING]
        damping = bodies.law[b, DAMPING]
        for k in range(bodies.starts[b], bodies.starts[b + 1]):
            t, i, lane = bodies.at[k]
            px = x[t, 0, i, lane] + bodies.offset[k, 0] - bodies.x[b, 0]
            py = x[t, 1, i, lane] + bodies.offset[k, 1] - bodies.x[b, 1]
            distance, nx, ny, _ = gap(px, py, bodies.outline[b])
            bodies.pressed[k, 0] = 0.0
            is_touching = distance < 0.0
            if not is_touching:
                continue
            vx = v[t, 0, i, lane] - bodies.v[b, 0]
            vy = v[t, 1, i, lane] - bodies.v[b, 1]
            length = bodies.length[k]
            closing = -(vx * nx + vy * ny)
            # the law returns the pressure first, then its slopes
            size = length * pressure(-distance, closing, (stiffness, smoothing, damping))[0]
            spring = length * pressure(-distance, 0.0, (stiffness, smoothing, 0.0))[0]
            dashpot = size - spring if damping > 0.0 else 0.0
            bodies.lost[k] = (dashpot * nx, dashpot * ny, vx, vy)
            bodies.pressed[k] = (size, nx, ny)
            f[t, 0, i, lane] += size * nx
            f[t, 1, i, lane] += size * ny
            bodies.force[b, 0] += size * nx
            bodies.force[b, 1] += size * ny
            bodies.stored[b] += length * stored(-distance, stiffness, smoothing)
            bodies.depth[b] = max(bodies.depth[b], -distance)


@kernel
def add_friction(particles, bodies, kick, amplitude, speed):
    """Add friction to f of own particles, which holds all other forces, and to that of bodies.

    Friction is implicit: it depends on the sliding velocity that it leaves, see `_drag`.

    kick: µs. amplitude: (loads,). speed: (motions,) mean rate of each amplitude in the step, 1/µs.
    """
    v = particles.v
    f = particles.f
    loads = particles.loads
    for b in range(bodies.x.shape[0]):
        law = bodies.law[b, FRICTION], bodies.law[b, SLIP_SPEED]
        has_friction = bodies.law[b, FRICTION] > 0.0
        if not has_friction:
            continue
        begin = bodies.starts[b]
        end = bodies.starts[b + 1]
        motion = bodies.motion[b]
        is_driven = motion >= 0
        # a body that moves freely yields to the friction of all its particles
        mobility_of_body = (end - begin) * bodies.per_mass[b]
        for k in range(begin, end):
            size, nx, ny = bodies.pressed[k]
            if not size > 0.0:
                continue
            t, i, lane = bodies.at[k]
            sliding = 0.0
            mobility = mobility_of_body
            tangent = (-ny, nx)
            for axis in range(2):
                per_mass = particles.per_mass[t, axis, i, lane]
                force = f[t, axis, i, lane]
                for n in range(loads.shape[0]):
                    force += amplitude[n] * loads[n, t, axis, i, lane]
                # a body that moves freely has the velocity before its kick: an error of first order
                v_body = bodies.v[b, axis]
                if is_driven and kick > 0.0:
                    v_body = speed[motion] * bodies.largest[b, axis]
                v_particle = v[t, axis, i, lane] + kick * per_mass * force
                sliding += tangent[axis] * (v_particle - v_body)
                mobility += tangent[axis] * tangent[axis] * per_mass
            drag = _drag(size, sliding, kick * mobility, law)
            for axis in range(2):
                f[t, axis, i, lane] -= drag * tangent[axis]
                bodies.force[b, axis] -= drag * tangent[axis]
                bodies.lost[k, axis] -= drag * tangent[axis]


@kernel
def _drag(size, sliding, yielding, law):
    """Return friction at the sliding velocity w that it leaves.

    w solves w + yielding · friction(w) = sliding. Friction is a concave function of w > 0, so that
    Newton's method from 0 rises to the root.

    size: normal force, µN. sliding: velocity without friction, µm/µs. yielding: velocity per force.
    law: friction and slip speed.
    """
    # nothing yields in a step without a kick: friction is then that at the present velocity
    w = 0.0 if yielding > 0.0 else sliding
    for _ in range(_ITERATIONS):
        drag, _, slope = friction(size, w, law)
        change = (sliding - w - yielding * drag) / (1.0 + yielding * slope)
        w += change
        if not abs(change) > _STICK * abs(w):
            break
    return friction(size, w, law)[0]


@kernel
def move_bodies(bodies, length, speed):
    """Move the bodies by one step under `bodies.force`, and add to their works and impulses.

    length: (2,) kick and drift, µs. speed: (motions,) mean rate of each amplitude, 1/µs.
    """
    kick, drift = length
    for b in range(bodies.x.shape[0]):
        moves_freely = bodies.per_mass[b] > 0.0
        is_driven = bodies.motion[b] >= 0
        for axis in range(2):
            v_before = bodies.v[b, axis]
            force = bodies.force[b, axis]
            bodies.impulse[b, axis] += kick * force
            if moves_freely:
                pull = bodies.pull[b, axis]
                v_after = v_before + kick * (pull - force * bodies.per_mass[b])
                mean = 0.5 * (v_before + v_after)
                bodies.work[BY_PULL] += kick * mean * pull / bodies.per_mass[b]
            elif is_driven:
                v_after = speed[bodies.motion[b]] * bodies.largest[b, axis]
                bodies.work[BY_MOTION] += kick * 0.5 * (v_before + v_after) * force
            else:
                # a body without mass and motion rests
                v_after = 0.0
            bodies.v[b, axis] = v_after
            bodies.x[b, axis] += drift * v_after


@kernel
def add_contact_loss(particles, bodies, kick):
    """Add the energy that dashpots and friction take in a step to `bodies.work`."""
    v = particles.v
    lost = bodies.lost
    for b in range(bodies.x.shape[0]):
        for k in range(bodies.starts[b], bodies.starts[b + 1]):
            is_touching = bodies.pressed[k, 0] > 0.0
            if is_touching:
                t, i, lane = bodies.at[k]
                for axis in range(2):
                    force = lost[k, axis]
                    v_before = lost[k, 2 + axis]
                    v_after = v[t, axis, i, lane] - bodies.v[b, axis]
                    mean = 0.5 * (v_before + v_after)
                    bodies.work[LOST] -= kick * mean * force
