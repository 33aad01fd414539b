"""Tables in HDF5, whole or absent: RVE stresses with their ellipsoids, and surface laws."""

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
# Numbers of a surface law that stand in the header, by their names in `TabulatedSurface`.
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
    """A table that was read from a file; `StressTable` describes its fields."""

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

    Args:
        recipe: recipe of the run that writes it.
        seconds: time of all runs that it learnt from.
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
    """Read a table; a FileError where the file is no table of this schema, or damaged."""
    with reading(Path(path), TABLE) as stored:
        table = StoredTable(records=Records(**stored.arrays()), **stored.header())
        if not (table.tolerance > 0.0 and table.stress_spread > 0.0):
            raise ValueError("tolerance and stress_spread must be positive")
    return table


def write_surface(path: Path, table: TabulatedSurface, recipe: Mapping[str, Any]) -> None:
    """Write the table of a surface law, whole or not at all, with the recipe of its run."""
    header = {
        **origin(table.cell, table.initialisation, recipe=recipe),
        **{name: getattr(table, name) for name in _NUMBERS},
        "inputs": "Chebyshev polynomials of stretch and stretch rate over their ranges",
    }
    arrays = {"coefficients": table.coefficients, "stretch": np.array(table.stretch)}
    write(path, SURFACE, header, arrays)


def read_surface(path: str | Path) -> TabulatedSurface:
    """Read the table of a surface law; a FileError where the file is no such table, or damaged."""
    with reading(Path(path), SURFACE) as stored:
        header = stored.header()
        arrays = stored.arrays()
        coefficients = arrays["coefficients"]
        low, high = arrays["stretch"].tolist()
        is_range = 0.0 < low < high and header["rate"] > 0.0
        if min(coefficients.shape) < 2 or not is_range:
            raise ValueError("coefficients, stretch and rate: no table over a range")
        return TabulatedSurface(coefficients=coefficients, stretch=(low, high), **header)


# Reject a table of another RVE; arguments: path, table, cell and initialisation.
check_table = partial(check_same_rve, "a table", "start an empty one or use one of {}")
# Reject the table of another surface law, for which the outer wall counts; arguments as above.
check_surface = partial(check_same_rve, "a surface table", "tabulate the surface of {}", wall=True)
