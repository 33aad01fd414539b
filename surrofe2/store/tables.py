"""Tables in HDF5, whole or absent: of RVE answers with their ellipsoids, and of surface laws."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from surrofe2.base.sampling import SamplingRange
from surrofe2.base.tensors import INPUTS
from surrofe2.base.units import STRESS
from surrofe2.cache.table.records import OUTPUTS, Records
from surrofe2.cache.table.stress_table import StressTable
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.store.hdf5 import ORIGIN, Column, Kind, check_same_rve, origin, reading, write
from surrofe2.surface.tabulated import TabulatedSurface

TABLE = Kind(
    "table",
    2,
    ORIGIN | {"range": SamplingRange, "tolerance": float, "stress_spread": float},
    {
        "centre": Column((None, INPUTS), unit="1 (3), 1/µs (4)"),
        "stress": Column((None, OUTPUTS), unit=STRESS),
        "slope": Column((None, OUTPUTS, INPUTS), unit=f"{STRESS} over that of centre"),
        "curvature": Column((None, INPUTS, INPUTS), unit=f"{STRESS} over that of centre, twice"),
    },
    finite=True,
)
_NUMBERS = ("rate", "mass", "depth", "width", "error", "spread")
SURFACE = Kind(
    "surface table",
    2,
    ORIGIN | dict.fromkeys(_NUMBERS, float),
    {"coefficients": Column((None, None), unit="µN"), "stretch": Column((2,))},
    finite=True,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredTable:
    """A table read back, as `StressTable` has it."""

    records: Records
    cell: CellParameters
    initialisation: str
    range: SamplingRange
    tolerance: float
    stress_spread: float


def write_table(
    path: Path,
    table: StressTable | StoredTable,
    recipe: Mapping[str, Any],
    seconds: float = 0.0,
) -> None:
    """Write a table, whole or not at all.

    recipe: of the run that wrote it. seconds: of all runs that it learnt from.
    """
    header = {
        **origin(table.cell, table.initialisation, recipe=recipe),
        "range": asdict(table.range),
        "tolerance": table.tolerance,
        "stress_spread": table.stress_spread,
        "seconds": seconds,
        "inputs": "sum, difference, shear of U - I; sum, difference, shear, spin of R^T F_dot",
    }
    write(path, TABLE, header, table.records._asdict())


def read_table(path: str | Path) -> StoredTable:
    """Read a table; a FileError where it is none of this schema, or damaged."""
    with reading(Path(path), TABLE) as stored:
        table = StoredTable(records=Records(**stored.arrays()), **stored.header())
        if not (table.tolerance > 0.0 and table.stress_spread > 0.0):
            raise ValueError("tolerance and stress_spread must be positive")
    return table


def write_surface(path: Path, table: TabulatedSurface, recipe: Mapping[str, Any]) -> None:
    """Write the table of a surface law, whole or not at all; `recipe`: of the run that made it."""
    header = {
        **origin(table.cell, table.initialisation, recipe=recipe),
        **{name: getattr(table, name) for name in _NUMBERS},
        "inputs": "Chebyshev polynomials of stretch and stretch rate over their ranges",
    }
    arrays = {"coefficients": table.coefficients, "stretch": np.array(table.stretch)}
    write(path, SURFACE, header, arrays)


def read_surface(path: str | Path) -> TabulatedSurface:
    """Read the table of a surface law; a FileError where it is none of this schema, or damaged."""
    with reading(Path(path), SURFACE) as stored:
        header, (coefficients, stretch) = stored.header(), stored.arrays().values()
        low, high = stretch.tolist()
        if min(coefficients.shape) < 2 or not (0.0 < low < high and header["rate"] > 0.0):
            raise ValueError("coefficients, stretch and rate: no table over a range")
        return TabulatedSurface(coefficients=coefficients, stretch=(low, high), **header)


check_table = partial(check_same_rve, "a table", "start an empty one or use one of {}")
"""Refuse a table of other plant cells: path, table, and the cell and initialisation wanted."""
check_surface = partial(check_same_rve, "a surface table", "tabulate the surface of {}", wall=True)
"""The same of the table of a surface law, on which the outer wall counts."""
