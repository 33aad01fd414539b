"""Kernels of all particles of a tissue: its time step and its elastic energy.

A step copies images from their owners (gathers them), sums forces, adds those on images to their
owners (folds them), kicks velocities and lets positions drift. In between, forces act on the
outline, and driven particles get their velocities.

Arrays hold one tile after the other, and one more that never changes: in it are the images of
cells that do not exist, at rest and far away, and a force that is always zero::

    x, v, f  (tiles + 1, 2, local, TILE)     own particles first, then images

A step has two parts, each parallel over tiles: a tile writes its own images and f; then its own f,
v and x. Its result does therefore not depend on the number of threads.
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
from surrofe2.tissue.pair_lists import (
    OF_BONDS,
    OF_CONTACTS,
    OF_FOLDS,
    OF_IMAGES,
    FluidConstants,
    bond_at,
    contact_at,
    fluid_at,
    sap_at,
)

_FLUID_MASS = FluidConstants._fields.index("fluid_mass")
_SOUND_SPEED_SQUARED = FluidConstants._fields.index("sound_speed_squared")
"""Rows of `PairConstants.fluid`."""


class Particles(NamedTuple):
    """All particles, the dead loads on them, and the work of these.

    Attributes:
        x, v, f: (tiles + 1, 2, local, TILE) positions, µm, velocities, µm/µs, and forces, µN.
        per_mass: (tiles, 2, own, TILE) 1/mass, 1/ng; 0 for missing particles, and for components
            that do not follow forces.
        loads: (loads, tiles, 2, own, TILE) forces of dead loads at amplitude 1, µN.
        work: (loads, tiles, TILE) work of these so far, pJ. Each step adds
            kick · force · mean of the velocities before and after.
    """

    x: Array
    v: Array
    f: Array
    per_mass: Array
    loads: Array
    work: Array


class Watch(NamedTuple):
    """Motion since lists were made, by which it is known when they must be made again.

    Attributes:
        listed: (tiles, 2, own, TILE) positions at that time, µm.
        mean: (tiles, 2, TILE) mean displacement ū of each plant cell since then, µm.
        spread: (tiles, TILE) largest |u − ū|² within it, µm².
        apart: (tiles, TILE) largest |ū_B − ū|² of its neighbours B, µm².
    """

    listed: Array
    mean: Array
    spread: Array
    apart: Array


@parallel_kernel
def leap(particles, lists, constants, cells, driven, bodies, outline, watch, steps, retained):
    """Make leapfrog steps in place, until lists could miss a pair; return how many were made.

    A step computes forces at x with the current velocities, then v += kick a, x += drift v. A step
    without a kick leaves all velocities as they are.

    Args:
        steps: (n, 2) kick and drift of each step, µs; (n, loads) amplitudes; (n, motions) mean rate
            of each prescribed amplitude in the step, 1/µs.
        retained: part of the velocity that a step leaves; 1, or less with drag.
    """
    lengths, amplitudes, speeds = steps
    tiles = particles.x.shape[0] - 1
    for n in range(len(lengths)):
        for k in numba.prange(tiles):
            _sum_forces(cells.order[k], particles, lists, constants, cells)
            _measure_apart(cells.order[k], cells, watch)
        # lists could miss a pair: the step begins anew with new lists, and with the forces of these
        if not _largest_motion(watch) <= cells.skin:
            return n
        kick = lengths[n, 0]
        amplitude = amplitudes[n]
        speed = speeds[n]
        # with the velocities before this step, also of what is driven
        add_normal_contact(particles, bodies)
        add_outline_forces(particles, outline, amplitude)
        if kick != 0.0:
            drive_particles(particles.v, driven, speed)
        if bodies.rubs:
            # friction needs all other forces, so they are folded before it
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
    """Set the images of tile t and the forces on its local particles, not folded yet."""
    own_particles = cells.particles
    begin = lists.starts[t]
    end = lists.starts[t + 1]
    first = begin[OF_IMAGES]
    last = end[OF_IMAGES]
    _gather_images(particles.x, t, own_particles, first, last, lists.source)
    _gather_images(particles.v, t, own_particles, first, last, lists.source)
    x = particles.x[t]
    v = particles.v[t]
    f = particles.f[t]
    for i in range(own_particles + last - first):
        store(0.0, f, 0, i)
        store(0.0, f, 1, i)
    for k in range(begin[OF_BONDS], end[OF_BONDS]):
        i = lists.bonds[k, 0]
        j = lists.bonds[k, 1]
        pair = pair_at(x, v, i, j)
        a = tension(wall(pair.length, bond_at(constants.bonds, k)), pair.rate) * pair.inverse
        add_pair(f, i, j, a * pair.rx, a * pair.ry)
    for k in range(begin[OF_CONTACTS], end[OF_CONTACTS]):
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
        # one row for all tiles if there is one type of plant cell
        row = min(np.int64(t), constants.fluid.shape[0] - 1)
        add_sph_forces(x, v, f, cells, fluid_at(constants.fluid, row), slope, volume)
        for k in range(cells.rim_start.shape[0] - 1):
            rim = lists.rim[t, cells.rim_start[k] : cells.rim_start[k + 1]]
            _add_sap_forces(x, v, f, rim, sap_at(constants.sap, t, k))


@kernel
def _sap_area(x, rim, sap):
    """Return the area within a rim, µm²; 1 where there is no plant cell, so that 1/A is finite."""
    return sap.is_there * rim_area(x, rim) + (1.0 - sap.is_there)


@kernel
def _add_sap_forces(x, v, f, rim, sap):
    """Add pressure and viscous forces S g_k of a uniform fluid to f (2, local, TILE).

    See `plant_cell.uniform_fluid`. rim: local wall particles around it. sap: its `Sap`.
    """
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
    """Copy x (tiles + 1, 2, local, TILE) of their owners to the images of tile t.

    start, end: entries of the tile in `source`. particles: number of own particles.
    """
    flat = x.reshape(-1)
    to_y = x.shape[2] * TILE  # from an x component to the y component in a flat array
    for k in range(start, end):
        local = particles + k - start
        for lane in range(TILE):
            owner = source[k, lane]
            x[t, 0, local, lane] = flat[owner]
            x[t, 1, local, lane] = flat[owner + to_y]


@kernel
def _fold(t, f, lists):
    """Add to the forces f of tile t's own particles those on their images."""
    flat = f.reshape(-1)
    to_y = f.shape[2] * TILE
    for k in range(lists.starts[t, OF_FOLDS], lists.starts[t + 1, OF_FOLDS]):
        i = lists.fold[k]
        for lane in range(TILE):
            image = lists.fold_source[k, lane]
            f[t, 0, i, lane] += flat[image]
            f[t, 1, i, lane] += flat[image + to_y]


@kernel
def _kick_and_drift(t, particles, lists, cells, watch, amplitude, step):
    """Set v ← retained v + kick a and x ← x + drift v of the own particles of tile t.

    It adds to the works of loads, and sets `watch.mean` and `watch.spread` of the tile.

    step: kick, drift, retained, and whether f is folded already.
    """
    x = particles.x
    v = particles.v
    f = particles.f
    loads = particles.loads
    kick, drift, retained, is_folded = step
    if not is_folded:
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
            work = load(particles.work, n, t) + 0.5 * kick * amplitude[n] * power
            store(work, particles.work, n, t)
        new_x = load(x, t, 0, i) + drift * speed_x
        new_y = load(x, t, 1, i) + drift * speed_y
        store(new_x, x, t, 0, i)
        store(new_y, x, t, 1, i)
        # particles that do not exist never move, so they add nothing
        mean_x += new_x - load(watch.listed, t, 0, i)
        mean_y += new_y - load(watch.listed, t, 1, i)
    per_count = load(cells.per_count, t)
    mean_x = mean_x * per_count
    mean_y = mean_y * per_count
    store(mean_x, watch.mean, t, 0)
    store(mean_y, watch.mean, t, 1)
    largest = spread(0.0)
    for i in range(cells.particles):
        dx = load(x, t, 0, i) - load(watch.listed, t, 0, i) - mean_x
        dy = load(x, t, 1, i) - load(watch.listed, t, 1, i) - mean_y
        # a position that is not finite spoils the mean, and so all squares: `_largest_motion` sees
        # it
        square = (dx * dx + dy * dy) * load(cells.exists, t, i)
        largest = where_less(square, largest, largest, square)
    store(largest, watch.spread, t)


@kernel
def _measure_apart(t, cells, watch):
    """Set watch.apart of tile t, by the mean displacements of neighbouring periods."""
    for lane in range(TILE):
        largest = 0.0
        for s in cells.next_shifts:
            neighbour = cells.place[t, s, lane]
            is_there = neighbour >= 0
            if is_there:
                tile = neighbour // TILE
                lane_of_neighbour = neighbour % TILE
                dx = watch.mean[tile, 0, lane_of_neighbour] - watch.mean[t, 0, lane]
                dy = watch.mean[tile, 1, lane_of_neighbour] - watch.mean[t, 1, lane]
                largest = max(largest, dx * dx + dy * dy)
        watch.apart[t, lane] = largest


@kernel
def _largest_motion(watch):
    """Return 2 d + |ū_B − ū_A|, a bound of the motion of one particle against another, µm.

    See the head of `pair_lists`. It is infinite where a position is not finite.
    """
    largest_spread = 0.0
    largest_apart = 0.0
    for t in range(watch.spread.shape[0]):
        for lane in range(TILE):
            if not watch.spread[t, lane] < np.inf:  # True for NaN, too
                return np.inf
            largest_spread = max(largest_spread, watch.spread[t, lane])
            largest_apart = max(largest_apart, watch.apart[t, lane])
    return 2.0 * np.sqrt(largest_spread) + np.sqrt(largest_apart)


@parallel_kernel
def elastic_energy(x, lists, constants, cells, energy):
    """Fill energy (tiles, TILE) with that of which forces at rest are the negative gradient, pJ.

    It is that of springs, ½ k (|r| − l₀)², of contacts, and of the fluid, Σ m c_s² ln ρ with SPH,
    else that of `plant_cell.uniform_fluid`.

    x: (tiles + 1, 2, local, TILE) positions, with images set, µm.
    """
    for t in numba.prange(energy.shape[0]):
        begin = lists.starts[t]
        end = lists.starts[t + 1]
        x_of_tile = x[t]
        total = spread(0.0)
        for k in range(begin[OF_BONDS], end[OF_BONDS]):
            rx, ry = difference(x_of_tile, lists.bonds[k, 0], lists.bonds[k, 1])
            length, _ = norm(rx, ry)
            total += wall_energy(length, bond_at(constants.bonds, k))
        for k in range(begin[OF_CONTACTS], end[OF_CONTACTS]):
            rx, ry = difference(x_of_tile, lists.contacts[k, 0], lists.contacts[k, 1])
            length, inverse = norm(rx, ry)
            total += contact_energy(length, inverse, contact_at(constants, k))
        store(total, energy, t)
        if t < cells.fluid_tiles:
            slope = np.empty((cells.fluid_pairs.shape[0], TILE))
            volume = np.empty((cells.particles - cells.walls, TILE))
            row = min(np.int64(t), constants.fluid.shape[0] - 1)
            fluid_specific_volume(x_of_tile, cells, fluid_at(constants.fluid, row), slope, volume)
            for p in range(volume.shape[0]):
                for lane in range(TILE):
                    mass = constants.fluid[row, _FLUID_MASS, lane]
                    weight = mass * constants.fluid[row, _SOUND_SPEED_SQUARED, lane]
                    # a particle that does not exist has a density, too, that of itself
                    weight *= cells.exists[t, cells.walls + p, lane]
                    energy[t, lane] -= weight * np.log(volume[p, lane])
            for k in range(cells.rim_start.shape[0] - 1):
                rim = lists.rim[t, cells.rim_start[k] : cells.rim_start[k + 1]]
                _add_sap_energy(x_of_tile, rim, sap_at(constants.sap, t, k), energy[t])


@kernel
def _add_sap_energy(x, rim, sap, energy):
    """Add the stored energy of a uniform fluid, pJ, to energy (TILE,)."""
    # lanes have no logarithm, so they are taken apart: rows as they are read below
    rows = np.empty((5, TILE))
    store(_sap_area(x, rim, sap), rows, 0)
    store(sap.fluid_mass, rows, 1)
    store(sap.fluid_mass * sap.sound_speed_squared, rows, 2)
    store(sap.sap_modulus, rows, 3)
    store(sap.rest_area, rows, 4)
    for lane in range(TILE):
        area = rows[0, lane]
        mass = rows[1, lane]
        osmotic = rows[2, lane]
        modulus = rows[3, lane]
        rest = rows[4, lane]
        energy[lane] += osmotic * np.log(mass / area)
        energy[lane] += modulus * (area - rest - rest * np.log(area / rest))
