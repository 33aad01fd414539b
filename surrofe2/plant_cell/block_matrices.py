"""Matrices of an RVE in blocks, one matrix a lane: their layout and their LU factors.

Particles are gathered in groups, the fluid of a plant cell or the wall particles along an edge;
groups that interact have a full block. One group of all particles is a dense matrix. Groups are
eliminated in the order of minimum degree, and what elimination fills in is part of the pattern,
found once for all RVEs. Rows of a group are alike: blocks from the first eliminated neighbour to
the last, without gaps between them::

    values[start[g] + (column[i] + a) · width[g] + offset[g, h] + column[j] + b, lane]
        couples component a of particle i of group g with component b of particle j of group h

Values and factors are (size, TILE), all of one `Pattern`. No pivoting: near a stable equilibrium
the symmetric part of the matrices is definite, and a factorisation that is bad all the same shows
as a solve that does not converge. Eight columns are eliminated at a time, so that what is updated
is read and written an eighth as often, and rows in pairs, the two of a particle. b holds two
unknowns for each particle but the held one.

Pressures are unknowns, too, that no b holds: their equations have the right-hand side zero, and
what they come to is not wanted. As each couples a whole rim, the matrix with them is much emptier
than the one without. They lie like particles behind all others, with a second unknown that is idle.
With them the matrix of a stable equilibrium has a positive pivot for each pressure, else negative
ones (Haynsworth: its inertia is that of −1/p′ and that of the matrix without them).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.arrays import Array
from surrofe2.base.compilation import kernel, pair_law
from surrofe2.base.simd import TILE, load, spread, store

Ints = NDArray[np.int32]

HELD = -1
PANEL = 8
COLUMNS = 4


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
    pressures: number of pressures, the last of the particles.
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
    pressures: int


def make_pattern(
    labels: Sequence[int] | Ints, pairs: Iterable[tuple[int, int]], pressures: int = 0
) -> Pattern:
    """Order groups by minimum degree and find what fills in.

    Args:
        labels: (particles,) group of each particle, any numbers; particle 0 is held. The last
            `pressures` of them are pressures.
        pairs: groups, by their labels, that interact.
    """
    labels = np.asarray(labels)
    members = {g: 1 + np.flatnonzero(labels[1:] == g) for g in np.unique(labels[1:]).tolist()}
    beside: dict[int, set[int]] = {g: set() for g in members}
    for g, h in pairs:
        if g != h and g in beside and h in beside:
            beside[g].add(h)
            beside[h].add(g)
    later = {}  # groups as they are eliminated, and those coupled to each that come after
    while beside:
        g = min(beside, key=lambda h: (sum(len(members[k]) for k in beside[h]), h))
        later[g] = others = beside.pop(g)
        for h in others:
            beside[h] |= others
            beside[h] -= {g, h}
    rank = {g: k for k, g in enumerate(later)}
    count = len(later)
    upper = [sorted(rank[h] for h in others) for others in later.values()]
    lower = [[h for h in range(g) if g in upper[h]] for g in range(count)]
    size = [2 * len(members[g]) for g in later]
    offset = np.full((count, count), -1, dtype=np.int32)
    width, start = np.zeros((2, count), dtype=np.int32)
    group, column = np.full((2, len(labels)), HELD, dtype=np.int32)
    total = 0
    for g, numbers in enumerate(members[label] for label in later):
        at = 0
        for h in [*lower[g], g, *upper[g]]:
            offset[g, h] = at
            at += size[h]
        width[g] = at
        start[g] = total
        group[numbers] = g
        column[numbers] = 2 * np.arange(len(numbers))
        total += size[g] * at
    blocks = offset[group[:, None], group]
    stride = width[group]
    exists = (blocks >= 0) & (group[:, None] >= 0) & (group >= 0)
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
        block=np.where(exists, blocks, -1).astype(np.int32),
        stride=stride,
        size=total,
        pressures=pressures,
    )


@cache
def dense_pattern(particles: int, pressures: int = 0) -> Pattern:
    """That of full matrices: one group of all particles and pressures."""
    return make_pattern(np.zeros(particles + pressures, dtype=np.int32), [], pressures)


def factorisation_work(pattern: Pattern) -> float:
    """Multiplications of one LU factorisation."""
    size = np.diff(pattern.first).astype(np.float64)
    ends = pattern.upper_start
    work = 0.0
    for g, s in enumerate(size):
        right = size[pattern.upper[ends[g] : ends[g + 1]]].sum()
        work += s**3 / 3.0 + s**2 * right + s * right**2
    return float(work)


# LU factors


class Matrices(NamedTuple):
    """Scratch of one tile for linear systems; n particles.

    matrix: (size, TILE) Jacobian of the forces, then its factors. columns: (2n, 8, TILE), their
    slopes by F and Ḟ. step: (2n − 2, TILE).
    """

    matrix: Array
    columns: Array
    no_columns: Array
    step: Array


@kernel
def make_matrices(topology):
    """Uninitialised scratch."""
    n = topology.particles
    return Matrices(
        np.empty((topology.size, TILE)),
        np.empty((2 * n, 8, TILE)),
        np.empty((0, 8, TILE)),
        np.empty((2 * n - 2, TILE)),
    )


@kernel
def factorise(a, pattern, symmetric):
    """LU in place, unit lower triangle; the diagonal holds reciprocal pivots.

    Where a is `symmetric`, elimination keeps to the upper triangle.
    """
    for g in range(pattern.width.shape[0]):
        size = pattern.first[g + 1] - pattern.first[g]
        width = pattern.width[g]
        diagonal = pattern.offset[g, g]
        for k in range(0, size, PANEL):
            count = min(PANEL, size - k)
            panel = pattern.start[g] + k * width
            _factorise_panel(a, panel, width, diagonal + k, count)
            _eliminate(a, pattern, g, g, k, symmetric)
            for m in range(pattern.upper_start[g], pattern.upper_start[g + 1]):
                _eliminate(a, pattern, g, np.int64(pattern.upper[m]), k, symmetric)


@kernel
def _factorise_panel(a, panel, width, diagonal, count):
    """Eliminate the first columns of the `count` rows at `panel` from each other."""
    for k in range(count):
        line = panel + k * width
        pivot = 1.0 / load(a, line + diagonal + k)
        store(pivot, a, line + diagonal + k)
        for i in range(k + 1, count):
            row = panel + i * width
            factor = load(a, row + diagonal + k) * pivot
            store(factor, a, row + diagonal + k)
            for j in range(diagonal + k + 1, width):
                store(load(a, row + j) - factor * load(a, line + j), a, row + j)


@kernel
def _eliminate(a, pattern, g, h, k, symmetric):
    """Clear the panel's columns, the eight (or last) at k of group g, from rows of h below it."""
    size = pattern.first[g + 1] - pattern.first[g]
    rows = pattern.first[h + 1] - pattern.first[h]
    width = pattern.width[g]
    diagonal = pattern.offset[g, g]
    there = pattern.width[h]
    at = pattern.offset[h, g] + k
    count = min(PANEL, size - k)
    panel = pattern.start[g] + k * width
    # Row i of h, in pairs: its part in columns of g becomes multipliers at `at`; then, for each
    # group c right of it, row i −= multipliers · panel, from `begin` in the panel to `to` in row i.
    # If symmetric, what lies left of the diagonal is skipped, and multipliers come from `mirror`.
    for i in range(k + count if h == g else 0, rows, 2):
        row = pattern.start[h] + i * there
        _set_multipliers(
            a,
            panel,
            width,
            diagonal + k,
            count,
            row,
            there,
            at,
            pattern.offset[g, h] + i,
            symmetric,
        )
        if h == g or not symmetric:
            skip = i - i % PANEL if symmetric else k + count
            begin = diagonal + skip
            to = pattern.offset[h, g] + skip
            _update(a, panel, width, count, row, there, at, begin, to, size - skip)
        for m in range(pattern.upper_start[g], pattern.upper_start[g + 1]):
            c = pattern.upper[m]
            if c >= h or not symmetric:
                skip = i - i % PANEL if symmetric and c == h else 0
                begin = pattern.offset[g, c] + skip
                to = pattern.offset[h, c] + skip
                columns = pattern.first[c + 1] - pattern.first[c] - skip
                _update(a, panel, width, count, row, there, at, begin, to, columns)


@kernel
def _set_multipliers(a, panel, width, diagonal, count, row, there, at, mirror, symmetric):
    """Multipliers of the panel's columns in the two rows at `row`, in place of what they clear.

    own, at: where these columns begin in rows of the panel and in the two, which are `there` wide.
    mirror: where the columns of the two begin in rows of the panel, if the matrix is symmetric.
    """
    for r in range(2):
        line = row + r * there + at
        for k in range(count):
            above = panel + k * width
            if symmetric:
                value = load(a, above + mirror + r)
            else:
                value = load(a, line + k)
                for m in range(k):
                    value -= load(a, line + m) * load(a, panel + m * width + diagonal + k)
            store(value * load(a, above + diagonal + k), a, line + k)


@kernel
def _update(a, panel, width, count, row, there, at, begin, to, columns):
    """Subtract the panel's rows from the two at `row`: `columns` from `begin` there, `to` here."""
    if count == PANEL:
        _subtract_panel(a, panel + begin, width, row + at, row + to, there, columns)
    else:
        for k in range(0, count, 2):
            line = panel + k * width + begin
            _subtract_pair(a, line, width, row + at + k, row + to, there, columns)


@kernel
def _subtract_pair(a, line, width, factors, to, there, columns):
    """a[to + j] −= Σ_m a[factors + m] a[line + m · width + j] for both rows, two m."""
    f0 = load(a, factors)
    f1 = load(a, factors + 1)
    g0 = load(a, factors + there)
    g1 = load(a, factors + there + 1)
    for j in range(columns):
        u0 = load(a, line + j)
        u1 = load(a, line + width + j)
        store(load(a, to + j) - (f0 * u0 + f1 * u1), a, to + j)
        store(load(a, to + there + j) - (g0 * u0 + g1 * u1), a, to + there + j)


@kernel
def _subtract_panel(a, line, width, factors, to, there, columns):
    """As `_subtract_pair` with eight m."""
    low = factors
    high = factors + there
    f0 = load(a, low)
    f1 = load(a, low + 1)
    f2 = load(a, low + 2)
    f3 = load(a, low + 3)
    f4 = load(a, low + 4)
    f5 = load(a, low + 5)
    f6 = load(a, low + 6)
    f7 = load(a, low + 7)
    g0 = load(a, high)
    g1 = load(a, high + 1)
    g2 = load(a, high + 2)
    g3 = load(a, high + 3)
    g4 = load(a, high + 4)
    g5 = load(a, high + 5)
    g6 = load(a, high + 6)
    g7 = load(a, high + 7)
    l1 = line + width
    l2 = line + 2 * width
    l3 = line + 3 * width
    l4 = line + 4 * width
    l5 = line + 5 * width
    l6 = line + 6 * width
    l7 = line + 7 * width
    for j in range(columns):
        u0 = load(a, line + j)
        u1 = load(a, l1 + j)
        u2 = load(a, l2 + j)
        u3 = load(a, l3 + j)
        p = f0 * u0 + f1 * u1
        q = g0 * u0 + g1 * u1
        p += f2 * u2 + f3 * u3
        q += g2 * u2 + g3 * u3
        u4 = load(a, l4 + j)
        u5 = load(a, l5 + j)
        u6 = load(a, l6 + j)
        u7 = load(a, l7 + j)
        p += f4 * u4 + f5 * u5
        q += g4 * u4 + g5 * u5
        p += f6 * u6 + f7 * u7
        q += g6 * u6 + g7 * u7
        store(load(a, to + j) - p, a, to + j)
        store(load(a, to + there + j) - q, a, to + there + j)


@kernel
def has_negative_pivots(lu, pattern, answer):
    """answer (TILE,): whether all pivots are but one for each pressure.

    A symmetric matrix is negative definite then, once its pressures are eliminated.
    """
    others = np.zeros(TILE, dtype=np.int64)
    answer[:] = True
    for g in range(pattern.width.shape[0]):
        at = pattern.start[g] + pattern.offset[g, g]
        for k in range(pattern.first[g + 1] - pattern.first[g]):
            for lane in range(TILE):
                pivot = lu[at + k * (pattern.width[g] + 1), lane]
                if not pivot < 0.0:
                    others[lane] += 1
                    answer[lane] &= pivot > 0.0
    for lane in range(TILE):
        answer[lane] &= others[lane] == pattern.pressures


@kernel
def solve(lu, b, pattern):
    """Replace b (unknowns, TILE) by the solution, lu as `factorise` left it, in any precision."""
    y = np.zeros((pattern.first[-1], TILE))
    groups = pattern.width.shape[0]
    _reorder(b, y, pattern, False)
    for g in range(groups):
        first = pattern.first[g]
        row = pattern.start[g]
        for k in range(pattern.first[g + 1] - first):
            value = load(y, first + k) - _dot(lu, row + pattern.offset[g, g], y, first, k)
            for m in range(pattern.lower_start[g], pattern.lower_start[g + 1]):
                c = pattern.lower[m]
                begin = pattern.first[c]
                count = pattern.first[c + 1] - pattern.first[c]
                value -= _dot(lu, row + pattern.offset[g, c], y, begin, count)
            store(value, y, first + k)
            row += pattern.width[g]
    for g in range(groups - 1, -1, -1):
        first = pattern.first[g]
        size = pattern.first[g + 1] - pattern.first[g]
        row = pattern.start[g] + size * pattern.width[g]
        for k in range(size - 1, -1, -1):
            row -= pattern.width[g]
            pivot = row + pattern.offset[g, g] + k
            value = load(y, first + k) - _dot(lu, pivot + 1, y, first + k + 1, size - k - 1)
            for m in range(pattern.upper_start[g], pattern.upper_start[g + 1]):
                c = pattern.upper[m]
                begin = pattern.first[c]
                count = pattern.first[c + 1] - pattern.first[c]
                value -= _dot(lu, row + pattern.offset[g, c], y, begin, count)
            store(value * load(lu, pivot), y, first + k)
    _reorder(y, b, pattern, True)


@kernel
def solve_columns(lu, b, pattern, transposed):
    """As `solve` for the four columns of b (4, unknowns, TILE), of the `transposed` matrix or not.

    The factors are far larger than the columns and are read once for all of them.
    """
    y = np.zeros((COLUMNS, pattern.first[-1], TILE))
    groups = pattern.width.shape[0]
    for m in range(COLUMNS):
        _reorder(b[m], y[m], pattern, False)
    for g in range(groups):
        first = pattern.first[g]
        row = pattern.start[g]
        size = pattern.first[g + 1] - first
        for k in range(size):
            diagonal = row + pattern.offset[g, g]
            if transposed:
                _scale(y, first + k, load(lu, diagonal + k))
                _spread(lu, diagonal + k + 1, y, first + k, first + k + 1, size - k - 1)
                neighbours = pattern.upper
                ends = pattern.upper_start
            else:
                _gather(lu, diagonal, y, first + k, first, k)
                neighbours = pattern.lower
                ends = pattern.lower_start
            for m in range(ends[g], ends[g + 1]):
                _with_block(lu, row, y, first + k, pattern, g, neighbours[m], transposed)
            row += pattern.width[g]
    for g in range(groups - 1, -1, -1):
        first = pattern.first[g]
        size = pattern.first[g + 1] - pattern.first[g]
        row = pattern.start[g] + size * pattern.width[g]
        for k in range(size - 1, -1, -1):
            row -= pattern.width[g]
            diagonal = row + pattern.offset[g, g]
            if transposed:
                _spread(lu, diagonal, y, first + k, first, k)
                neighbours = pattern.lower
                ends = pattern.lower_start
            else:
                _gather(lu, diagonal + k + 1, y, first + k, first + k + 1, size - k - 1)
                neighbours = pattern.upper
                ends = pattern.upper_start
            for m in range(ends[g], ends[g + 1]):
                _with_block(lu, row, y, first + k, pattern, g, neighbours[m], transposed)
            if not transposed:
                _scale(y, first + k, load(lu, diagonal + k))
    for m in range(COLUMNS):
        _reorder(y[m], b[m], pattern, True)


@kernel
def _reorder(source, target, pattern, back):
    """From the order of particles to that of elimination, or `back`; pressures are left out."""
    for i in range(1, pattern.group.shape[0] - pattern.pressures):
        here = 2 * i - 2
        there = pattern.first[pattern.group[i]] + pattern.column[i]
        if back:
            here, there = there, here
        store(load(source, here), target, there)
        store(load(source, here + 1), target, there + 1)


@kernel
def _dot(lu, at, y, first, count):
    """Σ_j lu[at + j] y[first + j] over j < count, in four chains."""
    s0 = spread(0.0)
    s1 = spread(0.0)
    s2 = spread(0.0)
    s3 = spread(0.0)
    for j in range(0, count - 3, 4):
        s0 += load(lu, at + j) * load(y, first + j)
        s1 += load(lu, at + j + 1) * load(y, first + j + 1)
        s2 += load(lu, at + j + 2) * load(y, first + j + 2)
        s3 += load(lu, at + j + 3) * load(y, first + j + 3)
    for j in range(count - count % 4, count):
        s0 += load(lu, at + j) * load(y, first + j)
    return (s0 + s1) + (s2 + s3)


@pair_law
def _with_block(lu, row, y, here, pattern, g, c, transposed):
    """`_spread` or `_gather` with the columns of group c in a row of group g."""
    at = pattern.offset[g, c]
    first = pattern.first[c]
    count = pattern.first[c + 1]
    if transposed:
        _spread(lu, row + at, y, here, first, count - first)
    else:
        _gather(lu, row + at, y, here, first, count - first)


@kernel
def _gather(lu, at, y, here, first, count):
    """y[:, here] −= Σ_j lu[at + j] y[:, first + j] over j < count."""
    s0 = load(y, 0, here)
    s1 = load(y, 1, here)
    s2 = load(y, 2, here)
    s3 = load(y, 3, here)
    for j in range(count):
        factor = load(lu, at + j)
        s0 -= factor * load(y, 0, first + j)
        s1 -= factor * load(y, 1, first + j)
        s2 -= factor * load(y, 2, first + j)
        s3 -= factor * load(y, 3, first + j)
    store(s0, y, 0, here)
    store(s1, y, 1, here)
    store(s2, y, 2, here)
    store(s3, y, 3, here)


@kernel
def _spread(lu, at, y, here, first, count):
    """y[:, first + j] −= lu[at + j] y[:, here] for j < count."""
    s0 = load(y, 0, here)
    s1 = load(y, 1, here)
    s2 = load(y, 2, here)
    s3 = load(y, 3, here)
    for j in range(count):
        factor = load(lu, at + j)
        store(load(y, 0, first + j) - factor * s0, y, 0, first + j)
        store(load(y, 1, first + j) - factor * s1, y, 1, first + j)
        store(load(y, 2, first + j) - factor * s2, y, 2, first + j)
        store(load(y, 3, first + j) - factor * s3, y, 3, first + j)


@kernel
def _scale(y, here, pivot):
    for m in range(COLUMNS):
        store(load(y, m, here) * pivot, y, m, here)


@kernel
def solved_columns(matrices, first, topology):
    """(4, free, TILE) −J⁻¹ ∂f of four of the columns, J factorised: how x follows F or Ḟ."""
    steps = np.empty((COLUMNS, *matrices.step.shape))
    for m in range(COLUMNS):
        for i in range(steps.shape[1]):
            store(-load(matrices.columns, i + 2, first + m), steps, m, i)
    solve_columns(matrices.matrix, steps, topology, False)
    return steps
