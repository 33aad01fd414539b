"""What each HDF5 file says of its origin, and the check of it before its numbers are used."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import h5py

from surrofe2.errors import FileError, MismatchError, Surrofe2Error, shortened
from surrofe2.io.files import plain
from surrofe2.io.hdf5 import DAMAGED, reading_hdf5, stored_number
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.sampling import SamplingRange


@dataclass(frozen=True, slots=True, kw_only=True)
class Origin:
    """Where the answers in a file come from: plant cells, settings of their RVEs, recipe."""

    cell: CellParameters
    rve: Mapping[str, Any]
    recipe: Mapping[str, Any]

    def attributes(self, schema: str, schema_version: int) -> dict[str, Any]:
        """As of `stamp`, and the settings of the RVEs."""
        initialisation = str(self.rve["initialisation"])
        stamped = stamp(schema, schema_version, self.cell, initialisation, self.recipe)
        return {**stamped, "rve": json.dumps(plain(self.rve))}


def stamp(
    schema: str,
    schema_version: int,
    cell: CellParameters,
    initialisation: str,
    recipe: Mapping[str, Any],
) -> dict[str, Any]:
    """Attributes of a file: schema, package, time, and the plant cells that its answers are of."""
    return {
        "schema": schema,
        "schema_version": schema_version,
        "package_version": version("surrofe2"),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "recipe": json.dumps(plain(recipe)),
        "cell": json.dumps(cell.to_dict()),
        "cell_fingerprint": cell.fingerprint,
        "initialisation": initialisation,
    }


def stored_cell(file: h5py.File) -> tuple[CellParameters, str]:
    """(plant cells, initialisation) that a file's answers are of."""
    cell = CellParameters(**json.loads(stored_text(file, "cell")))
    if cell.fingerprint != stored_text(file, "cell_fingerprint"):
        raise ValueError("cell: its parameters are not those that the answers are of")
    return cell, stored_text(file, "initialisation")


def stored_range(file: h5py.File) -> SamplingRange:
    """The range that a file has as JSON."""
    return SamplingRange(**json.loads(stored_text(file, "range")))


def stored_text(file: h5py.File, name: str) -> str:
    """A text among the attributes of a file.

    Raises:
        ValueError: it is missing or no text.
    """
    value = file.attrs.get(name)
    if not isinstance(value, str):
        raise ValueError(f"{name}: missing, or no text")
    return value


def read_seconds(path: Path) -> float | None:
    """Seconds that the answers in a file took to make; None where it does not say.

    Raises:
        FileError: it cannot be read.
    """
    with reading_hdf5(path) as file:
        return stored_number(file, "seconds") if "seconds" in file.attrs else None


@contextmanager
def reading(path: Path, schema: str, schema_version: int) -> Iterator[h5py.File]:
    """An open HDF5 file of a schema ("surrofe2-…"), from which the block reads.

    Raises:
        FileError: missing, foreign, of another schema or version, or an entry is missing or wrong.
    """
    kind = schema.removeprefix("surrofe2-").replace("-", " ")
    with reading_hdf5(path) as file:
        if str(file.attrs.get("schema")) != schema:
            raise FileError(f"{path}: an HDF5 file, but not a surrofe2 {kind}")
        found = str(file.attrs.get("schema_version"))
        if found != str(schema_version):
            found = shortened(found, 20)
            raise FileError(f"{path}: {kind} schema {found}; this surrofe2 reads {schema_version}")
        try:
            yield file
        except DAMAGED as error:
            if isinstance(error, Surrofe2Error) and str(path) in str(error):
                raise
            told = shortened(" ".join(str(error).split()), 120)
            raise FileError(f"{path}: not a whole surrofe2 {kind}: {told}") from None


def check_same_rve(
    made: str,
    there: tuple[CellParameters, str],
    here: tuple[CellParameters, str],
    advice: str,
) -> None:
    """Refuse answers of other cell parameters or another initialisation.

    Args:
        made: the sentence up to what the answers are for.
        there, here: (plant cells, initialisation) of the answers, and wanted.
        advice: the sentence's end; "{}" stands for "these parameters" or "this initialisation".

    Raises:
        MismatchError: naming the first parameter that differs.
    """
    known = there[0].to_dict()
    for name, value in here[0].to_dict().items():
        if name == "outer_wall":  # not of the RVE
            continue
        if known.get(name) != value:
            raise MismatchError(
                f"{made} for cell.{name} = {known.get(name)}, not {value}; "
                + advice.format("these parameters")
            )
    if there[1] != here[1]:
        raise MismatchError(
            f"{made} for initialisation {there[1]}, not {here[1]}; "
            + advice.format("this initialisation")
        )
