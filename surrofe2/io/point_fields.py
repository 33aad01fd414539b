"""What the stress law was asked and answered at its points, as a cloud of points over time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from surrofe2.io.fields import (
    BOUND_NAME,
    F_DOT_NAME,
    F_NAME,
    SOURCE_NAME,
    STRESS_NAME,
    in_space,
    invariants,
    tensor_in_space,
    writing_series,
)
from surrofe2.io.hdf5 import reading_hdf5, stored_array

Array = NDArray[np.float64]

NAME = "points"
_TENSORS = (STRESS_NAME, F_NAME, F_DOT_NAME)


def write_point_fields(
    folder: Path, position: Array, t: Array, values: Mapping[str, Array], per_element: int
) -> None:
    """Write points.xdmf and points.h5: points in µm and what they have at times t (m,), µs.

    Args:
        position: (n, 2) reference positions, those of an element one after the other.
        values: by the names that the files have, vectors (m, n, 2), tensors (m, n, 2, 2) and
            numbers (m, n); what has no points (m, 0) is left out.
        per_element: points of each element.
    """
    each = np.arange(len(position))
    of = {"element": (each // per_element).astype(np.float64)}
    with writing_series(folder, position, "Polyvertex", each[:, None], NAME) as write:
        for k, time in enumerate(t):
            now = {name: series[k] for name, series in values.items() if series.shape[1]}
            told = {name: _in_space(name, at) for name, at in now.items()}
            write(float(time), told | invariants(now[STRESS_NAME]) | of, {})


def _in_space(name: str, values: Array) -> Array:
    if values.ndim == 3:
        return tensor_in_space(values, thickness=float(name == F_NAME))
    return in_space(values) if values.ndim == 2 else values


def read_point_fields(folder: Path) -> dict[str, Array]:
    """t (m,), points (n, 2) and tensors (m, n, 2, 2), numbers (m, n) that they have, by name.

    Raises:
        FileError: points.h5 is missing or damaged.
    """
    with reading_hdf5(folder / f"{NAME}.h5") as file:
        t, at = stored_array(file, "t", (None,)), stored_array(file, "points", (None, 3))
        found = {"t": t, "points": at[:, :2]}
        for name in (*_TENSORS, SOURCE_NAME, BOUND_NAME):
            shape = (len(at), 3, 3) if name in _TENSORS else (len(at),)
            if f"{name}.0" in file:
                whole = [stored_array(file, f"{name}.{k}", shape) for k in range(len(t))]
                found[name] = np.stack(whole)[..., :2, :2] if len(shape) > 1 else np.stack(whole)
        return found
