"""Walls along the outlines of a labelled image, divided into springs.

Pixels are cells (positive numbers), or air (0): air spaces and the outside of the tissue. Sides of
pixels between two regions form walls from corner to corner, where three regions or more meet.
Walls are smoothed between their corners, so that steps of pixels vanish, and divided evenly into
springs of about one length. Air has a polygon, too, along each of its borders, so that a wall
always lies between two polygons.

Plant cells that the border of the image cuts are closed by a wall along it. Regions too small for
springs of that length are given to the nearest others, regions within a single plant cell to that
cell. Corners that are very near one another become one, at which four or more cells may meet.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy  # scipy.ndimage is loaded where an image is outlined
from numpy.typing import NDArray

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.errors import InputError
from surrofe2.plant_cell.arrangement import Arrangement
from surrofe2.plant_cell.tessellation import Tessellation, polygon_area

SMALLEST = 4.0
"""Area of the smallest region, in squares of a spring's length."""
_NEAR = 0.3
"""Part of a spring's length up to which two corners of walls become one."""
_SMOOTHINGS = 8
"""Number of times that each inner point of a wall moves half of the way to the middle of its
neighbours."""
_DISSOLVINGS = 5
"""Rounds in which small pieces are dissolved: what they are merged with may be too small, too."""
_FEWEST = 3
"""Fewest springs of a wall that ends where it begins, and fewest walls around a plant cell."""

_APART = 0.85
"""Least distance of particles that no spring joins, in lengths of a spring: nearer ones would repel
each other so much that the first relaxation diverges."""
_SPREADINGS = 200
"""Most rounds in which particles are moved apart, each time by half of what is lacking."""
_TINY = 1e-3
"""Smallest distance by which is divided, in least distances: particles may coincide."""

Point = tuple[int, int]
"""A corner of pixels: x and y in pixels."""
Path = list[Point]


@dataclass(frozen=True, slots=True)
class Outlined:
    """Walls along the outlines of an image.

    Attributes:
        arrangement: a single period of it is the whole tissue, from the image's lower left corner.
        is_cell: (polygons,) whether a polygon is a plant cell; others are air.
        dissolved: regions too small for the springs, which were given to the nearest others.
        enclosed: regions within a single plant cell, which were given to it.
    """

    arrangement: Arrangement
    is_cell: Flags
    dissolved: int
    enclosed: int


def outline_cells(labels: NDArray[np.int64], pixel: float, length: float) -> Outlined:
    """Lay out walls along the outlines of plant cells.

    Args:
        labels: (rows, columns), the first row at the top; cells from 1 on, each in one piece, and
            0 where there is air.
        pixel: side of a pixel, µm.
        length: length of a spring, µm.

    Raises:
        InputError: a plant cell has several others within it, or none is left.
    """
    # turned over, so that rows count upwards, as y does
    regions, dissolved = _without_small(labels[::-1], SMALLEST * (length / pixel) ** 2)
    # within a frame of air, one pixel wide, so that walls close at the border of the image
    regions, enclosed = _without_enclosed(_pieces(np.pad(regions, 1)))
    if not (regions > 0).any():
        raise InputError(
            f"image: no cell is larger than {SMALLEST:g} squares of a spring's length, "
            f"{length:.3g} µm; check image.pixel and the size of the plant cell"
        )
    paths = _paths(regions)
    loops = [*_loops(regions, paths)]
    _check_whole(loops, paths, pixel)
    lines = _lines(paths, labels.shape, length / pixel)
    arrangement = _arrange(lines, loops, labels.shape, pixel, length)
    is_cell = np.array([region > 0 for region, _ in loops])
    return Outlined(arrangement, is_cell, dissolved, enclosed)


def _without_small(labels: NDArray[np.int64], least: float) -> tuple[NDArray[np.int64], int]:
    """Merge pieces of cells or air with fewer pixels than `least` with their surroundings.

    Each of their pixels gets the label of the nearest pixel of a larger piece.

    Returns:
        The labels, and how many pieces were dissolved.
    """
    dissolved = 0
    for _ in range(_DISSOLVINGS):
        _, piece, pixels = np.unique(_pieces(labels), return_inverse=True, return_counts=True)
        is_small = pixels < least
        dissolved += int(is_small.sum())
        small = is_small[piece].reshape(labels.shape)
        if small.all():
            # there is no larger piece whose label they could take
            return np.zeros_like(labels), dissolved
        if not small.any():
            break
        nearest = scipy.ndimage.distance_transform_edt(
            small, return_distances=False, return_indices=True
        )
        labels = labels[tuple(nearest)]
    return labels, dissolved


def _pieces(labels: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number the pieces of pixels that share sides and a label: cells 1, 2, …, air −1, −2, …."""
    number = np.arange(labels.size).reshape(labels.shape)
    pairs = []
    for first, second in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        same = labels[first] == labels[second]
        pairs.append(np.stack([number[first][same], number[second][same]]))
    i, j = np.concatenate(pairs, axis=1)
    graph = scipy.sparse.coo_array((np.ones(len(i)), (i, j)), shape=(labels.size, labels.size))
    _, piece = scipy.sparse.csgraph.connected_components(graph, directed=False)
    pieces = piece.reshape(labels.shape).astype(np.int64) + 1
    return np.where(labels > 0, pieces, -pieces)


def _without_enclosed(regions: NDArray[np.int64]) -> tuple[NDArray[np.int64], int]:
    """Merge regions whose only neighbour is a cell with that cell; also return how many."""
    beside: dict[int, set[int]] = {}
    for first, second in ((regions[:, :-1], regions[:, 1:]), (regions[:-1], regions[1:])):
        differ = first != second
        pairs = np.unique(np.stack([first[differ], second[differ]], axis=1), axis=0)
        for a, b in pairs.tolist():
            beside.setdefault(a, set()).add(b)
            beside.setdefault(b, set()).add(a)
    outside = int(regions[0, 0])
    enclosed = 0
    for region, others in beside.items():
        if region != outside and len(others) == 1 and max(others) > 0:
            regions[regions == region] = max(others)
            enclosed += 1
    return regions, enclosed


def _paths(regions: NDArray[np.int64]) -> list[Path]:
    """Return walls as corners of pixels, each from where three or more regions meet to the next.

    Corners of the image are ends of walls, too. A wall around an island ends where it begins.
    """
    beside = _neighbours_along_walls(regions)
    rows, columns = regions.shape
    # of the image itself, within its frame of one pixel
    corners = {(x, y) for x in (1, columns - 1) for y in (1, rows - 1)}
    ends = {point for point, others in beside.items() if len(others) > 2 or point in corners}
    paths: list[Path] = []
    walked: set[tuple[Point, Point]] = set()
    # islands have no ends: they begin at any of their points, after all other walls
    for begin in [*sorted(ends), *sorted(beside.keys() - ends)]:
        is_on_a_path = begin not in ends and any(
            (begin, other) in walked for other in beside[begin]
        )
        if is_on_a_path:
            continue
        for following in beside[begin]:
            if (begin, following) in walked:
                continue
            path = [begin, following]
            while path[-1] not in ends and path[-1] != begin:
                # a point that is no end has two neighbours; the path came from one of them
                one, other = beside[path[-1]]
                path.append(other if one == path[-2] else one)
            for a, b in pairwise(path):
                walked |= {(a, b), (b, a)}
            paths.append(path)
    return paths


def _neighbours_along_walls(regions: NDArray[np.int64]) -> dict[Point, list[Point]]:
    """Return, for each corner of pixels on a wall, those one side of a pixel further along walls.

    regions: (rows, columns); a wall lies wherever two neighbouring pixels differ.
    """
    y, x = np.nonzero(regions[1:] != regions[:-1])
    level = np.stack([x, y + 1, x + 1, y + 1], axis=1)
    y, x = np.nonzero(regions[:, 1:] != regions[:, :-1])
    upright = np.stack([x + 1, y, x + 1, y + 1], axis=1)
    beside: dict[Point, list[Point]] = {}
    for ax, ay, bx, by in np.concatenate([level, upright]).tolist():
        beside.setdefault((ax, ay), []).append((bx, by))
        beside.setdefault((bx, by), []).append((ax, ay))
    return beside


def _left_of(regions: NDArray[np.int64], begin: Point, end: Point) -> int:
    """Return the region on the left of a step from a corner of pixels to the next.

    Pixel (row, column) has its lower left corner at x = column, y = row.
    """
    ax, ay = begin
    bx, by = end
    if ay == by:
        goes_right = bx > ax
        row = ay if goes_right else ay - 1
        return int(regions[row, min(ax, bx)])
    goes_up = by > ay
    column = ax - 1 if goes_up else ax
    return int(regions[min(ay, by), column])


Directed = tuple[int, bool]
"""The number of a wall, and whether it is walked backwards."""


def _directed(paths: list[Path], wall: Directed) -> Path:
    """Return the points of a wall in the direction in which it is walked."""
    number, is_back = wall
    return paths[number][::-1] if is_back else paths[number]


def _loops(regions: NDArray[np.int64], paths: list[Path]) -> Iterator[tuple[int, list[Directed]]]:
    """Yield each region, cells first, with each closed way around it that has it on its left."""
    # walls by the region on their left and the point at which they begin
    leaving: dict[tuple[int, Point], list[Directed]] = {}
    for number in range(len(paths)):
        for wall in ((number, False), (number, True)):
            path = _directed(paths, wall)
            region = _left_of(regions, path[0], path[1])
            leaving.setdefault((region, path[0]), []).append(wall)

    def cells_first(key: tuple[int, Point]) -> tuple[bool, int, Point]:
        """Order cells by their numbers, then air."""
        region, begin = key
        return region < 0, abs(region), begin

    for region, begin in sorted(leaving, key=cells_first):
        while leaving[region, begin]:
            wall = leaving[region, begin].pop()
            loop = [wall]
            path = _directed(paths, wall)
            while path[-1] != begin:
                candidates = leaving[region, path[-1]]
                # where a region meets itself, the way around the same pixel turns left
                turns = [_turn(path, _directed(paths, wall)) for wall in candidates]
                wall = candidates.pop(turns.index(max(turns)))
                loop.append(wall)
                path = _directed(paths, wall)
            yield region, loop


def _turn(path: Path, following: Path) -> int:
    """Return 1 where the second of two walls turns to the left of the first, −1 to the right."""
    ax, ay = path[-2]
    bx, by = path[-1]
    cx, cy = following[1]
    return (bx - ax) * (cy - by) - (by - ay) * (cx - bx)


def _check_whole(loops: list[tuple[int, list[Directed]]], paths: list[Path], pixel: float) -> None:
    """Raise InputError for a plant cell that has other regions within it."""
    for region, loop in loops:
        points: Path = []
        for wall in loop:
            points += _directed(paths, wall)[:-1]
        polygon = np.array(points, dtype=float)
        # a way with the region on its left runs clockwise only if it is around something within
        if region > 0 and polygon_area(polygon) < 0.0:
            x, y = pixel * (polygon.mean(axis=0) - 1.0)
            raise InputError(
                f"image: the cells about ({x:.4g}, {y:.4g}) µm lie within another cell; merge them "
                "with it, or label it as 0 if it is an air space"
            )


@dataclass(frozen=True, slots=True)
class Line:
    """A wall: the corners at its ends, and points (n, 2) along it, pixels.

    A wall has no points if it vanished, as its corners became one.
    """

    begin: Point
    end: Point
    points: Array


def _lines(paths: list[Path], shape: tuple[int, ...], near: float) -> list[Line]:
    """Smooth walls, and merge corners that are joined by a wall shorter than `_NEAR` springs.

    Args:
        shape: (rows, columns) of the image.
        near: length of a spring in pixels.
    """
    smooth = [_smoothed(np.array(path, dtype=np.float64)) for path in paths]
    # each corner points to one that it is merged with; at the end of that way is the one that stays
    merged: dict[Point, Point] = {}
    for path in paths:
        for point in (path[0], path[-1]):
            merged[point] = point

    def root(point: Point) -> Point:
        """Return the corner that stays of those that a corner is merged with."""
        while merged[point] != point:
            point = merged[point]
        return point

    is_short = []
    for path, line in zip(paths, smooth, strict=True):
        is_short.append(length_of(line) < _NEAR * near and path[0] != path[-1])
    for path, short in zip(paths, is_short, strict=True):
        if short:
            merged[root(path[0])] = root(path[-1])
    members: dict[Point, list[Point]] = {}
    for point in merged:
        members.setdefault(root(point), []).append(point)
    rows, columns = shape
    place: dict[Point, Array] = {}
    for corner, points in members.items():
        position = np.array(points, dtype=np.float64)
        # 2 at a corner of the image, 1 on its border, else 0: a merged corner takes the mean of
        # those that rank highest, so that it stays in the corner or on the border
        rank = np.sum((position == 1.0) | (position == [columns + 1.0, rows + 1.0]), axis=1)
        place[corner] = position[rank == rank.max()].mean(axis=0)
    lines = []
    for path, line, short in zip(paths, smooth, is_short, strict=True):
        begin = root(path[0])
        end = root(path[-1])
        # points in between follow both ends, in proportion to their number along the wall
        along = np.linspace(0.0, 1.0, len(line))[:, None]
        moved = line + (1.0 - along) * (place[begin] - line[0]) + along * (place[end] - line[-1])
        is_gone = short and begin == end
        lines.append(Line(begin, end, moved[:0] if is_gone else moved))
    return lines


def length_of(line: Array) -> float:
    """Return the length of a line (n, 2)."""
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def _smoothed(path: Array) -> Array:
    """Return a path (n, 2) without the steps of pixels; its ends stay where they are."""
    line = path.copy()
    for _ in range(_SMOOTHINGS):
        line[1:-1] = 0.25 * line[:-2] + 0.5 * line[1:-1] + 0.25 * line[2:]
    return line


def _arrange(
    lines: list[Line],
    loops: list[tuple[int, list[Directed]]],
    shape: tuple[int, ...],
    pixel: float,
    length: float,
) -> Arrangement:
    """Divide lines into springs and gather the particles around each polygon.

    Args:
        lines: walls as smooth lines, pixels.
        loops: each region with a closed way around it.
        shape: (rows, columns) of the image.
        pixel: side of a pixel, µm.
        length: length of a spring, µm.
    """
    # particles: corners first, then those along walls; pixels
    places: list[Array] = []
    corners: dict[Point, int] = {}
    for line in lines:
        if not len(line.points):
            continue
        for point, place in ((line.begin, line.points[0]), (line.end, line.points[-1])):
            if point not in corners:
                corners[point] = len(places)
                places.append(place)
    no_wall = -1
    wall_of = [no_wall] * len(places)
    bonds: list[tuple[int, int]] = []
    wall_of_bond: list[int] = []
    chains: list[list[int]] = []  # particles along each wall, from end to end
    for number, line in enumerate(lines):
        if not len(line.points):
            chains.append([])
            continue
        begin = corners[line.begin]
        end = corners[line.end]
        springs = max(1, round(pixel * length_of(line.points) / length))
        if begin == end:
            springs = max(_FEWEST, springs)
        elif springs == 1 and (min(begin, end), max(begin, end)) in bonds:
            springs = 2  # another wall joins the same corners, and two bonds must not be the same
        inner = range(len(places), len(places) + springs - 1)
        places += [*_divided(line.points, springs)]
        wall_of += [number] * len(inner)
        chain = [begin, *inner, end]
        bonds += [(min(i, j), max(i, j)) for i, j in pairwise(chain)]
        wall_of_bond += [number] * springs
        # a corner is counted to the last of its walls
        for i in (begin, end):
            wall_of[i] = max(wall_of[i], number)
        chains.append(chain)
    # the image begins one pixel within its frame of air
    position = pixel * (np.array(places) - 1.0)
    position = _spread(position, np.array(bonds), pixel * np.array(shape[::-1]), length)
    rims = [_rim_of(region, loop, chains, position, length) for region, loop in loops]
    no_shift = (0, 0)
    tessellation = Tessellation(
        # only one period is used, so the lattice may be any that keeps images away
        lattice=2.0 * pixel * np.diag(shape[::-1]).astype(np.float64),
        vertices=position,
        polygons=tuple(tuple((i, no_shift) for i in rim) for rim in rims),
        edges=tuple((i, j, no_shift) for i, j in bonds),
    )
    return Arrangement(
        tessellation=tessellation,
        wall_position=position,
        bonds=np.array([(i, j, *no_shift) for i, j in bonds], dtype=np.int32),
        rims=tuple(np.array([(i, *no_shift) for i in rim], dtype=np.int32) for rim in rims),
        fluid_counts=(),
        wall_edge=np.array(wall_of, dtype=np.int32),
        outer=np.zeros(len(places), dtype=np.int32),
        wall_of_bond=np.array(wall_of_bond, dtype=np.int32),
    )


def _rim_of(
    region: int, loop: list[Directed], chains: list[list[int]], position: Array, length: float
) -> list[int]:
    """Return the particles around a region, along one of its loops.

    Args:
        chains: particles along each wall.
        position: (n, 2) positions of the particles, µm.
        length: length of a spring, µm.

    Raises:
        InputError: a plant cell is too narrow for the springs.
    """
    rim: list[int] = []
    for number, is_back in loop:
        chain = chains[number]
        if is_back:
            chain = chain[::-1]
        rim += chain[:-1]  # the last one is the first of the next wall
    is_cell = region > 0
    if is_cell and (len(rim) < _FEWEST or polygon_area(position[rim]) <= 0.0):
        x, y = position[rim].mean(axis=0)
        raise InputError(
            f"image: the cell about ({x:.4g}, {y:.4g}) µm is too narrow for springs of "
            f"{length:.3g} µm; merge it with another one"
        )
    return rim


def _spread(position: Array, bonds: Index, size: Array, length: float) -> Array:
    """Move particles that no spring joins apart, until none are nearer than `_APART` springs.

    In sharp corners walls would repel each other more than they bear. Particles on the border of
    the image stay there.

    Args:
        position: (n, 2) µm; it is not changed.
        bonds: (b, 2) pairs that springs join, the smaller number first.
        size: (2,) width and height of the image, µm.
        length: length of a spring, µm.
    """
    least = _APART * length
    stays = ((position == 0.0) | (position == size)).any(axis=1)
    joined = set(map(tuple, bonds.tolist()))
    position = position.copy()
    for _ in range(_SPREADINGS):
        pairs = scipy.spatial.cKDTree(position).query_pairs(least)
        # sorted, as a set has no order and sums of moves round differently in another one
        near = np.array([pair for pair in sorted(pairs) if pair not in joined], dtype=np.int64)
        near = near.reshape(-1, 2)
        near = near[~stays[near].all(axis=1)]
        if not len(near):
            break
        first, second = near.T
        apart = position[second] - position[first]
        distance = np.linalg.norm(apart, axis=1)
        lacking = (least - distance) / np.maximum(distance, _TINY * least)
        # half of what is lacking is shared by the particles of a pair that may move
        moves = (~stays[near]).astype(np.float64)
        moves *= (0.5 * lacking / moves.sum(axis=1))[:, None]
        np.add.at(position, first, -moves[:, :1] * apart)
        np.add.at(position, second, moves[:, 1:] * apart)
    return position


def _divided(line: Array, parts: int) -> Array:
    """Return the points (parts − 1, 2) that divide a line (n, 2) into parts of equal length."""
    lengths = np.linalg.norm(np.diff(line, axis=0), axis=1)
    along = np.append(0.0, np.cumsum(lengths))
    places = along[-1] * np.arange(1, parts) / parts
    x, y = line.T
    return np.stack([np.interp(places, along, x), np.interp(places, along, y)], axis=1)
