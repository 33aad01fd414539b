"""How a data set lies in its HDF5 file; data/README.md shows the schema."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from surrofe2.errors import FileError
from surrofe2.io.files import check_same, plain, replacing
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.sampling import SamplingRange
from surrofe2.stress_law import Status, describe
from surrofe2.stress_samples import TANGENTS, StressSamples
from surrofe2.units import NONE, RATE, STRESS, VISCOSITY

SCHEMA = "surrofe2-data-set"
SCHEMA_VERSION = 1
LEFT = "left_bifurcation"
_ARRAYS = {"F": NONE, "F_dot": RATE, "stress": STRESS}
_TANGENT_UNITS = dict(zip(TANGENTS, (STRESS, VISCOSITY), strict=True))


@dataclass(frozen=True, slots=True, kw_only=True)
class DataSetHeader:
    """What a data set is made from; two data sets with equal headers hold equal numbers.

    `tangents`: whether it holds ∂P/∂F and ∂P/∂Ḟ as well. `recipe` and `rest_length` (of the
    walls, µm) are carried along and not compared.
    """

    cell: CellParameters
    rve: Mapping[str, Any]
    range: SamplingRange
    count: int
    seed: int
    chunk: int
    version: str
    recipe: Mapping[str, Any]
    rest_length: float | None = None
    tangents: bool = False

    def compared(self) -> dict[str, Any]:
        """Everything the numbers depend on, flat, by the names a recipe uses."""
        sections = {
            "cell": self.cell.to_dict(),
            "rve": dict(self.rve),
            "range": asdict(self.range),
            "samples": {
                "count": self.count,
                "seed": self.seed,
                "chunk": self.chunk,
                "tangents": self.tangents,
            },
            "surrofe2": {"version": self.version},
        }
        return {
            f"{name}.{key}": v for name, part in plain(sections).items() for key, v in part.items()
        }


def create_file(path: Path, header: DataSetHeader) -> None:
    """Lay out an empty data set, whole or not at all."""
    with replacing(path) as partial, h5py.File(partial, "w") as file:
        for name, unit in _ARRAYS.items():
            lay_out(file, name, (header.count, 2, 2), np.float64).attrs["unit"] = unit
        for name, unit in _TANGENT_UNITS.items() if header.tangents else ():
            lay_out(file, name, (header.count, *[2] * 4), np.float64).attrs["unit"] = unit
        status = lay_out(file, "status", (header.count,), np.int8)
        status.attrs["meaning"] = json.dumps({int(code): describe(code) for code in Status})
        left = lay_out(file, LEFT, (header.count,), np.int8)
        left.attrs["meaning"] = "1: a stable state beyond a bifurcation, one of several"
        file["completed"] = np.int64(0)
        file.attrs.update(
            schema=SCHEMA,
            schema_version=SCHEMA_VERSION,
            package_version=header.version,
            created=datetime.now(UTC).isoformat(timespec="seconds"),
            status="writing",
            recipe=json.dumps(header.recipe),
            compared=json.dumps(header.compared()),
            cell=json.dumps(header.cell.to_dict()),
            cell_fingerprint=header.cell.fingerprint,
            initialisation=header.rve["initialisation"],
            rve=json.dumps(plain(header.rve)),
            range=json.dumps(asdict(header.range)),
            count=header.count,
            seed=header.seed,
        )
        if header.rest_length is not None:
            file.attrs["rest_length"] = header.rest_length


def lay_out(file: h5py.File, name: str, shape: tuple[int, ...], dtype: type) -> h5py.Dataset:
    """A contiguous array whose place in the file is fixed now, so a kill cannot move it."""
    plan = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plan.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    kind = h5py.h5t.py_create(np.dtype(dtype))
    h5py.h5d.create(file.id, name.encode(), kind, h5py.h5s.create_simple(shape), dcpl=plan)
    return file[name]


def check_header(path: Path, file: h5py.File, header: DataSetHeader) -> None:
    """Refuse to continue a data set that was begun with other settings.

    Raises:
        MismatchError: naming the first that differs.
    """
    there = {"samples.tangents": False} | json.loads(file.attrs["compared"])
    check_same(path, header.compared(), there)


def samples_of(path: Path, file: h5py.File) -> StressSamples:
    """All samples of an open data set, as the numerics know them.

    Raises:
        FileError: the file is damaged.
    """
    try:
        given = [name for name in TANGENTS if name in file]
        arrays = {name: file[name][:] for name in (*_ARRAYS, "status", *given)}
        interval = {k: tuples_of(v) for k, v in json.loads(file.attrs["range"]).items()}
        return StressSamples(
            **arrays,
            cell=CellParameters(**json.loads(file.attrs["cell"])),
            initialisation=str(file.attrs["initialisation"]),
            range=SamplingRange(**interval),
            seed=int(file.attrs["seed"]),
            rest_length=_float_or_none(file.attrs.get("rest_length")),
            left_bifurcation=file[LEFT][:].astype(np.bool_) if LEFT in file else None,
        )
    except (KeyError, TypeError, ValueError) as error:
        raise FileError(f"{path}: not a whole surrofe2 data set: {error}") from None


def _float_or_none(value: Any) -> float | None:
    return None if value is None else float(value)


def tuples_of(value: Any) -> Any:
    """A JSON list as the tuple it was."""
    return tuple(value) if isinstance(value, list) else value
