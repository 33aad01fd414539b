"""Cells of images that scikit-image draws: shapes, what is no whole cell, an RVE like them."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.plant_cell.measurements import living_cell
from surrofe2.plant_cell.parameters import LEAST_VARIATION
from surrofe2.questions import cell_image
from surrofe2.questions.cell_image import (
    alignment_of,
    at_rest,
    laid_out,
    measure_cells,
    rve_like,
    section,
)
from surrofe2.recipe.entries import read_toml
from surrofe2.recipe.recipe import make_recipe

draw = pytest.importorskip("skimage.draw")
measure = pytest.importorskip("skimage.measure")


def image_of(polygons, shape):
    """Labels of polygons in pixels, x to the right and y upwards."""
    labels = np.zeros(shape, dtype=np.int64)
    for number, polygon in enumerate(polygons, 1):
        x, y = polygon.T
        rows, columns = draw.polygon(shape[0] - y - 0.5, x - 0.5, shape)
        labels[rows, columns] = number
    return labels


def tissue_image(cell, scale=4.0, size=(420, 420)):
    """Labels of many periods of an RVE's cells as they are laid out, `scale` pixels per µm."""
    tessellation, number = cell.tessellation, range(cell.cells)
    polygons = [
        scale * (tessellation.corners(k) + tessellation.lattice @ (a, b))
        for k in number
        for a in range(-9, 10)
        for b in range(-9, 10)
    ]
    inside = [each for each in polygons if (each.max(axis=0) > 0.0).all()]
    inside = [each for each in inside if (each.min(axis=0) < size[::-1]).all()]
    return image_of(inside, size)


def ellipses(directions, ratio=2.0, half=20.0):
    """Separate ellipses in a row, with long axes in these directions, degrees from x upwards."""
    size = int(5 * half)
    labels = np.zeros((size, size * len(directions)), dtype=np.int64)
    for k, direction in enumerate(directions):
        rows, columns = draw.ellipse(
            size / 2,
            size * (k + 0.5),
            half / np.sqrt(ratio),
            half * np.sqrt(ratio),
            shape=labels.shape,
            rotation=np.deg2rad(direction),
        )
        labels[rows, columns] = k + 1
    return labels


def squares(rows=5, columns=5, side=20, line=0):
    """Square cells of so many pixels, divided by lines of 0."""
    labels = np.arange(1, rows * columns + 1).reshape(rows, columns)
    image = np.kron(labels, np.ones((side, side), dtype=np.int64))
    for k in range(1, rows):
        image[k * side - line : k * side] = 0
    for k in range(1, columns):
        image[:, k * side - line : k * side] = 0
    return image


def test_shapes_are_those_that_scikit_image_measures():
    labels = ellipses((10.0, 70.0, -40.0, 0.0), ratio=1.7)
    cells = measure_cells(labels, 0.5)
    known = measure.regionprops(labels)
    np.testing.assert_allclose(cells.area, [0.25 * each.area for each in known])
    ratio = [each.axis_major_length / each.axis_minor_length for each in known]
    # pixels are squares here and points there
    np.testing.assert_allclose(cells.aspect, ratio, rtol=1e-3)
    np.testing.assert_allclose(cells.direction, [10.0, 70.0, -40.0, 0.0], atol=1.0)
    centres = [
        (0.5 * (x + 0.5), 0.5 * (len(labels) - 0.5 - y)) for y, x in (p.centroid for p in known)
    ]
    np.testing.assert_allclose(cells.centre, centres)


def test_a_pixel_scales_lengths_and_nothing_else():
    labels = ellipses((10.0, 70.0, -40.0))
    once, twice = measure_cells(labels, 0.35), measure_cells(labels, 0.7)
    assert twice.cell_size == pytest.approx(2.0 * once.cell_size)
    assert twice.shapes.area_variation == pytest.approx(once.shapes.area_variation)
    np.testing.assert_array_equal(twice.aspect, once.aspect)


@pytest.mark.parametrize("direction", [0.0, 30.0, 90.0, -60.0])
def test_parallel_axes_are_aligned_and_scattered_ones_are_not(direction):
    aligned = measure_cells(ellipses((direction,) * 4), 1.0).shapes
    assert aligned.alignment == pytest.approx(1.0, abs=1e-3)
    apart = np.deg2rad(2.0 * (aligned.direction - direction))
    assert np.cos(apart) == pytest.approx(1.0, abs=1e-3)
    scattered = measure_cells(ellipses((0.0, 45.0, 90.0, 135.0)), 1.0).shapes
    assert scattered.alignment < 0.02
    assert alignment_of(np.ones(3), np.zeros(3)) == (0.0, 0.0)


@pytest.mark.parametrize("shape", [{}, {"area_variation": 0.4}, {"elongation": 1.8}], ids=str)
def test_an_image_of_an_rve_has_the_shapes_of_the_rve(shape):
    cell = living_cell("apple", arrangement="voronoi", cells=6, cell_size=15.0, **shape)
    cells, known = measure_cells(tissue_image(cell), 0.25), laid_out(cell)
    assert cells.cell_size == pytest.approx(15.0, rel=0.02)
    seen = cells.shapes
    assert seen.area_variation == pytest.approx(known.area_variation, rel=0.1)
    assert seen.elongation == pytest.approx(known.elongation, rel=0.03)
    assert seen.neighbours == pytest.approx(6.0, rel=0.1)
    if "elongation" in shape:
        assert seen.direction == pytest.approx(known.direction, abs=5.0)
        assert min(seen.alignment, known.alignment) > 0.8


@pytest.mark.parametrize("line", [0, 1, 3])
def test_cells_at_the_border_are_neighbours_alone_and_lines_belong_to_cells(line):
    cells = measure_cells(squares(line=line), 1.0)
    assert (len(cells.area), cells.cut, cells.holes) == (9, 16, 0)
    np.testing.assert_allclose(cells.area, 400.0)
    # four meet at a corner: those across are no neighbours
    assert cells.corners == 16
    np.testing.assert_array_equal(cells.neighbours, 4)
    assert any("four cells meet" in remark for remark in cells.remarks())
    assert list(cells.label) == [7, 8, 9, 12, 13, 14, 17, 18, 19]


def test_a_hole_is_no_cell_and_cells_beside_it_have_no_number_of_neighbours():
    image = squares(7, 7)
    image[image == 25] = 0
    cells = measure_cells(image, 1.0)
    assert (len(cells.area), cells.holes) == (24, 1)
    assert cells.hole_fraction == pytest.approx(1 / 49)
    assert (cells.neighbours == -1).sum() == 4
    assert any("holes: 1, 2 % of the area" in remark for remark in cells.remarks())


def test_how_wide_a_line_may_be_is_stated():
    image = squares(line=5)
    wide = measure_cells(image, 1.0)
    assert wide.area.mean() == pytest.approx(225.0)
    assert (wide.neighbours == -1).all()
    lines = measure_cells(image, 1.0, line=5)
    assert lines.area.mean() == pytest.approx(400.0)
    np.testing.assert_array_equal(lines.neighbours, 4)
    with pytest.raises(InputError, match="--line: -1; it must be at least 0"):
        measure_cells(image, 1.0, line=-1)


def test_specks_and_pieces_are_named():
    image = squares()
    image[30, 30] = 99  # one pixel within cell 7
    image[50, 50] = 8  # a piece of cell 8 within cell 13
    cells = measure_cells(image, 1.0)
    assert (cells.small, cells.pieces, cells.holes) == (1, 1, 0)
    np.testing.assert_allclose(cells.area, 400.0)
    remarks = " ".join(cells.remarks())
    assert "fewer than 9 pixels, left out: 1" in remarks
    assert "the largest is taken: 1" in remarks


def test_labels_may_be_any_numbers():
    image = squares()
    others = image * 1000 + 7 * (image > 0)
    expected = measure_cells(image, 1.0).label * 1000 + 7
    np.testing.assert_array_equal(measure_cells(others, 1.0).label, expected)


def test_an_image_without_whole_cells_is_refused():
    with pytest.raises(InputError, match="image: 1 whole cells; at least 3"):
        measure_cells(squares(3, 3), 1.0)
    with pytest.raises(InputError, match=r"--pixel: 0\.0; it must be positive"):
        measure_cells(squares(), 0.0)


def test_an_rve_is_like_the_cells_of_an_image(monkeypatch):
    monkeypatch.setattr(cell_image, "_ENOUGH", 1)
    monkeypatch.setattr(cell_image, "_CORRECTIONS", 1)
    original = living_cell("apple", arrangement="voronoi", cells=6, cell_size=15.0)
    cells = measure_cells(tissue_image(original), 0.25)
    like = rve_like(cells, number=6)
    wanted = cells.shapes
    assert like.at_rest.area_variation == pytest.approx(wanted.area_variation, rel=0.25)
    assert like.at_rest == at_rest(like.cell)
    assert like.entries["cell_size"] == pytest.approx(cells.cell_size, rel=1e-3)
    text = section(like, "an image")
    assert make_recipe(read_toml(text)).study().cell.parameters == like.cell
    assert text.startswith(cell_image.MARK)
    assert (
        make_recipe(read_toml(section(like, "a line\nand another"))).study().cell.parameters
        == like.cell
    )


def test_long_axes_that_point_everywhere_stretch_no_rve(monkeypatch):
    cells = measure_cells(ellipses((0.0, 45.0, 90.0, 135.0)), 1.0)
    monkeypatch.setattr(cell_image, "at_rest", laid_out)
    like = rve_like(replace(cells, area=cells.area * [1.0, 1.5, 0.5, 1.0]), number=8)
    assert "elongation" not in like.entries
    assert any("point everywhere" in remark for remark in like.remarks)


def test_cells_of_one_area_have_the_rve_whose_areas_vary_least(monkeypatch):
    monkeypatch.setattr(cell_image, "at_rest", laid_out)
    like = rve_like(measure_cells(squares(), 1.0), number=8)
    assert like.entries["area_variation"] == LEAST_VARIATION
    assert any("areas vary by 0; those of an RVE can by 0.1" in remark for remark in like.remarks)


def test_cells_rounder_than_voronoi_cells_stretch_no_rve(monkeypatch):
    """Cells of one direction that are hardly long: Voronoi cells are longer as they come."""
    monkeypatch.setattr(cell_image, "at_rest", laid_out)
    cells = measure_cells(ellipses((30.0,) * 4, ratio=1.1), 1.0)
    like = rve_like(replace(cells, area=cells.area * [1.0, 1.4, 0.6, 1.0]), number=8)
    assert "elongation" not in like.entries
    assert like.laid_out.elongation > cells.shapes.elongation
    assert any("without being stretched" in remark for remark in like.remarks)


def test_what_is_laid_out_is_corrected_for_what_is_left_at_rest(monkeypatch):
    """At rest half the elongation is left: twice as much is laid out."""

    def relaxed(cell):
        shapes = laid_out(cell)
        return replace(shapes, elongation=1.0 + 0.5 * (shapes.elongation - 1.0))

    monkeypatch.setattr(cell_image, "at_rest", relaxed)
    cells = measure_cells(ellipses((30.0,) * 4, ratio=1.5), 1.0)
    cells = replace(cells, area=cells.area * [1.0, 1.4, 0.6, 1.0])
    like = rve_like(cells, number=8)
    wanted = cells.shapes
    assert like.at_rest.elongation == pytest.approx(wanted.elongation, rel=0.03)
    assert like.laid_out.elongation == pytest.approx(2.0, rel=0.05)
    assert like.entries["elongation_direction"] == pytest.approx(30.0, abs=1.0)
