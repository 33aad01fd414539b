"""The histogram of audited errors."""

import numpy as np

from surrofe2.cache.audit import ErrorRecord
from surrofe2.report.comparison_plot import coarse_histogram


def test_each_error_is_counted_in_its_bin():
    errors = 10.0 ** np.random.default_rng(1).uniform(-6.0, 0.0, 1000)
    record = ErrorRecord(0.1)
    record.add(errors)
    edges, shares = coarse_histogram(record.to_dict()["histogram"])
    counts = ((errors > edges[:-1, None]) & (errors <= edges[1:, None])).sum(axis=1)
    np.testing.assert_allclose(shares, counts / 1000.0, atol=1e-12)
    np.testing.assert_allclose(np.diff(np.log10(edges)), 0.1, rtol=1e-9)
