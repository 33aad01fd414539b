"""Curves kept between calls: the same to the bit, and only for their own configuration."""

import numpy as np
import pytest

from surrofe2.displacement_curve import DisplacementCurve
from surrofe2.errors import FileError
from surrofe2.io import kept as kept_files
from surrofe2.io.files import read_json, write_json
from surrofe2.io.kept import KeptCurve, KeptCurves

T = np.linspace(0.0, 7.0, 30)
CURVE = DisplacementCurve(T, np.random.default_rng(1).normal(size=(30, 2)))
CONFIGURATION = {"cell": {"viscosity": 0.1}, "elements": (4, 4)}


def test_a_kept_curve_comes_back_to_the_bit(tmp_path):
    kept = KeptCurves(tmp_path / "curves")
    assert kept.read("bar", CONFIGURATION) is None
    kept.write("bar", CONFIGURATION, KeptCurve(CURVE, 3.5))
    found = kept.read("bar", CONFIGURATION)
    np.testing.assert_array_equal(found.curve.t, CURVE.t)
    np.testing.assert_array_equal(found.curve.displacement, CURVE.displacement)
    assert found.seconds == 3.5


def test_another_configuration_or_other_sources_are_not_taken(tmp_path, monkeypatch):
    kept = KeptCurves(tmp_path)
    path = kept.write("bar", CONFIGURATION, KeptCurve(CURVE, 3.5))
    assert kept.read("bar", {**CONFIGURATION, "elements": (8, 8)}) is None
    assert kept.read("tissue", CONFIGURATION) is None
    monkeypatch.setattr(kept_files, "cache_folder", lambda: tmp_path / "other")
    assert kept.read("bar", CONFIGURATION) is None
    monkeypatch.undo()
    record = read_json(path)
    del record["t"]
    write_json(path, record)
    with pytest.raises(FileError, match="not a whole curve; delete it"):
        kept.read("bar", CONFIGURATION)
