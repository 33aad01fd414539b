"""Which entries the sparse matrices of an RVE have: found once, since all its copies share it.

Particles are gathered in groups, the fluid of a plant cell or the wall particles along an edge;
groups that interact have a full block. Groups are eliminated in the order of minimum degree, and
what elimination fills in is part of the pattern. Rows of a group are alike: blocks from the first
eliminated neighbour to the last, without gaps between them::

    values[row_start[i] + a · width[g] + offset[g, h] + 2 · place[j] + b, lane]
        couples component a of particle i of group g with component b of particle j of group h
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int32]
Longs = NDArray[np.int64]

HELD = -1


class Pattern(NamedTuple):
    """Layout of sparse matrices and factors; groups are numbered as they are eliminated.

    group, place: (particles,) group of each particle and its place there; HELD for particle 0.
    row_start: (particles,) where the first of its two rows begins among the values.
    first: (groups + 1,) first unknown of each group in the order of elimination.
    width: (groups,) entries of a row.
    offset: (groups, groups) where a block begins within a row, −1 where there is none.
    start: (groups,) where the first row of a group begins.
    lower, upper: (·,) neighbours eliminated before and after, ascending; those of g are
        lower[lower_start[g]:lower_start[g + 1]].
    unknown: (unknowns,) position of each unknown 2 i + a − 2 in the order of elimination.
    size: number of values.
    """

    group: Ints
    place: Ints
    row_start: Longs
    first: Ints
    width: Ints
    offset: Ints
    start: Longs
    lower: Ints
    lower_start: Ints
    upper: Ints
    upper_start: Ints
    unknown: Ints
    size: int


def make_pattern(labels: Sequence[int] | Ints, pairs: Iterable[tuple[int, int]]) -> Pattern:
    """Order groups by minimum degree and find what fills in.

    Args:
        labels: (particles,) group of each particle, any numbers; particle 0 is held.
        pairs: groups, by their labels, that interact.
    """
    labels = np.asarray(labels)
    known = sorted(set(labels[1:].tolist()))
    weight = {g: int(np.sum(labels[1:] == g)) for g in known}
    neighbours: dict[int, set[int]] = {g: set() for g in known}
    for g, h in pairs:
        if g != h and g in neighbours and h in neighbours:
            neighbours[g].add(h)
            neighbours[h].add(g)
    order, later = _eliminate(neighbours, weight)
    return _layout(labels, order, later)


def factorisation_work(pattern: Pattern) -> float:
    """Multiplications of one LU factorisation."""
    size = np.diff(pattern.first).astype(np.float64)
    ends = pattern.upper_start
    work = 0.0
    for g, s in enumerate(size):
        right = size[pattern.upper[ends[g] : ends[g + 1]]].sum()
        work += s**3 / 3.0 + s**2 * right + s * right**2
    return float(work)


def _eliminate(
    neighbours: dict[int, set[int]], weight: dict[int, int]
) -> tuple[list[int], dict[int, set[int]]]:
    """Order of elimination, and of each group those coupled to it that come after."""
    left = {g: set(others) for g, others in neighbours.items()}
    order, later = [], {}
    while left:
        g = min(left, key=lambda h: (sum(weight[k] for k in left[h]), h))
        others = left.pop(g)
        for h in others:
            left[h] |= others
            left[h] -= {g, h}
        order.append(g)
        later[g] = others
    return order, later


def _layout(labels: Ints, order: list[int], later: dict[int, set[int]]) -> Pattern:
    rank = {g: k for k, g in enumerate(order)}
    count, particles = len(order), len(labels)
    members = [[i for i in range(1, particles) if labels[i] == g] for g in order]
    upper = [sorted(rank[h] for h in later[g]) for g in order]
    lower = [[h for h in range(g) if g in upper[h]] for g in range(count)]
    size = [2 * len(m) for m in members]
    first = np.append(0, np.cumsum(size)).astype(np.int32)
    offset = np.full((count, count), -1, dtype=np.int32)
    width, start = np.zeros(count, dtype=np.int32), np.zeros(count, dtype=np.int64)
    group, place = (np.full(particles, HELD, dtype=np.int32) for _ in range(2))
    row_start = np.full(particles, HELD, dtype=np.int64)
    total = 0
    for g in range(count):
        at = 0
        for h in [*lower[g], g, *upper[g]]:
            offset[g, h] = at
            at += size[h]
        width[g], start[g] = at, total
        for k, i in enumerate(members[g]):
            group[i], place[i], row_start[i] = g, k, total + 2 * k * at
        total += size[g] * at
    unknown = np.empty(2 * particles - 2, dtype=np.int32)
    for axis in range(2):
        unknown[axis::2] = first[group[1:]] + 2 * place[1:] + axis
    return Pattern(
        group, place, row_start, first, width, offset, start,
        _flat(lower), _starts(lower), _flat(upper), _starts(upper), unknown, total,
    )  # fmt: skip


def _flat(lists: list[list[int]]) -> Ints:
    return np.array([entry for entries in lists for entry in entries], dtype=np.int32)


def _starts(lists: list[list[int]]) -> Ints:
    return np.append(0, np.cumsum([len(entries) for entries in lists])).astype(np.int32)
