"""Settled reference states: kept by the fingerprint."""

import numpy as np
import pytest

from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import RveLaw
from surrofe2.store import samples
from surrofe2.store.samples import kept_reference

CELL = CellParameters()


def same(found, wanted):
    pairs = zip(found.to_arrays().values(), wanted.to_arrays().values(), strict=True)
    return all(np.array_equal(a, b) for a, b in pairs)


@pytest.fixture
def settled(monkeypatch, tmp_path):
    """Of which plant cells references were settled; nothing is in the cache folder."""
    cells, settle = [], samples.settle_reference
    monkeypatch.setattr(samples, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(
        samples, "settle_reference", lambda cell: cells.append(cell) or settle(cell)
    )
    return cells


def test_a_reference_is_settled_once_and_kept_to_the_bit(settled):
    first, again = (kept_reference(CELL) for _ in range(2))
    assert settled == [CELL]
    assert same(again, first)
    assert same(again, RveLaw(CELL).reference)


def test_a_damaged_or_foreign_file_is_no_reference(settled, tmp_path):
    other = CellParameters(viscosity=0.2)
    first = kept_reference(CELL)
    (path,) = (tmp_path / "references").iterdir()
    path.with_name(f"{other.fingerprint}.h5").write_bytes(path.read_bytes())
    path.write_bytes(path.read_bytes()[:-200])
    assert same(kept_reference(CELL), first)
    assert kept_reference(other).fingerprint == other.fingerprint
    assert settled == [CELL, CELL, other]
