"""What takes long to compute and is kept: settled reference states, surface tables, long curves.

Each is a JSON file that is taken only by the configuration and the sources of the package that it
was computed with. Nine Voronoi plant cells take ten seconds to settle; their positions are a few
kilobytes.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from surrofe2.compilation import cache_folder
from surrofe2.errors import FileError
from surrofe2.io.files import plain, read_json, write_json
from surrofe2.io.hdf5 import reading_hdf5
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.plant_cell.reference_state import ReferenceState

_GROUP = "reference"


def write_kept(path: Path, configuration: Mapping[str, Any], values: Mapping[str, Any]) -> None:
    """Keep values that were computed by a configuration."""
    write_json(path, {"identity": _identity(configuration), **values})


def read_kept(path: Path, configuration: Mapping[str, Any]) -> dict[str, Any] | None:
    """The values of exactly this configuration and these sources, or None.

    Raises:
        FileError: the file is damaged.
    """
    if not path.exists():
        return None
    stored = read_json(path)
    return stored if stored.get("identity") == _identity(configuration) else None


def _identity(configuration: Mapping[str, Any]) -> dict[str, Any]:
    named: dict[str, Any] = plain({"sources": cache_folder().name, **configuration})
    return named


def reference_path(cell: CellParameters) -> Path:
    """Where the reference state of a cell is kept for commands of these very sources."""
    return cache_folder() / "references" / f"{cell.fingerprint}.json"


def write_reference(path: Path, reference: ReferenceState) -> None:
    """Write a reference state, whole or not at all."""
    write_kept(path, {"cell": reference.fingerprint}, reference.to_arrays())


def read_reference(path: Path, cell: CellParameters) -> ReferenceState | None:
    """The reference state of a cell; None where the file is missing, damaged or of another."""
    try:
        stored = read_kept(path, {"cell": cell.fingerprint})
    except FileError:
        return None
    if stored is None:
        return None
    del stored["identity"]
    return _checked(stored, cell)


def attached(reference: ReferenceState) -> dict[str, np.ndarray]:
    """The arrays by which a data set carries the reference state of its RVEs along."""
    return {f"{_GROUP}/{name}": values for name, values in reference.to_arrays().items()}


def read_attached(path: Path, cell: CellParameters) -> ReferenceState | None:
    """The reference state of a cell that a data set carries; None where it does not."""
    try:
        with reading_hdf5(path) as file:
            arrays = {name: file[_GROUP][name][()] for name in file.get(_GROUP, ())}
    except FileError:
        return None
    return _checked(arrays, cell)


def _checked(stored: Mapping[str, Any], cell: CellParameters) -> ReferenceState | None:
    try:
        arrays = {name: np.array(values) for name, values in stored.items()}
        found = ReferenceState.from_arrays(arrays)
        found.check_belongs_to(cell)
    except (TypeError, ValueError, OverflowError):  # InputError and MismatchError among them
        return None
    return found
