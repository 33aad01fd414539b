"""Settled reference states of RVEs, kept by the cell's fingerprint.

Nine Voronoi plant cells take ten seconds to settle; their positions are a few kilobytes.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from surrofe2.compilation import cache_folder
from surrofe2.errors import FileError, InputError, MismatchError
from surrofe2.io.checkpoints import read_checkpoint, write_checkpoint
from surrofe2.io.files import opened_hdf5
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.plant_cell.reference_state import ReferenceState

_OF, _GROUP = "a settled reference state", "reference"


def reference_path(cell: CellParameters) -> Path:
    """Where the reference state of a cell is kept for commands of these very sources."""
    return cache_folder() / "references" / f"{cell.fingerprint}.h5"


def write_reference(path: Path, reference: ReferenceState) -> None:
    """Write a reference state, whole or not at all."""
    write_checkpoint(path, reference.to_arrays(), _OF)


def read_reference(path: Path, cell: CellParameters) -> ReferenceState | None:
    """The reference state of a cell; None where the file is missing, damaged or of another."""
    try:
        return _checked(read_checkpoint(path, _OF), cell)
    except FileError:
        return None


def attached(reference: ReferenceState) -> dict[str, np.ndarray]:
    """The arrays by which a data set carries the reference state of its RVEs along."""
    return {f"{_GROUP}/{name}": values for name, values in reference.to_arrays().items()}


def read_attached(path: Path, cell: CellParameters) -> ReferenceState | None:
    """The reference state of a cell that a data set carries; None where it does not."""
    try:
        with opened_hdf5(path, "r") as file:
            arrays = {name: file[_GROUP][name][()] for name in file.get(_GROUP, ())}
    except FileError:
        return None
    return _checked(arrays, cell)


def _checked(arrays: dict[str, np.ndarray], cell: CellParameters) -> ReferenceState | None:
    try:
        found = ReferenceState.from_arrays(arrays)
        found.check_belongs_to(cell)
    except (InputError, MismatchError):
        return None
    return found
