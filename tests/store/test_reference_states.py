"""Settled reference states: kept by the fingerprint."""

import numpy as np
import pytest

from surrofe2.plant_cell.arrangement import ReferenceState
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import RveLaw
from surrofe2.store.samples import read_reference, write_reference
from surrofe2.workflow import laws

CELL = CellParameters()
POSITION = np.linspace(0.0, 1.0, 6).reshape(3, 2) / 3.0
REFERENCE = ReferenceState(CELL.fingerprint, POSITION, 25.0 * np.eye(2), 1.5)


def same(found, wanted):
    pairs = zip(found.to_arrays().values(), wanted.to_arrays().values(), strict=True)
    return all(np.array_equal(a, b) for a, b in pairs)


def test_a_reference_comes_back_to_the_bit(tmp_path):
    path = tmp_path / "one.h5"
    write_reference(path, REFERENCE)
    assert same(read_reference(path, CELL), REFERENCE)


def test_a_missing_damaged_or_foreign_file_is_no_reference(tmp_path):
    path = tmp_path / "one.h5"
    assert read_reference(path, CELL) is None
    write_reference(path, REFERENCE)
    assert read_reference(path, CellParameters(viscosity=0.2)) is None
    path.write_bytes(path.read_bytes()[:-200])
    assert read_reference(path, CELL) is None


@pytest.fixture
def settled(monkeypatch, tmp_path):
    """How often a reference was settled; nothing is in the cache folder."""
    count, settle = [], laws.settle_reference
    monkeypatch.setattr(laws, "reference_path", lambda cell: tmp_path / "cache" / "one.h5")
    monkeypatch.setattr(laws, "settle_reference", lambda cell: count.append(1) or settle(cell))
    return count


def test_a_reference_is_settled_once_and_kept(settled):
    first, again = (laws.kept_reference(CELL) for _ in range(2))
    assert len(settled) == 1
    assert same(again, first)
    assert same(again, RveLaw(CELL).reference)
