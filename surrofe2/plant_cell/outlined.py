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
"""How often each inner point of a wall moves half of the way to the middle of its neighbours."""
_DISSOLVINGS = 5
"""How often small pieces are dissolved, as what they are given to may be in pieces, too."""
_FEWEST = 3
"""Springs of a wall that ends where it begins."""

_APART = 0.85
"""Distance of particles of two walls, of a spring's length: nearer ones repel each other so much
that the first relaxation bursts."""
_SPREADINGS = 200
"""How often particles are moved apart at most, each time by half of what is lacking."""
_TINY = 1e-3
"""Smallest distance by which is divided, of the one wanted: particles may coincide."""

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
    regions, dissolved = _without_small(labels[::-1], SMALLEST * (length / pixel) ** 2)
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
    """Labels without pieces, of cells or air, of fewer pixels than `least`, and how many these are.

    Their pixels belong to the nearest of the others.
    """
    dissolved = 0
    for _ in range(_DISSOLVINGS):
        _, inverse, count = np.unique(_pieces(labels), return_inverse=True, return_counts=True)
        small = (count < least)[inverse].reshape(labels.shape)
        dissolved += int((count < least).sum())
        if small.all():
            return np.zeros_like(labels), dissolved
        if not small.any():
            break
        nearest = scipy.ndimage.distance_transform_edt(
            small, return_distances=False, return_indices=True
        )
        labels = labels[tuple(nearest)]
    return labels, dissolved


def _pieces(labels: NDArray[np.int64]) -> NDArray[np.int64]:
    """Numbers of pieces whose pixels share sides and a label: from 1 of cells, from −1 of air."""
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
    """Regions without those whose only neighbour is a cell, which they become a part of."""
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
    """Walls as corners of pixels, from where three or more regions meet to the next such place.

    Corners of the image are ends of walls, too. A wall around an island ends where it begins.
    """
    beside: dict[Point, list[Point]] = {}
    y, x = np.nonzero(regions[1:] != regions[:-1])
    level = np.stack([x, y + 1, x + 1, y + 1], axis=1)
    y, x = np.nonzero(regions[:, 1:] != regions[:, :-1])
    upright = np.stack([x + 1, y, x + 1, y + 1], axis=1)
    for ax, ay, bx, by in np.concatenate([level, upright]).tolist():
        beside.setdefault((ax, ay), []).append((bx, by))
        beside.setdefault((bx, by), []).append((ax, ay))
    rows, columns = regions.shape
    corners = {(x, y) for x in (1, columns - 1) for y in (1, rows - 1)}
    ends = {point for point, others in beside.items() if len(others) > 2 or point in corners}
    paths: list[Path] = []
    walked: set[tuple[Point, Point]] = set()
    for begin in [*sorted(ends), *sorted(beside.keys() - ends)]:
        is_on_wall = begin not in ends and any((begin, each) in walked for each in beside[begin])
        for following in [] if is_on_wall else beside[begin]:
            if (begin, following) in walked:
                continue
            path = [begin, following]
            while path[-1] not in ends and path[-1] != begin:
                one, other = beside[path[-1]]
                path.append(other if one == path[-2] else one)
            for a, b in pairwise(path):
                walked |= {(a, b), (b, a)}
            paths.append(path)
    return paths


def _left_of(regions: NDArray[np.int64], begin: Point, end: Point) -> int:
    """The region on the left of a step from a corner of pixels to the next."""
    ax, ay = begin
    bx, by = end
    if ay == by:  # upwards is the left of a step to the right
        return int(regions[ay if bx > ax else ay - 1, min(ax, bx)])
    return int(regions[min(ay, by), ax - 1 if by > ay else ax])


Directed = tuple[int, bool]
"""The number of a wall, and whether it is walked backwards."""


def _directed(paths: list[Path], wall: Directed) -> Path:
    number, is_back = wall
    return paths[number][::-1] if is_back else paths[number]


def _loops(regions: NDArray[np.int64], paths: list[Path]) -> Iterator[tuple[int, list[Directed]]]:
    """Each closed way around a region, which is on its left, with the region, cells first."""
    leaving: dict[tuple[int, Point], list[Directed]] = {}
    for number in range(len(paths)):
        for wall in ((number, False), (number, True)):
            path = _directed(paths, wall)
            leaving.setdefault((_left_of(regions, *path[:2]), path[0]), []).append(wall)
    for region, begin in sorted(leaving, key=lambda key: (key[0] < 0, abs(key[0]), key[1])):
        while leaving[region, begin]:
            loop = [leaving[region, begin].pop()]
            while (path := _directed(paths, loop[-1]))[-1] != begin:
                following = leaving[region, path[-1]]
                # where a region meets itself, the way around the same pixel goes on to the left
                turns = [_turn(path, _directed(paths, wall)) for wall in following]
                loop.append(following.pop(turns.index(max(turns))))
            yield region, loop


def _turn(path: Path, following: Path) -> int:
    """1 where the second of two walls turns to the left of the first, −1 to the right."""
    ax, ay = path[-2]
    bx, by = path[-1]
    cx, cy = following[1]
    return (bx - ax) * (cy - by) - (by - ay) * (cx - bx)


def _check_whole(loops: list[tuple[int, list[Directed]]], paths: list[Path], pixel: float) -> None:
    """Raise InputError for a plant cell that has other regions within it."""
    for region, loop in loops:
        around = np.array([p for wall in loop for p in _directed(paths, wall)[:-1]], dtype=float)
        if region > 0 and polygon_area(around) < 0.0:
            x, y = pixel * (around.mean(axis=0) - 1.0)
            raise InputError(
                f"image: the cells about ({x:.4g}, {y:.4g}) µm lie within another cell; merge them "
                "with it, or label it as 0 if it is an air space"
            )


@dataclass(frozen=True, slots=True)
class Line:
    """A wall: the corners at its ends, and points along it (n, 2), pixels; none if it vanished."""

    begin: Point
    end: Point
    points: Array


def _lines(paths: list[Path], shape: tuple[int, ...], near: float) -> list[Line]:
    """Walls as smooth lines; of corners that are `_NEAR` each other one is left.

    Args:
        shape: (rows, columns) of the image. near: length of a spring in pixels.
    """
    smooth = [_smoothed(np.array(path, dtype=np.float64)) for path in paths]
    corner: dict[Point, Point] = {point: point for path in paths for point in (path[0], path[-1])}

    def root(point: Point) -> Point:
        while corner[point] != point:
            point = corner[point]
        return point

    rows, columns = shape
    is_short = [length_of(line) < _NEAR * near and path[0] != path[-1]
                for line, path in zip(smooth, paths, strict=True)]  # fmt: skip
    for path, short in zip(paths, is_short, strict=True):
        if short:
            corner[root(path[0])] = root(path[-1])
    members: dict[Point, list[Point]] = {}
    for point in corner:
        members.setdefault(root(point), []).append(point)
    place: dict[Point, Array] = {}
    for one, every in members.items():
        at = np.array(every, dtype=np.float64)
        # corners on the border of the image stay there, and those of the image where they are
        on_border = np.sum((at == 1.0) | (at == [columns + 1.0, rows + 1.0]), axis=1)
        place[one] = at[on_border == on_border.max()].mean(axis=0)
    lines = []
    for path, line, short in zip(paths, smooth, is_short, strict=True):
        begin = root(path[0])
        end = root(path[-1])
        along = np.linspace(0.0, 1.0, len(line))[:, None]
        moved = line + (1.0 - along) * (place[begin] - line[0]) + along * (place[end] - line[-1])
        is_gone = short and begin == end
        lines.append(Line(begin, end, moved[:0] if is_gone else moved))
    return lines


def length_of(line: Array) -> float:
    """Length of a line (n, 2)."""
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def _smoothed(path: Array) -> Array:
    """A path without the steps of pixels; its ends stay where they are."""
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
    """Divide lines into springs and gather the particles around each polygon."""
    corners: dict[Point, int] = {}
    at: list[Array] = []
    for line in lines:
        if not len(line.points):
            continue
        for point, position in ((line.begin, line.points[0]), (line.end, line.points[-1])):
            if point not in corners:
                corners[point] = len(at)
                at.append(position)
    wall_of = [-1] * len(at)
    bonds: list[tuple[int, int]] = []
    wall_of_bond: list[int] = []
    particles: list[list[int]] = []
    for number, line in enumerate(lines):
        if not len(line.points):
            particles.append([])
            continue
        begin = corners[line.begin]
        end = corners[line.end]
        springs = max(1, round(pixel * length_of(line.points) / length))
        if begin == end:
            springs = max(_FEWEST, springs)
        elif springs == 1 and (min(begin, end), max(begin, end)) in bonds:
            springs = 2  # two walls between the same corners
        inner = range(len(at), len(at) + springs - 1)
        at += [*_divided(line.points, springs)]
        wall_of += [number] * len(inner)
        chain = [begin, *inner, end]
        bonds += [(min(i, j), max(i, j)) for i, j in pairwise(chain)]
        wall_of_bond += [number] * springs
        for i in (begin, end):
            wall_of[i] = max(wall_of[i], number)
        particles.append(chain)
    # the image begins one pixel within its frame of air
    position = pixel * (np.array(at) - 1.0)
    position = _spread(position, np.array(bonds), pixel * np.array(shape[::-1]), length)
    rims = []
    for region, loop in loops:
        rim: list[int] = []
        for number, is_back in loop:
            chain = particles[number]
            rim += (chain[::-1] if is_back else chain)[:-1]
        if region > 0 and (len(rim) < _FEWEST or polygon_area(position[rim]) <= 0.0):
            x, y = position[rim].mean(axis=0)
            raise InputError(
                f"image: the cell about ({x:.4g}, {y:.4g}) µm is too narrow for springs of "
                f"{length:.3g} µm; merge it with another one"
            )
        rims.append(rim)
    lattice = 2.0 * pixel * np.diag(shape[::-1]).astype(np.float64)  # only one period is used
    tessellation = Tessellation(
        lattice,
        position,
        tuple(tuple((i, (0, 0)) for i in rim) for rim in rims),
        tuple((i, j, (0, 0)) for i, j in bonds),
    )
    return Arrangement(
        tessellation,
        position,
        np.array([(i, j, 0, 0) for i, j in bonds], dtype=np.int32),
        tuple(np.array([(i, 0, 0) for i in rim], dtype=np.int32) for rim in rims),
        (),
        np.array(wall_of, dtype=np.int32),
        np.zeros(len(at), dtype=np.int32),
        np.array(wall_of_bond, dtype=np.int32),
    )


def _spread(position: Array, bonds: Index, size: Array, length: float) -> Array:
    """Positions (n, 2) where particles that no spring joins are not much nearer than a spring.

    In sharp corners walls would repel each other more than they bear. Particles on the border of
    the image stay there.

    Args:
        size: (2,) width and height of the image, µm.
    """
    least = _APART * length
    stays = ((position == 0.0) | (position == size)).any(axis=1)
    joined = set(map(tuple, bonds.tolist()))
    position = position.copy()
    for _ in range(_SPREADINGS):
        pairs = scipy.spatial.cKDTree(position).query_pairs(least)
        apart = np.array([pair for pair in sorted(pairs) if pair not in joined], dtype=np.int64)
        apart = apart.reshape(-1, 2)
        apart = apart[~stays[apart].all(axis=1)]
        if not len(apart):
            break
        way = position[apart[:, 1]] - position[apart[:, 0]]
        distance = np.linalg.norm(way, axis=1)
        lacking = (least - distance) / np.maximum(distance, _TINY * least)
        moves = (~stays[apart]).astype(np.float64)
        moves *= (0.5 * lacking / moves.sum(axis=1))[:, None]
        np.add.at(position, apart[:, 0], -moves[:, :1] * way)
        np.add.at(position, apart[:, 1], moves[:, 1:] * way)
    return position


def _divided(line: Array, parts: int) -> Array:
    """(parts − 1, 2) points that divide a line (n, 2) into parts of equal length."""
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1)))
    places = way[-1] * np.arange(1, parts) / parts
    return np.stack([np.interp(places, way, each) for each in line.T], axis=1)
