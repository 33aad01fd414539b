"""Matrices of an RVE in blocks, one matrix a lane: their layout and their LU factors.

Particles are gathered in groups, the fluid of a plant cell or the wall particles along an edge;
groups that interact have a full block. One group of all particles is a dense matrix. Groups are
eliminated in the order of minimum degree, and blocks that elimination fills in are part of the
pattern, which is made once for all RVEs. All rows of a group have the same layout: its blocks in
the order of elimination, without gaps between them::

    values[start[g] + (column[i] + a) · width[g] + offset[g, h] + column[j] + b, lane]
        couples component a of particle i of group g with component b of particle j of group h

Values and factors are (size, TILE), all of one `Pattern`. No pivoting: near a stable equilibrium
the symmetric part of the matrices is definite, and a factorisation that is inaccurate shows as a
solve that does not converge. Eight columns are eliminated at a time, so that what is updated is
read and written an eighth as often, and rows in pairs, the two of a particle. A right-hand side b
has two entries for each particle except the held one.

Pressures are unknowns, too, but have no entries in b: their equations have the right-hand side
zero, and their values are not needed. As each couples a whole rim, the matrix with them is much
emptier than the one without. They lie like particles behind all others, with a second unknown that
is idle.
With them the matrix of a stable equilibrium has a positive pivot for each pressure, else negative
ones (Haynsworth: its inertia is that of −1/p′ and that of the matrix without them).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.arrays import Array
from surrofe2.base.compilation import kernel, pair_law
from surrofe2.base.simd import TILE, load, spread, store

Ints = NDArray[np.int32]

HELD = -1
"""Group and column of particle 0, which is held and has no unknowns."""
NO_BLOCK = -1
"""Place of the block of two groups, or two particles, that are not coupled."""
PANEL = 8
"""Columns that are eliminated at a time; `_subtract_panel` is written out for this number."""
COLUMNS = 4
"""Right-hand sides that `solve_columns` solves at a time: the four entries of F, or of Ḟ."""


class Pattern(NamedTuple):
    """Layout of matrices and their factors; groups are numbered as they are eliminated.

    group, column: (particles,) group of each particle, and its first column within the blocks of
        that group; HELD for particle 0. Particle i has the unknowns first[group[i]] + column[i]
        and the next.
    first: (groups + 1,) first unknown of each group in the order of elimination.
    width: (groups,) entries of a row.
    start: (groups,) where the first row of a group begins.
    offset: (groups, groups) where a block begins within a row, NO_BLOCK where there is none.
    lower, upper: (·,) neighbours eliminated before and after, ascending; those of g are
        lower[lower_start[g]:lower_start[g + 1]].
    block: (particles, particles) where the 2 × 2 block of two particles begins, or NO_BLOCK.
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
    """Order groups by minimum degree, and lay out their blocks and those that fill in.

    Args:
        labels: (particles,) group of each particle, any numbers; particle 0 is held. The last
            `pressures` of them are pressures.
        pairs: groups, by their labels, that interact.
    """
    labels = np.asarray(labels)
    members = {g: 1 + np.flatnonzero(labels[1:] == g) for g in np.unique(labels[1:]).tolist()}
    later = _eliminated(members, pairs)
    rank = {label: g for g, label in enumerate(later)}
    count = len(later)
    upper = [sorted(rank[label] for label in others) for others in later.values()]
    lower = [[h for h in range(g) if g in upper[h]] for g in range(count)]
    size = [2 * len(members[label]) for label in later]
    offset = np.full((count, count), NO_BLOCK, dtype=np.int32)
    width = np.zeros(count, dtype=np.int32)
    start = np.zeros(count, dtype=np.int32)
    group = np.full(len(labels), HELD, dtype=np.int32)
    column = np.full(len(labels), HELD, dtype=np.int32)
    total = 0
    for g, label in enumerate(later):
        particles = members[label]
        row_length = 0
        for h in [*lower[g], g, *upper[g]]:
            offset[g, h] = row_length
            row_length += size[h]
        width[g] = row_length
        start[g] = total
        group[particles] = g
        column[particles] = 2 * np.arange(len(particles))
        total += size[g] * row_length
    # particle 0 is HELD, −1, and reads the rows of the last group here; `exists` leaves it out
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
        block=np.where(exists, blocks, NO_BLOCK).astype(np.int32),
        stride=stride,
        size=total,
        pressures=pressures,
    )


def _eliminated(
    members: dict[int, NDArray[Any]], pairs: Iterable[tuple[int, int]]
) -> dict[int, set[int]]:
    """Return the groups in the order of elimination, each with the later groups coupled to it.

    Minimum degree: the group whose neighbours have the fewest particles goes next. Elimination
    couples these neighbours to each other.

    Args:
        members: particles of each group, by its label.
        pairs: labels of groups that interact.
    """
    beside: dict[int, set[int]] = {label: set() for label in members}
    for g, h in pairs:
        if g != h and g in beside and h in beside:
            beside[g].add(h)
            beside[h].add(g)
    later: dict[int, set[int]] = {}
    while beside:
        # of equal degrees the lower label goes first, so that the order is always the same
        g = min(beside, key=lambda h: (sum(len(members[k]) for k in beside[h]), h))
        others = beside.pop(g)
        later[g] = others
        for h in others:
            beside[h] |= others
            beside[h] -= {g, h}
    return later


@cache
def dense_pattern(particles: int, pressures: int = 0) -> Pattern:
    """Return the pattern of full matrices: one group of all particles and pressures."""
    return make_pattern(np.zeros(particles + pressures, dtype=np.int32), [], pressures)


def factorisation_work(pattern: Pattern) -> float:
    """Estimate the multiplications of one LU factorisation.

    A group of s unknowns with r coupled ones behind it takes s³/3 + s² r + s r².
    """
    size = np.diff(pattern.first).astype(np.float64)
    ends = pattern.upper_start
    multiplications = 0.0
    for g, s in enumerate(size):
        r = size[pattern.upper[ends[g] : ends[g + 1]]].sum()
        multiplications += s**3 / 3.0 + s**2 * r + s * r**2
    return float(multiplications)


# LU factors


class Matrices(NamedTuple):
    """Scratch of one tile for linear systems; n particles.

    matrix: (size, TILE) Jacobian of the forces, then its factors.
    columns: (2n, 8, TILE) slopes of the forces by the entries of F and Ḟ.
    no_columns: empty, for kernels that are to leave these slopes out.
    step: (2n − 2, TILE) right-hand side, then solution; the held particle has no entries.
    """

    matrix: Array
    columns: Array
    no_columns: Array
    step: Array


@kernel
def make_matrices(topology):
    """Return `Matrices` that are not initialised."""
    n = topology.particles
    return Matrices(
        np.empty((topology.size, TILE)),
        np.empty((2 * n, 8, TILE)),
        np.empty((0, 8, TILE)),
        np.empty((2 * n - 2, TILE)),
    )


@kernel
def factorise(a, pattern, symmetric):
    """Replace a (size, TILE) by its LU factors.

    L has a unit diagonal, so the diagonal is free to hold the reciprocal pivots of U. Where a is
    `symmetric`, elimination keeps to the upper triangle, at half the work.
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
                # of the type of g, so that numba compiles one version for both calls
                _eliminate(a, pattern, g, np.int64(pattern.upper[m]), k, symmetric)


@kernel
def _factorise_panel(a, panel, width, diagonal, count):
    """Eliminate the first columns of the `count` rows at `panel` from each other.

    a: (size, TILE). diagonal: column of the panel's first pivot within its rows, which are `width`
    long.
    """
    for k in range(count):
        pivot_row = panel + k * width
        pivot = 1.0 / load(a, pivot_row + diagonal + k)
        store(pivot, a, pivot_row + diagonal + k)
        for i in range(k + 1, count):
            row = panel + i * width
            factor = load(a, row + diagonal + k) * pivot
            store(factor, a, row + diagonal + k)
            for j in range(diagonal + k + 1, width):
                store(load(a, row + j) - factor * load(a, pivot_row + j), a, row + j)


@kernel
def _eliminate(a, pattern, g, h, k, symmetric):
    """Clear the panel's columns from the rows of group h that lie below the panel.

    The panel is the PANEL rows (or those that are left) of group g from its row k on. Rows of h are
    taken in pairs, those of one particle:

    - their entries in the panel's columns become multipliers, `_set_multipliers`;
    - in every group of columns right of these, row −= multipliers · panel, `_update`.

    If the matrix is symmetric, columns left of the diagonal are skipped.
    """
    size = pattern.first[g + 1] - pattern.first[g]
    rows = pattern.first[h + 1] - pattern.first[h]
    width = pattern.width[g]
    diagonal = pattern.offset[g, g]
    row_width = pattern.width[h]
    multipliers = pattern.offset[h, g] + k
    count = min(PANEL, size - k)
    panel = pattern.start[g] + k * width
    first_row = k + count if h == g else 0
    for i in range(first_row, rows, 2):
        row = pattern.start[h] + i * row_width
        mirror = pattern.offset[g, h] + i
        _set_multipliers(
            a, panel, width, diagonal + k, count, row, row_width, multipliers, mirror, symmetric
        )
        if h == g or not symmetric:
            # columns of g itself: those of the panel are cleared already; if symmetric, those up to
            # the whole panel that row i lies in are not needed
            skip = i - i % PANEL if symmetric else k + count
            begin = diagonal + skip
            target = pattern.offset[h, g] + skip
            _update(a, panel, width, count, row, row_width, multipliers, begin, target, size - skip)
        for m in range(pattern.upper_start[g], pattern.upper_start[g + 1]):
            c = pattern.upper[m]
            if c >= h or not symmetric:
                skip = i - i % PANEL if symmetric and c == h else 0
                begin = pattern.offset[g, c] + skip
                target = pattern.offset[h, c] + skip
                columns = pattern.first[c + 1] - pattern.first[c] - skip
                _update(a, panel, width, count, row, row_width, multipliers, begin, target, columns)


@kernel
def _set_multipliers(
    a, panel, width, diagonal, count, row, row_width, multipliers, mirror, symmetric
):
    """Set the multipliers of the panel's columns in the two rows at `row`, in place.

    A multiplier is the entry to be cleared, as the columns before have changed it, over the pivot.

    width, row_width: lengths of rows of the panel and of the two.
    diagonal, multipliers: where the panel's columns begin in rows of the panel and in the two.
    mirror: where the columns of the two rows begin in rows of the panel; if the matrix is
        `symmetric`, the entry to be cleared is read there.
    """
    for r in range(2):
        line = row + r * row_width + multipliers
        for k in range(count):
            pivot_row = panel + k * width
            if symmetric:
                value = load(a, pivot_row + mirror + r)
            else:
                value = load(a, line + k)
                for m in range(k):
                    value -= load(a, line + m) * load(a, panel + m * width + diagonal + k)
            store(value * load(a, pivot_row + diagonal + k), a, line + k)


@kernel
def _update(a, panel, width, count, row, row_width, multipliers, begin, target, columns):
    """Subtract multiples of the panel's `count` rows from the two rows at `row`.

    It takes `columns` entries: from `begin` on in rows of the panel, from `target` on in the two.
    """
    if count == PANEL:
        _subtract_panel(
            a, panel + begin, width, row + multipliers, row + target, row_width, columns
        )
    else:
        # a last panel is smaller, but even: the two rows of each particle
        for k in range(0, count, 2):
            line = panel + k * width + begin
            _subtract_pair(a, line, width, row + multipliers + k, row + target, row_width, columns)


@kernel
def _subtract_pair(a, line, width, factors, target, row_width, columns):
    """Set a[target + j] −= Σ_m a[factors + m] a[line + m · width + j] over m < 2, j < columns.

    It does the same for the row `row_width` further on, with its own factors.
    """
    f0 = load(a, factors)
    f1 = load(a, factors + 1)
    g0 = load(a, factors + row_width)
    g1 = load(a, factors + row_width + 1)
    for j in range(columns):
        u0 = load(a, line + j)
        u1 = load(a, line + width + j)
        store(load(a, target + j) - (f0 * u0 + f1 * u1), a, target + j)
        store(load(a, target + row_width + j) - (g0 * u0 + g1 * u1), a, target + row_width + j)


@kernel
def _subtract_panel(a, line, width, factors, target, row_width, columns):
    """Do as `_subtract_pair`, with the eight rows of a whole panel: m < PANEL.

    It is written out, for the sixteen factors then stay in registers.
    """
    low = factors
    high = factors + row_width
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
        store(load(a, target + j) - p, a, target + j)
        store(load(a, target + row_width + j) - q, a, target + row_width + j)


@kernel
def has_negative_pivots(lu, pattern, answer):
    """Set answer (TILE,) to whether all pivots are negative, except a positive one per pressure.

    A symmetric matrix is negative definite then, once its pressures are eliminated.
    """
    positive = np.zeros(TILE, dtype=np.int64)
    answer[:] = True
    for g in range(pattern.width.shape[0]):
        first_pivot = pattern.start[g] + pattern.offset[g, g]
        for k in range(pattern.first[g + 1] - pattern.first[g]):
            for lane in range(TILE):
                pivot = lu[first_pivot + k * (pattern.width[g] + 1), lane]
                # `not <`, since a pivot may be NaN, which is not positive either
                if not pivot < 0.0:
                    positive[lane] += 1
                    answer[lane] &= pivot > 0.0
    for lane in range(TILE):
        answer[lane] &= positive[lane] == pattern.pressures


@kernel
def solve(lu, b, pattern):
    """Replace b (unknowns, TILE) by the solution of L U x = b.

    lu: (size, TILE) factors as `factorise` leaves them, in single or double precision.
    """
    # zero, as the equations of pressures have nothing on the right, and `_reorder` skips them
    y = np.zeros((pattern.first[-1], TILE))
    groups = pattern.width.shape[0]
    _reorder(b, y, pattern, False)
    # forwards by L, whose diagonal is 1
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
    # backwards by U, whose diagonal holds reciprocals
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
    """Replace the columns of b (COLUMNS, unknowns, TILE) by solutions, as `solve` does for one.

    The factors are far larger than the columns and are read once for all of them. They lie by rows:
    to solve with the matrix, each row is multiplied by what is solved already (`_gather`); to solve
    with the `transposed` one, each unknown is subtracted along its row (`_spread`).
    """
    # zero for pressures, as in `solve`
    y = np.zeros((COLUMNS, pattern.first[-1], TILE))
    groups = pattern.width.shape[0]
    for m in range(COLUMNS):
        _reorder(b[m], y[m], pattern, False)
    # forwards: by L, or by the transposed U, whose diagonal holds reciprocals
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
    # backwards: by U, or by the transposed L, whose diagonal is 1
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
    """Copy unknowns (unknowns, TILE) from the order of particles to that of elimination, or `back`.

    The held particle and the pressures are left out.
    """
    for i in range(1, pattern.group.shape[0] - pattern.pressures):
        begin = 2 * i - 2
        end = pattern.first[pattern.group[i]] + pattern.column[i]
        if back:
            begin, end = end, begin
        store(load(source, begin), target, end)
        store(load(source, begin + 1), target, end + 1)


@kernel
def _dot(lu, start, y, first, count):
    """Return Σ_j lu[start + j] y[first + j] over j < count.

    Four sums that do not wait for one another keep the processor busy.
    """
    s0 = spread(0.0)
    s1 = spread(0.0)
    s2 = spread(0.0)
    s3 = spread(0.0)
    for j in range(0, count - 3, 4):
        s0 += load(lu, start + j) * load(y, first + j)
        s1 += load(lu, start + j + 1) * load(y, first + j + 1)
        s2 += load(lu, start + j + 2) * load(y, first + j + 2)
        s3 += load(lu, start + j + 3) * load(y, first + j + 3)
    for j in range(count - count % 4, count):
        s0 += load(lu, start + j) * load(y, first + j)
    return (s0 + s1) + (s2 + s3)


@pair_law
def _with_block(lu, row, y, unknown, pattern, g, c, transposed):
    """Do `_spread` or `_gather` with the columns of group c in a row of group g."""
    start = row + pattern.offset[g, c]
    first = pattern.first[c]
    end = pattern.first[c + 1]
    if transposed:
        _spread(lu, start, y, unknown, first, end - first)
    else:
        _gather(lu, start, y, unknown, first, end - first)


@kernel
def _gather(lu, start, y, unknown, first, count):
    """Set y[:, unknown] −= Σ_j lu[start + j] y[:, first + j] over j < count."""
    s0 = load(y, 0, unknown)
    s1 = load(y, 1, unknown)
    s2 = load(y, 2, unknown)
    s3 = load(y, 3, unknown)
    for j in range(count):
        factor = load(lu, start + j)
        s0 -= factor * load(y, 0, first + j)
        s1 -= factor * load(y, 1, first + j)
        s2 -= factor * load(y, 2, first + j)
        s3 -= factor * load(y, 3, first + j)
    store(s0, y, 0, unknown)
    store(s1, y, 1, unknown)
    store(s2, y, 2, unknown)
    store(s3, y, 3, unknown)


@kernel
def _spread(lu, start, y, unknown, first, count):
    """Set y[:, first + j] −= lu[start + j] y[:, unknown] for j < count."""
    s0 = load(y, 0, unknown)
    s1 = load(y, 1, unknown)
    s2 = load(y, 2, unknown)
    s3 = load(y, 3, unknown)
    for j in range(count):
        factor = load(lu, start + j)
        store(load(y, 0, first + j) - factor * s0, y, 0, first + j)
        store(load(y, 1, first + j) - factor * s1, y, 1, first + j)
        store(load(y, 2, first + j) - factor * s2, y, 2, first + j)
        store(load(y, 3, first + j) - factor * s3, y, 3, first + j)


@kernel
def _scale(y, unknown, pivot):
    """Multiply y[:, unknown] by a reciprocal pivot, in every column."""
    for m in range(COLUMNS):
        store(load(y, m, unknown) * pivot, y, m, unknown)


@kernel
def solved_columns(matrices, first, topology):
    """Return −J⁻¹ ∂f/∂(entries of F or Ḟ), (COLUMNS, free, TILE): how positions x follow them.

    matrices.matrix holds the factors of J; first: 0 for columns of F, COLUMNS for those of Ḟ.
    """
    steps = np.empty((COLUMNS, *matrices.step.shape))
    for m in range(COLUMNS):
        for i in range(steps.shape[1]):
            # the first two rows are those of the held particle
            store(-load(matrices.columns, i + 2, first + m), steps, m, i)
    solve_columns(matrices.matrix, steps, topology, False)
    return steps
