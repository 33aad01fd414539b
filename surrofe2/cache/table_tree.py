"""Which ellipsoids of thousands hold a point: a binary tree of boxes around them, compiled.

Each node has the box that bounds its ellipsoids, each leaf a few of them. A search goes down every
branch whose box holds the point, so unlike the tree of ISAT (Pope 1997, section 3.4), which cuts
space by planes between records, it finds all ellipsoids that hold the point.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.compilation import kernel
from surrofe2.tensors import INPUTS

Array = NDArray[np.float64]

LEAF = 4
"""Most records of a leaf."""
_DEPTH = 128


class Tree(NamedTuple):
    """Nodes in the order they are made; node 0 is the root.

    Attributes:
        low, high: (nodes, 7) box.
        child: (nodes,) first of the two children, which lie side by side; −1 for a leaf.
        first, size: (nodes,) records of a leaf, as a run in `order`.
        order: (records,) record numbers.
    """

    low: Array
    high: Array
    child: NDArray[np.int32]
    first: NDArray[np.int32]
    size: NDArray[np.int32]
    order: NDArray[np.int32]


def make_tree(centre: Array, half_width: Array) -> Tree:
    """A tree over boxes of these centres and half widths, (records, 7) each."""
    records = len(centre)
    most = max(1, 2 * records)
    tree = Tree(
        np.full((most, INPUTS), np.inf),
        np.full((most, INPUTS), -np.inf),
        np.full(most, -1, dtype=np.int32),
        np.zeros(most, dtype=np.int32),
        np.zeros(most, dtype=np.int32),
        np.arange(records, dtype=np.int32),
    )
    used = _build(np.ascontiguousarray(centre), np.ascontiguousarray(half_width), *tree)
    nodes = {name: getattr(tree, name)[:used].copy() for name in Tree._fields[:-1]}
    return tree._replace(**nodes)


@kernel
def _build(centre, half_width, low, high, child, first, count, order):  # type: ignore[no-untyped-def]
    """Fill the nodes; how many are used."""
    records = centre.shape[0]
    count[0] = records
    used, node = 1, 0
    typical = np.full(INPUTS, 1e-300)
    for k in range(records):
        for i in range(INPUTS):
            typical[i] += half_width[k, i] / records
    while node < used:
        begin, size = first[node], count[node]
        least, most = np.full(INPUTS, np.inf), np.full(INPUTS, -np.inf)
        for n in range(begin, begin + size):
            k = order[n]
            for i in range(INPUTS):
                c, h = centre[k, i], half_width[k, i]
                low[node, i] = min(low[node, i], c - h)
                high[node, i] = max(high[node, i], c + h)
                least[i], most[i] = min(least[i], c), max(most[i], c)
        axis, widest = 0, -1.0
        for i in range(INPUTS):
            if (most[i] - least[i]) / typical[i] > widest:
                axis, widest = i, (most[i] - least[i]) / typical[i]
        if size > LEAF:
            cut = begin + _partition(centre, order, begin, size, axis, least[axis], most[axis])
            child[node] = used
            first[used], count[used] = begin, cut - begin
            first[used + 1], count[used + 1] = cut, begin + size - cut
            used += 2
        node += 1
    return used


@kernel
def _partition(centre, order, begin, size, axis, least, most):  # type: ignore[no-untyped-def]
    """Put the lower half along the axis first; its size, neither 0 nor all."""
    middle = 0.5 * (least + most)
    cut = begin
    for n in range(begin, begin + size):
        if centre[order[n], axis] < middle:
            order[cut], order[n] = order[n], order[cut]
            cut += 1
    if cut == begin or cut == begin + size:
        return size // 2
    return cut - begin


@kernel
def find_all(x, tolerance, centre, curvature, tree, records, bounds):  # type: ignore[no-untyped-def]
    """Number of ellipsoids that hold x (7,), of which `records` and `bounds` are filled.

    The bound of record k is dᵀ curvature[k] d with d = x − centre[k]; its ellipsoid is where that
    is at most `tolerance`. What no longer fits into the arrays is left out.
    """
    found = 0
    if centre.shape[0] == 0:
        return found
    stack = np.empty(_DEPTH, dtype=np.int32)
    stack[0] = 0
    height = 1
    d = np.empty(INPUTS)
    while height > 0:
        height -= 1
        node = stack[height]
        inside = True
        for i in range(INPUTS):
            inside &= (x[i] >= tree.low[node, i]) & (x[i] <= tree.high[node, i])
        if not inside:
            continue
        if tree.child[node] >= 0:
            stack[height] = tree.child[node]
            stack[height + 1] = tree.child[node] + 1
            height += 2
            continue
        for n in range(tree.first[node], tree.first[node] + tree.size[node]):
            k = tree.order[n]
            for i in range(INPUTS):
                d[i] = x[i] - centre[k, i]
            bound = quadratic(d, curvature[k])
            if bound <= tolerance and found < records.shape[0]:
                records[found], bounds[found] = k, bound
                found += 1
    return found


@kernel
def find(x, tolerance, centre, curvature, tree):  # type: ignore[no-untyped-def]
    """(record, bound) of the ellipsoid with the smallest bound at x (7,); −1 where none holds x."""
    count = centre.shape[0]
    records, bounds = np.empty(count, dtype=np.int32), np.empty(count)
    best, smallest = -1, tolerance
    for n in range(find_all(x, tolerance, centre, curvature, tree, records, bounds)):
        if bounds[n] <= smallest:
            best, smallest = records[n], bounds[n]
    return best, smallest


@kernel
def quadratic(d, matrix):  # type: ignore[no-untyped-def]
    """dᵀ M d."""
    total = 0.0
    for i in range(INPUTS):
        row = 0.0
        for j in range(INPUTS):
            row += matrix[i, j] * d[j]
        total += row * d[i]
    return total
