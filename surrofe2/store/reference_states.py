"""Settled reference states of RVEs: in the cache folder of the sources, and carried by data sets.

Nine Voronoi plant cells take ten seconds to settle; their positions are a few kilobytes.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from surrofe2.compilation import cache_folder
from surrofe2.errors import FileError
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.plant_cell.reference_state import ReferenceState
from surrofe2.store.hdf5 import CHECKPOINT, Stored, reading_hdf5
from surrofe2.store.store import read_kept, write_kept

_GROUP = "reference"


def reference_path(cell: CellParameters) -> Path:
    """Where the reference state of a cell is kept for commands of these very sources."""
    return cache_folder() / "references" / f"{cell.fingerprint}.json"


def write_reference(path: Path, reference: ReferenceState) -> None:
    """Write a reference state, whole or not at all."""
    write_kept(path, {"cell": reference.fingerprint}, reference.to_arrays())


def read_reference(path: Path, cell: CellParameters) -> ReferenceState | None:
    """The reference state of a cell; None where the file is missing, damaged or of another."""
    try:
        return _checked(read_kept(path, {"cell": cell.fingerprint}), cell)
    except FileError:
        return None


def attached(reference: ReferenceState | None) -> dict[str, np.ndarray]:
    """The arrays by which a data set carries the reference state of its RVEs along."""
    arrays = {} if reference is None else reference.to_arrays()
    return {f"{_GROUP}/{name}": values for name, values in arrays.items()}


def read_attached(path: Path, cell: CellParameters) -> ReferenceState | None:
    """The reference state of a cell that a data set carries; None where it does not."""
    try:
        with reading_hdf5(path) as file:
            return _checked(Stored(file, CHECKPOINT).all_arrays(_GROUP), cell)
    except FileError:
        return None


def _checked(stored: Mapping[str, Any] | None, cell: CellParameters) -> ReferenceState | None:
    try:
        arrays = {name: np.array(values) for name, values in (stored or {}).items()}
        found = ReferenceState.from_arrays(arrays)
        found.check_belongs_to(cell)
    except (TypeError, ValueError, OverflowError):  # InputError and MismatchError among them
        return None
    return found
