"""What counts as a state that left its branch, and that none of a few does."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from surrofe2.law.stress_law import Status
from surrofe2.plant_cell.parameters import CellParameters
from validation.branches import count, law_of


@dataclass
class OfTwoBranches:
    """A law with another stress where it comes from a state; of the first point it may say so."""

    reports: bool
    cell = CellParameters.preset("water", fluid="uniform")

    def respond(self, F, F_dot, state=None):
        stress = np.zeros_like(F)
        is_left = np.zeros(len(F), dtype=bool)
        if state is not None:
            stress[0] = 1.0
            is_left[0] = self.reports
        return SimpleNamespace(
            stress=stress,
            status=np.full(len(F), Status.OK),
            state=SimpleNamespace(left_points=is_left),
            effort={"newton_solves": 2 * len(F)},
        )

    def accept(self, F, F_dot, answer):
        return answer


@pytest.mark.parametrize("reports", [True, False])
def test_another_branch_counts_as_reported_or_not(reports):
    row = count(OfTwoBranches(reports), "drained", 1, 0.01, 5)
    assert (row.left, row.failed, row.solves) == (0, 0, 2.0)
    assert row.by_shear == (1 if reports else 0)
    assert row.unreported == (0 if reports else 1)
    assert row.apart == 0.0


@pytest.mark.parametrize("sap", ["drained", "undrained"])
def test_small_strains_leave_no_branch(sap):
    row = count(law_of(CellParameters.preset("printed"), sap, 1), sap, 1, 0.01, 4)
    assert (row.left, row.failed, row.by_shear, row.unreported) == (0, 0, 0, 0)
    assert 0.0 < row.apart < 1e-9
