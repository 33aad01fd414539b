"""Figures of tissues with supports and rigid bodies, and of plant cells."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import Collection, LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from surrofe2.base.arrays import Array
from surrofe2.problem.rigid_bodies import Circle, Corner, Plane, RigidBody, Shape
from surrofe2.run.charts import VERMILION, in_words
from surrofe2.rve.particles import Particles
from surrofe2.store.fields import StoredFields

MARGIN = 0.08
"""Room about a tissue with bodies, as a fraction of its size."""
_LEAST_SPAN = 0.02
"""Of colours, relative to the largest value: smaller differences are noise and look like it."""
_BOTH_SIGNS = 0.05
"""Of the largest value: from there on a value of the other sign makes colours diverge."""
_SIDES = 5000
"""Elements from which on their sides are not drawn."""
_ARC = 48
"""Sides of a drawn circle."""
_STILL = 1e-6
"""Of the largest displacement: what moves less is held."""
_PANELS = 6
"""Times at which plant cells are drawn."""


def rounded_up(value: float) -> float:
    """The next of 1, 2, 2.5, 5 or 10 times a power of ten."""
    if value <= 0.0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(k for k in (1.0, 2.0, 2.5, 5.0, 10.0) if k * power >= value * 0.9999) * power)


@dataclass(frozen=True, slots=True)
class Colours:
    """What values look like: a colour map between round limits, and words with the unit."""

    label: str
    low: float
    high: float
    name: str

    @classmethod
    def of(cls, label: str, values: Array, name: str = "viridis") -> Colours:
        """For these values; a map that diverges from 0 where they have both signs."""
        known = values[np.isfinite(values)]
        low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
        largest = max(abs(low), abs(high)) or 1.0
        if min(-low, high) > _BOTH_SIGNS * largest:
            end = rounded_up(largest)
            return cls(label, -end, end, "RdBu_r")
        lacking = 0.5 * max(_LEAST_SPAN * largest - (high - low), 0.0)
        step = rounded_up(0.2 * (high - low + 2.0 * lacking))
        ends = np.floor((low - lacking) / step + 1e-6), np.ceil((high + lacking) / step - 1e-6)
        return cls(label, float(ends[0] * step), float(ends[1] * step), name)

    def paint(self, drawn: Collection, values: Array) -> Any:
        """Colour a collection by values, grey where they are unknown."""
        colours = colormaps[self.name].with_extremes(bad="0.6")
        drawn.set(array=values, cmap=colours, clim=(self.low, self.high))
        return drawn

    def bar(self, places: Axes | Sequence[Axes], drawn: Any, location: str = "right") -> None:
        """The colour bar beside one or more axes, or at their "bottom"."""
        places = [places] if isinstance(places, Axes) else [*places]
        figure = places[0].get_figure()
        assert figure is not None
        look: Any = {"label": self.label, "shrink": 0.8, "aspect": 25, "location": location}
        bar = figure.colorbar(drawn, ax=places, **look)
        bar.locator = MaxNLocator(5)
        bar.update_ticks()
        bar.ax.ticklabel_format(useOffset=False)
        bar.ax.tick_params(labelsize=8)


def draw_scale_bar(axes: Axes, low: Array, high: Array) -> None:
    """A bar of round length below a box of two corners, and room for it."""
    width, room = float(high[0] - low[0]), 0.07 * float(max(high - low))
    length = rounded_up(0.12 * width)
    y = low[1] - room
    axes.plot([low[0], low[0] + length], [y, y], color="black", linewidth=2.5, clip_on=False)
    text = f"{length / 1000.0:g} mm" if length >= 1000.0 else f"{length:g} µm"
    axes.text(low[0] + 0.5 * length, y - 0.3 * room, text, ha="center", va="top", fontsize=8)
    axes.set(xlim=(low[0], high[0]), ylim=(y - 2.0 * room, high[1]), aspect="equal")
    axes.axis("off")


# A tissue, its supports and rigid bodies.


@dataclass(frozen=True, slots=True)
class DrawnBody:
    """A body at the times of the fields.

    Attributes:
        outline: (n, 2) where it began, a plane's and a corner's cut off far from the tissue, µm.
        moved: (m, 2) how far it is from there, µm.
    """

    outline: Array
    moved: Array

    def at(self, k: int, factor: float) -> Array:
        """(n, 2) outline at time k, its displacement multiplied as the tissue's is."""
        return self.outline + factor * self.moved[k]


def drawn_bodies(
    bodies: Iterable[RigidBody], t: Array, history: Mapping[str, Array], fields: StoredFields
) -> list[DrawnBody]:
    """Rigid bodies at the times of the fields; history: of a run, at its times t."""
    far, drawn = 4.0 * float(np.ptp(fields.points, axis=0).max()), []
    for body in bodies:
        moved = np.zeros((len(fields.t), 2))
        if f"position {body.name} x" in history:  # counted from where the body began
            position = [history[f"position {body.name} {axis}"] for axis in "xy"]
            moved = np.stack([np.interp(fields.t, t, each) for each in position], axis=1)
        drawn.append(DrawnBody(np.array(body.position) + outline(body.shape, far), moved))
    return drawn


def outline(shape: Shape, far: float) -> Array:
    """(n, 2) closed line of a shape about its position, cut off at a distance of some `far`, µm."""
    if isinstance(shape, Plane):
        x, y = np.array(shape.normal) / np.linalg.norm(shape.normal)
        along, inward = far * np.array([-y, x]), -far * np.array([x, y])
        return np.stack([along, -along, inward - along, inward + along])
    if isinstance(shape, Circle):
        turn = 2.0 * np.pi * np.arange(_ARC) / _ARC
        return shape.radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    assert isinstance(shape, Corner)
    x, y, cosine, sine, radius, _ = shape.outline
    axis, across = np.array([x, y]), np.array([-y, x])
    half = np.arctan2(sine, cosine)
    turn = np.linspace(half + 0.5 * np.pi, 1.5 * np.pi - half, _ARC)[:, None]
    arc = radius * (axis + np.cos(turn) * axis + np.sin(turn) * across)
    ends = [arc[k] + far * (cosine * axis + side * sine * across) for k, side in ((0, 1), (-1, -1))]
    return np.vstack([ends[0], arc, ends[1]])


def rim(fields: StoredFields) -> list[int]:
    """Order of an element's nodes along its sides."""
    corners = fields.cells.shape[1]
    return [0, 3, 1, 4, 2, 5] if corners == 6 else [*range(corners)]


def box(at: Array, bodies: Sequence[DrawnBody]) -> tuple[Array, Array]:
    """Lower left and upper right corner of what is shown of positions (…, 2); bodies need room."""
    points = at.reshape(-1, 2)
    low, high = points.min(axis=0), points.max(axis=0)
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
) -> Any:
    """The tissue at time k with supports, rigid bodies and a scale bar; what a colour bar takes.

    A half with a line of symmetry at its end is drawn whole. `values` (e,) are of the elements;
    displacements are drawn `factor` times as large."""
    at, order = fields.points + factor * fields.displacement[k], rim(fields)
    sides = _held_sides(fields)
    copies = [at]
    for axis, x in enumerate(fields.points.T):
        lines = {x[a] for a, *_, still in sides if still == axis}
        if len(lines) == 1 and lines <= {x.min(), x.max()}:
            mirror = 2.0 * lines.pop()
            copies += [np.where(np.arange(2) == axis, mirror - each, each) for each in copies]
    low, high = box(np.concatenate(copies), bodies)
    for body in bodies:
        axes.fill(*body.at(k, factor).T, facecolor="0.85", edgecolor="0.4", linewidth=1.0)
    for each in copies:
        corners = [*each[fields.cells[:, order]]]
        width = 0.3 * (len(corners) < _SIDES)
        drawn: Collection = PolyCollection(corners, edgecolors="0.4", linewidths=width)
        if fields.cells.shape[1] == 2:  # the springs of a full tissue
            drawn = LineCollection(corners, linewidths=0.8)
        axes.add_collection(colours.paint(drawn, values))
    depth = 0.035 * float(max(high - low))
    for a, b, inside, still in sides:
        for each in copies:
            ends = each[[a, b]]
            if still == _BOTH:
                along, across = ends[1] - ends[0], ends[0] - each[inside]
                normal = np.array([along[1], -along[0]]) / np.linalg.norm(along)
                out = depth * np.sign(normal @ across) * normal
                band = np.vstack([ends, ends[::-1] + out])
                axes.fill(*band.T, facecolor="none", edgecolor="0.4", hatch="/////", linewidth=0.0)
                low, high = np.minimum(low, band.min(axis=0)), np.maximum(high, band.max(axis=0))
            if still in (_BOTH, _RIGID):
                axes.plot(*ends.T, color="0.15", linewidth=2.5, solid_capstyle="butt")
            else:  # a line of symmetry
                axes.plot(*ends.T, color="0.15", linewidth=0.8, dashes=(8, 2, 2, 2))
    draw_scale_bar(axes, low, high)
    return drawn


_BOTH, _RIGID = 2, 3


def _held_sides(fields: StoredFields) -> list[tuple[int, int, int, int]]:
    """Sides on the boundary that supports or grips hold, by how they move in all of the fields:
    their nodes, a node inside across each, and the component that is still, or _BOTH, or _RIGID."""
    corners = {3: 3, 4: 4, 6: 3}.get(fields.cells.shape[1], 0)
    u = fields.displacement
    still = _STILL * float(abs(u).max())
    if not corners or not still:
        return []
    cells = fields.cells[:, :corners]
    sides = np.stack([np.roll(cells, -k, axis=1) for k in range(3)], axis=-1).reshape(-1, 3)
    ends = np.sort(sides[:, :2], axis=1)
    _, first, owners = np.unique(ends, axis=0, return_index=True, return_counts=True)
    held = []
    for a, b, inside in sides[first[owners == 1]].tolist():
        along = abs(fields.points[b] - fields.points[a])
        fixed = abs(u[:, [a, b]]).max(axis=(0, 1)) <= still
        if fixed.all():
            held.append((a, b, inside, _BOTH))
        elif abs(u[:, a] - u[:, b]).max() <= still:
            held.append((a, b, inside, _RIGID))
        elif fixed.any() and along[fixed.argmax()] < 1e-6 * along.sum():
            held.append((a, b, inside, int(fixed.argmax())))
    return held


# Plant cells.


def draw_cells(
    axes: Axes, seen: Particles, k: int, half: float = 0.0
) -> tuple[tuple[Colours, Any], tuple[Colours, Any]]:
    """RVE k with its neighbours: walls by stretch, fluid by turgor (dots, or areas if uniform); for
    the two colour bars their colours, the same for all RVEs, and what is drawn in them.

    half: of the width of the window about its centre, µm; 0: the RVE and a little more.
    """
    walls = Colours.of("wall length / rest length", seen.stretch)
    fluid = Colours.of("turgor (µN/µm)", seen.pressure, "Blues")
    lattice = seen.F[k] @ seen.lattice
    x, n_walls = seen.position[k], int(seen.is_wall.sum())
    half = half or 0.75 * float(abs(lattice).sum(axis=0).max())
    many = 1 + int(np.ceil(2.0 * half * abs(np.linalg.inv(lattice)).max()))
    shifts = np.arange(-many, many + 1)
    copies = np.stack(np.meshgrid(shifts, shifts), axis=-1).reshape(-1, 2) @ lattice.T
    copies = copies[(abs(copies) < half + 2.0 * abs(lattice).sum(axis=1)).all(axis=1)]
    first, second = x[seen.bonds[:, 0]], x[seen.bonds[:, 1]] + seen.bond_shift @ lattice.T
    segments = (np.stack([first, second], axis=1)[None] + copies[:, None, None]).reshape(-1, 2, 2)
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
    for each in (drawn, inside):
        each.set_clip_path(window)
    return (walls, drawn), (fluid, inside)


def cell_figure(
    title: str,
    seen: Particles,
    fields: StoredFields,
    element: int,
    point: Sequence[float],
    is_rest: bool = False,
) -> Figure:
    """A look into the plant cells at a point: where it is, wall stretch over time, six times.

    `seen` is the RVE of an element at the times of the fields, of a rest the factors of its load,
    and `point` in the undeformed tissue, µm."""
    t, clock = fields.t, "load factor {:.4g}" if is_rest else "t = {:.4g} µs"
    chosen = np.unique(np.linspace(0, len(t) - 1, min(_PANELS, len(t))).round().astype(int))
    columns = min(3, len(chosen))
    rows = -(-len(chosen) // columns)
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
