"""Contact of particles with rigid bodies, which rest, move as prescribed or fly, as kernels.

The law is that of FE² (`contact_law`), point by point: a particle i that may touch a body has the
pressure of its gap g times L_i, the unloaded length of its part of the boundary. The spring and the
dashpot act at the velocities at hand, as all forces do. Friction is that at the end of the kick,
v₁ = v* − (kick/m) µ p L w₁/√(w₁² + s²), where v* is what all other forces make of v: a particle may
so stick at any pressure without a shorter step.

A body with a mass moves by leapfrog as particles do; one that follows a motion has in each step its
mean velocity. What dashpots and friction take is their force times the mean of the relative
velocities before and after a kick, which closes the energy balance of the kick.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.compilation import kernel
from surrofe2.problem.contact_law import circle, corner, friction, pressure, stored

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

PLANE, CIRCLE, CORNER = 0, 1, 2
_ITERATIONS = 50


class Plates(NamedTuple):
    """Rigid bodies b, and particles c that may touch them.

    Attributes:
        starts: (b + 1,) where the particles of each body begin.
        at: (c, 3) tile, own particle, lane. length: (c,) of the boundary, µm.
        offset: (c, 2) added to a particle's position, µm.
        kind: (b,) `PLANE`, `CIRCLE` or `CORNER`. outline: (b, 5) of a plane its unit normal, of a
            circle its radius, of a corner as `contact_law.corner` takes it.
        law: (b, 5) stiffness k, smoothing δ, damping c, friction µ, slip speed s.
        rubs: whether any has friction.
        x, v: (b, 2) position and velocity, µm and µm/µs.
        force: (b, 2) on the tissue at the last step, µN; stored: (b,) energy, pJ; depth: (b,) µm.
        per_mass: (b,) 1/ng, 0 where the motion is prescribed; pull: (b, 2) acceleration of others.
        motion: (b,) which, −1 of one that rests or flies; largest: (b, 2) µm at amplitude 1.
        work: (3,) so far: of `pull`, of what moves bodies, and lost in contact, pJ.
        pressed: (c, 3) at the last step force along the normal, µN, and normal; lost: (c, 4) force
            of dashpot and friction, µN, and velocity relative to the body; of rough bodies only.
    """

    starts: Ints
    at: Ints
    length: Array
    offset: Array
    kind: Ints
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
    motion: Ints
    largest: Array
    work: Array
    pressed: Array
    lost: Array


NO_PLATES = Plates(
    np.zeros(1, np.int64), np.zeros((0, 3), np.int64), np.zeros(0), np.zeros((0, 2)),
    np.zeros(0, np.int64), np.zeros((0, 5)), np.zeros((0, 5)), False, np.zeros((0, 2)),
    np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros(0), np.zeros((0, 2)),
    np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros(3), np.zeros((0, 3)), np.zeros((0, 4)),
)  # fmt: skip


@kernel
def press(particles, plates):
    """Add forces of springs and dashpots to f of own particles; set what the last step has."""
    x, v, f = particles.x, particles.v, particles.f
    for b in range(plates.starts.shape[0] - 1):
        law = plates.law[b]
        rough = law[2] > 0.0 or law[3] > 0.0
        sum_x, sum_y, energy, depth, closing = 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(plates.starts[b], plates.starts[b + 1]):
            t, i, lane = plates.at[k, 0], plates.at[k, 1], plates.at[k, 2]
            px = x[t, 0, i, lane] + plates.offset[k, 0] - plates.x[b, 0]
            py = x[t, 1, i, lane] + plates.offset[k, 1] - plates.x[b, 1]
            gap, nx, ny = _gap(px, py, plates.kind[b], plates.outline[b])
            plates.pressed[k, 0] = 0.0
            if not gap < 0.0:
                continue
            if rough:
                vx = v[t, 0, i, lane] - plates.v[b, 0]
                vy = v[t, 1, i, lane] - plates.v[b, 1]
                closing = -(vx * nx + vy * ny)
                plates.lost[k, 2], plates.lost[k, 3] = vx, vy
            whole = pressure(-gap, closing, (law[0], law[1], law[2]))[0]
            size = plates.length[k] * whole
            if rough:
                spring = pressure(-gap, 0.0, (law[0], law[1], 0.0))[0]
                dashpot = size - plates.length[k] * spring
                plates.lost[k, 0], plates.lost[k, 1] = dashpot * nx, dashpot * ny
            plates.pressed[k, 0], plates.pressed[k, 1], plates.pressed[k, 2] = size, nx, ny
            f[t, 0, i, lane] += size * nx
            f[t, 1, i, lane] += size * ny
            sum_x += size * nx
            sum_y += size * ny
            energy += plates.length[k] * stored(-gap, law[0], law[1])
            depth = max(depth, -gap)
        plates.force[b, 0], plates.force[b, 1] = sum_x, sum_y
        plates.stored[b], plates.depth[b] = energy, depth


@kernel
def _gap(x, y, kind, outline):
    """Gap and normal at a point relative to a body."""
    if kind == CIRCLE:
        gap, nx, ny, _ = circle(x, y, outline[0])
    elif kind == CORNER:
        wedge = outline[0], outline[1], outline[2], outline[3], outline[4]
        gap, nx, ny, _ = corner(x, y, wedge)
    else:
        nx, ny = outline[0], outline[1]
        gap = x * nx + y * ny
    return gap, nx, ny


@kernel
def rub(particles, body, plates, kick, amplitude, speed):
    """Add friction to f of own particles, which has all other forces, and to that of the bodies.

    body: `kernels.Body`; amplitude: (loads,); speed: (motions,) of the step.
    """
    v, f, loads = particles.v, particles.f, body.loads
    for b in range(plates.starts.shape[0] - 1):
        law = plates.law[b, 3], plates.law[b, 4]
        if not law[0] > 0.0:
            continue
        moved = plates.motion[b]
        begin, end = plates.starts[b], plates.starts[b + 1]
        of_body = (end - begin) * plates.per_mass[b]
        for k in range(begin, end):
            size, nx, ny = plates.pressed[k, 0], plates.pressed[k, 1], plates.pressed[k, 2]
            if not size > 0.0:
                continue
            t, i, lane = plates.at[k, 0], plates.at[k, 1], plates.at[k, 2]
            sliding, mobility = 0.0, of_body
            for axis in range(2):
                along = -ny if axis == 0 else nx
                share = body.per_mass[t, i, lane] * body.free[t, axis, i, lane]
                force = f[t, axis, i, lane]
                for n in range(loads.shape[0]):
                    force += amplitude[n] * loads[n, t, axis, i, lane]
                base = plates.v[b, axis]
                if moved >= 0 and kick > 0.0:
                    base = speed[moved] * plates.largest[b, axis]
                sliding += along * (v[t, axis, i, lane] + kick * share * force - base)
                mobility += along * along * share
            drag = _drag(size, sliding, kick * mobility, law)
            f[t, 0, i, lane] += drag * ny
            f[t, 1, i, lane] -= drag * nx
            plates.force[b, 0] += drag * ny
            plates.force[b, 1] -= drag * nx
            plates.lost[k, 0] += drag * ny
            plates.lost[k, 1] -= drag * nx


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
                plates.work[0] += kick * mean * pull / plates.per_mass[b]
            elif plates.motion[b] >= 0:
                now = speed[plates.motion[b]] * plates.largest[b, axis]
                plates.work[1] += kick * 0.5 * (before + now) * force
            else:
                now = 0.0
            plates.v[b, axis] = now
            plates.x[b, axis] += drift * now


@kernel
def add_contact_loss(particles, plates, kick):
    """Add what dashpots and friction took in a step."""
    v, lost = particles.v, plates.lost
    for b in range(plates.starts.shape[0] - 1):
        if plates.law[b, 2] > 0.0 or plates.law[b, 3] > 0.0:
            for k in range(plates.starts[b], plates.starts[b + 1]):
                if plates.pressed[k, 0] > 0.0:
                    t, i, lane = plates.at[k, 0], plates.at[k, 1], plates.at[k, 2]
                    for axis in range(2):
                        now = v[t, axis, i, lane] - plates.v[b, axis]
                        mean = 0.5 * (lost[k, 2 + axis] + now)
                        plates.work[2] -= kick * mean * lost[k, axis]
