"""Kernels of all particles of a tissue: its time step and its elastic energy.

A step gathers images, sums forces, folds them back, kicks and drifts; in between the outline is
acted on and driven particles get their velocity.

Arrays hold a tile after the other, and one more that stays as it is: there lie the images of
cells that do not exist, at rest and far away, and there is the force that is always zero::

    x, v, f  (tiles + 1, 2, local, TILE)     own particles first, then images

A step has two parts, each parallel over tiles, so that its result does not depend on how many
threads there are: a tile writes its own images and f; then its own f, v and x.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from surrofe2.base.arrays import Array
from surrofe2.base.compilation import kernel, parallel_kernel
from surrofe2.base.simd import TILE, load, spread, store, where_less
from surrofe2.plant_cell.pair_laws import (
    contact,
    contact_energy,
    tension,
    wall,
    wall_energy,
    within,
)
from surrofe2.plant_cell.pair_sums import add_pair, difference, norm, pair_at
from surrofe2.plant_cell.sph_fluid import add_sph_forces, fluid_specific_volume
from surrofe2.plant_cell.uniform_fluid import (
    add_vector,
    normal_at,
    rim_area,
    rim_product,
    twice_deviator,
)
from surrofe2.tissue.external_forces import (
    add_contact_loss,
    add_driving_work,
    add_friction,
    add_normal_contact,
    add_outline_forces,
    add_outline_work,
    drive_particles,
    move_bodies,
)
from surrofe2.tissue.pair_lists import bond_at, contact_at, fluid_at, sap_at


class Particles(NamedTuple):
    """All particles, what they are moved by, and the work of that.

    Attributes:
        x, v, f: (tiles + 1, 2, local, TILE) µm, µm/µs, µN.
        per_mass: (tiles, 2, own, TILE) 1/ng, 0 where missing and where v does not follow forces.
        loads: (loads, tiles, 2, own, TILE) µN at amplitude 1.
        work: (loads, tiles, TILE) of these, pJ, to which each step adds: kick · force · mean of the
            velocities before and after.
    """

    x: Array
    v: Array
    f: Array
    per_mass: Array
    loads: Array
    work: Array


class Watch(NamedTuple):
    """Motion since lists were made.

    Attributes:
        listed: (tiles, 2, own, TILE) positions at that time, µm.
        mean: (tiles, 2, TILE) mean displacement ū of each plant cell since then, µm.
        spread: (tiles, TILE) largest |u − ū|² within it, µm².
        apart: (tiles, TILE) largest |ū_B − ū|² to its neighbours, µm².
    """

    listed: Array
    mean: Array
    spread: Array
    apart: Array


@parallel_kernel
def leap(particles, lists, constants, cells, driven, bodies, outline, watch, steps, retained):
    """Leapfrog steps in place; how many were taken before lists could miss a pair.

    A step takes forces at x with the velocities at hand, then v += kick a, x += drift v. One
    without a kick leaves all velocities as they are.

    Args:
        steps: (n, 2) by which v is kicked and x drifts, µs; (n, loads) amplitudes; (n, motions)
            mean rate of each amplitude in the step, 1/µs.
        retained: part of the velocity that a step leaves; 1, or less with drag.
    """
    lengths, amplitudes, speeds = steps
    tiles = particles.x.shape[0] - 1
    for n in range(len(lengths)):
        for k in numba.prange(tiles):
            _sum_forces(cells.order[k], particles, lists, constants, cells)
            _measure_apart(cells.order[k], cells, watch)
        if not _largest_motion(watch) <= cells.skin:
            return n
        kick = lengths[n, 0]
        amplitude = amplitudes[n]
        speed = speeds[n]
        add_normal_contact(particles, bodies)
        add_outline_forces(particles, outline, amplitude)
        if kick != 0.0:
            drive_particles(particles.v, driven, speed)
        if bodies.rubs:
            for k in numba.prange(tiles):
                _fold(cells.order[k], particles.f, lists)
            add_friction(particles, bodies, kick, amplitude, speed)
        if kick != 0.0:
            move_bodies(bodies, lengths[n], speed)
        step = kick, lengths[n, 1], retained, bodies.rubs
        for k in numba.prange(tiles):
            _kick_and_drift(cells.order[k], particles, lists, cells, watch, amplitude, step)
        if kick != 0.0:
            add_driving_work(particles, driven, kick, amplitude)
            add_contact_loss(particles, bodies, kick)
            add_outline_work(particles, outline, kick)
    return len(lengths)


@kernel
def _sum_forces(t, particles, lists, constants, cells):
    """Images of tile t and the forces on its local particles, not folded."""
    own_particles = cells.particles
    here = lists.starts[t]
    end = lists.starts[t + 1]
    _gather_images(particles.x, t, own_particles, here[0], end[0], lists.source)
    _gather_images(particles.v, t, own_particles, here[0], end[0], lists.source)
    x = particles.x[t]
    v = particles.v[t]
    f = particles.f[t]
    for i in range(own_particles + end[0] - here[0]):
        store(0.0, f, 0, i)
        store(0.0, f, 1, i)
    for k in range(here[1], end[1]):
        i = lists.bonds[k, 0]
        j = lists.bonds[k, 1]
        pair = pair_at(x, v, i, j)
        a = tension(wall(pair.length, bond_at(constants.bonds, k)), pair.rate) * pair.inverse
        add_pair(f, i, j, a * pair.rx, a * pair.ry)
    for k in range(here[2], end[2]):
        i = lists.contacts[k, 0]
        j = lists.contacts[k, 1]
        pair = pair_at(x, v, i, j)
        c = contact_at(constants, k)
        law = contact(pair.length, pair.inverse, c)
        a = tension(law, pair.rate) * within(pair.length, pair.inverse, c)
        add_pair(f, i, j, a * pair.rx, a * pair.ry)
    if t < cells.fluid_tiles:
        slope = np.empty((cells.fluid_pairs.shape[0], TILE))
        volume = np.empty((own_particles - cells.walls, TILE))
        row = min(np.int64(t), constants.fluid.shape[0] - 1)
        add_sph_forces(x, v, f, cells, fluid_at(constants.fluid, row), slope, volume)
        for k in range(cells.rim_start.shape[0] - 1):
            rim = lists.rim[t, cells.rim_start[k] : cells.rim_start[k + 1]]
            _add_sap_forces(x, v, f, rim, sap_at(constants.sap, t, k))


@kernel
def _sap_area(x, rim, sap):
    """Area within a rim, µm²; 1 where there is no plant cell."""
    return sap.is_there * rim_area(x, rim) + (1.0 - sap.is_there)


@kernel
def _add_sap_forces(x, v, f, rim, sap):
    """Add pressure and viscous forces S g_k of a uniform fluid to f."""
    per_area = 1.0 / _sap_area(x, rim, sap)
    osmotic = sap.fluid_mass * sap.sound_speed_squared
    pressure = (osmotic + sap.sap_modulus * sap.rest_area) * per_area - sap.sap_modulus
    xx, xy, yx, yy = rim_product(v, x, rim)
    L = (xx * per_area, xy * per_area, yx * per_area, yy * per_area)
    txx, txy, tyy = twice_deviator(L, sap.viscosity)
    sxx = pressure - txx
    syy = pressure - tyy
    for k in range(rim.shape[0]):
        gx, gy = normal_at(x, rim, k)
        add_vector(f, rim[k], sxx * gx - txy * gy, syy * gy - txy * gx)


@kernel
def _gather_images(x, t, particles, start, end, source):
    """Copy the owners of tile t's images."""
    flat = x.reshape(-1)
    y = x.shape[2] * TILE
    for k in range(start, end):
        local = particles + k - start
        for lane in range(TILE):
            s = source[k, lane]
            x[t, 0, local, lane] = flat[s]
            x[t, 1, local, lane] = flat[s + y]


@kernel
def _fold(t, f, lists):
    """Fold image forces back to tile t's own particles."""
    flat = f.reshape(-1)
    y = f.shape[2] * TILE
    for k in range(lists.starts[t, 3], lists.starts[t + 1, 3]):
        i = lists.fold[k]
        for lane in range(TILE):
            s = lists.fold_source[k, lane]
            f[t, 0, i, lane] += flat[s]
            f[t, 1, i, lane] += flat[s + y]


@kernel
def _kick_and_drift(t, particles, lists, cells, watch, amplitude, step):
    """v += kick a, x += drift v of tile t's own particles; how far they are from where listed.

    step: kick, drift, the part of v that is retained, whether f is folded.
    """
    x = particles.x
    v = particles.v
    f = particles.f
    loads = particles.loads
    kick, drift, retained, folded = step
    if not folded:
        _fold(t, f, lists)
    mean_x = spread(0.0)
    mean_y = spread(0.0)
    for i in range(cells.particles):
        pull_x = load(f, t, 0, i)
        pull_y = load(f, t, 1, i)
        for n in range(loads.shape[0]):
            pull_x += amplitude[n] * load(loads, n, t, 0, i)
            pull_y += amplitude[n] * load(loads, n, t, 1, i)
        old_x = load(v, t, 0, i)
        old_y = load(v, t, 1, i)
        speed_x = retained * old_x + kick * load(particles.per_mass, t, 0, i) * pull_x
        speed_y = retained * old_y + kick * load(particles.per_mass, t, 1, i) * pull_y
        store(speed_x, v, t, 0, i)
        store(speed_y, v, t, 1, i)
        for n in range(loads.shape[0]):
            power = load(loads, n, t, 0, i) * (old_x + speed_x)
            power += load(loads, n, t, 1, i) * (old_y + speed_y)
            done = load(particles.work, n, t) + 0.5 * kick * amplitude[n] * power
            store(done, particles.work, n, t)
        new_x = load(x, t, 0, i) + drift * speed_x
        new_y = load(x, t, 1, i) + drift * speed_y
        store(new_x, x, t, 0, i)
        store(new_y, x, t, 1, i)
        mean_x += new_x - load(watch.listed, t, 0, i)
        mean_y += new_y - load(watch.listed, t, 1, i)
    share = load(cells.per_count, t)
    mean_x = mean_x * share
    mean_y = mean_y * share
    store(mean_x, watch.mean, t, 0)
    store(mean_y, watch.mean, t, 1)
    largest = spread(0.0)
    for i in range(cells.particles):
        dx = load(x, t, 0, i) - load(watch.listed, t, 0, i) - mean_x
        dy = load(x, t, 1, i) - load(watch.listed, t, 1, i) - mean_y
        square = (dx * dx + dy * dy) * load(cells.exists, t, i)
        largest = where_less(square, largest, largest, square)
    store(largest, watch.spread, t)


@kernel
def _measure_apart(t, cells, watch):
    """watch.apart of tile t: mean displacements against those of the next cells."""
    for lane in range(TILE):
        largest = 0.0
        for s in cells.next_shifts:
            there = cells.place[t, s, lane]
            if there >= 0:
                tile = there // TILE
                other = there % TILE
                dx = watch.mean[tile, 0, other] - watch.mean[t, 0, lane]
                dy = watch.mean[tile, 1, other] - watch.mean[t, 1, lane]
                largest = max(largest, dx * dx + dy * dy)
        watch.apart[t, lane] = largest


@kernel
def _largest_motion(watch):
    """2 d + |ū_B − ū_A|, the largest anywhere, µm."""
    within = 0.0
    apart = 0.0
    for t in range(watch.spread.shape[0]):
        for lane in range(TILE):
            if not watch.spread[t, lane] < np.inf:
                return np.inf
            within = max(within, watch.spread[t, lane])
            apart = max(apart, watch.apart[t, lane])
    return 2.0 * np.sqrt(within) + np.sqrt(apart)


@parallel_kernel
def elastic_energy(x, lists, constants, cells, energy):
    """energy (tiles, TILE) of which the forces at rest are the negative gradient, in pJ.

    Springs ½ k (|r| − l₀)², contacts, SPH fluid Σ m c_s² ln ρ, or that of `uniform_fluid`.
    x: (tiles + 1, 2, local, TILE) with images set.
    """
    for t in numba.prange(energy.shape[0]):
        here = lists.starts[t]
        end = lists.starts[t + 1]
        there = x[t]
        total = spread(0.0)
        for k in range(here[1], end[1]):
            rx, ry = difference(there, lists.bonds[k, 0], lists.bonds[k, 1])
            length, _ = norm(rx, ry)
            total += wall_energy(length, bond_at(constants.bonds, k))
        for k in range(here[2], end[2]):
            rx, ry = difference(there, lists.contacts[k, 0], lists.contacts[k, 1])
            length, inverse = norm(rx, ry)
            total += contact_energy(length, inverse, contact_at(constants, k))
        store(total, energy, t)
        if t < cells.fluid_tiles:
            slope = np.empty((cells.fluid_pairs.shape[0], TILE))
            volume = np.empty((cells.particles - cells.walls, TILE))
            row = min(np.int64(t), constants.fluid.shape[0] - 1)
            fluid_specific_volume(there, cells, fluid_at(constants.fluid, row), slope, volume)
            for p in range(volume.shape[0]):
                for lane in range(TILE):
                    weight = constants.fluid[row, 1, lane] * constants.fluid[row, 2, lane]
                    weight *= cells.exists[t, cells.walls + p, lane]
                    energy[t, lane] -= weight * np.log(volume[p, lane])
            for k in range(cells.rim_start.shape[0] - 1):
                rim = lists.rim[t, cells.rim_start[k] : cells.rim_start[k + 1]]
                _add_sap_energy(there, rim, sap_at(constants.sap, t, k), energy[t])


@kernel
def _add_sap_energy(x, rim, sap, energy):
    """Add the stored energy of a uniform fluid, pJ, to energy (TILE,)."""
    sums = np.empty((5, TILE))
    store(_sap_area(x, rim, sap), sums, 0)
    store(sap.fluid_mass, sums, 1)
    store(sap.fluid_mass * sap.sound_speed_squared, sums, 2)
    store(sap.sap_modulus, sums, 3)
    store(sap.rest_area, sums, 4)
    for lane in range(TILE):
        area = sums[0, lane]
        mass = sums[1, lane]
        osmotic = sums[2, lane]
        modulus = sums[3, lane]
        rest = sums[4, lane]
        energy[lane] += osmotic * np.log(mass / area)
        energy[lane] += modulus * (area - rest - rest * np.log(area / rest))
