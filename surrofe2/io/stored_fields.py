"""The fields of a folder read back as they are: a mesh or particles, and what these have."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from surrofe2.io.fields import DISPLACEMENT_NAME
from surrofe2.io.hdf5 import reading_hdf5, stored_array

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class StoredFields:
    """Fields over time.

    Attributes:
        points: (n, 2) reference positions, µm. cells: (e, k) points of each element or spring.
        t: (m,) µs; of a rest the factor of the load.
        displacement: (m, n, 2) µm.
        values: by name, numbers (m, e) and tensors (m, e, 2, 2) of cells.
    """

    points: Array
    cells: NDArray[np.int64]
    t: Array
    displacement: Array
    values: dict[str, Array]


def read_fields(folder: Path, names: Iterable[str]) -> StoredFields:
    """The motion in fields.h5, and what there is of the values of these names.

    Raises:
        FileError: missing or damaged.
    """
    with reading_hdf5(folder / "fields.h5") as file:
        t, at = stored_array(file, "t", (None,)), stored_array(file, "points", (None, 3))
        cells = stored_array(file, "cells", (None, None), np.int64)
        if not (len(t) and 0 <= cells.min(initial=0) <= cells.max(initial=0) < len(at)):
            raise ValueError("t or cells: empty, or of points that are not there")
        there = range(len(t))
        moved = np.stack([stored_array(file, f"{DISPLACEMENT_NAME}.{k}", at.shape) for k in there])
        values = {}
        for name in names:
            if f"{name}.0" in file:
                shape = (len(cells), *(None for _ in file[f"{name}.0"].shape[1:]))
                whole = np.stack([stored_array(file, f"{name}.{k}", shape) for k in there])
                values[name] = whole[..., :2, :2] if len(shape) > 1 else whole
        return StoredFields(at[:, :2], cells, t, moved[..., :2], values)
