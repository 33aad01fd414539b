"""Tables of surface laws in HDF5: coefficients, range, error and origin; whole or absent."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from surrofe2.errors import MismatchError
from surrofe2.io.hdf5 import stored_array, stored_number, writing_hdf5
from surrofe2.io.provenance import check_same_rve, reading, stamp, stored_cell
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.surface.tabulated import TabulatedSurface

SCHEMA = "surrofe2-surface-table"
SCHEMA_VERSION = 2
_ADVICE = "tabulate the surface of {}"
_NUMBERS = ("rate", "mass", "depth", "width", "error", "spread")


def write_surface(path: Path, table: TabulatedSurface, recipe: Mapping[str, Any]) -> None:
    """Write a table, whole or not at all; `recipe`: of the run that made it."""
    with writing_hdf5(path) as file:
        file["coefficients"] = table.coefficients
        file["coefficients"].attrs["unit"] = "µN"
        file["stretch"] = np.array(table.stretch)
        numbers = (table.rate, table.mass, table.depth, table.width, table.error, table.spread)
        file.attrs.update(
            stamp(SCHEMA, SCHEMA_VERSION, table.cell, table.initialisation, recipe),
            **dict(zip(_NUMBERS, numbers, strict=True)),
            inputs="Chebyshev polynomials of stretch and stretch rate over their ranges",
        )


def read_surface(path: str | Path) -> TabulatedSurface:
    """Read a table.

    Raises:
        FileError: not a table of this schema, truncated or damaged.
    """
    with reading(Path(path), SCHEMA, SCHEMA_VERSION) as file:
        cell, initialisation = stored_cell(file)
        coefficients = stored_array(file, "coefficients", (None, None))
        low, high = stored_array(file, "stretch", (2,)).tolist()
        rate, mass, depth, width, error, spread = (stored_number(file, name) for name in _NUMBERS)
        if not (np.isfinite(coefficients).all() and min(coefficients.shape) >= 2):
            raise ValueError("coefficients are damaged")
        if not (0.0 < low < high and rate > 0.0):
            raise ValueError("stretch and rate: no range")
        return TabulatedSurface(
            coefficients, (low, high), rate, mass, depth, width, cell, initialisation, error, spread
        )


def check_surface(
    path: Path, table: TabulatedSurface, cell: CellParameters, initialisation: str
) -> None:
    """Refuse a table of other plant cells.

    Raises:
        MismatchError: naming the first parameter that differs.
    """
    made = f"{path}: a surface table"
    check_same_rve(made, (table.cell, table.initialisation), (cell, initialisation), _ADVICE)
    if table.cell.outer_wall != cell.outer_wall:
        raise MismatchError(
            f"{made} for cell.outer_wall = {table.cell.outer_wall}, not {cell.outer_wall}; "
            + _ADVICE.format("these parameters")
        )
