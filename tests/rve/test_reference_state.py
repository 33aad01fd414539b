"""A settled reference state that is kept and handed to another law."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2.base.errors import InputError, MismatchError
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import ReferenceState, RveLaw
from tests.rve.rves import deformations


@pytest.fixture(scope="module")
def law():
    return RveLaw(CellParameters.preset("water"))


@pytest.mark.parametrize(
    "cell",
    [
        CellParameters.preset("water"),
        CellParameters(arrangement="square", cells=4),
        pytest.param(CellParameters(arrangement="voronoi", cells=4), marks=pytest.mark.slow),
    ],
    ids=lambda cell: f"{cell.cells} {cell.arrangement}",
)
def test_law_from_a_kept_reference_answers_with_the_same_bits(cell):
    F, F_dot = deformations("water", 9, corners=False)
    settled = RveLaw(cell)
    kept = ReferenceState.from_arrays(settled.reference.to_arrays())
    law = RveLaw(cell, reference=kept)
    assert law.reference is kept
    assert law.rest_length == settled.rest_length
    np.testing.assert_array_equal(law.unit_cell.position, settled.unit_cell.position)
    answers = [this.respond(F, F_dot) for this in (settled, law)]
    assert np.isfinite(answers[0].stress).all()
    np.testing.assert_array_equal(answers[0].stress, answers[1].stress)
    np.testing.assert_array_equal(answers[0].state.z, answers[1].state.z)


def test_reference_of_another_cell_is_refused(law):
    other = replace(law.cell, wall_stiffness=3999.0)
    with pytest.raises(MismatchError, match=r"^reference: it belongs to plant cells [0-9a-f]{16},"):
        RveLaw(other, reference=law.reference)


def test_reference_that_is_no_stable_equilibrium_is_refused(law):
    position = law.reference.position.copy()
    position[19:] = position[19]  # all fluid in one place
    position[19:] += 1e-3 * np.arange(32).reshape(16, 2)
    with pytest.raises(InputError, match="reference: not a stable equilibrium"):
        RveLaw(law.cell, reference=replace(law.reference, position=position))


@pytest.mark.parametrize(
    "change",
    [{"lattice": None}, {"position": np.zeros((3, 3))}, {"rest_length": np.array([np.nan])}],
)
def test_incomplete_arrays_are_refused(law, change):
    arrays = {k: v for k, v in (law.reference.to_arrays() | change).items() if v is not None}
    with pytest.raises(InputError, match=r"^reference: arrays are missing, not finite or of oth"):
        ReferenceState.from_arrays(arrays)
