"""Meshes of scikit-fem: checks of what a problem needs of one, and names for its parts.

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

MOST_ELEMENTS = 10_000_000  # more would take all memory
# An end of a box may be infinite.
_CORNER: Mapping[str, Any] = {"unit": LENGTH, "inf": True}
_ELEMENTS = (skfem.ElementQuad1, skfem.ElementTriP1, skfem.ElementTriP2)
# Fraction of the largest coordinate that files of single precision or of six digits may lose.
DIGITS = 1e-6
# Parts of a mesh that are nearer to each other than this fraction of a side's length are meant to
# be one.
CLOSED = 1e-3
# An element is degenerate where the sine of a corner, relative to its longest side, is below this.
_FLAT = 1e-6
# The middle of a curved side may be off its chord by this fraction of the longest side.
_MOST_BEND = 0.25


class Part(ABC):
    """A part of the plane, by which a boundary or a region gets its name."""

    __slots__ = ()

    @abstractmethod
    def holds(self, points: Array, slack: float = 0.0) -> Flags:
        """Return (n,) whether each of the points (n, 2), µm, is in the part.

        A point that is at most `slack` outside, µm, is in it, and one that only rounding has moved
        out in any case.
        """

    @staticmethod
    def read(where: str, entry: Any) -> Part:
        """Read what a recipe states: a box, a half plane or a circle."""
        return build_only(PARTS, entry, where)

    def entry(self) -> dict[str, Any]:
        """Return the table that states this part in a recipe, under its name."""
        kind, entries = with_kind(self, PARTS)
        return {kind: entries}


@dataclass(frozen=True, slots=True)
class Box(Part):
    """A rectangle from `low` to `high`, edges included; coordinates in µm may be infinite.

    Examples:
        >>> import numpy as np
        >>> from surrofe2 import Box
        >>> skin = Box((0.0, 900.0), (2000.0, 1000.0))  # the upper 100 µm of 2 mm × 1 mm
        >>> points = np.array([[500.0, 950.0], [500.0, 500.0]])
        >>> skin.holds(points).tolist()
        [True, False]
    """

    low: tuple[float, float]
    high: tuple[float, float]

    def __post_init__(self) -> None:
        for name in ("low", "high"):
            corner = check_value(f"box.{name}", getattr(self, name), tuple[float, float], _CORNER)
            object.__setattr__(self, name, corner)

    def holds(self, points: Array, slack: float = 0.0) -> Flags:
        low = np.array(self.low)
        high = np.array(self.high)
        width = high - low
        rounding = 1e-9 * np.max(width[np.isfinite(width)], initial=1.0)
        slack = max(slack, rounding)
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
        rounding = 1e-9 * abs(points).max(initial=1.0)
        slack = max(slack, rounding)
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
        rounding = 1e-9 * self.radius
        return np.asarray(distance <= self.radius + max(slack, rounding))


PARTS: dict[str, type[Part]] = {"box": Box, "half_plane": HalfPlane, "circle": Disc}


@dataclass(frozen=True, slots=True)
class NodeAt:
    """The node of a mesh at a place, on which a support or a force acts alone.

    Its text, "at 0 100", stands in names of columns, which must not have commas.
    """

    point: tuple[float, float] = setting(about="place of the node", unit=LENGTH)

    def __post_init__(self) -> None:
        check_settings(self, "on")

    def __str__(self) -> str:
        return f"at {self.point[0]:g} {self.point[1]:g}"

    def node(self, mesh: skfem.Mesh, where: str) -> int:
        """Return the number of the node that is as near to the place as `precision` says.

        Raises:
            InputError: no node is so near; it names the nearest one.
        """
        offset = mesh.p.T - np.array(self.point)
        distance = np.hypot(offset[:, 0], offset[:, 1])
        nearest = int(distance.argmin())
        # mesh.width in a recipe, such as 0.1, and its nodes may differ by rounding
        slack = max(precision(mesh), 1e-9 * abs(mesh.p).max())
        if distance[nearest] > slack:
            raise InputError(
                f"{where}.point: {list(self.point)}; no node of the mesh is within {slack:.2g} µm "
                f"of it; the nearest is at {_at(mesh.p[:, nearest], 9)}, "
                f"{distance[nearest]:.3g} µm away"
            )
        return nearest


def rectangle(width: float, height: float, elements: tuple[int, int]) -> skfem.MeshQuad1:
    """Make [0, width] × [0, height] µm in equal quadrilaterals, numbered along y, then x.

    Its sides are the boundaries left, right, bottom and top.

    Raises:
        InputError: a size is not positive, or `elements` in x and y are none or too many.

    Examples:
        >>> from surrofe2 import rectangle
        >>> mesh = rectangle(2000.0, 1000.0, (4, 2))  # 2 mm × 1 mm
        >>> mesh.nelements
        8
        >>> sorted(mesh.boundaries)
        ['bottom', 'left', 'right', 'top']
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
    # scikit-fem's own are clockwise
    counter_clockwise = skfem.MeshQuad1(mesh.p, mesh.t[[0, 3, 2, 1]])
    return with_boundaries(
        counter_clockwise,
        left=Box((0.0, 0.0), (0.0, height)),
        right=Box((width, 0.0), (width, height)),
        bottom=Box((0.0, 0.0), (width, 0.0)),
        top=Box((0.0, height), (width, height)),
    )


def with_boundaries(mesh: skfem.Mesh, **parts: Part) -> skfem.Mesh:
    """Return the mesh with more boundaries, each of the outer sides whose nodes lie in a part.

    A node that is as near to the part as `precision` says lies in it.

    Raises:
        InputError: a part holds no outer side.

    Examples:
        A grip holds the right quarter of the upper side, two sides of elements of 250 µm:

        >>> from surrofe2 import Box, rectangle, with_boundaries
        >>> grip = Box((1500.0, 1000.0), (2000.0, 1000.0))
        >>> mesh = with_boundaries(rectangle(2000.0, 1000.0, (8, 4)), grip=grip)
        >>> len(mesh.boundaries["grip"])
        2
    """
    if not parts:
        return mesh
    outer = mesh.boundary_facets()
    nodes_of_side = facet_nodes(mesh, outer)
    slack = precision(mesh)
    boundaries = {}
    for name, part in _by_name("mesh.boundaries", parts):
        is_in_part = part.holds(mesh.p.T, slack)
        facets = outer[is_in_part[nodes_of_side].all(axis=1)]
        if not facets.size:
            raise InputError(
                f"mesh.boundaries.{name}: {part}; it must hold both ends of an outer side; "
                f"{_what_is_near(mesh, is_in_part)}"
            )
        boundaries[name] = facets
    return mesh.with_boundaries(boundaries)


def with_regions(mesh: skfem.Mesh, **parts: Part) -> skfem.Mesh:
    """Return the mesh with more regions, each of the elements whose centre lies in a part.

    A centre that is as near to the part as `precision` says lies in it.

    Raises:
        InputError: a part holds no centre.

    Examples:
        >>> from surrofe2 import Box, rectangle, with_regions
        >>> skin = Box((0.0, 750.0), (2000.0, 1000.0))  # the uppermost of four rows of elements
        >>> flesh = Box((0.0, 0.0), (2000.0, 750.0))
        >>> mesh = with_regions(rectangle(2000.0, 1000.0, (8, 4)), skin=skin, flesh=flesh)
        >>> {name: len(elements) for name, elements in mesh.subdomains.items()}
        {'skin': 8, 'flesh': 24}
    """
    if not parts:
        return mesh
    centres = mesh.p.T[element_nodes(mesh)].mean(axis=1)
    slack = precision(mesh)
    regions = {}
    for name, part in _by_name("mesh.regions", parts):
        elements = np.flatnonzero(part.holds(centres, slack))
        if not elements.size:
            raise InputError(
                f"mesh.regions.{name}: {part}; it must hold the centre of an element; the mesh "
                f"{_reach(mesh)}"
            )
        regions[name] = elements
    return mesh.with_subdomains(regions)


def _by_name(where: str, parts: Mapping[str, Part]) -> Iterator[tuple[str, Part]]:
    """Yield the parts by name, each checked to be one.

    Names come as keywords, in which Python turns the micro sign into a Greek mu; it is put back.
    """
    for name, part in parts.items():
        if not hasattr(part, "holds"):
            raise InputError(
                f"{where}.{name}", f"{quoted(part)}; it must be a Box, a HalfPlane or a Disc"
            )
        yield with_micro_sign(name), part


def precision(mesh: skfem.Mesh) -> float:
    """Return the distance within which two places of a mesh are the same, µm.

    Files of single precision, or of six digits, have coordinates that are off by a millionth of the
    largest one. The distance is at most a thousandth of the shortest side.
    """
    ends = mesh.p[:, mesh.facets]
    shortest = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=0).min()
    return float(min(DIGITS * abs(mesh.p).max(), CLOSED * shortest))


def _reach(mesh: skfem.Mesh) -> str:
    """Say for a message from where to where a mesh reaches."""
    low, high = extent(mesh)
    return f"reaches from ({low[0]:.9g}, {low[1]:.9g}) to {_at(high, 9)}"


def _what_is_near(mesh: skfem.Mesh, is_in_part: Flags) -> str:
    """Say for a message what to do about a part of the plane that holds no side of a mesh.

    Args:
        is_in_part: (n,) whether each node is in the part.
    """
    alone = np.flatnonzero(is_in_part)
    if alone.size == 1:
        x, y = mesh.p[:, alone[0]]
        return f"a condition acts on the one node in it by on = {{ point = [{x:.9g}, {y:.9g}] }}"
    return f"the mesh {_reach(mesh)}"


def element_nodes(mesh: skfem.Mesh) -> Index:
    """Return the nodes of each element, (n_el, 4) or (n_el, 6).

    Corners come first, then the middles of a triangle's sides 0–1, 1–2 and 0–2.
    """
    return np.ascontiguousarray(mesh.dofs.element_dofs.T, dtype=np.int64)


def facet_nodes(mesh: skfem.Mesh, facets: NDArray[np.integer]) -> Index:
    """Return the nodes of facets, (m, 2) or (m, 3): both ends, then the middle.

    The ends are ordered so that the tissue is on the left of the way from the first to the second.
    """
    facets = np.asarray(facets, dtype=np.int64)
    ends = mesh.facets[:, facets].T.astype(np.int64)
    x = mesh.p.T[ends]
    element = mesh.f2t[0, facets]
    centre = mesh.p[:, mesh.t[:, element]].mean(axis=1).T
    along = x[:, 1] - x[:, 0]
    inward = centre - x[:, 0]
    is_on_the_right = along[:, 0] * inward[:, 1] < along[:, 1] * inward[:, 0]
    ends[is_on_the_right] = ends[is_on_the_right, ::-1]
    if mesh.elem is skfem.ElementTriP2:
        ends = np.column_stack([ends, mesh.dofs.facet_dofs[0, facets]])
    return ends


def boundary(mesh: skfem.Mesh, name: str, where: str = "boundary") -> Index:
    """Return the outer facets (m,) of a boundary; `where` is the field that errors name.

    Raises:
        InputError: there is no boundary of that name, a region has the name, too, or the boundary
            has facets within the tissue, or none.
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
    """Return the facets (m,) of a boundary, within the tissue or outside it.

    Raises:
        InputError: the name is unknown or ambiguous, or the boundary is empty.
    """
    return np.asarray(_named(mesh, mesh.boundaries, name, where, "boundary"), dtype=np.int64)


def region(mesh: skfem.Mesh, name: str | None, where: str = "region") -> Index:
    """Return the elements (k,) of a region; None: all elements.

    Raises:
        InputError: the name is unknown or ambiguous, or the region is empty.
    """
    if name is None:
        return np.arange(mesh.nelements)
    return np.asarray(_named(mesh, mesh.subdomains, name, where, "region"), dtype=np.int64)


def region_numbers(
    mesh: skfem.Mesh, regions: Mapping[str, Index], where: str, elements: Index
) -> Index:
    """Return the number (m,) of the region that each of the elements (m,) is in.

    Raises:
        InputError: an element is in none of the regions, or in several.
    """
    number = np.zeros(mesh.nelements, np.int64)
    claims = np.zeros(mesh.nelements, np.int64)  # regions that hold an element
    for k, members in enumerate(regions.values()):
        number[members] = k
        claims[members] += 1
    unclear = elements[claims[elements] != 1]
    if unclear.size:
        e = unclear[0]
        centre = mesh.p[:, element_nodes(mesh)[e]].mean(axis=1)
        raise InputError(
            f"{where}: element {e} at {_at(centre)} is in {claims[e]} of {', '.join(regions)}; "
            "every element must be in one"
        )
    return number[elements]


def nodes_on(mesh: skfem.Mesh, name: str | NodeAt | None, where: str = "on") -> Index:
    """Return the nodes (k,) of a boundary or a region, or the one at a place; None: all nodes.

    A boundary may have sides within the tissue, for their nodes may be held or moved.

    Raises:
        InputError: the name is unknown or ambiguous, the part is empty, or no node is there.
    """
    if isinstance(name, NodeAt):
        return np.array([name.node(mesh, where)])
    regions = mesh.subdomains or {}
    if name is None or name in regions:
        return np.unique(element_nodes(mesh)[region(mesh, name, where)])
    known = {**(mesh.boundaries or {}), **regions}
    facets = _named(mesh, known, name, where, "boundary or region")
    return np.unique(facet_nodes(mesh, facets))


def length_of(mesh: skfem.Mesh, facets: NDArray[np.integer]) -> float:
    """Return the length of facets together, µm."""
    if not len(facets):
        return 0.0
    return float(skfem.FacetBasis(mesh, mesh.elem(), facets=facets, intorder=6).dx.sum())


def area_of(mesh: skfem.Mesh, elements: NDArray[np.integer]) -> float:
    """Return the area of elements together, µm²."""
    if not len(elements):
        return 0.0
    return float(skfem.Basis(mesh, mesh.elem(), elements=elements, intorder=4).dx.sum())


def extent(mesh: skfem.Mesh) -> tuple[Array, Array]:
    """Return the lowest x and y, and the highest, (2,) each, µm."""
    return mesh.p.min(axis=1), mesh.p.max(axis=1)


def check_name(mesh: skfem.Mesh, name: str, where: str) -> None:
    """Reject a name that boundaries or regions of a mesh share, but for capitals and blanks.

    Raises:
        InputError: several of them have the name.
    """
    alike = []
    for kind, parts in (("boundary", mesh.boundaries), ("region", mesh.subdomains)):
        for other in parts or {}:
            if _plain(other) == _plain(name):
                alike.append(f"the {kind} {quoted(other)}")
    if len(alike) > 1:
        raise InputError(f"{where}: {name}; it may mean {' or '.join(alike)}; name them apart")


def _plain(name: str) -> str:
    """Return a name without blanks and capitals."""
    return "".join(name.split()).casefold()


def _named(
    mesh: skfem.Mesh, parts: Mapping[str, NDArray] | None, name: str, where: str, kind: str
) -> NDArray[np.integer]:
    """Return the part of a mesh that has a name.

    Args:
        parts: named parts of the mesh of this kind.
        where: field that errors name.
        kind: the word for such parts in errors.

    Raises:
        InputError: the name is unknown or ambiguous, or the part is empty.
    """
    if not parts:
        raise InputError(f"{where}: {name}; the mesh has no {kind} with a name; name parts of it")
    if name not in parts:
        close = difflib.get_close_matches(name, parts, n=1)
        hint = f"did you mean {close[0]}? " if close else ""
        raise InputError(f"{where}: {name}; no such {kind}; {hint}known are {', '.join(parts)}")
    check_name(mesh, name, where)
    if not len(parts[name]):
        raise InputError(f"{where}: {name}; the mesh has that name, and no {kind} of it")
    return parts[name]


def check_mesh(mesh: skfem.Mesh) -> skfem.Mesh:
    """Check the mesh of a problem, and return it; a `MeshTri1` gets the middles of its sides.

    Raises:
        InputError: the mesh is of another kind, an element is inverted or degenerate, elements lie
            on one another, a node has no element, there are several pieces, or parts touch that
            are not glued.
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
        boundaries = mesh.boundaries or {}
        regions = mesh.subdomains or {}
        mesh = skfem.MeshTri2.from_mesh(mesh)
        mesh = mesh.with_boundaries(boundaries).with_subdomains(regions)
    _check_orphans(mesh.p.T, element_nodes(mesh))
    _check_shapes(mesh.p.T, element_nodes(mesh))
    _check_seams(mesh)
    _check_pieces(mesh)
    return mesh


def _check_overlaps(mesh: skfem.Mesh) -> None:
    """Reject elements of the same nodes, and sides of more than two elements."""
    corners, count = np.unique(np.sort(mesh.t.T, axis=1), axis=0, return_counts=True)
    if count.max() > 1:
        centre = mesh.p[:, corners[count.argmax()]].mean(axis=1)
        raise InputError(
            f"mesh: {count.max()} elements of the same nodes at {_at(centre)}; keep one"
        )
    elements_at_side = np.bincount(mesh.t2f.ravel())
    if elements_at_side.max() > 2:
        middle = mesh.p[:, mesh.facets[:, elements_at_side.argmax()]].mean(axis=1)
        raise InputError(
            f"mesh: {elements_at_side.max()} elements share the side at {_at(middle)}; elements "
            "must not lie on one another"
        )


def _check_orphans(nodes: Array, elements: NDArray[np.integer]) -> None:
    """Reject nodes (n, 2) that no element has: nothing would determine their motion."""
    alone = np.setdiff1d(np.arange(len(nodes)), elements)
    if alone.size:
        raise InputError(
            f"mesh: {alone.size} nodes without an element, the first is {alone[0]} at "
            f"{_at(nodes[alone[0]])}; remove them"
        )


def _check_shapes(nodes: Array, elements: Index) -> None:
    """Reject elements whose corners do not all turn one way, or whose sides are bent too far."""
    corners = elements[:, :4] if elements.shape[1] == 4 else elements[:, :3]
    x = nodes[corners]
    ahead = np.roll(x, -1, axis=1) - x  # from each corner to the next
    behind = np.roll(ahead, 1, axis=1)
    turn = behind[..., 0] * ahead[..., 1] - behind[..., 1] * ahead[..., 0]
    # scikit-fem takes elements either way round.
    turn *= np.where(turn.sum(axis=1, keepdims=True) < 0.0, -1.0, 1.0)
    size = np.linalg.norm(ahead, axis=2).max(axis=1)
    bulge = turn.min(axis=1) / np.maximum(size, np.finfo(float).tiny) ** 2
    if elements.shape[1] == 6:
        middle_of_chord = 0.5 * (x + np.roll(x, -1, axis=1))
        bend = np.linalg.norm(nodes[elements[:, 3:]] - middle_of_chord, axis=2).max(axis=1)
        bulge = np.where(bend > _MOST_BEND * size, -1.0, bulge)
    worst = int(bulge.argmin())
    if not bulge[worst] > _FLAT:
        fault = "inverted" if bulge[worst] < -_FLAT else "degenerate"
        raise InputError(
            f"mesh: element {worst} at {_at(x[worst].mean(axis=0))} is {fault}; its corners must "
            "go round it and bulge outward"
        )


def _check_seams(mesh: skfem.Mesh) -> None:
    """Reject outer sides along which parts of a mesh touch and are not glued.

    A crack would run there. Nodes of outer sides must neither lie on one another, nor on outer
    sides that do not have them.
    """
    nodes = mesh.p.T
    outer = mesh.boundary_facets()
    ends = mesh.facets[:, outer].T
    x = nodes[ends]
    length = np.linalg.norm(x[:, 1] - x[:, 0], axis=1)
    outline = np.unique(ends)  # nodes of outer sides
    # only nodes of the outline can be at a seam, so the tree is small
    tree = scipy.spatial.cKDTree(nodes[outline])
    _check_glued(nodes, outline, ends, length, tree)

    centre = x.mean(axis=1)
    if mesh.elem is skfem.ElementTriP2:
        middle = nodes[mesh.dofs.facet_dofs[0, outer]]
    else:
        middle = centre
    sagitta = np.linalg.norm(middle - centre, axis=1)
    radius = (0.5 - CLOSED) * length + sagitta  # without the ends of a straight side
    near_side = tree.query_ball_point(centre, radius)
    # flat pairs (side, node near it), without the side's own ends
    side = np.repeat(np.arange(len(outer)), [len(near) for near in near_side])
    node = outline[np.concatenate([np.zeros(0, np.int64), *near_side]).astype(np.int64)]
    is_other = (ends[side] != node[:, None]).all(axis=1)
    side = side[is_other]
    node = node[is_other]
    distance = _distance_to_sides(nodes[node], x[side], middle[side])
    touching = np.flatnonzero(distance <= CLOSED * length[side])
    if touching.size:
        k = touching[0]
        a, b = x[side[k]]
        raise InputError(
            f"mesh: the node at {_at(nodes[node[k]])} lies on the side of an element from {_at(a)} "
            f"to {_at(b)} that does not have it; the elements there must share whole sides"
        )


def _check_glued(nodes: Array, outline: Index, ends: Index, length: Array, tree: Any) -> None:
    """Reject two nodes of the outline at one place.

    Args:
        nodes: (n, 2) positions of all nodes, µm.
        outline: (k,) numbers of the nodes of outer sides.
        ends: (m, 2) nodes of each outer side.
        length: (m,) length of each outer side, µm.
        tree: `cKDTree` of the outline's positions.
    """
    shortest = np.full(len(nodes), np.inf)  # length of the shortest outer side at each node
    np.minimum.at(shortest, ends, length[:, None])
    pairs = outline[tree.query_pairs(CLOSED * shortest[outline].max(), output_type="ndarray")]
    distance = np.linalg.norm(nodes[pairs[:, 0]] - nodes[pairs[:, 1]], axis=1)
    same = pairs[distance <= CLOSED * shortest[pairs].min(axis=1)]
    if len(same):
        first_node = same[0, 0]
        raise InputError(
            f"mesh: two nodes at {_at(nodes[first_node])}, so parts of the mesh touch there and "
            "are not glued; merge such nodes (in Gmsh: Coherence before meshing, or Coherence "
            "Mesh)"
        )


def _distance_to_sides(points: Array, ends: Array, middles: Array) -> Array:
    """Return the distance (n,) of points (n, 2) to sides, each point to its side.

    A side through its ends a and b (n, 2, 2) and its middle m (n, 2) is x(s) = (1−s)(1−2s) a +
    4s(1−s) m + s(2s−1) b, on which Newton's method finds the nearest s.
    """
    a = ends[:, 0]
    b = ends[:, 1]
    chord = b - a
    s = np.einsum("ni,ni->n", points - a, chord) / np.einsum("ni,ni->n", chord, chord)
    for _ in range(3):  # a straight side is exact at once; sides bend by a quarter at most
        t = s[:, None]
        on_side = (
            (1.0 - t) * (1.0 - 2.0 * t) * a
            + 4.0 * t * (1.0 - t) * middles
            + t * (2.0 * t - 1.0) * b
        )
        slope = (4.0 * t - 3.0) * a + (4.0 - 8.0 * t) * middles + (4.0 * t - 1.0) * b
        step = np.einsum("ni,ni->n", points - on_side, slope)
        s = s + step / np.einsum("ni,ni->n", slope, slope)
        s = np.clip(s, 0.0, 1.0)
    return np.linalg.norm(points - on_side, axis=1)


def _check_pieces(mesh: skfem.Mesh) -> None:
    """Reject a mesh of several pieces, and parts that share a node alone, like a hinge."""
    next_corner = np.roll(mesh.t, 1, axis=0)
    corners = int(mesh.t.max()) + 1
    pieces, piece_of_node = _connected(corners, mesh.t.ravel(), next_corner.ravel())
    if pieces > 1:
        sizes = np.bincount(piece_of_node[mesh.t[0]])
        smallest = int(sizes.argmin())
        node = int(np.flatnonzero(piece_of_node == smallest)[0])
        raise InputError(
            f"mesh: {pieces} pieces that do not touch, the smallest of {sizes.min()} elements "
            f"at {_at(mesh.p[:, node])}; it must be one"
        )
    # elements that share sides are of one part; a node of two parts is a hinge
    one_side, other_side = mesh.f2t[:, mesh.f2t[1] != -1]
    parts, part_of_element = _connected(mesh.nelements, one_side, other_side)
    if parts > 1:
        lowest = np.full(corners, parts)
        highest = np.full(corners, -1)
        part_of_corner = np.broadcast_to(part_of_element, mesh.t.shape)
        np.minimum.at(lowest, mesh.t, part_of_corner)
        np.maximum.at(highest, mesh.t, part_of_corner)
        node = int(np.flatnonzero(lowest != highest)[0])
        raise InputError(
            f"mesh: two parts share the node at {_at(mesh.p[:, node])} and no side, so that they "
            "would turn about it freely; let them share a side, or leave one out"
        )


def _connected(count: int, first: NDArray, second: NDArray) -> tuple[int, NDArray]:
    """Return how many pieces `count` things make, and the number (count,) of the piece of each.

    The things `first` and `second`, (m,) each, are connected in pairs.
    """
    graph = coo_matrix((np.ones(first.size), (first, second)), (count, count))
    pieces, piece_of_thing = connected_components(graph, directed=False)
    return int(pieces), piece_of_thing


def _at(point: Array, digits: int = 6) -> str:
    """Write a point (2,) in µm for a message."""
    return f"({point[0]:.{digits}g}, {point[1]:.{digits}g}) µm"
