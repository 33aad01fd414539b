"""Layout of the matrices of an RVE in blocks, found once for all its copies.

Particles are gathered in groups, the fluid of a plant cell or the wall particles along an edge;
groups that interact have a full block. One group of all particles is a dense matrix. Groups are
eliminated in the order of minimum degree, and what elimination fills in is part of the pattern.
Rows of a group are alike: blocks from the first eliminated neighbour to the last, without gaps
between them::

    values[start[g] + (column[i] + a) · width[g] + offset[g, h] + column[j] + b, lane]
        couples component a of particle i of group g with component b of particle j of group h
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int32]

HELD = -1


class Pattern(NamedTuple):
    """Layout of matrices and their factors; groups are numbered as they are eliminated.

    group, column: (particles,) group of each particle, and its first column within the blocks of
        that group; HELD for particle 0. Particle i has the unknowns first[group[i]] + column[i]
        and the next.
    first: (groups + 1,) first unknown of each group in the order of elimination.
    width: (groups,) entries of a row.
    start: (groups,) where the first row of a group begins.
    offset: (groups, groups) where a block begins within a row, −1 where there is none.
    lower, upper: (·,) neighbours eliminated before and after, ascending; those of g are
        lower[lower_start[g]:lower_start[g + 1]].
    block: (particles, particles) where the 2 × 2 block of two particles begins; −1: there is none.
    stride: (particles,) how far its second row is from there.
    size: number of values.
    """

    group: Ints
    column: Ints
    first: Ints
    width: Ints
    start: Ints
    offset: Ints
    lower: Ints
    lower_start: Ints
    upper: Ints
    upper_start: Ints
    block: Ints
    stride: Ints
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
    offset = np.full((count, count), -1, dtype=np.int32)
    width, start = np.zeros((2, count), dtype=np.int32)
    group, column = np.full((2, particles), HELD, dtype=np.int32)
    total = 0
    for g in range(count):
        at = 0
        for h in [*lower[g], g, *upper[g]]:
            offset[g, h] = at
            at += size[h]
        width[g], start[g] = at, total
        group[members[g]], column[members[g]] = g, 2 * np.arange(len(members[g]))
        total += size[g] * at
    blocks = offset[group[:, None], group] if count else np.full((particles, particles), -1)
    known = (blocks >= 0) & (group[:, None] >= 0) & (group >= 0)
    stride = width[group] if count else np.zeros(particles, dtype=np.int32)
    if count:
        blocks = blocks + (start[group] + column * stride)[:, None] + column
    return Pattern(
        group=group,
        column=column,
        first=np.cumsum([0, *size], dtype=np.int32),
        width=width,
        start=start,
        offset=offset,
        lower=np.array([*chain(*lower)], dtype=np.int32),
        lower_start=np.cumsum([0, *map(len, lower)], dtype=np.int32),
        upper=np.array([*chain(*upper)], dtype=np.int32),
        upper_start=np.cumsum([0, *map(len, upper)], dtype=np.int32),
        block=np.where(known, blocks, -1).astype(np.int32),
        stride=stride.astype(np.int32),
        size=total,
    )
