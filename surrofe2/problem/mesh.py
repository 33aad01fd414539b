"""Meshes are those of scikit-fem: what a problem needs of one, and names for its parts.

Quadrilaterals are `skfem.MeshQuad1`, triangles `skfem.MeshTri2` with six nodes; a `skfem.MeshTri1`
gets the middles of its sides. Lengths are in µm. Boundaries are named sets of facets, which must be
outer ones where they are loaded; regions are named subdomains of elements. Nodes, the columns of
`mesh.p`, are numbered as scikit-fem numbers the unknowns of `mesh.elem`: unknown 2 a + i of its
`ElementVector` is component i of node a.
"""

from __future__ import annotations

import difflib
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # scipy.spatial is loaded where places are compared
import skfem
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.errors import InputError, quoted
from surrofe2.base.settings import build_only, check_settings, check_value, setting, with_kind
from surrofe2.base.units import LENGTH, with_micro_sign

MOST_ELEMENTS = 10_000_000
_CORNER: Mapping[str, Any] = {"unit": LENGTH, "inf": True}
_ELEMENTS = skfem.ElementQuad1, skfem.ElementTriP1, skfem.ElementTriP2
DIGITS = 1e-6
"""Of the largest coordinate: what files of single precision or of six digits may lose."""
CLOSED = 1e-3
"""Of a side's length: parts of a mesh that are nearer to each other are meant to be one."""


class Part(ABC):
    """A part of the plane, by which a boundary or a region gets its name."""

    __slots__ = ()

    @abstractmethod
    def holds(self, points: Array, slack: float = 0.0) -> Flags:
        """(n,) whether each of the points (n, 2) is in it, or at most `slack` outside, µm; what
        rounding moves is inside in any case."""

    @staticmethod
    def read(where: str, entry: Any) -> Part:
        """What a recipe states: a box, a half plane or a circle."""
        return build_only(PARTS, entry, where)

    def entry(self) -> dict[str, Any]:
        """What a recipe has under its name."""
        return dict([with_kind(self, PARTS)])


@dataclass(frozen=True, slots=True)
class Box(Part):
    """x from low[0] to high[0], y from low[1] to high[1], edges included, µm."""

    low: tuple[float, float]
    high: tuple[float, float]

    def __post_init__(self) -> None:
        for name in ("low", "high"):
            corner = check_value(f"box.{name}", getattr(self, name), tuple[float, float], _CORNER)
            object.__setattr__(self, name, corner)

    def holds(self, points: Array, slack: float = 0.0) -> Flags:
        low, high = np.array(self.low), np.array(self.high)
        width = high - low
        slack = max(slack, 1e-9 * np.max(width[np.isfinite(width)], initial=1.0))
        inside = (points >= low - slack) & (points <= high + slack)
        return np.asarray(inside.all(axis=1))

    @staticmethod
    def read(where: str, entry: Any) -> Box:
        ends = tuple[float, float, float, float]
        x0, y0, x1, y1 = check_value(where, entry, ends, {"unit": LENGTH, "inf": True})
        if x0 > x1 or y0 > y1:
            raise InputError(where, f"{[x0, y0, x1, y1]}; it must be [x0, y0, x1, y1], low to high")
        return Box((x0, y0), (x1, y1))

    def entry(self) -> dict[str, Any]:
        return {"box": [*self.low, *self.high]}


@dataclass(frozen=True, slots=True)
class HalfPlane(Part):
    """All points p with (p − through)·normal ≥ 0, µm."""

    through: tuple[float, float] = setting(about="a point of its edge", unit=LENGTH)
    normal: tuple[float, float] = setting(about="pointing into it")

    def __post_init__(self) -> None:
        check_settings(self, "half_plane")
        if not any(self.normal):
            raise InputError("half_plane.normal", f"{list(self.normal)}; it must not be zero")

    def holds(self, points: Array, slack: float = 0.0) -> Flags:
        slack = max(slack, 1e-9 * abs(points).max(initial=1.0))
        normal = np.array(self.normal) / np.linalg.norm(self.normal)
        return (points - np.array(self.through)) @ normal >= -slack


@dataclass(frozen=True, slots=True)
class Disc(Part):
    """All points at most `radius` from the centre, µm."""

    centre: tuple[float, float] = setting(about="its middle", unit=LENGTH)
    radius: float = setting(about="radius of its edge", unit=LENGTH, above=0.0)

    def __post_init__(self) -> None:
        check_settings(self, "circle")

    def holds(self, points: Array, slack: float = 0.0) -> Flags:
        distance = np.linalg.norm(points - np.array(self.centre), axis=1)
        return np.asarray(distance <= self.radius + max(slack, 1e-9 * self.radius))


PARTS: dict[str, type[Part]] = {"box": Box, "half_plane": HalfPlane, "circle": Disc}


def rectangle(width: float, height: float, elements: tuple[int, int]) -> skfem.MeshQuad1:
    """[0, width] × [0, height] µm in equal quadrilaterals, numbered along y, then x.

    Its sides are the boundaries left, right, bottom and top.
    """
    nx, ny = check_value("mesh.elements", elements, tuple[int, int], {})
    width = check_value("mesh.width", width, float, {"unit": LENGTH, "above": 0.0})
    height = check_value("mesh.height", height, float, {"unit": LENGTH, "above": 0.0})
    if not (min(nx, ny) >= 1 and nx * ny <= MOST_ELEMENTS):
        raise InputError(
            f"mesh.elements: {quoted([nx, ny])}; there must be at least 1 each way and "
            f"{MOST_ELEMENTS} in all at most"
        )
    mesh = skfem.MeshQuad1.init_tensor(
        np.linspace(0.0, width, nx + 1), np.linspace(0.0, height, ny + 1)
    )
    counter_clockwise = skfem.MeshQuad1(mesh.p, mesh.t[[0, 3, 2, 1]])
    return with_boundaries(
        counter_clockwise,
        left=Box((0.0, 0.0), (0.0, height)),
        right=Box((width, 0.0), (width, height)),
        bottom=Box((0.0, 0.0), (width, 0.0)),
        top=Box((0.0, height), (width, height)),
    )


def with_boundaries(mesh: skfem.Mesh, **parts: Part) -> skfem.Mesh:
    """The mesh with more boundaries: the outer sides whose nodes all lie in a part, or as near to
    it as `precision` says.

    Raises:
        InputError: there is none.
    """
    if not parts:
        return mesh
    outer, slack = mesh.boundary_facets(), precision(mesh)
    sides, named = facet_nodes(mesh, outer), {}
    for name, part in _by_name("mesh.boundaries", parts):
        named[name] = outer[part.holds(mesh.p.T, slack)[sides].all(axis=1)]
        if not named[name].size:
            raise InputError(
                f"mesh.boundaries.{name}: {part}; it must hold both ends of an outer side; "
                f"the mesh {_reach(mesh)}"
            )
    return mesh.with_boundaries(named)


def with_regions(mesh: skfem.Mesh, **parts: Part) -> skfem.Mesh:
    """The mesh with more regions: the elements whose centre lies in a part, or as near to it as
    `precision` says.

    Raises:
        InputError: there is none.
    """
    if not parts:
        return mesh
    centres, slack, named = mesh.p.T[element_nodes(mesh)].mean(axis=1), precision(mesh), {}
    for name, part in _by_name("mesh.regions", parts):
        named[name] = np.flatnonzero(part.holds(centres, slack))
        if not named[name].size:
            raise InputError(
                f"mesh.regions.{name}: {part}; it must hold the centre of an element; the mesh "
                f"{_reach(mesh)}"
            )
    return mesh.with_subdomains(named)


def _by_name(where: str, parts: Mapping[str, Part]) -> Iterator[tuple[str, Part]]:
    """Names, in which Python makes Greek mu of the micro sign, and their parts."""
    for name, part in parts.items():
        if not hasattr(part, "holds"):
            raise InputError(
                f"{where}.{name}", f"{quoted(part)}; it must be a Box, a HalfPlane or a Disc"
            )
        yield with_micro_sign(name), part


def precision(mesh: skfem.Mesh) -> float:
    """Distance within which two places of a mesh are the same, µm.

    Files of single precision, or of six digits, have coordinates that are off by a millionth of the
    largest one. It is at most a thousandth of the shortest side.
    """
    ends = mesh.p[:, mesh.facets]
    shortest = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=0).min()
    return float(min(DIGITS * abs(mesh.p).max(), CLOSED * shortest))


def _reach(mesh: skfem.Mesh) -> str:
    low, high = extent(mesh)
    return f"reaches from ({low[0]:.9g}, {low[1]:.9g}) to {_at(high, 9)}"


def element_nodes(mesh: skfem.Mesh) -> Index:
    """(n_el, 4) or (n_el, 6) nodes of each element: corners, then the middles of a triangle's sides
    0–1, 1–2 and 0–2."""
    return np.ascontiguousarray(mesh.dofs.element_dofs.T, dtype=np.int64)


def facet_nodes(mesh: skfem.Mesh, facets: NDArray[np.integer]) -> Index:
    """(m, 2) or (m, 3) nodes of facets: both ends with the tissue on the left of the way from the
    first to the second, then the middle."""
    facets = np.asarray(facets, dtype=np.int64)
    ends = mesh.facets[:, facets].T.astype(np.int64)
    x, centre = mesh.p.T[ends], mesh.p[:, mesh.t[:, mesh.f2t[0, facets]]].mean(axis=1).T
    along, inward = x[:, 1] - x[:, 0], centre - x[:, 0]
    is_right = along[:, 0] * inward[:, 1] < along[:, 1] * inward[:, 0]
    ends[is_right] = ends[is_right, ::-1]
    if mesh.elem is skfem.ElementTriP2:
        ends = np.column_stack([ends, mesh.dofs.facet_dofs[0, facets]])
    return ends


def boundary(mesh: skfem.Mesh, name: str, where: str = "boundary") -> Index:
    """(m,) outer facets of a boundary; `where` says who asks.

    Raises:
        InputError: there is none of that name, another thing has the name, or it has facets within
            the tissue, or none.
    """
    facets = facets_of(mesh, name, where)
    inner = facets[mesh.f2t[1, facets] != -1]
    if inner.size:
        a, b = mesh.p.T[mesh.facets[:, inner[0]]]
        raise InputError(
            f"{where}: {name}; {inner.size} of its {facets.size} sides are within the tissue, the "
            f"first from {_at(a)} to {_at(b)}; it must have outer sides only"
        )
    return facets


def facets_of(mesh: skfem.Mesh, name: str, where: str = "boundary") -> Index:
    """(m,) facets of a boundary, within the tissue or outside; errors as of `boundary`."""
    return np.asarray(_named(mesh, mesh.boundaries, name, where, "boundary"), dtype=np.int64)


def region(mesh: skfem.Mesh, name: str | None, where: str = "region") -> Index:
    """(k,) elements of a region, of None all; else an `InputError` as of `boundary`."""
    if name is None:
        return np.arange(mesh.nelements)
    return np.asarray(_named(mesh, mesh.subdomains, name, where, "region"), dtype=np.int64)


def region_numbers(
    mesh: skfem.Mesh, regions: Mapping[str, Index], where: str, elements: Index
) -> Index:
    """(m,) which of the regions each of the elements is in; an `InputError` unless in just one."""
    number, claims = np.zeros((2, mesh.nelements), np.int64)
    for k, own in enumerate(regions.values()):
        number[own] = k
        claims[own] += 1
    for e in elements[claims[elements] != 1][:1]:
        raise InputError(
            f"{where}: element {e} at {_at(mesh.p[:, element_nodes(mesh)[e]].mean(axis=1))} is in "
            f"{claims[e]} of {', '.join(regions)}; every element must be in one"
        )
    return number[elements]


def nodes_on(mesh: skfem.Mesh, name: str | None, where: str = "on") -> Index:
    """(k,) nodes of a boundary or a region, of None all; an `InputError` as of `boundary`, but for
    sides within the tissue, whose nodes may be held or moved."""
    regions = mesh.subdomains or {}
    if name is None or name in regions:
        return np.unique(element_nodes(mesh)[region(mesh, name, where)])
    known = {**(mesh.boundaries or {}), **regions}
    facets = _named(mesh, known, name, where, "boundary or region")
    return np.unique(facet_nodes(mesh, facets))


def length_of(mesh: skfem.Mesh, facets: NDArray[np.integer]) -> float:
    """Length of facets together, µm."""
    if not len(facets):
        return 0.0
    return float(skfem.FacetBasis(mesh, mesh.elem(), facets=facets, intorder=6).dx.sum())


def area_of(mesh: skfem.Mesh, elements: NDArray[np.integer]) -> float:
    """Area of elements together, µm²."""
    if not len(elements):
        return 0.0
    return float(skfem.Basis(mesh, mesh.elem(), elements=elements, intorder=4).dx.sum())


def extent(mesh: skfem.Mesh) -> tuple[Array, Array]:
    """Lowest and highest x and y, µm."""
    return mesh.p.min(axis=1), mesh.p.max(axis=1)


def check_name(mesh: skfem.Mesh, name: str, where: str) -> None:
    """Refuse a name that boundaries or regions of a mesh share, but for capitals and blanks.

    Raises:
        InputError: it is ambiguous.
    """
    plain = _plain(name)
    alike = [
        f"the {what} {quoted(known)}"
        for what, names in (("boundary", mesh.boundaries), ("region", mesh.subdomains))
        for known in names or {}
        if _plain(known) == plain
    ]
    if len(alike) > 1:
        raise InputError(f"{where}: {name}; it may mean {' or '.join(alike)}; name them apart")


def _plain(name: str) -> str:
    """A name without blanks and capitals."""
    return "".join(name.split()).casefold()


def _named(
    mesh: skfem.Mesh, known: Mapping[str, NDArray] | None, name: str, where: str, what: str
) -> NDArray[np.integer]:
    known = known or {}
    if name in known:
        check_name(mesh, name, where)
        if not len(known[name]):
            raise InputError(f"{where}: {name}; the mesh has that name, and no {what} of it")
        return known[name]
    if not known:
        raise InputError(f"{where}: {name}; the mesh has no {what} with a name; name parts of it")
    close = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean {close[0]}? " if close else ""
    raise InputError(f"{where}: {name}; no such {what}; {hint}known are {', '.join(known)}")


def check_mesh(mesh: skfem.Mesh) -> skfem.Mesh:
    """The mesh of a problem, a `MeshTri1` with the middles of its sides. Raises `InputError` where
    it is of another kind, an element is inverted or degenerate, elements lie on one another, a node
    has no element, there are several pieces, or parts touch that are not glued.
    """
    if not isinstance(mesh, skfem.Mesh) or mesh.elem not in _ELEMENTS:
        raise InputError(
            f"mesh: {type(mesh).__name__}; it must be a skfem.MeshQuad1, MeshTri1 or MeshTri2"
        )
    if mesh.t.size == 0:
        raise InputError("mesh: it has no element; it must have at least one")
    if mesh.t.min() < 0 or mesh.t.max() >= mesh.p.shape[1]:
        raise InputError(
            f"mesh.t: node {mesh.t.max()}; nodes are numbered from 0 to {mesh.p.shape[1] - 1}"
        )
    _check_overlaps(mesh)
    if mesh.elem is skfem.ElementTriP1:
        _check_orphans(mesh.p.T, mesh.t)
        # Facets and elements keep their numbers, so boundaries and regions are the same, too.
        boundaries, regions = mesh.boundaries or {}, mesh.subdomains or {}
        mesh = skfem.MeshTri2.from_mesh(mesh)
        mesh = mesh.with_boundaries(boundaries).with_subdomains(regions)
    _check_orphans(mesh.p.T, element_nodes(mesh))
    _check_shapes(mesh.p.T, element_nodes(mesh))
    _check_seams(mesh)
    _check_pieces(mesh)
    return mesh


def _check_overlaps(mesh: skfem.Mesh) -> None:
    twice, count = np.unique(np.sort(mesh.t.T, axis=1), axis=0, return_counts=True)
    if count.max() > 1:
        at = mesh.p[:, twice[count.argmax()]].mean(axis=1)
        raise InputError(f"mesh: {count.max()} elements of the same nodes at {_at(at)}; keep one")
    shared = np.bincount(mesh.t2f.ravel())
    if shared.max() > 2:
        at = mesh.p[:, mesh.facets[:, shared.argmax()]].mean(axis=1)
        raise InputError(
            f"mesh: {shared.max()} elements share the side at {_at(at)}; elements must not lie on "
            "one another"
        )


def _check_orphans(nodes: Array, elements: NDArray[np.integer]) -> None:
    alone = np.setdiff1d(np.arange(len(nodes)), elements)
    if alone.size:
        raise InputError(
            f"mesh: {alone.size} nodes without an element, the first is {alone[0]} at "
            f"{_at(nodes[alone[0]])}; remove them"
        )


def _check_shapes(nodes: Array, elements: Index) -> None:
    """The corners of every element must turn one way, and the middles lie near their sides."""
    x = nodes[elements[:, :4] if elements.shape[1] == 4 else elements[:, :3]]
    ahead = np.roll(x, -1, axis=1) - x
    behind = np.roll(ahead, 1, axis=1)
    turn = behind[..., 0] * ahead[..., 1] - behind[..., 1] * ahead[..., 0]
    # scikit-fem takes elements either way round.
    turn *= np.where(turn.sum(axis=1, keepdims=True) < 0.0, -1.0, 1.0)
    size = np.linalg.norm(ahead, axis=2).max(axis=1)
    flat = turn.min(axis=1) / np.maximum(size, np.finfo(float).tiny) ** 2
    if elements.shape[1] == 6:
        middle = 0.5 * (x + np.roll(x, -1, axis=1))
        away = np.linalg.norm(nodes[elements[:, 3:]] - middle, axis=2).max(axis=1)
        flat = np.where(away > 0.25 * size, -1.0, flat)
    worst = int(flat.argmin())
    if not flat[worst] > 1e-6:
        what = "inverted" if flat[worst] < -1e-6 else "degenerate"
        raise InputError(
            f"mesh: element {worst} at {_at(x[worst].mean(axis=0))} is {what}; its corners must go "
            "round it and bulge outward"
        )


def _check_seams(mesh: skfem.Mesh) -> None:
    """Nodes of outer sides must not lie on one another, nor on outer sides that do not have them:
    a crack would run there."""
    nodes, outer = mesh.p.T, mesh.boundary_facets()
    ends = mesh.facets[:, outer].T
    x = nodes[ends]
    length = np.linalg.norm(x[:, 1] - x[:, 0], axis=1)
    outline = np.unique(ends)
    shortest = np.full(len(nodes), np.inf)  # of the outer sides at each node
    np.minimum.at(shortest, ends, length[:, None])
    tree = scipy.spatial.cKDTree(nodes[outline])
    near = outline[tree.query_pairs(CLOSED * shortest[outline].max(), output_type="ndarray")]
    apart = np.linalg.norm(nodes[near[:, 0]] - nodes[near[:, 1]], axis=1)
    for pair in near[apart <= CLOSED * shortest[near].min(axis=1)][:1]:
        raise InputError(
            f"mesh: two nodes at {_at(nodes[pair[0]])}, so parts of the mesh touch there and are "
            "not glued; merge such nodes (in Gmsh: Coherence before meshing, or Coherence Mesh)"
        )
    if mesh.elem is skfem.ElementTriP2:
        middle = nodes[mesh.dofs.facet_dofs[0, outer]]
    else:
        middle = x.mean(axis=1)
    sagitta = np.linalg.norm(middle - x.mean(axis=1), axis=1)
    radius = (0.5 - CLOSED) * length + sagitta  # without the ends of a straight side
    inside = tree.query_ball_point(x.mean(axis=1), radius)
    side = np.repeat(np.arange(len(outer)), [*map(len, inside)])
    node = outline[np.concatenate([np.zeros(0, np.int64), *inside]).astype(np.int64)]
    is_other = (ends[side] != node[:, None]).all(axis=1)
    side, node = side[is_other], node[is_other]
    gap = _distance_to_sides(nodes[node], x[side], middle[side])
    for k in np.flatnonzero(gap <= CLOSED * length[side])[:1]:
        a, b = x[side[k]]
        raise InputError(
            f"mesh: the node at {_at(nodes[node[k]])} lies on the side of an element from {_at(a)} "
            f"to {_at(b)} that does not have it; the elements there must share whole sides"
        )


def _distance_to_sides(points: Array, ends: Array, middles: Array) -> Array:
    """(n,) distance of points (n, 2) to sides through their ends (n, 2, 2) and middles (n, 2).

    A side is x(s) = (1−s)(1−2s) a + 4s(1−s) m + s(2s−1) b, on which Newton's method finds the
    nearest s.
    """
    a, b = ends[:, 0], ends[:, 1]
    chord = b - a
    s = np.einsum("ni,ni->n", points - a, chord) / np.einsum("ni,ni->n", chord, chord)
    for _ in range(3):
        t = s[:, None]
        at = (
            (1.0 - t) * (1.0 - 2.0 * t) * a
            + 4.0 * t * (1.0 - t) * middles
            + t * (2.0 * t - 1.0) * b
        )
        slope = (4.0 * t - 3.0) * a + (4.0 - 8.0 * t) * middles + (4.0 * t - 1.0) * b
        s = s + np.einsum("ni,ni->n", points - at, slope) / np.einsum("ni,ni->n", slope, slope)
        s = np.clip(s, 0.0, 1.0)
    return np.linalg.norm(points - at, axis=1)


def _check_pieces(mesh: skfem.Mesh) -> None:
    first, second = mesh.t, np.roll(mesh.t, 1, axis=0)
    corners = int(mesh.t.max()) + 1
    pieces, label = _connected(corners, first.ravel(), second.ravel())
    if pieces > 1:
        sizes = np.bincount(label[mesh.t[0]])
        piece = int(sizes.argmin())
        node = int(np.flatnonzero(label == piece)[0])
        raise InputError(
            f"mesh: {pieces} pieces that do not touch, the smallest of {sizes.min()} elements "
            f"at {_at(mesh.p[:, node])}; it must be one"
        )
    inner = mesh.f2t[:, mesh.f2t[1] != -1]
    parts, part = _connected(mesh.nelements, *inner)
    if parts > 1:
        lowest, highest = np.full(corners, parts), np.full(corners, -1)
        of_corner = np.broadcast_to(part, mesh.t.shape)
        np.minimum.at(lowest, mesh.t, of_corner)
        np.maximum.at(highest, mesh.t, of_corner)
        node = int(np.flatnonzero(lowest != highest)[0])
        raise InputError(
            f"mesh: two parts share the node at {_at(mesh.p[:, node])} and no side, so that they "
            "would turn about it freely; let them share a side, or leave one out"
        )


def _connected(count: int, first: NDArray, second: NDArray) -> tuple[int, NDArray]:
    """How many pieces `count` things are that are connected in pairs, and the piece of each."""
    graph = coo_matrix((np.ones(first.size), (first, second)), (count, count))
    pieces, label = connected_components(graph, directed=False)
    return int(pieces), label


def _at(point: Array, digits: int = 6) -> str:
    return f"({point[0]:.{digits}g}, {point[1]:.{digits}g}) µm"
