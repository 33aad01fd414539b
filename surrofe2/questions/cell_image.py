"""Plant cells of a labelled image: how large and long they are, and an RVE that is like them.

Pixels of a cell have its label, those between cells 0. Lines between cells are divided among their
neighbours; what is wider stays a hole, an air space. Cells that the border of the image cuts count
as neighbours alone, and so does what is too small to have a shape.

The aspect ratio of a cell is the root of the ratio of its principal second moments of area, its
direction that of the long axis, from x (to the right) towards y (upwards). The *alignment* of cells
is the length of the mean of exp(2iθ) over their directions, weighted by the logarithm of their
aspect ratio: 1 where all long axes are parallel, near 0 where they point everywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy  # scipy.ndimage is loaded where an image is measured

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.errors import InputError, printable
from surrofe2.plant_cell.arrangement import make_arrangement
from surrofe2.plant_cell.measurements import living_cell
from surrofe2.plant_cell.parameters import LEAST_VARIATION, LIVING, CellParameters
from surrofe2.plant_cell.tessellation import aspect_ratio, polygon_area
from surrofe2.report.tables import Quantity, Table
from surrofe2.rve import RveLaw
from surrofe2.store.labelled_image import LINE, Labels

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Beginning of the recipe of such an RVE.
MARK = "# Like "
# Pixels of a cell below which it has no shape, and whole cells that an image must have.
FEWEST_PIXELS = 9
FEWEST_CELLS = 3

# The search for an RVE (`rve_like`).
# Alignment below which it is not stretched: cells that are laid out at random reach 0.4.
_ALIGNED = 0.5
# Largest variation of areas, and aspect ratio, that are laid out.
_MOST_VARIATION = 0.6
_MOST_ELONGATION = 6.0
# Seeds that are tried at most, and the number of layouts that come to rest, of which the best is
# taken.
_SEEDS = 20
_ENOUGH = 3
# A layout is corrected so often for what is left of it at rest, or until the relative difference is
# as small as this.
_CORRECTIONS = 3
_NEAR = 0.03
# A variation of areas at rest counts as at least this, so that a correction by it is finite.
_LEAST_SHAPE = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class Shapes:
    """Numbers on the shapes of cells, of an image or of an RVE.

    Attributes:
        area_variation: coefficient of variation of the areas.
        elongation: mean aspect ratio.
        direction: mean direction of the long axes, degrees.
        alignment: alignment of the long axes, from 0 to 1.
        neighbours: mean number; NaN where no cell is surrounded by cells.
    """

    area_variation: float
    elongation: float
    direction: float
    alignment: float
    neighbours: float

    @classmethod
    def of(cls, area: Array, aspect: Array, direction: Array, neighbours: float) -> Shapes:
        """Compute the numbers from areas, aspect ratios and directions (°) of cells, (n,) each."""
        alignment, mean_direction = alignment_of(aspect, direction)
        return cls(
            area_variation=float(area.std() / area.mean()),
            elongation=float(aspect.mean()),
            direction=mean_direction,
            alignment=alignment,
            neighbours=neighbours,
        )

    def difference(self, wanted: Shapes) -> float:
        """Return the larger relative difference, of the areas' variation or of the aspect ratio."""
        of_areas = abs(self.area_variation - wanted.area_variation) / wanted.area_variation
        of_aspect = abs(self.elongation - wanted.elongation) / wanted.elongation
        return max(of_areas, of_aspect)


@dataclass(frozen=True, slots=True, kw_only=True)
class ImagedCells:
    """The n whole cells of an image, and what was left out of it.

    Attributes:
        labels: (rows, columns) numbers of all cells, lines between them divided.
        pixel: side of a pixel, µm.
        number: (n,) numbers of the whole cells in `labels`.
        label: (n,) their labels in the image.
        area: (n,) µm².
        aspect: (n,) aspect ratios.
        direction: (n,) degrees from −90 to 90.
        centre: (n, 2) x and y from the lower left corner, µm.
        neighbours: (n,) cells beside each; −1 of a cell at a hole or at the outside, which has
            fewer than in a closed tissue.
        cut: number of cells at the border of the image.
        small: number of cells of fewer than `FEWEST_PIXELS` pixels.
        pieces: number of cells in pieces, of which the largest was taken.
        holes: number of holes.
        hole_fraction: their fraction of all area.
        corners: number of places where four cells meet; those across are no neighbours.
    """

    labels: Labels
    pixel: float
    number: Index
    label: Index
    area: Array
    aspect: Array
    direction: Array
    centre: Array
    neighbours: Index
    cut: int
    small: int
    pieces: int
    holes: int
    hole_fraction: float
    corners: int

    @property
    def cell_size(self) -> float:
        """Side of a square of the mean area, µm."""
        return float(np.sqrt(self.area.mean()))

    @property
    def shapes(self) -> Shapes:
        """Numbers on the whole cells; neighbours are those of cells surrounded by cells."""
        enclosed = self.neighbours[self.neighbours >= 0]
        neighbours = float(enclosed.mean()) if enclosed.size else float("nan")
        return Shapes.of(self.area, self.aspect, self.direction, neighbours)

    def remarks(self) -> Iterator[str]:
        """Iterate over remarks on what in the image is no whole cell among cells."""
        if self.cut:
            yield f"cells that the border of the image cuts, left out: {self.cut}"
        if self.small:
            yield f"cells of fewer than {FEWEST_PIXELS} pixels, left out: {self.small}"
        if self.pieces:
            yield f"cells in pieces, of which the largest is taken: {self.pieces}"
        if self.holes:
            percent = 100.0 * self.hole_fraction
            yield f"holes: {self.holes}, {percent:.2g} % of the area; an RVE has no air spaces"
        if self.corners:
            yield f"places where four cells meet, no neighbours across: {self.corners}"


def alignment_of(aspect: Array, direction: Array) -> tuple[float, float]:
    """Compute the alignment of long axes (n,), and their mean direction in degrees."""
    weight = np.log(aspect)  # a round cell has no direction
    total = weight.sum()
    if not total > 0.0:
        return 0.0, 0.0
    # an axis points both ways: at twice its angle both are the same
    mean = (weight * np.exp(2j * np.deg2rad(direction))).sum() / total
    return float(abs(mean)), float(np.rad2deg(np.angle(mean)) / 2.0)


def measure_cells(labels: Labels, pixel: float, line: int = LINE) -> ImagedCells:
    """Measure the cells of a labelled image.

    Args:
        labels: (rows, columns), the first row at the top; 0 between cells.
        pixel: side of a pixel, µm.
        line: most pixels across a line between cells; what is wider is a hole.

    Raises:
        InputError: the pixel has no size, the line fewer than 0 pixels, or fewer than
            `FEWEST_CELLS` cells are whole.
    """
    if not 0.0 < pixel < np.inf:
        raise InputError(f"--pixel: {pixel}; it must be positive (µm)")
    if line < 0:
        raise InputError(f"--line: {line}; it must be at least 0 (pixels)")
    whole, pieces = _largest_pieces(labels)
    count = np.bincount(whole.ravel())  # pixels of each cell; 0 is what lies between cells
    count[0] = 0
    few = (count > 0) & (count < FEWEST_PIXELS)
    whole[few[whole]] = 0
    filled = _without_lines(whole, line)
    at_border = np.zeros(len(count), dtype=np.bool_)
    for side in (filled[0], filled[-1], filled[:, 0], filled[:, -1]):
        at_border[side] = True
    area = np.bincount(filled.ravel(), minlength=len(count))
    number = np.flatnonzero((area > 0) & ~at_border)
    number = number[number > 0]
    if len(number) < FEWEST_CELLS:
        raise InputError(
            f"image: {len(number)} whole cells; at least {FEWEST_CELLS} must lie within its border"
        )
    holes, hole_area, at_hole = _holes(filled, len(count))
    aspect, direction, centre = _moments(filled, number)
    beside = _neighbours(filled, len(count))
    beside[at_hole] = -1
    names = np.unique(labels)
    names = np.concatenate([[0], names[names > 0]])
    return ImagedCells(
        labels=filled,
        pixel=pixel,
        number=number,
        label=names[number],
        area=np.asarray(area[number] * pixel**2, dtype=np.float64),
        aspect=aspect,
        direction=direction,
        centre=centre * pixel,
        neighbours=beside[number],
        cut=int((at_border & (area > 0))[1:].sum()),
        small=int(few.sum()),
        pieces=pieces,
        holes=holes,
        hole_fraction=hole_area / filled.size,
        corners=_corners_of_four(filled),
    )


def _largest_pieces(labels: Labels) -> tuple[Labels, int]:
    """Number the cells from 1 in the order of their labels, and keep the largest piece of each.

    Returns:
        Numbers of all pixels, 0 for other pieces; and how many cells had several.
    """
    names, inverse = np.unique(labels, return_inverse=True)
    numbered: Labels = inverse.reshape(labels.shape).astype(np.int64)
    numbered += 0 if names[0] == 0 else 1
    several = 0
    for number, box in enumerate(scipy.ndimage.find_objects(numbered), 1):
        if box is None:
            continue
        inside = numbered[box] == number
        parts, count = scipy.ndimage.label(inside)
        if count > 1:
            several += 1
            sizes = np.bincount(parts.ravel())
            sizes[0] = 0
            numbered[box][inside & (parts != sizes.argmax())] = 0
    return numbered, several


def _without_lines(labels: Labels, line: int) -> Labels:
    """Give the pixels of lines between cells, at most so many across, to the nearest cell."""
    empty = labels == 0
    if not empty.any():
        return labels
    # what holds a square of more pixels is no line; beyond the image there may be more of it
    wider = line + 1
    square = np.ones((wider, wider), dtype=np.bool_)
    room = np.pad(empty, wider, constant_values=True)
    wide = scipy.ndimage.binary_opening(room, square)[wider:-wider, wider:-wider]
    nearest = scipy.ndimage.distance_transform_edt(
        empty, return_distances=False, return_indices=True
    )
    filled: Labels = np.where(empty & ~wide, labels[tuple(nearest)], labels)
    return filled


def _holes(labels: Labels, numbers: int) -> tuple[int, int, Flags]:
    """Find holes within cells.

    Args:
        numbers: number of cells, 0 included.

    Returns:
        Number of holes; their pixels; (numbers,) whether each cell is at a hole or at the outside.
    """
    parts, count = scipy.ndimage.label(labels == 0)
    sizes = np.bincount(parts.ravel(), minlength=count + 1)
    inner = np.ones(count + 1, dtype=np.bool_)
    inner[0] = False
    for side in (parts[0], parts[-1], parts[:, 0], parts[:, -1]):
        inner[side] = False
    beside = np.zeros(numbers, dtype=np.bool_)
    for a, b in _beside(labels):
        beside[a[b == 0]] = True
        beside[b[a == 0]] = True
    return int(inner.sum()), int(sizes[inner].sum()), beside


def _beside(labels: Labels) -> Iterator[tuple[Index, Index]]:
    """Yield the labels of pixels that share a side and differ: side by side, then stacked."""
    for first, second in ((labels[:, :-1], labels[:, 1:]), (labels[:-1], labels[1:])):
        differ = first != second
        yield first[differ], second[differ]


def _neighbours(labels: Labels, count: int) -> Index:
    """Return (count,) the number of cells that share a side of a pixel with each cell."""
    pairs = np.concatenate([np.stack(pair, axis=1) for pair in _beside(labels)])
    pairs = pairs[(pairs > 0).all(axis=1)]
    pairs = np.unique(np.sort(pairs, axis=1), axis=0)
    return np.bincount(pairs.ravel(), minlength=count)


def _corners_of_four(labels: Labels) -> int:
    """Count the places where four different cells meet."""
    four = np.stack([labels[:-1, :-1], labels[:-1, 1:], labels[1:, :-1], labels[1:, 1:]])
    ordered = np.sort(four, axis=0)
    differ = (np.diff(ordered, axis=0) > 0).all(axis=0)
    return int((differ & (ordered[0] > 0)).sum())


def _moments(labels: Labels, number: Index) -> tuple[Array, Array, Array]:
    """Compute aspect ratios, directions (°) (n,) and centres (n, 2), in pixels, of cells."""
    rows, columns = np.nonzero(labels)
    x = columns + 0.5
    y = labels.shape[0] - 0.5 - rows
    which = labels[rows, columns]

    def mean(values: Any) -> Array:
        """Return the mean over each cell of values at all pixels."""
        return np.asarray((np.bincount(which, values) / area)[number], dtype=np.float64)

    area = np.maximum(np.bincount(which), 1)
    centre = np.stack([mean(x), mean(y)], axis=1)
    # a pixel is a square, with the second moment 1/12 about its middle
    xx = mean(x * x) - centre[:, 0] ** 2 + 1.0 / 12.0
    yy = mean(y * y) - centre[:, 1] ** 2 + 1.0 / 12.0
    xy = mean(x * y) - centre[:, 0] * centre[:, 1]
    half = (xx + yy) / 2.0
    deviation = np.hypot((xx - yy) / 2.0, xy)
    aspect = np.sqrt((half + deviation) / (half - deviation))
    return aspect, np.rad2deg(np.arctan2(2.0 * xy, xx - yy) / 2.0), centre


def _direction(corners: Array) -> float:
    """Compute the direction of a polygon's long axis, °, by second moments of its outline."""
    # 20 points along each side, which stand for its length
    steps = np.linspace(0.0, 1.0, 20, endpoint=False)[:, None, None]
    sides = np.roll(corners, -1, axis=0) - corners
    along = corners + steps * sides
    length = np.linalg.norm(sides, axis=1)
    weight = np.broadcast_to(length, along.shape[:2]).ravel()
    r = along.reshape(-1, 2)
    r = r - weight @ r / weight.sum()
    xx = weight @ r[:, 0] ** 2
    yy = weight @ r[:, 1] ** 2
    xy = weight @ (r[:, 0] * r[:, 1])
    return float(np.rad2deg(np.arctan2(2.0 * xy, xx - yy) / 2.0))


def laid_out(cell: CellParameters) -> Shapes:
    """Compute the shapes of the plant cells of an RVE as they are laid out."""
    tessellation = cell.tessellation
    return _shapes_of([tessellation.corners(k) for k in range(cell.cells)], cell)


def at_rest(cell: CellParameters) -> Shapes:
    """Compute the shapes of an RVE's plant cells at rest, by the wall particles around each."""
    polygons, _ = polygons_at_rest(cell)
    return _shapes_of(polygons, cell)


def polygons_at_rest(cell: CellParameters) -> tuple[list[Array], Array]:
    """Return the wall particles around each plant cell of an RVE at rest, (k, 2) each, in µm.

    The second value is the lattice (2, 2), whose columns are the periods.
    """
    reference = RveLaw(cell).reference
    position = reference.position
    lattice = reference.lattice
    rims = make_arrangement(cell).rims
    return [position[rim[:, 0]] + rim[:, 1:] @ lattice.T for rim in rims], lattice


def _shapes_of(polygons: list[Array], cell: CellParameters) -> Shapes:
    """Compute the shapes of polygons (k, 2), one for each plant cell of an RVE."""
    area = np.array([polygon_area(polygon) for polygon in polygons])
    aspect = np.array([aspect_ratio(polygon) for polygon in polygons])
    direction = np.array([_direction(polygon) for polygon in polygons])
    neighbours = float(np.mean([len(corners) for corners in cell.tessellation.polygons]))
    return Shapes.of(area, aspect, direction, neighbours)


@dataclass(frozen=True, slots=True, kw_only=True)
class LikeCells:
    """An RVE that is like the cells of an image.

    Attributes:
        entries: those of a section [cell] that states it.
        cell: its parameters.
        laid_out: its shapes as laid out.
        at_rest: its shapes at rest.
        remarks: remarks on what of the image it cannot have.
    """

    entries: dict[str, Any]
    cell: CellParameters
    laid_out: Shapes
    at_rest: Shapes
    remarks: tuple[str, ...]

    def table(self, wanted: Shapes) -> Table[Any]:
        """Make a table of the shapes that are wanted, laid out, and left at rest."""
        shapes = {"image": wanted, "laid out": self.laid_out, "at rest": self.at_rest}
        quantities = {
            "variation of areas": lambda shape: shape.area_variation,
            "mean aspect ratio": lambda shape: shape.elongation,
            "mean direction, °": lambda shape: shape.direction,
            "alignment": lambda shape: shape.alignment,
            "neighbours": lambda shape: shape.neighbours,
        }
        rows: list[dict[str, Any]] = []
        for name, value_of in quantities.items():
            values = {column: value_of(shape) for column, shape in shapes.items()}
            rows.append({"quantity": name, **values})
        columns: list[Quantity[Any]] = [Quantity("quantity", "", "")]
        columns += [Quantity(column, "", ".3g") for column in shapes]
        return Table(columns, rows)


def rve_like(
    cells: ImagedCells,
    preset: str = "apple",
    number: int = 9,
    *,
    progress: Callable[[float], None] = lambda done: None,
) -> LikeCells:
    """Find a Voronoi RVE whose cells at rest are like those of an image.

    Walls of one rest length change areas and shapes when they settle. So for each of some seeds the
    layout is corrected until the cells at rest are near what is wanted, or `_CORRECTIONS` times.
    The thickness of the walls is the preset's in proportion to the size of the cells, so that the
    turgor stretches them as much.

    Args:
        cells: those of the image.
        preset: of living cells, whose other measurements it has.
        number: of plant cells in the RVE.
        progress: called with the fraction of the search that is done.

    Raises:
        InputError: no seed has a layout that comes to rest.
    """
    wanted = cells.shapes
    tissue = LIVING[preset][0]
    thickness = tissue.wall_thickness * cells.cell_size / tissue.cell_size
    remarks = [
        f"wall_thickness {thickness:.3g} µm is the preset's in proportion to the size of the "
        "cells: measure it"
    ]
    variation = min(max(wanted.area_variation, LEAST_VARIATION), _MOST_VARIATION)
    if variation != wanted.area_variation:
        remarks.append(
            f"areas vary by {wanted.area_variation:.3g}; those of an RVE can by {LEAST_VARIATION} "
            f"to {_MOST_VARIATION}"
        )
    is_stretched = wanted.alignment >= _ALIGNED
    if not is_stretched:
        remarks.append(
            f"long axes point everywhere (alignment {wanted.alignment:.2g}), so the RVE is not "
            "stretched"
        )
    entries: dict[str, Any] = {
        "preset": preset,
        "cell_size": _rounded(cells.cell_size),
        "wall_thickness": _rounded(thickness),
        "arrangement": "voronoi",
        "cells": number,
    }
    aim = replace(wanted, area_variation=variation)
    best: LikeCells | None = None
    settled = 0
    refused = list[InputError]()
    for seed in range(1, 1 + _SEEDS):
        entries["arrangement_seed"] = seed
        try:
            # an RVE of this seed counts, too, where its next correction is refused
            for candidate in _corrected(entries, aim, is_stretched, tuple(remarks)):
                difference = candidate.at_rest.difference(aim)
                if best is None or difference < best.at_rest.difference(aim):
                    best = candidate
        except InputError as error:
            refused.append(error)
        else:
            settled += 1
        progress(max(settled / _ENOUGH, seed / _SEEDS))
        if settled == _ENOUGH or (best and best.at_rest.difference(aim) <= _NEAR):
            break
    if best is None:
        raise refused[-1]
    return best


def _corrected(
    entries: Mapping[str, Any], aim: Shapes, is_stretched: bool, remarks: tuple[str, ...]
) -> Iterator[LikeCells]:
    """Yield RVEs of one seed, each laid out by what the one before lacked at rest.

    Raises:
        InputError: the layout is out of reach, or does not come to rest.
    """
    areas = aim.area_variation
    aspect = aim.elongation if is_stretched else 1.0
    before: dict[str, Any] = {}
    for _ in range(1 + _CORRECTIONS):
        tried = {
            **entries,
            "area_variation": _rounded(min(max(areas, LEAST_VARIATION), _MOST_VARIATION)),
        }
        cell = living_cell(**tried)
        remarks_on_it = remarks
        if is_stretched:
            # Voronoi cells are longer than wide as they come, and cannot be laid out rounder
            as_they_come = laid_out(cell).elongation
            if _rounded(aspect) > as_they_come:
                tried["elongation"] = _rounded(aspect)
                tried["elongation_direction"] = _rounded(aim.direction)
                cell = living_cell(**tried)
            else:
                aspect = as_they_come
                remarks_on_it = (
                    *remarks,
                    f"mean aspect ratio {aim.elongation:.3g}: Voronoi cells have "
                    f"{as_they_come:.3g} without being stretched, so the RVE is not stretched",
                )
        if tried == before:
            return  # the correction has changed nothing: what is wanted is out of reach
        before = tried
        reached = LikeCells(
            entries=tried,
            cell=cell,
            laid_out=laid_out(cell),
            at_rest=at_rest(cell),
            remarks=remarks_on_it,
        )
        yield reached
        rest = reached.at_rest
        if rest.difference(aim) <= _NEAR:
            return
        # next time more or less in proportion to what is left of it
        areas *= aim.area_variation / max(rest.area_variation, _LEAST_SHAPE)
        if is_stretched:
            # the same for the part beyond 1, the aspect ratio of a round cell
            aspect = 1.0 + (aspect - 1.0) * (aim.elongation - 1.0) / (rest.elongation - 1.0)
            aspect = min(max(aspect, 1.0), _MOST_ELONGATION)


def _rounded(value: float) -> float:
    """Round a number to four digits, as a recipe states it."""
    return float(f"{value:.4g}")


def shapes_table(cells: ImagedCells) -> Table[Any]:
    """Make a table of the shapes of the whole cells of an image."""
    shapes = cells.shapes
    rows: list[dict[str, Any]] = [
        {"quantity": "whole cells", "value": len(cells.area), "unit": ""},
        {"quantity": "mean area", "value": float(cells.area.mean()), "unit": "µm²"},
        {"quantity": "side of a square of that area", "value": cells.cell_size, "unit": "µm"},
        {"quantity": "variation of areas", "value": shapes.area_variation, "unit": ""},
        {"quantity": "mean aspect ratio", "value": shapes.elongation, "unit": ""},
        {"quantity": "mean direction of long axes", "value": shapes.direction, "unit": "°"},
        {"quantity": "alignment of long axes", "value": shapes.alignment, "unit": ""},
        {"quantity": "neighbours", "value": shapes.neighbours, "unit": ""},
    ]
    value: Quantity[Any] = Quantity("value", "", ".4g")
    return Table((Quantity("quantity", "", ""), value, Quantity("unit", "", "")), rows)


def picture(cells: ImagedCells, like: LikeCells | None = None) -> Figure:
    """Draw the outlines of the image's cells, beside them those of an RVE."""
    # here, since the other commands on cells need no matplotlib
    from surrofe2.report.outlines import long_axes, outlines_figure

    rve = None if like is None else polygons_at_rest(like.cell)
    axes = long_axes(cells.centre, cells.area, cells.aspect, cells.direction)
    return outlines_figure(cells.labels, cells.pixel, cells.number, axes, rve)


def section(like: LikeCells, about: str) -> str:
    """Return the section [cell] of a recipe in TOML, with a comment on where it comes from."""
    lines = [f"{MARK}{printable(about)}"]  # names of files may have line breaks
    lines += [f"# {remark}" for remark in like.remarks]
    lines.append("[cell]")
    for key, value in like.entries.items():
        lines.append(f'{key} = "{value}"' if isinstance(value, str) else f"{key} = {value}")
    return "\n".join(lines) + "\n"
