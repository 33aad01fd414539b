"""From listed pair kinds to the flat arrays that kernels walk through."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.simd import TILE
from surrofe2.tissue.layout import Tissue
from surrofe2.tissue.pair_kinds import PairKinds

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


class Grid(NamedTuple):
    """Neighbouring places.

    Attributes:
        place: (tiles, shifts, TILE) place of the cell at each of `PairKinds.shifts`, or −1.
        wrap: (tiles, shifts, 2, TILE) how often a periodic patch is left on the way there.
        exists: (tiles, own, TILE) 1.0 where there is a particle, else 0.
        per_count: (tiles, TILE) 1/(number of own particles), or 0.
        next_shifts: the shifts to the next column or row.
    """

    place: Ints
    wrap: Array
    exists: Array
    per_count: Array
    next_shifts: Ints


class Lists(NamedTuple):
    """Pairs of all tiles one after another; those of tile t are [starts[t, k], starts[t + 1, k]).

    Attributes:
        starts: (tiles + 1, 5) of images, bonds, lines, contacts, folds.
        source: (images, TILE) flat index of the owner in (tiles + 1, 2, local, TILE).
        wrap: (images, 2, TILE) periods between owner and image.
        bonds, lines, contacts: (·, 2) local particles.
        bond_share, line_share: (·, TILE) 1, ½ at the boundary, 0 where there is no pair.
        fold: (folds,) own particle; fold_source: (folds, TILE) flat index of the image force.
        order: (tiles,) in which to go through them: dear and cheap ones evenly mixed, so that
            equal parts of it cost threads the same.
        local: local particles of a tile, at most.
        fluid_tiles: how many tiles, the first ones, have fluid.
        skin: how far particles of neighbouring cells may move against one another, µm.
    """

    starts: Ints
    source: Ints
    wrap: Array
    bonds: NDArray[np.int32]
    lines: NDArray[np.int32]
    contacts: NDArray[np.int32]
    bond_share: Array
    line_share: Array
    fold: Ints
    fold_source: Ints
    order: Ints
    local: int
    fluid_tiles: int
    skin: float


@dataclass(frozen=True, slots=True)
class _TileLists:
    """Lists of one tile, before it is known where other tiles keep their particles."""

    image_kind: Ints  # (images, 2): own particle of the other cell, shift
    pairs: NDArray[np.int32]
    share: Array
    bonds: int
    lines: int


def assemble(
    tissue: Tissue,
    kinds: PairKinds,
    grid: Grid,
    share: Array,
    close: NDArray[np.bool_],
    skin: float,
) -> Lists:
    """Lists of the kinds that `close` (tiles, kinds) marks, in their order."""
    tiles = [_tile_lists(tissue.own, kinds, share[t], close[t]) for t in range(tissue.tiles)]
    local = tissue.own + max(len(tile.image_kind) for tile in tiles)
    source, wrap, owner = _image_sources(tissue, grid, tiles, local)
    image_starts = _starts([len(tile.image_kind) for tile in tiles])
    fold, fold_source, fold_starts = _folds(tissue, owner, image_starts, local)
    counts = [(tile.bonds, tile.lines, len(tile.pairs) - tile.bonds - tile.lines) for tile in tiles]
    starts = [image_starts, *(_starts([c[k] for c in counts]) for k in range(3)), fold_starts]
    bonds = [tile.pairs[: tile.bonds] for tile in tiles]
    lines = [tile.pairs[tile.bonds : tile.bonds + tile.lines] for tile in tiles]
    contacts = [tile.pairs[tile.bonds + tile.lines :] for tile in tiles]
    return Lists(
        starts=np.ascontiguousarray(np.stack(starts, axis=1)),
        source=source,
        wrap=wrap,
        bonds=np.concatenate(bonds),
        lines=np.concatenate(lines),
        contacts=np.concatenate(contacts),
        bond_share=np.concatenate([tile.share[: tile.bonds] for tile in tiles]),
        line_share=np.concatenate([tile.share[tile.bonds :] for tile in tiles]),
        fold=fold,
        fold_source=fold_source,
        order=_mixed(tissue.fluid_tiles, tissue.tiles),
        local=local,
        fluid_tiles=tissue.fluid_tiles,
        skin=skin,
    )


def _starts(counts: list[int]) -> Ints:
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


def _mixed(dear: int, tiles: int) -> Ints:
    """The numbers below `dear` and those from there to `tiles`, evenly mixed."""
    cheap = tiles - dear
    spots = [(np.arange(n) + 0.5) / max(n, 1) for n in (dear, cheap)]
    return np.argsort(np.concatenate(spots), kind="stable")


def _tile_lists(own: int, kinds: PairKinds, share: Array, close: NDArray[np.bool_]) -> _TileLists:
    listed = np.flatnonzero(close)
    on_lines = listed[listed < kinds.bonds + kinds.lines]
    j, shift = kinds.j[listed], kinds.shift[listed]
    elsewhere = shift > 0
    image_kind, number = np.unique(
        np.stack([shift, j], axis=1)[elsewhere], axis=0, return_inverse=True
    )
    local_j = j.copy()
    local_j[elsewhere] = own + number.reshape(-1)
    bonds = int((listed < kinds.bonds).sum())
    return _TileLists(
        image_kind=image_kind[:, ::-1],
        pairs=np.stack([kinds.i[listed], local_j], axis=1).astype(np.int32),
        share=share[on_lines],
        bonds=bonds,
        lines=len(on_lines) - bonds,
    )


def _image_sources(
    tissue: Tissue, grid: Grid, tiles: list[_TileLists], local: int
) -> tuple[Ints, Array, Ints]:
    """source and wrap of `Lists`, and (images, TILE) flat own index of the owner, or −1."""
    kind = np.concatenate([tile.image_kind for tile in tiles])
    tile = np.repeat(np.arange(tissue.tiles), [len(t.image_kind) for t in tiles])
    particle, shift = kind.T
    place = grid.place[tile, shift]
    there, lane = np.divmod(place, TILE)
    nowhere = tissue.tiles * 2 * local * TILE
    source = (there * 2 * local + particle[:, None]) * TILE + lane
    owner = (there * tissue.own + particle[:, None]) * TILE + lane
    owner[place < 0] = -1
    missing = (place < 0) | ~tissue.exists.reshape(-1)[owner]
    return (
        np.where(place < 0, nowhere, source),
        np.ascontiguousarray(grid.wrap[tile, shift]),
        np.where(missing, -1, owner),
    )


def _folds(tissue: Tissue, owner: Ints, image_starts: Ints, local: int) -> tuple[Ints, Ints, Ints]:
    """fold and fold_source of `Lists`, and where each tile's folds start.

    Row r of an own particle holds, lane by lane, the r-th image of it that exists; lanes with
    fewer images read a force that is always zero.
    """
    image, lane = np.nonzero(owner >= 0)
    tile = np.searchsorted(image_starts, image, side="right") - 1
    number = tissue.own + image - image_starts[tile]
    source = (tile * 2 * local + number) * TILE + lane
    key = owner[image, lane]
    order = np.argsort(key, kind="stable")
    key, source = key[order], source[order]
    first = np.searchsorted(key, key, side="left")
    rank = np.arange(len(key)) - first
    particle, at_lane = np.divmod(key, TILE)
    rows, row = np.unique(np.stack([particle, rank], axis=1), axis=0, return_inverse=True)
    fold_source = np.full((len(rows), TILE), tissue.tiles * 2 * local * TILE)
    fold_source[row.reshape(-1), at_lane] = source
    own_tile, fold = np.divmod(rows[:, 0], tissue.own)
    return fold, fold_source, np.searchsorted(own_tile, np.arange(tissue.tiles + 1))
