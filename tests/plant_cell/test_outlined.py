"""Walls along the outlines of images, which scikit-image draws."""

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.plant_cell.outlined import outline_cells
from tests.questions.test_cell_image import squares

pytest.importorskip("skimage")
from skimage import draw, segmentation

PIXEL, LENGTH = 0.5, 2.0


def segmented(size=(120, 160), cells=12):
    """Labels of the cells about random points."""
    seeds = np.zeros(size, dtype=np.int64)
    at = np.random.default_rng(3).choice(seeds.size, cells, replace=False)
    seeds.flat[at] = np.arange(1, cells + 1)
    return segmentation.expand_labels(seeds, distance=sum(size))


def outlined(labels):
    return outline_cells(labels, PIXEL, LENGTH)


def spring_lengths(arrangement):
    i, j = arrangement.bonds[:, :2].T
    return np.linalg.norm(arrangement.wall_position[j] - arrangement.wall_position[i], axis=1)


def sides(arrangement):
    """How many polygons have each bond on their left, by (i, j) as walked."""
    count = {}
    for rim in arrangement.rims:
        for i, j in zip(rim[:, 0].tolist(), np.roll(rim[:, 0], -1).tolist(), strict=True):
            count[i, j] = count.get((i, j), 0) + 1
    return count


def test_cells_fill_an_image_and_each_spring_lies_between_two_polygons():
    labels = segmented()
    made = outlined(labels)
    arrangement, areas = made.arrangement, made.arrangement.tessellation.areas
    assert areas[made.is_cell].sum() == pytest.approx(labels.size * PIXEL**2)
    pixels = np.bincount(labels.ravel())[1:]
    np.testing.assert_allclose(
        np.sort(areas[made.is_cell]), np.sort(pixels[pixels > 0]) * PIXEL**2, rtol=0.06
    )
    both = sides(arrangement)
    assert set(both.values()) == {1}
    forth = {(i, j) for i, j in arrangement.bonds[:, :2].tolist()}
    assert both.keys() == forth | {(j, i) for i, j in forth}
    lengths = spring_lengths(arrangement)
    assert lengths.min() > 0.3 * LENGTH
    assert lengths.max() < 1.5 * LENGTH
    assert lengths.mean() == pytest.approx(LENGTH, rel=0.05)


def test_a_circle_has_its_round_outline():
    labels = np.zeros((100, 100), dtype=np.int64)
    labels[draw.disk((50.0, 50.0), 40.0)] = 1
    made = outlined(labels)
    assert list(made.is_cell) == [True, False]
    perimeter = spring_lengths(made.arrangement).sum()
    assert perimeter == pytest.approx(2.0 * np.pi * 40.0 * PIXEL, rel=0.02)


def test_air_has_a_polygon_for_each_border():
    image = squares(5, 5)
    image[image == 7] = 0
    made = outlined(image)
    areas = made.arrangement.tessellation.areas
    assert made.is_cell.sum() == 24
    np.testing.assert_allclose(areas[~made.is_cell], [-2500.0, 100.0])
    apart = np.zeros((60, 60), dtype=np.int64)
    apart[5:25, 5:25], apart[35:55, 35:55] = 1, 2
    made = outlined(apart)
    assert (made.is_cell.sum(), (~made.is_cell).sum()) == (2, 2)


def test_four_cells_meet_at_a_corner_or_nearly_at_one():
    image = squares(2, 2)
    made = outlined(image)
    ends = made.arrangement.bonds[:, :2].ravel()
    assert np.bincount(ends).max() == 4
    image[19:21, 19:21] = 1  # two corners, a pixel from the one
    made = outline_cells(image, PIXEL, 3.0)
    assert np.bincount(made.arrangement.bonds[:, :2].ravel()).max() == 4


def test_what_is_too_small_or_within_a_cell_belongs_to_others():
    image = squares(3, 3)
    image[25, 20] = 99  # one pixel between cells
    image[0, 20] = 0  # and one of air at the border
    image[25:33, 45:53] = 98  # a nucleus
    made = outlined(image)
    assert (made.is_cell.sum(), made.dissolved, made.enclosed) == (9, 2, 1)
    assert made.arrangement.tessellation.areas[made.is_cell].sum() == pytest.approx(900.0)


def test_a_cell_with_others_within_and_an_image_without_cells_are_refused():
    image = squares(3, 3, side=30)
    image[35:45, 35:50], image[45:55, 35:50] = 98, 99
    with pytest.raises(InputError, match=r"about \(21\.\d*, 22\.\d*\) µm lie within another cell"):
        outlined(image)
    with pytest.raises(InputError, match="no cell is larger than 4 squares of a spring's length"):
        outline_cells(squares(), 0.1, 5.0)
