"""Tables of RVE answers in HDF5: records with units, parameters and tolerance; whole or absent."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from surrofe2.cache.table.records import OUTPUTS, Records
from surrofe2.cache.table.stress_table import StressTable
from surrofe2.io.hdf5 import stored_array, stored_number, writing_hdf5
from surrofe2.io.provenance import (
    check_same_rve,
    reading,
    stamp,
    stored_cell,
    stored_range,
    stored_text,
)
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.sampling import SamplingRange
from surrofe2.tensors import INPUTS
from surrofe2.units import STRESS

SCHEMA = "surrofe2-table"
SCHEMA_VERSION = 2
_UNITS = {
    "centre": "1 (3), 1/µs (4)",
    "stress": STRESS,
    "slope": f"{STRESS} over that of centre",
    "curvature": f"{STRESS} over that of centre, twice",
    "extent": f"that of centre, squared, over {STRESS}",
}
_SHAPES = {
    "centre": (INPUTS,),
    "stress": (OUTPUTS,),
    "slope": (OUTPUTS, INPUTS),
    "curvature": (INPUTS, INPUTS),
    "extent": (INPUTS,),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredTable:
    """A table read back.

    Attributes:
        records: see `Records`.
        tolerance, spread: largest error for which it was grown, and spread of stress, µN/µm.
        range: by which neighbours of records were placed.
        recipe: of the run that wrote it, or what it was merged from.
        seconds: of all runs that it learnt from.
    """

    records: Records
    cell: CellParameters
    initialisation: str
    range: SamplingRange
    tolerance: float
    spread: float
    recipe: Mapping[str, Any]
    seconds: float = 0.0


def stored(table: StressTable, recipe: Mapping[str, Any], seconds: float = 0.0) -> StoredTable:
    """What is written of a table."""
    return StoredTable(
        records=table.records,
        cell=table.cell,
        initialisation=table.initialisation,
        range=table.range,
        tolerance=table.tolerance,
        spread=table.stress_spread,
        recipe=recipe,
        seconds=seconds,
    )


def write_table(path: Path, table: StoredTable) -> None:
    """Write a table, whole or not at all."""
    with writing_hdf5(path) as file:
        for name, values in table.records._asdict().items():
            file[name] = values
            file[name].attrs["unit"] = _UNITS[name]
        file.attrs.update(
            stamp(SCHEMA, SCHEMA_VERSION, table.cell, table.initialisation, table.recipe),
            range=json.dumps(asdict(table.range)),
            tolerance=table.tolerance,
            stress_spread=table.spread,
            seconds=table.seconds,
            inputs="sum, difference, shear of U - I; sum, difference, shear, spin of R^T F_dot",
        )


def read_table(path: str | Path) -> StoredTable:
    """Read a table.

    Raises:
        FileError: not a table of this schema, truncated or damaged.
    """
    with reading(Path(path), SCHEMA, SCHEMA_VERSION) as file:
        cell, initialisation = stored_cell(file)
        table = StoredTable(
            records=Records(
                *(stored_array(file, name, (None, *_SHAPES[name])) for name in _SHAPES)
            ),
            cell=cell,
            initialisation=initialisation,
            range=stored_range(file),
            tolerance=stored_number(file, "tolerance"),
            spread=stored_number(file, "stress_spread"),
            recipe=json.loads(stored_text(file, "recipe")),
            seconds=stored_number(file, "seconds"),
        )
        _check_whole(table)
    return table


def _check_whole(table: StoredTable) -> None:
    count = len(table.records.centre)
    for name, values in table.records._asdict().items():
        if len(values) != count or not np.isfinite(values).all():
            raise ValueError(f"{name} is damaged")
    if not (table.tolerance > 0.0 and table.spread > 0.0):
        raise ValueError("tolerance and stress_spread must be positive")
    if not isinstance(table.recipe, dict):
        raise ValueError("recipe: not a JSON object")


def check_table(path: Path, table: StoredTable, cell: CellParameters, initialisation: str) -> None:
    """Refuse a table of other parameters.

    Raises:
        MismatchError: naming the first parameter that differs.
    """
    advice = "start an empty one or use one of {}"
    there = table.cell, table.initialisation
    check_same_rve(f"{path}: a table", there, (cell, initialisation), advice)
