"""Figures of tissues with supports and rigid bodies, and of plant cells."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import skfem
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import Collection, LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.markers import CARETRIGHT, CARETUP
from matplotlib.patches import Rectangle

from surrofe2.base.arrays import Array, Index
from surrofe2.problem import Problem
from surrofe2.problem.conditions import (
    BodyForce,
    Condition,
    Fixed,
    PointForce,
    PrescribedMotion,
    Pressure,
    Traction,
)
from surrofe2.problem.mesh import DIGITS, NodeAt, facet_nodes, facets_of, nodes_on
from surrofe2.problem.rigid_bodies import Circle, Corner, Plane, RigidBody, Shape
from surrofe2.run.charts import VERMILION, in_words
from surrofe2.rve.particles import Particles
from surrofe2.store.fields import DISPLACEMENT_NAME, StoredFields

if TYPE_CHECKING:
    from surrofe2.macro import Rest

# Room about a tissue with bodies, as a fraction of its size.
MARGIN = 0.08
# Colours span at least this fraction of the largest value: smaller differences are noise, and are
# to look like it.
_LEAST_SPAN = 0.02
# Colours diverge from 0 where values of the other sign are beyond this fraction of the largest.
_BOTH_SIGNS = 0.05
# Elements from which on their sides are not drawn, for they would cover the colours.
_MOST_WITH_SIDES = 5000
# Sides of a drawn circle.
_ARC = 48
# A node that moves less than this fraction of the largest displacement is held.
_STILL = 1e-6
# Arrows along a boundary on which a load acts.
_ARROWS = 5
# Cosine of the angle between a load and the normal of its side below which it acts along the side.
_TANGENTIAL = 1e-3
# Length of an arrow, as a fraction of the tissue's extent.
ARROW = 0.1
# Times at which plant cells are drawn.
_PANELS = 6


def rounded_up(value: float) -> float:
    """Return the next of 1, 2, 2.5, 5 or 10 times a power of ten; 1 for values that are ≤ 0."""
    if value <= 0.0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    for factor in (1.0, 2.0, 2.5, 5.0):
        if factor * power >= value * 0.9999:  # a round value stays, whatever its rounding
            return float(factor * power)
    return float(10.0 * power)


@dataclass(frozen=True, slots=True)
class Colours:
    """A colour map between round limits, and words for the values.

    Attributes:
        label: words for the values, with their unit.
        low: value at the lower end of the map.
        high: value at its upper end.
        name: name of the map in matplotlib.
    """

    label: str
    low: float
    high: float
    name: str

    @classmethod
    def of(cls, label: str, values: Array, name: str = "viridis") -> Colours:
        """Choose colours for values; where these have both signs, a map that diverges from 0."""
        known = values[np.isfinite(values)]
        low = float(known.min()) if known.size else 0.0
        high = float(known.max()) if known.size else 1.0
        largest = max(abs(low), abs(high)) or 1.0
        if min(-low, high) > _BOTH_SIGNS * largest:
            end = rounded_up(largest)
            return cls(label, -end, end, "RdBu_r")
        lacking = 0.5 * max(_LEAST_SPAN * largest - (high - low), 0.0)  # at each end
        step = rounded_up(0.2 * (high - low + 2.0 * lacking))
        # 1e-6: an end that is a multiple of the step, but for rounding, stays
        lower_end = np.floor((low - lacking) / step + 1e-6) * step
        upper_end = np.ceil((high + lacking) / step - 1e-6) * step
        return cls(label, float(lower_end), float(upper_end), name)

    def paint(self, drawn: Collection, values: Array) -> Any:
        """Colour a collection by values, grey where they are unknown, and return it."""
        colours = colormaps[self.name].with_extremes(bad="0.6")
        drawn.set(array=values, cmap=colours, clim=(self.low, self.high))
        return drawn

    def bar(self, places: Axes | Sequence[Axes], drawn: Any, location: str = "right") -> None:
        """Draw the colour bar beside one or more axes, or at their "bottom"."""
        places = [places] if isinstance(places, Axes) else [*places]
        figure = places[0].get_figure()
        assert figure is not None
        look: Any = {"label": self.label, "shrink": 0.8, "aspect": 25, "location": location}
        bar = figure.colorbar(drawn, ax=places, **look)
        bar.set_ticks(self.ticks())
        bar.ax.ticklabel_format(useOffset=False)
        bar.ax.tick_params(labelsize=8)

    def ticks(self) -> list[float]:
        """Return values at even distances from limit to limit, with as few digits as may be.

        Limits of both signs have 0 among them.
        """
        span = self.high - self.low
        counts = (4, 6) if self.low < 0.0 < self.high else (5, 4, 6, 3)
        many = min(counts, key=lambda count: len(f"{span / count:.6g}"))
        values: list[float] = np.linspace(self.low, self.high, many + 1).tolist()
        return values


def bar_length(width: float) -> float:
    """Return the round length of the scale bar of a picture of this width, µm."""
    return rounded_up(0.12 * width)


def length_in_words(length: float) -> str:
    """Write a length, µm, with its unit."""
    return f"{length / 1000.0:g} mm" if length >= 1000.0 else f"{length:g} µm"


def draw_scale_bar(axes: Axes, low: Array, high: Array) -> None:
    """Draw a bar of round length below a box of two corners (2,), and make room for it."""
    width = float(high[0] - low[0])
    room = 0.07 * float(max(high - low))
    length = bar_length(width)
    y = low[1] - room
    axes.plot([low[0], low[0] + length], [y, y], color="black", linewidth=2.5, clip_on=False)
    text = length_in_words(length)
    axes.text(low[0] + 0.5 * length, y - 0.3 * room, text, ha="center", va="top", fontsize=8)
    axes.set(xlim=(low[0], high[0]), ylim=(y - 2.0 * room, high[1]), aspect="equal")
    axes.axis("off")


# A tissue, its supports and rigid bodies.


@dataclass(frozen=True, slots=True)
class DrawnBody:
    """A body at the times of the fields.

    Attributes:
        outline: (n, 2) outline where the body began, µm; that of a plane and of a corner is cut off
            far from the tissue.
        moved: (m, 2) displacement of the body from there, µm.
    """

    outline: Array
    moved: Array

    def at(self, k: int, factor: float) -> Array:
        """Return the outline (n, 2) at time k, with `factor` times its displacement."""
        return self.outline + factor * self.moved[k]


@dataclass(frozen=True, slots=True)
class DrawnNode:
    """A node at which a support or an arrow is drawn.

    Attributes:
        node: number of the node.
        components: components that are held, "x", "y" or "xy"; "": none.
        pull: (2,) direction of the arrow, of any length; zero: none.
        pushes: True if the arrow ends at the node, False if it begins there.
    """

    node: int
    components: str
    pull: Array
    pushes: bool = False

    def arrow(self, position: Array, length: float) -> Array:
        """Return both ends (2, 2) of the arrow, the tip last, of the node at (2,)."""
        step = length * self.pull / np.linalg.norm(self.pull)
        return np.stack([position - step, position] if self.pushes else [position, position + step])


def fields_at_rest(rest: Rest) -> StoredFields:
    """Return the displacements of a tissue without load and at rest, for `draw_tissue`.

    The times are the factors of the load.
    """
    space = rest.system.discretisation
    u = rest.displacement.reshape(-1, 2)
    displacement = np.stack([np.zeros_like(u), u])
    factors = np.array([0.0, rest.factor])
    return StoredFields(space.nodes, space.elements, factors, {DISPLACEMENT_NAME: displacement})


def drawn_nodes(conditions: Iterable[Condition], fields: StoredFields) -> list[DrawnNode]:
    """Return the nodes of a tissue on which conditions act alone."""
    drawn = []
    for condition in conditions:
        if not isinstance(condition.on, NodeAt):
            continue
        components = condition.components if isinstance(condition, Fixed) else ""
        drawn.append(DrawnNode(_nearest(fields, condition.on.point), components, _pull(condition)))
    return drawn


def _nearest(fields: StoredFields, point: Any) -> int:
    """Return the number of the undeformed tissue's node next to a point (2,)."""
    offset = fields.points - np.asarray(point)
    return int(np.hypot(offset[:, 0], offset[:, 1]).argmin())


def _pull(condition: Condition) -> Array:
    """Return force, traction, acceleration or prescribed displacement (2,) of a condition, else 0.

    The direction of a pressure follows from the side on which it acts.
    """
    if isinstance(condition, PrescribedMotion):
        return np.array([value or 0.0 for value in condition.displacement])
    if isinstance(condition, PointForce):
        return np.array(condition.force)
    if isinstance(condition, Traction):
        return np.array(condition.traction)
    if isinstance(condition, BodyForce):
        return np.array(condition.acceleration)
    return np.zeros(2)


def drawn_loads(problem: Problem, fields: StoredFields) -> list[DrawnNode]:
    """Return supports of nodes, and arrows for loads and prescribed motions, for `draw_tissue`.

    There are some arrows on a boundary, and one in the middle of a region. They show the direction
    on the undeformed tissue where the amplitude is 1, and no size.
    """
    mesh = problem.mesh
    drawn = drawn_nodes(problem.conditions, fields)
    for condition in problem.conditions:
        pull = _pull(condition)
        on = condition.on
        acts = pull.any() or (isinstance(condition, Pressure) and condition.pressure != 0.0)
        if isinstance(on, NodeAt) or not acts:
            continue
        if on is None or on in (mesh.subdomains or {}):
            places = mesh.p.T[nodes_on(mesh, on)]
            middle = places[_middle(places)]
            drawn.append(DrawnNode(_nearest(fields, middle), "", pull))
            continue
        drawn += _arrows_on(mesh, condition, facets_of(mesh, on), fields)
    return drawn


def _arrows_on(
    mesh: skfem.Mesh, condition: Condition, facets: Index, fields: StoredFields
) -> list[DrawnNode]:
    """Return arrows for a load or a motion of the sides (m,) of a boundary.

    Where it acts along all of them it is one, which others would cover.
    """
    pull = _pull(condition)
    ends = mesh.p.T[facet_nodes(mesh, facets)[:, :2]]
    along = ends[:, 1] - ends[:, 0]
    outward = np.column_stack([along[:, 1], -along[:, 0]])
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    # sides within the tissue have no outside
    is_outer = mesh.f2t[1, facets] == -1
    places = ends.reshape(-1, 2)
    if isinstance(condition, Pressure):
        pulls = -np.sign(condition.pressure) * outward
    else:
        pulls = np.tile(pull / np.linalg.norm(pull), (len(facets), 1))
    # the sign of what acts along a side would be that of rounding
    cosine = (pulls * outward).sum(axis=1)
    pushes = is_outer & (cosine < -_TANGENTIAL)
    chosen = _apart(places, _ARROWS)
    if (abs(cosine) < _TANGENTIAL).all():
        chosen = [_middle(places)]
    return [
        DrawnNode(_nearest(fields, places[end]), "", pulls[end // 2], bool(pushes[end // 2]))
        for end in chosen
    ]


def _middle(points: Array) -> int:
    """Return the number of the point (n, 2) next to the mean, which of a ring is not in it."""
    return int(np.linalg.norm(points - points.mean(axis=0), axis=1).argmin())


def _apart(points: Array, most: int) -> list[int]:
    """Return the numbers of at most so many of the points (n, 2) that lie far apart."""
    # an end of a side is farthest from its middle
    chosen = [int(np.linalg.norm(points - points.mean(axis=0), axis=1).argmax())]
    nearest = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < most and nearest.max() > 0.0:
        chosen.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return chosen


def drawn_bodies(
    bodies: Iterable[RigidBody], t: Array, history: Mapping[str, Array], fields: StoredFields
) -> list[DrawnBody]:
    """Return rigid bodies at the times of the fields.

    Args:
        t: (n,) times of the history, µs.
        history: columns of a run's history by name.
    """
    # planes are cut off this far away, four times the tissue's extent
    far = 4.0 * float(np.ptp(fields.points, axis=0).max())
    drawn = []
    for body in bodies:
        moved = np.zeros((len(fields.t), 2))
        if f"position {body.name} x" in history:  # counted from where the body began
            x = np.interp(fields.t, t, history[f"position {body.name} x"])
            y = np.interp(fields.t, t, history[f"position {body.name} y"])
            moved = np.stack([x, y], axis=1)
        drawn.append(DrawnBody(np.array(body.position) + outline(body.shape, far), moved))
    return drawn


def outline(shape: Shape, far: float) -> Array:
    """Return the closed line (n, 2) of a shape about its position, µm.

    A plane and a corner are cut off at a distance of some `far`, µm.
    """
    if isinstance(shape, Plane):
        x, y = np.array(shape.normal) / np.linalg.norm(shape.normal)
        along = far * np.array([-y, x])
        inward = -far * np.array([x, y])
        return np.stack([along, -along, inward - along, inward + along])
    if isinstance(shape, Circle):
        turn = 2.0 * np.pi * np.arange(_ARC) / _ARC
        return shape.radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    assert isinstance(shape, Corner)
    x, y, cosine, sine, radius, _ = shape.outline
    axis = np.array([x, y])
    across = np.array([-y, x])
    half = np.arctan2(sine, cosine)
    turn = np.linspace(half + 0.5 * np.pi, 1.5 * np.pi - half, _ARC)[:, None]
    arc = radius * (axis + np.cos(turn) * axis + np.sin(turn) * across)
    # both flanks go on from the ends of the arc
    first_flank = arc[0] + far * (cosine * axis + sine * across)
    last_flank = arc[-1] + far * (cosine * axis - sine * across)
    return np.vstack([first_flank, arc, last_flank])


def rim(fields: StoredFields) -> list[int]:
    """Return the order of an element's nodes along its sides."""
    nodes = fields.cells.shape[1]
    if nodes == 6:  # stored as corners, then middles of sides
        return [0, 3, 1, 4, 2, 5]
    return [*range(nodes)]


def box(position: Array, bodies: Sequence[DrawnBody]) -> tuple[Array, Array]:
    """Return the lower left and upper right corner of what is shown of positions (…, 2).

    Bodies need room about the tissue.
    """
    points = position.reshape(-1, 2)
    low = points.min(axis=0)
    high = points.max(axis=0)
    room = MARGIN * float((high - low).max()) if bodies else 0.0
    return low - room, high + room


def draw_tissue(
    axes: Axes,
    fields: StoredFields,
    k: int,
    values: Array,
    colours: Colours,
    *,
    factor: float = 1.0,
    bodies: Sequence[DrawnBody] = (),
    nodes: Sequence[DrawnNode] = (),
) -> Any:
    """Draw the tissue at time k with supports, rigid bodies and a scale bar.

    A half with a line of symmetry at its end is drawn whole.

    Args:
        k: number of the time.
        values: (e,) values of the elements, by which they are coloured.
        colours: colours of the values.
        factor: displacements are drawn so many times as large.
        nodes: nodes at which supports or arrows are drawn.

    Returns:
        The collection from which a colour bar is made.
    """
    position = fields.points + factor * fields.displacement[k]
    sides = _held_sides(fields)
    copies = _with_mirror_images(fields, sides, position)
    low, high = box(np.concatenate([copy for copy, _ in copies]), bodies)
    width, height = (high - low).tolist()
    window = Rectangle((low[0], low[1]), width, height, transform=axes.transData)
    for body in bodies:
        # what is far away would fill the room of the scale bar
        (shape,) = axes.fill(*body.at(k, factor).T, facecolor="0.85", edgecolor="0.4", lw=1.0)
        shape.set_clip_path(window)
    order = rim(fields)
    for copy, _ in copies:
        corners = [*copy[fields.cells[:, order]]]
        width = 0.3 if len(corners) < _MOST_WITH_SIDES else 0.0
        drawn: Collection = PolyCollection(corners, edgecolors="0.4", linewidths=width)
        if fields.cells.shape[1] == 2:  # the springs of a full tissue
            drawn = LineCollection(corners, linewidths=0.8)
        axes.add_collection(colours.paint(drawn, values))
    extent = float(max(high - low))
    depth = 0.035 * extent  # of the hatched band of a support
    for side in sides:
        for copy, _ in copies:
            ends = copy[[side.a, side.b]]
            if side.motion == _FIXED:
                # a hatched band outside of the tissue
                along = ends[1] - ends[0]
                outward = ends[0] - copy[side.inside]
                normal = np.array([along[1], -along[0]]) / np.linalg.norm(along)
                out = depth * np.sign(normal @ outward) * normal
                band = np.vstack([ends, ends[::-1] + out])
                axes.fill(*band.T, facecolor="none", edgecolor="0.4", hatch="/////", linewidth=0.0)
                low = np.minimum(low, band.min(axis=0))
                high = np.maximum(high, band.max(axis=0))
            if side.motion in (_FIXED, _RIGID):
                axes.plot(*ends.T, color="0.15", linewidth=2.5, solid_capstyle="butt")
            else:  # a line of symmetry
                axes.plot(*ends.T, color="0.15", linewidth=0.8, dashes=(8, 2, 2, 2))
    for node in nodes:
        for copy, signs in copies:
            # a node on the line of symmetry is its own image
            apart = float(np.linalg.norm(copy[node.node] - position[node.node]))
            if copy is not position and apart < DIGITS * extent:
                continue
            image = replace(node, pull=signs * node.pull)
            ends = _draw_node(axes, image, copy[node.node], ARROW * extent)
            low = np.minimum(low, ends.min(axis=0))
            high = np.maximum(high, ends.max(axis=0))
    draw_scale_bar(axes, low, high)
    return drawn


def _draw_node(axes: Axes, node: DrawnNode, position: Array, size: float) -> Array:
    """Draw what acts on a node at (2,): a wedge before each held component, an arrow for a pull.

    Args:
        size: length of the arrow, µm.

    Returns:
        The ends (k, 2) of what is drawn.
    """
    for component in node.components:
        # carets, whose tip is at the node
        marker = CARETRIGHT if component == "x" else CARETUP
        axes.plot(*position, marker=marker, color="0.15", markersize=9.0)
    if not node.pull.any():
        return position[None]
    ends = node.arrow(position, size)
    arrow = {"arrowstyle": "-|>", "color": "0.15", "shrinkA": 0.0, "shrinkB": 0.0}
    axes.annotate("", ends[1], ends[0], arrowprops=arrow)
    return ends


def draw_borders(axes: Axes, fields: StoredFields, k: int, regions: Sequence[Array]) -> None:
    """Draw the lines between regions over the tissue at time k, in the half that is computed.

    Args:
        regions: numbers of the elements of each region.
    """
    number = np.full(len(fields.cells), -1)
    for region, elements in enumerate(regions):
        number[elements] = region
    position = fields.points + fields.displacement[k]
    corners = fields.cells[:, rim(fields)]
    # a side of six-node triangles is two, which the middle node joins
    sides = np.stack([corners, np.roll(corners, -1, axis=1)], axis=-1).reshape(-1, 2)
    of_side = np.repeat(number, corners.shape[1])
    ends = np.sort(sides, axis=1)
    ends, which = np.unique(ends, axis=0, return_inverse=True)
    # the lowest and the highest number of the elements at each side
    least = np.full(len(ends), len(regions))
    most = np.full(len(ends), -1)
    np.minimum.at(least, which, of_side)
    np.maximum.at(most, which, of_side)
    borders = ends[least < most]
    lines = LineCollection([*position[borders]], colors="0.1", linewidths=1.6)
    axes.add_collection(lines)


def supported_sides(fields: StoredFields) -> list[tuple[int, int, bool]]:
    """Return the sides on the boundary that do not deform, as in a clamp or a grip.

    Returns:
        The numbers of both end nodes, and whether the side stands still.
    """
    sides = _held_sides(fields)
    return [(s.a, s.b, s.motion == _FIXED) for s in sides if s.motion in (_FIXED, _RIGID)]


# How a side on the boundary moves; 0 and 1: along a line of symmetry, with this component held.
_FIXED = 2
_RIGID = 3  # both of its nodes move alike, as in a grip


class _HeldSide(NamedTuple):
    """A side on the boundary that a support or a grip holds.

    Attributes:
        a: number of the node at one end.
        b: number of the node at the other end.
        inside: number of a node of its element that is not on it.
        motion: the component that is held, or `_FIXED`, or `_RIGID`.
    """

    a: int
    b: int
    inside: int
    motion: int


def _with_mirror_images(
    fields: StoredFields, sides: Sequence[_HeldSide], position: Array
) -> list[tuple[Array, Array]]:
    """Return positions (n, 2) of the nodes, and of their images in lines of symmetry.

    A line counts where it is straight and at an end of the undeformed tissue.

    Returns:
        Pairs of positions and signs (2,), by which the components of vectors are multiplied there.
    """
    copies = [(position, np.ones(2))]
    for axis, x in enumerate(fields.points.T):
        nodes = [side.a for side in sides if side.motion == axis]
        if not nodes:
            continue
        line = float(x[nodes].mean())
        rounding = DIGITS * float(np.ptp(x))
        is_straight = np.ptp(x[nodes]) <= rounding
        is_at_an_end = min(line - x.min(), x.max() - line) <= rounding
        if is_straight and is_at_an_end:
            mirror = 2.0 * line
            is_axis = np.arange(2) == axis
            copies += [
                (np.where(is_axis, mirror - copy, copy), np.where(is_axis, -signs, signs))
                for copy, signs in copies
            ]
    return copies


def _held_sides(fields: StoredFields) -> list[_HeldSide]:
    """Find the sides on the boundary that supports or grips hold, by their motion in all fields."""
    corners = {3: 3, 4: 4, 6: 3}.get(fields.cells.shape[1], 0)
    u = fields.displacement
    still = _STILL * float(abs(u).max())
    if not corners or not still:
        return []
    cells = fields.cells[:, :corners]
    # (a, b, inside): three corners that follow each other
    sides = np.stack([np.roll(cells, -k, axis=1) for k in range(3)], axis=-1).reshape(-1, 3)
    ends = np.sort(sides[:, :2], axis=1)
    _, first, elements = np.unique(ends, axis=0, return_index=True, return_counts=True)
    on_boundary = first[elements == 1]
    held = []
    for a, b, inside in sides[on_boundary].tolist():
        along = abs(fields.points[b] - fields.points[a])
        is_fixed = abs(u[:, [a, b]]).max(axis=(0, 1)) <= still
        component = int(is_fixed.argmax())
        is_across = along[component] < 1e-6 * along.sum()  # the component that is held
        if is_fixed.all():
            held.append(_HeldSide(a, b, inside, _FIXED))
        elif abs(u[:, a] - u[:, b]).max() <= still:
            held.append(_HeldSide(a, b, inside, _RIGID))
        elif is_fixed.any() and is_across:
            held.append(_HeldSide(a, b, inside, component))
    return held


# Plant cells.


def draw_cells(
    axes: Axes, seen: Particles, k: int, half: float = 0.0
) -> tuple[tuple[Colours, Any], tuple[Colours, Any]]:
    """Draw RVE k with its neighbours: walls by stretch, fluid by pressure.

    Fluid particles are dots; a uniform fluid fills areas.

    Args:
        seen: RVEs at several times or points.
        k: number of the RVE.
        half: half of the width of the window about its centre, µm; 0: the RVE and a little more.

    Returns:
        For the colour bars of walls and of fluid: the colours, which are the same for all RVEs, and
        the collection that is drawn in them.
    """
    walls = Colours.of("wall length / rest length", seen.stretch)
    fluid = Colours.of("fluid pressure (MPa)", seen.pressure, "Blues")
    lattice = seen.F[k] @ seen.lattice
    x = seen.position[k]
    n_walls = int(seen.is_wall.sum())
    if not half:
        half = 0.75 * float(abs(lattice).sum(axis=0).max())
    # copies of the RVE that reach into the window, of many enough in each direction
    many = 1 + int(np.ceil(2.0 * half * abs(np.linalg.inv(lattice)).max()))
    shifts = np.arange(-many, many + 1)
    copies = np.stack(np.meshgrid(shifts, shifts), axis=-1).reshape(-1, 2) @ lattice.T
    copies = copies[(abs(copies) < half + 2.0 * abs(lattice).sum(axis=1)).all(axis=1)]
    begin = x[seen.bonds[:, 0]]
    end = x[seen.bonds[:, 1]] + seen.bond_shift @ lattice.T
    segments = (np.stack([begin, end], axis=1)[None] + copies[:, None, None]).reshape(-1, 2, 2)
    if seen.is_wall.all():
        rims = [x[rim[:, 0]] + rim[:, 1:] @ lattice.T for rim in seen.rims]
        inside: Any = PolyCollection([rim + shift for shift in copies for rim in rims])
        axes.add_collection(inside)
    else:
        dots = (x[n_walls:][None] + copies[:, None]).reshape(-1, 2)
        size = 14.0 * min(1.0, (20.0 / half) ** 2)
        inside = axes.scatter(
            dots[:, 0], dots[:, 1], s=max(size, 2.0), edgecolors="0.5", linewidths=0.3
        )
    fluid.paint(inside, np.tile(seen.pressure[k], len(copies)))
    drawn = LineCollection([*segments], linewidths=2.2, capstyle="round")
    axes.add_collection(walls.paint(drawn, np.tile(seen.stretch[k], len(copies))))
    centre = x[:n_walls].mean(axis=0) + 0.25 * lattice.sum(axis=1)
    draw_scale_bar(axes, centre - half, centre + half)
    window = Rectangle(centre - half, 2.0 * half, 2.0 * half, transform=axes.transData)
    drawn.set_clip_path(window)
    inside.set_clip_path(window)
    return (walls, drawn), (fluid, inside)


def times_that_differ(F: Array, count: int) -> Array:
    """Choose at most so many times, in order, at which F (n, 2, 2) differs most.

    The first is among them. Each further one is that whose F is farthest from all before it, so
    that an oscillation is not seen at one phase again and again.
    """
    flat = F.reshape(len(F), 4)
    chosen = [0]
    distance = np.linalg.norm(flat - flat[0], axis=1)
    while len(chosen) < min(count, len(F)):
        # where nothing moves, times at even distances are as good as any
        farthest = int(distance.argmax())
        if distance[farthest] == 0.0:
            return np.unique(np.linspace(0, len(F) - 1, min(count, len(F))).round().astype(int))
        chosen.append(farthest)
        distance = np.minimum(distance, np.linalg.norm(flat - flat[farthest], axis=1))
    return np.sort(chosen)


def cell_figure(
    title: str,
    seen: Particles,
    fields: StoredFields,
    element: int,
    point: Sequence[float],
    is_rest: bool = False,
) -> Figure:
    """Draw the plant cells at a point: where it is, wall stretch over time, and the cells at six
    times.

    Args:
        title: heading of the figure.
        seen: the RVE of the element at the times of the fields.
        fields: of the run.
        element: number of the element.
        point: position in the undeformed tissue, µm.
        is_rest: whether the times are factors of the load of a rest.
    """
    t = fields.t
    clock = "load factor {:.4g}" if is_rest else "t = {:.4g} µs"
    chosen = times_that_differ(seen.F, _PANELS)
    columns = min(3, len(chosen))
    rows = int(np.ceil(len(chosen) / columns))
    figure = Figure(figsize=(3.0 * columns + 1.8, 3.0 * rows + 2.6), layout="constrained")
    figure.suptitle(in_words(title), fontsize=11)
    parts: Any = figure.subfigures(2, 1, height_ratios=(2.2, 3.0 * rows))
    above, below = parts
    place, curve = above.subplots(1, 2, width_ratios=(1.0, 1.4))

    still = fields.points[fields.cells[:, rim(fields)]]
    place.add_collection(PolyCollection([*still], facecolors="0.93", edgecolors="0.6"))
    place.add_collection(PolyCollection([still[element]], facecolors="0.6"))
    place.plot(*point, "x", color=VERMILION, markersize=8.0, mew=2.0)
    draw_scale_bar(place, *box(fields.points, ()))
    place.set_title("element and point (×)", fontsize=9)

    stretch = seen.extremes()["largest_wall_stretch"]
    curve.plot(t, stretch, color="0.3", linewidth=1.2)
    curve.plot(t[chosen], stretch[chosen], "o", color=VERMILION, markersize=5.0)
    curve.set_xlabel("load factor" if is_rest else "time (µs)")
    curve.set_ylabel("largest wall length\n/ rest length")
    curve.ticklabel_format(useOffset=False)
    curve.set_title("dots: the times below", fontsize=9)
    curve.grid(alpha=0.25)

    half = 0.75 * float(abs(np.einsum("nij,jk->nki", seen.F, seen.lattice)).sum(axis=1).max())
    places = below.subplots(rows, columns, squeeze=False)
    for axes, k in zip(places.flat, chosen, strict=False):
        bars = draw_cells(axes, seen, int(k), half)
        axes.set_title(clock.format(t[k]), fontsize=9)
    for axes in places.flat[len(chosen) :]:
        axes.axis("off")
    for colours, drawn in bars:
        colours.bar(places.ravel().tolist(), drawn)
    return figure
