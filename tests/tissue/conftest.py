"""A relaxed plant cell of each preset, once for all tests of the tissue."""

from __future__ import annotations

import pytest

from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import RveLaw
from surrofe2.tissue.layout import make_tissue


@pytest.fixture(scope="session")
def reference():
    """reference(preset): cell and its reference state."""

    def of(preset):
        cell = CellParameters.preset(preset)
        return cell, RveLaw(cell).reference

    return of


@pytest.fixture(scope="session")
def tissue_of(reference):
    """tissue_of(cells, preset)."""

    def make(cells, preset="printed"):
        return make_tissue(*reference(preset), cells)

    return make
