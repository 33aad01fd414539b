"""Settled reference states of RVEs, kept by the cell's fingerprint.

Nine Voronoi plant cells take ten seconds to settle; their positions are a few kilobytes.
"""

from __future__ import annotations

from pathlib import Path

from surrofe2.compilation import cache_folder
from surrofe2.errors import FileError, InputError, MismatchError
from surrofe2.io.checkpoints import read_checkpoint, write_checkpoint
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.plant_cell.reference_state import ReferenceState

_OF = "a settled reference state"


def reference_path(cell: CellParameters) -> Path:
    """Where the reference state of a cell is kept for commands of these very sources."""
    return cache_folder() / "references" / f"{cell.fingerprint}.h5"


def write_reference(path: Path, reference: ReferenceState) -> None:
    """Write a reference state, whole or not at all."""
    write_checkpoint(path, reference.to_arrays(), _OF)


def read_reference(path: Path, cell: CellParameters) -> ReferenceState | None:
    """The reference state of a cell; None where the file is missing, damaged or of another."""
    try:
        found = ReferenceState.from_arrays(read_checkpoint(path, _OF))
        found.check_belongs_to(cell)
    except (FileError, InputError, MismatchError):
        return None
    return found
