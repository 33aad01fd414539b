"""Finds which of many ellipsoids hold a point: a binary tree of the boxes around them, compiled.

Each node has the box that bounds its ellipsoids, each leaf a few of them. A search goes down every
branch whose box holds the point, so unlike the tree of ISAT (Pope 1997, section 3.4), which cuts
space by planes between records, it finds all ellipsoids that hold the point.

Records come in one at a time. Where that leaves a node's children too unlike in size, the part
below is built anew (Galperin and Rivest 1993, Scapegoat trees), so the depth stays logarithmic and
so does the cost of a record, on average. Boxes of ellipsoids that grow are enlarged up to the root.
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
DEPTH = 128
"""Nodes that wait while a tree is searched, at most."""
_SLACK = 1.0 + 1e-6  # so that rounding leaves no point of an ellipsoid outside its box
_EVEN = 0.3  # by how much of their sum the children of a new node may differ
_UNBALANCED = 0.7  # largest share of a node's records in one child


class Tree(NamedTuple):
    """Nodes in the order they were made; node 0 is the root.

    Attributes:
        low, high: (nodes, 7) box.
        child: (nodes,) first of the two children, which lie side by side; −1 for a leaf.
        parent: (nodes,). size: (nodes,) records below.
        first: (nodes,) used while a part is built.
        member: (nodes, LEAF) records of a leaf.
        leaf: (records,) where each record is.
        used: (2,) nodes and records in use; the arrays may have room for more.
        tolerance: for which the ellipsoids are those of the records.
    """

    low: Array
    high: Array
    child: NDArray[np.int32]
    parent: NDArray[np.int32]
    size: NDArray[np.int32]
    first: NDArray[np.int32]
    member: NDArray[np.int32]
    leaf: NDArray[np.int32]
    used: NDArray[np.int64]
    tolerance: float


def make_tree(centre: Array, extent: Array, tolerance: float, room: int = 0) -> Tree:
    """A tree of the ellipsoids of these records, see `Records`, with room for `room` of them."""
    records = len(centre)
    room = max(room, records)
    nodes = 4 * room + 2 * LEAF
    tree = Tree(
        low=np.zeros((nodes, INPUTS)),  # all of it goes into checkpoints, the room too
        high=np.zeros((nodes, INPUTS)),
        child=np.full(nodes, -1, dtype=np.int32),
        parent=np.full(nodes, -1, dtype=np.int32),
        size=np.zeros(nodes, dtype=np.int32),
        first=np.zeros(nodes, dtype=np.int32),
        member=np.zeros((nodes, LEAF), dtype=np.int32),
        leaf=np.zeros(room, dtype=np.int32),
        used=np.array([1, records], dtype=np.int64),
        tolerance=float(tolerance),
    )
    _build(0, np.arange(records, dtype=np.int32), centre, extent, tree)
    return tree


def insert(tree: Tree, centre: Array, extent: Array, records: int) -> Tree:
    """The tree of the first `records` records, those it knows among them; in place if they fit."""
    room = len(tree.leaf) if records <= len(tree.leaf) else 0
    while room and tree.used[1] < records:
        if not _insert(tree.used[1], centre, extent, tree):
            room = 0
    if room:
        return tree
    return make_tree(centre[:records], extent[:records], tree.tolerance, 2 * records)


@kernel
def _enclose(node, ids, begin, end, centre, extent, tree):  # type: ignore[no-untyped-def]
    """Give the node the box around these records."""
    tree.low[node] = np.inf
    tree.high[node] = -np.inf
    for n in range(begin, end):
        _widen(node, ids[n], centre, extent, tree)


@kernel
def _widen(node, k, centre, extent, tree):  # type: ignore[no-untyped-def]
    """Enlarge the node's box to hold record k; whether it did not."""
    changed = False
    for i in range(INPUTS):
        half = _SLACK * np.sqrt(tree.tolerance * extent[k, i])
        low, high = centre[k, i] - half, centre[k, i] + half
        if low < tree.low[node, i]:
            tree.low[node, i] = low
            changed = True
        if high > tree.high[node, i]:
            tree.high[node, i] = high
            changed = True
    return changed


@kernel
def _build(root, ids, centre, extent, tree):  # type: ignore[no-untyped-def]
    """Build the part below `root` of the records `ids`, which are put in order; False: no room."""
    typical = np.full(INPUTS, 1e-300)
    for k in ids:
        for i in range(INPUTS):
            typical[i] += np.sqrt(tree.tolerance * extent[k, i]) / len(ids)
    tree.first[root], tree.size[root] = 0, len(ids)
    node, last = root, tree.used[0]
    while True:
        begin, size = tree.first[node], tree.size[node]
        _enclose(node, ids, begin, begin + size, centre, extent, tree)
        if size <= LEAF:
            tree.child[node] = -1
            for n in range(size):
                k = ids[begin + n]
                tree.member[node, n] = k
                tree.leaf[k] = node
        else:
            if last + 2 > len(tree.child):
                return False
            cut = begin + _partition(centre, typical, ids, begin, size)
            tree.child[node] = last
            tree.first[last], tree.size[last] = begin, cut - begin
            tree.first[last + 1], tree.size[last + 1] = cut, begin + size - cut
            tree.parent[last] = tree.parent[last + 1] = node
            last += 2
        node = tree.used[0] if node == root else node + 1
        if node >= last:
            tree.used[0] = last
            return True


@kernel
def _partition(centre, typical, ids, begin, size):  # type: ignore[no-untyped-def]
    """Put the lower half along the widest axis first, cut in space or else by number; its size."""
    axis, widest, middle = 0, -1.0, 0.0
    for i in range(INPUTS):
        least = most = centre[ids[begin], i]
        for n in range(begin, begin + size):
            least, most = min(least, centre[ids[n], i]), max(most, centre[ids[n], i])
        if (most - least) / typical[i] > widest:
            axis, widest, middle = i, (most - least) / typical[i], 0.5 * (least + most)
    cut = begin
    for n in range(begin, begin + size):
        if centre[ids[n], axis] < middle:
            ids[cut], ids[n] = ids[n], ids[cut]
            cut += 1
    if abs(2 * (cut - begin) - size) <= _EVEN * size:
        return cut - begin
    part = ids[begin : begin + size]
    along = np.empty(size)
    for n in range(size):
        along[n] = centre[part[n], axis]
    part[:] = part[np.argsort(along)]
    return size // 2


@kernel
def _insert(k, centre, extent, tree):  # type: ignore[no-untyped-def]
    """Add record k; False where there is no room for the nodes this takes."""
    node = 0
    while tree.child[node] >= 0:
        _widen(node, k, centre, extent, tree)
        tree.size[node] += 1
        left = tree.child[node]
        way, other = 0.0, 0.0
        for i in range(INPUTS):  # L1 distance to the middle of each child, in widths of the node
            width = tree.high[node, i] - tree.low[node, i] + 1e-300
            way += abs(2.0 * centre[k, i] - tree.low[left, i] - tree.high[left, i]) / width
            other += (
                abs(2.0 * centre[k, i] - tree.low[left + 1, i] - tree.high[left + 1, i]) / width
            )
        node = left if way <= other else left + 1
    size = tree.size[node]
    tree.used[1] = k + 1
    if size < LEAF:
        _widen(node, k, centre, extent, tree)
        tree.member[node, size] = k
        tree.leaf[k] = node
        tree.size[node] = size + 1
    else:
        ids = np.empty(LEAF + 1, dtype=np.int32)
        ids[:LEAF] = tree.member[node]
        ids[LEAF] = k
        if not _build(node, ids, centre, extent, tree):
            return False
    highest = -1
    while node >= 0:
        if tree.child[node] >= 0:
            left = tree.child[node]
            larger = max(tree.size[left], tree.size[left + 1])
            if larger > _UNBALANCED * tree.size[node] + LEAF:
                highest = node
        node = tree.parent[node]
    return highest < 0 or _build(highest, _below(highest, tree), centre, extent, tree)


@kernel
def _below(node, tree):  # type: ignore[no-untyped-def]
    """The records below a node."""
    ids, stack = np.empty(tree.size[node], dtype=np.int32), np.empty(DEPTH, dtype=np.int32)
    stack[0] = node
    height, found = 1, 0
    while height > 0:
        height -= 1
        at = stack[height]
        if tree.child[at] >= 0:
            stack[height], stack[height + 1] = tree.child[at], tree.child[at] + 1
            height += 2
            continue
        for n in range(tree.size[at]):
            ids[found] = tree.member[at, n]
            found += 1
    return ids


@kernel
def enlarge(k, centre, extent, tree):  # type: ignore[no-untyped-def]
    """Let the boxes hold the ellipsoid of record k, which has grown."""
    node = tree.leaf[k]
    while node >= 0 and _widen(node, k, centre, extent, tree):
        node = tree.parent[node]


@kernel
def find_all(x, limit, centre, curvature, tree, stack, records, bounds):  # type: ignore[no-untyped-def]
    """Number of records whose bound at x (7,) is at most `limit`, in rising order in `records`.

    The bound of record k is dᵀ curvature[k] d with d = x − centre[k], put into `bounds`. What does
    not fit into the arrays is left out. A box that holds ellipsoids of half width h holds those
    for another limit, s times as wide, when it is s − 1 times its own half width wider.

    stack: (`DEPTH`,) int32 room to work in.
    """
    found = 0
    if tree.used[1] == 0:
        return found
    wider = max(0.5 * (np.sqrt(limit / tree.tolerance) - 1.0), 0.0)
    stack[0] = 0
    height = 1
    while height > 0:
        height -= 1
        node = stack[height]
        inside = True
        for i in range(INPUTS):
            low, high = tree.low[node, i], tree.high[node, i]
            more = wider * (high - low)
            inside &= (x[i] >= low - more) & (x[i] <= high + more)
        if not inside:
            continue
        if tree.child[node] >= 0:
            stack[height] = tree.child[node]
            stack[height + 1] = tree.child[node] + 1
            height += 2
            continue
        for n in range(tree.size[node]):
            k = tree.member[node, n]
            bound = _bound(x, centre, curvature, k)
            if bound <= limit and found < records.shape[0]:
                place = found
                while place > 0 and records[place - 1] > k:
                    records[place], bounds[place] = records[place - 1], bounds[place - 1]
                    place -= 1
                records[place], bounds[place] = k, bound
                found += 1
    return found


@kernel
def _bound(x, centre, curvature, k):  # type: ignore[no-untyped-def]
    """dᵀ C d of record k: half of C is read, which is symmetric."""
    total = 0.0
    for i in range(INPUTS):
        row = 0.0
        for j in range(i):
            row += curvature[k, i, j] * (x[j] - centre[k, j])
        d = x[i] - centre[k, i]
        total += (2.0 * row + curvature[k, i, i] * d) * d
    return total


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
