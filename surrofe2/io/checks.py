"""What a file must be before its numbers are used: of our schema, and of the same RVE."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import h5py

from surrofe2.errors import FileError, MismatchError
from surrofe2.plant_cell.parameters import CellParameters


class Answers(Protocol):
    """Stored answers of an RVE."""

    @property
    def cell(self) -> CellParameters: ...  # noqa: D102 - the class says it
    @property
    def initialisation(self) -> str: ...  # noqa: D102


def check_schema(path: Path, file: h5py.File, schema: str, version: int, name: str) -> None:
    """Refuse an HDF5 file of another schema or version.

    Args:
        schema: as files have it, "surrofe2-…".
        name: what a file of the schema is called.

    Raises:
        FileError: it is of another one.
    """
    if file.attrs.get("schema") != schema:
        raise FileError(f"{path}: an HDF5 file, but not a {name}")
    found = int(file.attrs["schema_version"])
    if found != version:
        kind = schema.removeprefix("surrofe2-").replace("-", " ")
        raise FileError(f"{path}: {kind} schema {found}; this surrofe2 reads {version}")


def check_same_rve(
    made: str, answers: Answers, cell: CellParameters, initialisation: str, advice: str
) -> None:
    """Refuse answers of other cell parameters or another initialisation.

    Args:
        made: the sentence up to what the answers are for.
        advice: its end; "{}" stands for "these parameters" or "this initialisation".

    Raises:
        MismatchError: naming the first parameter that differs.
    """
    there = answers.cell.to_dict()
    for name, value in cell.to_dict().items():
        if there.get(name) != value:
            raise MismatchError(
                f"{made} for cell.{name} = {there.get(name)}, not {value}; "
                + advice.format("these parameters")
            )
    if answers.initialisation != initialisation:
        raise MismatchError(
            f"{made} for initialisation {answers.initialisation}, not {initialisation}; "
            + advice.format("this initialisation")
        )
