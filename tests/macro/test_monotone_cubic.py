"""The integral of the monotone cubic is that of scipy's."""

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from surrofe2.macro.monotone_cubic import integral_of_monotone_cubic


@pytest.mark.parametrize("count", [2, 3, 40])
@pytest.mark.parametrize("seed", range(4))
def test_it_is_scipy_s(count, seed):
    rng = np.random.default_rng(seed)
    x = np.cumsum(rng.uniform(0.1, 1.0, count))
    y = rng.normal(size=count).round(1)
    t = np.linspace(x[0] - 0.5, x[-1] + 0.5, 301)
    known = PchipInterpolator(x, y, extrapolate=False).antiderivative()(t)
    np.testing.assert_allclose(integral_of_monotone_cubic(x, y, t), known, rtol=0, atol=1e-12)
    assert np.isfinite(integral_of_monotone_cubic(x, y, x)).all()
