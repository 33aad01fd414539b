"""Plant cells of several types in one tissue: the constants of each bond, contact and fluid.

A wall between two plant cells is made of half a wall of each, so its bonds have the sum of both
halves: mean stiffness k and damping, and the rest length Σ k l₀/Σ k at which both halves balance. A
wall particle has the mean repulsion and contact damping of the plant cells around it, and a contact
the mean of its two particles. Fluid has the constants of its plant cell. Every mean is over plant
cells that are there; at the tissue's boundary the pair's share halves it. FE² knows no such walls:
there each type begins where the other ends.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.compilation import kernel, pair_law
from surrofe2.base.simd import TILE, load, store
from surrofe2.plant_cell.forces import (
    add_fluid_forces,
    add_pair,
    central_energy,
    central_tension,
    difference,
    fluid_specific_volume,
    norm,
    pair_at,
)
from surrofe2.plant_cell.tiles import Constants
from surrofe2.tissue.layout import Tissue, shares
from surrofe2.tissue.pair_kinds import make_pair_kinds
from surrofe2.tissue.pair_lists import PairLists

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


class Mixture(NamedTuple):
    """Constants where they differ, lanes last.

    Attributes:
        bonds: (bonds of all tiles, 3, TILE) stiffness, rest length, damping.
        contacts: (tiles + 1, 2, local, TILE) repulsion and contact damping of local particles.
        fluid: (tiles, 4, TILE) smoothing length, fluid mass, sound speed squared, viscosity.
    """

    bonds: Array
    contacts: Array
    fluid: Array


class MixtureMaker:
    """Makes the `Mixture` of a tissue for any of its pair lists."""

    def __init__(self, tissue: Tissue) -> None:
        self._tissue = tissue
        # One more type, the last, for plant cells that are not there.
        table = np.array([*tissue.types, np.zeros(len(tissue.types[0]))])
        of = dict(zip(Constants._fields, table.T, strict=True))
        self._bonds = _bond_constants(tissue, of)
        here = np.pad(tissue.kind, 1, constant_values=-1)[tissue.column + 1, tissue.row + 1]
        here = np.maximum(here, 0)  # places without fluid have some, so that kernels may divide
        fluid = [of[name][here] for name in Constants._fields[-4:]]
        self._fluid = _tiled(np.stack(fluid, axis=1))
        share = [
            shares(tissue.cell, tissue.kind == k, tissue.column, tissue.row)
            for k in range(len(tissue.types))
        ]
        whole = np.maximum(sum(share), 1e-3)
        means = [
            sum(part * one / whole for part, one in zip(share, of[name][:-1], strict=True))
            for name in ("repulsion", "contact_damping")
        ]
        self._contacts = _tiled(np.stack(means, axis=1))

    def make(self, lists: PairLists) -> Mixture:
        """For lists just made."""
        tissue, own = self._tissue, self._tissue.own
        contacts = np.zeros((tissue.tiles + 1, 2, lists.local, TILE))
        contacts[:-1, :, :own] = self._contacts
        images = lists.starts[:, 0]
        tile = np.repeat(np.arange(tissue.tiles), np.diff(images))
        local = own + np.arange(len(tile)) - images[tile]
        flat = contacts.reshape(-1)
        for k in (0, 1):
            contacts[tile, k, local] = flat[lists.source + k * lists.local * TILE]
        return Mixture(self._bonds, contacts, self._fluid)


def _bond_constants(tissue: Tissue, of: dict[str, Array]) -> Array:
    """(bonds of all tiles, 3, TILE), tile by tile, as all bonds are always listed."""
    kinds = make_pair_kinds(tissue.cell)
    kind = np.pad(tissue.kind, 1, constant_values=-1)
    first = kind[tissue.column + 1, tissue.row + 1]
    below, left = kind[tissue.column + 1, tissue.row], kind[tissue.column, tissue.row + 1]
    found = []
    for second in (below, left):  # walls along x, then along y
        both = np.stack([first, second])
        count = np.maximum((both >= 0).sum(axis=0), 1)
        stiffness = of["wall_stiffness"][both]
        rest = (stiffness * of["rest_length"][both]).sum(axis=0)
        total = stiffness.sum(axis=0)
        rest /= np.where(total > 0.0, total, 1.0)
        damping = of["wall_damping"][both].sum(axis=0) / count
        found.append(np.stack([total / count, rest, damping], axis=1))
    each = np.stack([found[axis] for axis in kinds.axis[: kinds.bonds]], axis=1)
    return _tiled(each).reshape(-1, 3, TILE)


def _tiled(values: NDArray) -> NDArray:
    """(places, …) → (tiles, …, TILE)."""
    return np.ascontiguousarray(np.moveaxis(values.reshape(-1, TILE, *values.shape[1:]), 1, -1))


@pair_law
def bond_constants(bonds, k, c):
    """Those of bond k; c: factors."""
    return Constants(
        load(bonds, k, 0) * c.wall_stiffness,
        load(bonds, k, 1),
        load(bonds, k, 2) * c.wall_damping,
        c.repulsion,
        c.cutoff,
        c.contact_damping,
        c.smoothing_length,
        c.fluid_mass,
        c.sound_speed_squared,
        c.viscosity,
    )


@pair_law
def contact_constants(contacts, i, j, c):
    """Those of a contact of particles i and j; c: factors."""
    return Constants(
        c.wall_stiffness,
        c.rest_length,
        c.wall_damping,
        0.5 * c.repulsion * (load(contacts, 0, i) + load(contacts, 0, j)),
        c.cutoff,
        0.5 * c.contact_damping * (load(contacts, 1, i) + load(contacts, 1, j)),
        c.smoothing_length,
        c.fluid_mass,
        c.sound_speed_squared,
        c.viscosity,
    )


@pair_law
def fluid_constants(fluid, t, c):
    """Those of the fluid in tile t; c: factors."""
    return Constants(
        c.wall_stiffness,
        c.rest_length,
        c.wall_damping,
        c.repulsion,
        c.cutoff,
        c.contact_damping,
        load(fluid, t, 0),
        load(fluid, t, 1),
        load(fluid, t, 2) * c.sound_speed_squared,
        load(fluid, t, 3) * c.viscosity,
    )


@kernel
def add_mixed_pairs(t, x, v, f, lists, mixture, c):
    """Add wall tensions and contacts of tile t to f (2, local, TILE)."""
    here, end = lists.starts[t], lists.starts[t + 1]
    for k in range(here[1], end[1]):
        i, j = lists.bonds[k, 0], lists.bonds[k, 1]
        pair = pair_at(x, v, i, j)
        own = bond_constants(mixture.bonds, k, c)
        a = load(lists.bond_share, k) * central_tension(pair, True, own) * pair.inverse
        add_pair(f, i, j, a * pair.rx, a * pair.ry)
    contacts = mixture.contacts[t]
    for k in range(here[2], end[2]):
        i, j = lists.lines[k, 0], lists.lines[k, 1]
        pair = pair_at(x, v, i, j)
        own = contact_constants(contacts, i, j, c)
        a = load(lists.line_share, k) * central_tension(pair, False, own) * pair.inverse
        add_pair(f, i, j, a * pair.rx, a * pair.ry)
    for k in range(here[3], end[3]):
        i, j = lists.contacts[k, 0], lists.contacts[k, 1]
        pair = pair_at(x, v, i, j)
        own = contact_constants(contacts, i, j, c)
        a = central_tension(pair, False, own) * pair.inverse
        add_pair(f, i, j, a * pair.rx, a * pair.ry)


@kernel
def add_mixed_fluid(t, x, v, f, fluid, mixture, c):
    """Add pressure and viscous forces of tile t to f (2, local, TILE)."""
    slope = np.empty((fluid.fluid_pairs.shape[0], TILE))
    volume = np.empty((fluid.particles - fluid.walls, TILE))
    add_fluid_forces(x, v, f, fluid, fluid_constants(mixture.fluid, t, c), slope, volume)


@kernel
def add_mixed_energy(t, x, lists, mixture, c, energy):
    """Add the stored energy of bonds and contacts of tile t, pJ, to energy (1, TILE)."""
    here, end = lists.starts[t], lists.starts[t + 1]
    total = load(energy, 0)
    for k in range(here[1], end[1]):
        rx, ry = difference(x, lists.bonds[k, 0], lists.bonds[k, 1])
        length, inverse = norm(rx, ry)
        own = bond_constants(mixture.bonds, k, c)
        total += load(lists.bond_share, k) * central_energy(length, inverse, True, own)
    contacts = mixture.contacts[t]
    for k in range(here[2], end[2]):
        rx, ry = difference(x, lists.lines[k, 0], lists.lines[k, 1])
        length, inverse = norm(rx, ry)
        own = contact_constants(contacts, lists.lines[k, 0], lists.lines[k, 1], c)
        total += load(lists.line_share, k) * central_energy(length, inverse, False, own)
    for k in range(here[3], end[3]):
        rx, ry = difference(x, lists.contacts[k, 0], lists.contacts[k, 1])
        length, inverse = norm(rx, ry)
        own = contact_constants(contacts, lists.contacts[k, 0], lists.contacts[k, 1], c)
        total += central_energy(length, inverse, False, own)
    store(total, energy, 0)


@kernel
def add_mixed_fluid_energy(t, x, fluid, exists, mixture, c, energy):
    """Add Σ m c_s² ln ρ of tile t, pJ; exists (own, TILE): 0 where there is no particle."""
    slope = np.empty((fluid.fluid_pairs.shape[0], TILE))
    volume = np.empty((fluid.particles - fluid.walls, TILE))
    own = fluid_constants(mixture.fluid, t, c)
    fluid_specific_volume(x, fluid, own, slope, volume)
    for p in range(volume.shape[0]):
        for lane in range(TILE):
            square = mixture.fluid[t, 2, lane] * c.sound_speed_squared
            weight = exists[fluid.walls + p, lane] * mixture.fluid[t, 1, lane] * square
            energy[0, lane] -= weight * np.log(volume[p, lane])
