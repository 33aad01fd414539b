"""The stability map, by what docs/theory.md reports and by the symmetry of the square cell."""

import numpy as np
import pytest

from surrofe2.base.sampling import SamplingRange
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.questions import stability
from surrofe2.questions.stability import CATEGORIES, LEFT, STABLE, WAYS

WATER = CellParameters.preset("water")


@pytest.mark.parametrize(
    ("way", "expected"), [("equibiaxial compression", 0.045), ("uniaxial compression", 0.056)]
)
def test_slack_walls_buckle_where_the_model_says(way, expected):
    assert stability.find_onset(WATER, *WAYS[way]) == pytest.approx(expected, abs=1e-3)


def test_a_way_that_stays_stable_has_no_onset():
    assert stability.find_onset(WATER, (1.0, 0.0, 0.0), 0.1) is None


def test_categories_turn_at_the_onset_and_both_axes_are_alike():
    onset = stability.find_onset(WATER, *WAYS["uniaxial compression"])
    F = np.array([np.diag([1.0 - s, 1.0]) for s in (0.8 * onset, 1.05 * onset, 1.3 * onset)])
    swapped = F[:, ::-1, ::-1]
    for these in (F, swapped):
        assert stability.categories(WATER, these).tolist() == [STABLE, LEFT, LEFT]


@pytest.mark.slow
def test_map_names_every_deformation():
    study = stability.stability(WATER, points=3)
    assert study.to_csv().count("\n") == 21  # with F = I in each plane
    names = {curve.name for panel in study.panels for curve in panel.curves}
    assert names <= {*CATEGORIES, "point"}
    assert sum(study.results["counts"]["stretch"].values()) == 9
    onset = {row["way"]: row for row in study.table.to_records()}
    assert onset["simple shear"] == {
        "way": "simple shear", "stable_up_to": 0.6, "loses_stability": False
    }  # fmt: skip


def test_the_outline_of_a_range_is_its_box_and_its_largest_shear():
    """In simple shear U₁₂ is γ / √(4 + γ²)."""
    range_ = SamplingRange(stretch=(0.9, 1.2), shear=0.05, rate=0.01)
    x, y = stability.outline(range_, "stretch")
    assert (x.min(), x.max(), y.min(), y.max()) == (0.9, 1.2, 0.9, 1.2)
    x, y = stability.outline(range_, "shear")
    largest = 0.05 * 2.0 / np.sqrt(1.0 - 0.05**2)
    assert np.interp(1.0, x[1:-1], y[1:-1]) == pytest.approx(largest, abs=1e-3)
    assert y[0] == y[-1] == 0.0
