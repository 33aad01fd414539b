import numpy as np
import pytest

from surrofe2.base.tensors import stress_error, stress_spread, transpose
from tests.numerics import turn


def test_error_is_that_of_one_entry_and_does_not_turn_with_the_frame():
    rng = np.random.default_rng(1)
    true = rng.normal(size=(5, 2, 2))
    found = true.copy()
    found[:, 0, 1] += 0.3
    assert stress_error(found, true) == pytest.approx(0.3)
    Q = turn(0.7)[None]
    turned = stress_error(Q @ found @ transpose(Q), Q @ true @ transpose(Q))
    assert turned == pytest.approx(0.3)


def test_spread_is_the_root_mean_square_distance_from_the_mean():
    stress = np.zeros((2, 2, 2))
    stress[:, 0, 0] = 1.0, 5.0
    assert stress_spread(stress) == pytest.approx(2.0)
    assert np.isnan(stress_error(stress * np.nan, stress)).all()
