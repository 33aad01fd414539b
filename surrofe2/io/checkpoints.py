"""Checkpoints: named arrays in HDF5, to carry an interrupted computation on."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import h5py
import numpy as np

from surrofe2.errors import FileError
from surrofe2.io.files import opened_hdf5, replacing

SCHEMA = "surrofe2-checkpoint"


def write_checkpoint(path: Path, arrays: Mapping[str, np.ndarray], of: str) -> None:
    """Write the arrays of a state; `of` identifies what it is a state of."""
    with replacing(path) as partial, h5py.File(partial, "w") as file:
        file.attrs.update(schema=SCHEMA, of=of)
        for name, values in arrays.items():
            file[name] = values


def read_checkpoint(path: Path, of: str) -> dict[str, np.ndarray]:
    """The arrays of a checkpoint of `of`, or a FileError."""
    with opened_hdf5(path, "r") as file:
        if file.attrs.get("schema") != SCHEMA:
            raise FileError(f"{path}: an HDF5 file, but not a surrofe2 checkpoint")
        if file.attrs["of"] != of:
            raise FileError(f"{path}: a checkpoint of {file.attrs['of']}, not of {of}")
        found: dict[str, np.ndarray] = {}

        def collect(name: str, item: object) -> None:
            if isinstance(item, h5py.Dataset):
                found[name] = np.asarray(item[()])

        file.visititems(collect)
    return found
