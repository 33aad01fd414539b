"""Means over arrangements, and sides of whole RVEs."""

import numpy as np
import pytest

from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.study import NamedCell
from surrofe2.store.samples import kept_reference
from surrofe2.tissue.simulation import plant_cells_within
from validation.case import FE2, TISSUE, Run, compare
from validation.irregular_tissue import bar, kinds_of, lines_of, sides, strip

PRINTED = NamedCell.of("printed")
T = np.arange(0.0, 60.25, 0.5)


def test_lines_end_with_mean_and_scatter_over_seeds():
    runs = []
    for each, force in zip(kinds_of(PRINTED, (1, 2)), (1.01, 1.03, 1.08), strict=True):
        case = {way: strip_without_sides(each, way) for way in (TISSUE, FE2)}
        runs += [Run(case[TISSUE], T, 0.0 * T + 1.0, 1.0), Run(case[FE2], T, 0.0 * T + force, 1.0)]
    lines = lines_of(compare(runs))
    assert [line.arrangement for line in lines[:3]] == ["Voronoi 1", "Voronoi 2", "squares"]
    np.testing.assert_allclose([line.off for line in lines], [1.0, 3.0, 8.0, 2.0])
    assert lines[-1].arrangement == "Voronoi, 2 seeds"
    assert lines[-1].scatter == pytest.approx(np.sqrt(2.0))


def strip_without_sides(of, way):
    """A strip whose sides are those of squares, so that no reference has to be settled."""
    squares = NamedCell(CellParameters.preset("printed", fluid="uniform"), of.name, of.source)
    return strip(squares, 8, way)


def test_sides_are_those_of_whole_rves():
    few = CellParameters.preset("printed", arrangement="voronoi", cells=4)
    width, height = sides(few, 16, 8)
    lattice = kept_reference(few).lattice
    assert width == pytest.approx(8.0 * lattice[0, 0])
    assert height == pytest.approx(4.0 * lattice[1, 1])
    case = bar(NamedCell(few, "few", "preset"), "bar, full load", TISSUE)
    _, inside = plant_cells_within(case.recipe.problem(), few, kept_reference(few))
    assert inside.sum() == 256
