"""Which entries the sparse matrices of an RVE have: found once, since all its copies share it.

Particles are gathered in groups, the fluid of a plant cell or the wall particles along an edge;
groups that interact have a full block. Groups are eliminated in the order of minimum degree, and
what elimination fills in is part of the pattern. Rows of a group are alike: blocks from the first
eliminated neighbour to the last, without gaps between them::

    values[row_start[i] + a · width[g] + offset[g, h] + 2 · place[j] + b, lane]
        couples component a of particle i of group g with component b of particle j of group h


Adding to the particles' Jacobian where it is stored dense, (2n, 2n, TILE), or sparse, `Blocks`.

The same kernels fill both; numba picks by the type of the matrix.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numba.core import types
from numba.extending import overload
from numpy.typing import NDArray

from surrofe2.compilation import OPTIONS, kernel
from surrofe2.simd import load, store

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


class Blocks(NamedTuple):
    """Sparse matrix of one tile: values (size, TILE), and where they belong (a `Pattern`)."""

    values: NDArray[np.float64]
    pattern: Any


def clear(jacobian: Any) -> None:
    """Set all entries to zero."""
    raise NotImplementedError("for kernels")


def add_block(jacobian: Any, i: Any, j: Any, xx: Any, xy: Any, yx: Any, yy: Any) -> None:
    """Add a 2 × 2 block at particles (i, j)."""
    raise NotImplementedError("for kernels")


def add_fluid_product(left: Any, right: Any, jacobian: Any, first: Any) -> None:
    """Add left @ right to the block of a plant cell's fluid, whose first particle is `first`."""
    raise NotImplementedError("for kernels")


def _is_dense(jacobian: Any) -> bool:
    return isinstance(jacobian, types.Array)


@overload(clear, jit_options=OPTIONS)
def _clear(jacobian):
    def dense(jacobian):
        jacobian[:] = 0.0

    def sparse(jacobian):
        jacobian.values[:] = 0.0

    return dense if _is_dense(jacobian) else sparse


@overload(add_block, jit_options=OPTIONS)
def _add_block(jacobian, i, j, xx, xy, yx, yy):
    def dense(jacobian, i, j, xx, xy, yx, yy):
        row, column = 2 * i, 2 * j
        store(load(jacobian, row, column) + xx, jacobian, row, column)
        store(load(jacobian, row, column + 1) + xy, jacobian, row, column + 1)
        store(load(jacobian, row + 1, column) + yx, jacobian, row + 1, column)
        store(load(jacobian, row + 1, column + 1) + yy, jacobian, row + 1, column + 1)

    def sparse(jacobian, i, j, xx, xy, yx, yy):
        values, pattern = jacobian.values, jacobian.pattern
        g, h = pattern.group[i], pattern.group[j]
        if g >= 0 and h >= 0:
            at = pattern.row_start[i] + pattern.offset[g, h] + 2 * pattern.place[j]
            below = at + pattern.width[g]
            store(load(values, at) + xx, values, at)
            store(load(values, at + 1) + xy, values, at + 1)
            store(load(values, below) + yx, values, below)
            store(load(values, below + 1) + yy, values, below + 1)

    return dense if _is_dense(jacobian) else sparse


@overload(add_fluid_product, jit_options=OPTIONS)
def _add_fluid_product(left, right, jacobian, first):
    def dense(left, right, jacobian, first):
        add_product(left, right, jacobian, 2 * first, 2 * first)

    def sparse(left, right, jacobian, first):
        values, pattern = jacobian.values, jacobian.pattern
        g = pattern.group[first]
        begin = pattern.row_start[first] + pattern.offset[g, g] + 2 * pattern.place[first]
        for m in range(left.shape[0]):
            line = begin + m * pattern.width[g]
            for n in range(0, right.shape[1], 2):
                even, odd = load(values, line + n), load(values, line + n + 1)
                for s in range(left.shape[1]):
                    factor = load(left, m, s)
                    even += factor * load(right, s, n)
                    odd += factor * load(right, s, n + 1)
                store(even, values, line + n)
                store(odd, values, line + n + 1)

    return dense if _is_dense(jacobian) else sparse


@kernel
def add_product(left, right, total, row, column):
    """total[row:, column:] += left @ right, lane by lane; two columns at a time, an even number."""
    for m in range(left.shape[0]):
        for n in range(0, right.shape[1], 2):
            even = load(total, row + m, column + n)
            odd = load(total, row + m, column + n + 1)
            for s in range(left.shape[1]):
                factor = load(left, m, s)
                even += factor * load(right, s, n)
                odd += factor * load(right, s, n + 1)
            store(even, total, row + m, column + n)
            store(odd, total, row + m, column + n + 1)
