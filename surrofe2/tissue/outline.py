"""The outline of a mesh, which plant cells it holds, and where on it a tissue's own outline lies.

The walls along the boundary of irregular tissue wind about the outline that a problem states. Each
of their particles stands for a place on it: the nearest one, in the order of the walls around the
tissue. Corners of the outline have a particle each, so that each side has its whole length.
"""

from __future__ import annotations

import numpy as np
import skfem

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.problem.mesh import facet_nodes

_CORNER = 0.3
"""Sine of the turn, 17°, from which on a vertex of an outline is a corner."""
_LEVEL = 1e-9
"""Distance from the outline, over its extent, up to which particles lie on it."""
_HAIR = 1e-6
"""Least distance between a corner and all particles but the one that stands for it, over the length
of the outline."""


def outlines(mesh: skfem.Mesh) -> list[Array]:
    """Return the corners (k, 2) of each closed outline of a mesh, the tissue on the left, µm."""
    ends = facet_nodes(mesh, mesh.boundary_facets())[:, :2]
    return [mesh.p.T[ring] for ring in rings_of(ends)]


def rings_of(pairs: Index) -> list[Index]:
    """Join pairs (k, 2), each of which leads from its first number to its second, to closed rings.

    Each number must come as often first as second.
    """
    following: dict[int, list[int]] = {}
    for begin, end in pairs.tolist():
        following.setdefault(begin, []).append(end)
    rings = []
    while following:
        ring = [next(iter(following))]
        while ring[-1] in following:
            ends = following[ring[-1]]
            ring.append(ends.pop())
            if not ends:
                del following[ring[-2]]
        rings.append(np.array(ring[:-1]))  # the last one is the first again
    return rings


def area_within(rings: list[Array]) -> float:
    """Return the area within outlines, µm²; those around holes, clockwise, count negative."""
    area = 0.0
    for ring in rings:
        area += 0.5 * float(np.sum(_cross(ring, np.roll(ring, -1, axis=0))))
    return area


def are_within(points: Array, rings: list[Array]) -> Flags:
    """Return (n,) whether points (n, 2) lie within outlines.

    That is where a ray from the point to the right crosses outlines an odd number of times.
    """
    inside = np.zeros(len(points), dtype=np.bool_)
    x, y = points.T
    for ring in rings:
        for (x0, y0), (x1, y1) in zip(ring, np.roll(ring, -1, axis=0), strict=True):
            passes = (y0 > y) != (y1 > y)
            along = np.divide(y - y0, y1 - y0, out=np.zeros(len(points)), where=passes)
            inside ^= passes & (x0 + along * (x1 - x0) > x)
    return inside


def on_outline(walls: Array, rings: list[Array]) -> Array:
    """Return places (n, 2) on the nearest outline for the particles around a tissue, in order.

    Args:
        walls: (n, 2) particles as they are laid out, one after the other around the tissue, which
            is on the left, µm.
        rings: corners of the outlines, as of `outlines`.
    """
    # the outline, or a hole, that these particles are around
    ring = min(rings, key=lambda ring: _mean_distance(walls, ring))
    distance, way = _nearest(walls, ring)
    lengths = np.linalg.norm(np.roll(ring, -1, axis=0) - ring, axis=1)
    starts = np.append(0.0, np.cumsum(lengths))
    around = float(lengths.sum())
    is_on_it = distance < _LEVEL * np.ptp(ring, axis=0).max()
    # ways in the order of the particles, without the jump back to 0 where the outline begins again
    steps = np.mod(np.diff(way, append=way[0]) + 0.5 * around, around) - 0.5 * around
    unrolled = way[0] + np.append(0.0, np.cumsum(steps[:-1]))
    goes_around_once = abs(steps.sum() - around) < 0.5 * around
    if goes_around_once:
        unrolled = _ascending(unrolled, around)
    for corner in _corners(ring):
        unrolled = _with_one_at(starts[corner], unrolled, around)
    way = np.mod(unrolled, around)
    side = np.clip(np.searchsorted(starts, way, side="right") - 1, 0, len(ring) - 1)
    along = ((way - starts[side]) / lengths[side])[:, None]
    places = ring[side] + along * (np.roll(ring, -1, axis=0) - ring)[side]
    return np.where(is_on_it[:, None], walls, places)


def _mean_distance(points: Array, ring: Array) -> float:
    """Return the mean distance of points (n, 2) to an outline."""
    distance, _ = _nearest(points, ring)
    return float(distance.mean())


def _nearest(points: Array, ring: Array) -> tuple[Array, Array]:
    """Return distances (n,) to an outline, and ways (n,) along it to the nearest places."""
    distance = np.full(len(points), np.inf)
    way = np.zeros(len(points))
    start = 0.0
    for begin, end in zip(ring, np.roll(ring, -1, axis=0), strict=True):
        along = end - begin
        length = float(np.linalg.norm(along))
        part = np.clip((points - begin) @ along / length**2, 0.0, 1.0)
        distance_to_side = np.linalg.norm(points - begin - part[:, None] * along, axis=1)
        is_nearer = distance_to_side < distance
        distance[is_nearer] = distance_to_side[is_nearer]
        way[is_nearer] = start + length * part[is_nearer]
        start += length
    return distance, way


def _ascending(way: Array, around: float) -> Array:
    """Return ways (n,) along a closed outline that nowhere go back, near those that may.

    Each is the mean of the largest way up to it and the smallest from it on.
    """
    # with one turn before and one after, as the outline is closed
    every = np.concatenate([way - around, way, way + around])
    largest_before = np.maximum.accumulate(every)
    smallest_after = np.minimum.accumulate(every[::-1])[::-1]
    return np.asarray(0.5 * (largest_before + smallest_after)[len(way) : 2 * len(way)])


def _with_one_at(corner: float, way: Array, around: float) -> Array:
    """Return ways (n,) of which the nearest to a corner ends at it.

    No other ends within `_HAIR` of it, so that each bond is on one side of the corner.

    corner: way along the outline to the corner. around: length of the outline.
    """
    from_corner = np.mod(way - corner + 0.5 * around, around) - 0.5 * around
    nearest = from_corner[abs(from_corner).argmin()]
    ties = np.flatnonzero(abs(from_corner - nearest) < _LEVEL * around)
    # of several at one place, the last one before the corner, or the first one behind it
    towards_corner = 1 if nearest < 0.0 else -1
    chosen = next(k for k in ties.tolist() if (k + towards_corner) % len(way) not in ties)
    is_before = np.mod(np.arange(len(way)) - chosen, len(way)) > len(way) // 2
    hair = _HAIR * around
    moved = np.where(abs(from_corner) < hair, np.where(is_before, -hair, hair), from_corner)
    moved[chosen] = 0.0
    return np.asarray(way + moved - from_corner)


def _corners(ring: Array) -> list[int]:
    """Return the vertices at which an outline (k, 2) turns sharply."""
    before = ring - np.roll(ring, 1, axis=0)
    after = np.roll(ring, -1, axis=0) - ring
    sizes = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    return np.flatnonzero(abs(_cross(before, after)) > _CORNER * sizes).tolist()


def _cross(a: Array, b: Array) -> Array:
    """Return the cross products (n,) of vectors a and b (n, 2)."""
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
