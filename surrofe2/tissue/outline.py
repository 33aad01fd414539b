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
"""Sine of the turn from which on a vertex of an outline is a corner."""
_LEVEL = 1e-9
"""Of the extent: particles as near to the outline lie on it."""
_HAIR = 1e-6
"""Of the way around: between a corner and all particles but the one that stands for it."""


def outlines(mesh: skfem.Mesh) -> list[Array]:
    """(k, 2) corners of each closed outline of a mesh, the tissue on the left, µm."""
    ends = facet_nodes(mesh, mesh.boundary_facets())[:, :2]
    return [mesh.p.T[ring] for ring in rings_of(ends)]


def rings_of(pairs: Index) -> list[Index]:
    """Closed rings of the pairs (k, 2), each of which leads from its first number to its second."""
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
        rings.append(np.array(ring[:-1]))
    return rings


def area_within(rings: list[Array]) -> float:
    """Area within outlines, µm²."""
    return sum(0.5 * float(np.sum(_cross(ring, np.roll(ring, -1, axis=0)))) for ring in rings)


def are_within(points: Array, rings: list[Array]) -> Flags:
    """(n,) whether points (n, 2) lie within: a way to the right crosses outlines oddly often."""
    inside = np.zeros(len(points), dtype=np.bool_)
    for ring in rings:
        for begin, end in zip(ring, np.roll(ring, -1, axis=0), strict=True):
            passes = (begin[1] > points[:, 1]) != (end[1] > points[:, 1])
            along = np.divide(
                points[:, 1] - begin[1], end[1] - begin[1], out=np.zeros(len(points)), where=passes
            )
            inside ^= passes & (begin[0] + along * (end[0] - begin[0]) > points[:, 0])
    return inside


def on_outline(walls: Array, rings: list[Array]) -> Array:
    """(n, 2) places on the nearest of outlines of the particles around a tissue, in their order.

    Args:
        walls: (n, 2) where they are laid out, µm, the tissue on the left of the way around.
    """
    ring, distance, way = min(
        ((ring, *_nearest(walls, ring)) for ring in rings), key=lambda each: float(each[1].mean())
    )
    lengths = np.linalg.norm(np.roll(ring, -1, axis=0) - ring, axis=1)
    starts = np.append(0.0, np.cumsum(lengths))
    around = float(lengths.sum())
    exact = distance < _LEVEL * np.ptp(ring, axis=0).max()
    # in their order, without the jump to where the outline begins anew
    steps = np.mod(np.diff(way, append=way[0]) + 0.5 * around, around) - 0.5 * around
    unrolled = way[0] + np.append(0.0, np.cumsum(steps[:-1]))
    if abs(steps.sum() - around) < 0.5 * around:  # they go around it once
        unrolled = _ascending(unrolled, around)
    for corner in _corners(ring):
        unrolled = _with_one_at(starts[corner], unrolled, around)
    place = np.mod(unrolled, around)
    side = np.clip(np.searchsorted(starts, place, side="right") - 1, 0, len(ring) - 1)
    along = ((place - starts[side]) / lengths[side])[:, None]
    corners = ring[side] + along * (np.roll(ring, -1, axis=0) - ring)[side]
    return np.where(exact[:, None], walls, corners)


def _nearest(points: Array, ring: Array) -> tuple[Array, Array]:
    """(n,) distances to an outline, and how far along it the nearest places lie."""
    distance = np.full(len(points), np.inf)
    way = np.zeros(len(points))
    start = 0.0
    for begin, end in zip(ring, np.roll(ring, -1, axis=0), strict=True):
        along = end - begin
        length = float(np.linalg.norm(along))
        part = np.clip((points - begin) @ along / length**2, 0.0, 1.0)
        there = np.linalg.norm(points - begin - part[:, None] * along, axis=1)
        nearer = there < distance
        distance[nearer] = there[nearer]
        way[nearer] = start + length * part[nearer]
        start += length
    return distance, way


def _ascending(way: Array, around: float) -> Array:
    """Ways along a closed outline that nowhere go back: means of the bounds on both sides."""
    every = np.concatenate([way - around, way, way + around])
    above = np.maximum.accumulate(every)
    below = np.minimum.accumulate(every[::-1])[::-1]
    return np.asarray(0.5 * (above + below)[len(way) : 2 * len(way)])


def _with_one_at(corner: float, way: Array, around: float) -> Array:
    """Ways of which one ends at a corner, and no other within `_HAIR`, so that each bond is on one
    side of it."""
    off = np.mod(way - corner + 0.5 * around, around) - 0.5 * around
    nearest = off[abs(off).argmin()]
    ties = np.flatnonzero(abs(off - nearest) < _LEVEL * around)
    # the last of those before the corner, or the first of those behind it
    beside = 1 if nearest < 0.0 else -1
    one = next(k for k in ties.tolist() if (k + beside) % len(way) not in ties)
    is_before = np.mod(np.arange(len(way)) - one, len(way)) > len(way) // 2
    hair = _HAIR * around
    moved = np.where(abs(off) < hair, np.where(is_before, -hair, hair), off)
    moved[one] = 0.0
    return np.asarray(way + moved - off)


def _corners(ring: Array) -> list[int]:
    """Vertices at which an outline turns sharply."""
    before = ring - np.roll(ring, 1, axis=0)
    after = np.roll(ring, -1, axis=0) - ring
    sizes = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    return np.flatnonzero(abs(_cross(before, after)) > _CORNER * sizes).tolist()


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
