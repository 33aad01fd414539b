"""Files of surrogates and of interrupted trainings. Nothing in a file is ever executed."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from surrofe2.base import units
from surrofe2.base.sampling import SamplingRange
from surrofe2.store.hdf5 import ORIGIN, Kind, check_same_rve, check_units, origin, reading, write
from surrofe2.store.store import WORD
from surrofe2.surrogate.domain import Calibration, Domain
from surrofe2.surrogate.features import NetworkParameters
from surrofe2.surrogate.settings import TrainingSettings
from surrofe2.surrogate.surrogate_law import SurrogateLaw

# Entries of the header that are attributes of the law.
_OF_LAW: dict[str, Any] = {
    "version": WORD, "data_fingerprint": WORD, "range": SamplingRange, "settings": TrainingSettings,
    "errors": dict, "seconds": dict, "rest_length": float | None,
}  # fmt: skip
SURROGATE = Kind(
    "surrogate",
    7,
    ORIGIN
    | _OF_LAW
    | {"network": dict, "units": dict, "domain": dict | None, "calibration": dict | None},
    finite=True,
    advice="train again with: surrofe2 train RECIPE --fresh",
)
# An interrupted training; its arrays are those of `surrogate.training.TrainingState`.
TRAINING = Kind("unfinished training", 6, {"identity": dict, "iterations": int, "seconds": float})
# Entries of the header on which no stress depends.
_OF_MAKING = ("sha256", "created", "package_version", "seconds")
# Components and figures that the errors of a surrogate have; see `SurrogateLaw.score`.
_STRESSES = ("xx", "xy", "yx", "yy")
_FIGURES = ("spread", "rms", "worst")
_UNITS = {"stress": units.STRESS, "rate": units.RATE, "rest_length": units.LENGTH}


def write_surrogate(law: SurrogateLaw, path: str | Path) -> None:
    """Write a surrogate, whole or not at all; a FileError where that fails."""
    header = {
        **origin(law.cell, law.initialisation),
        **{name: getattr(law, name) for name in _OF_LAW},
        "network": {"symmetry": law.network.symmetry, "degree": law.network.degree},
        "units": _UNITS,
    }
    arrays = {f"network/{name}": values for name, values in law.network.tensors.items()}
    if law.domain is not None:
        header["domain"] = {"square": law.domain.square}
        arrays["domain/scale"] = law.domain.scale
        arrays["domain/boundary"] = law.domain.boundary
    if law.calibration is not None:
        calibration = asdict(law.calibration)
        arrays["calibration/scale"] = calibration.pop("scale")
        arrays["calibration/near"] = calibration.pop("near")
        header["calibration"] = calibration
    write(Path(path), SURROGATE, header, arrays)


def read_surrogate(path: str | Path) -> SurrogateLaw:
    """Read a surrogate.

    Raises:
        FileError: missing, truncated, foreign, altered, or of an older version.
    """
    with reading(Path(path), SURROGATE) as stored:
        header = stored.header()
        arrays: dict[str, Any] = {"network": {}, "domain": {}, "calibration": {}}
        for path_of_array, values in stored.arrays().items():
            part, _, name = path_of_array.partition("/")
            arrays[part][name] = values
        check_units("stress, rate, rest_length", header.pop("units"), _UNITS)
        _check_errors(header["errors"])
        header["seconds"] = {name: float(value) for name, value in header["seconds"].items()}
        network = NetworkParameters(**header.pop("network"), tensors=arrays["network"])
        domain_entries = header.pop("domain")
        domain = None
        if domain_entries is not None:
            domain = Domain(**domain_entries, **arrays["domain"])
        calibration_entries = header.pop("calibration")
        calibration = None
        if calibration_entries is not None:
            # a quantile is the text "inf" in JSON where there is no bound
            for entries in (calibration_entries, *calibration_entries["kinds"].values()):
                entries["quantile"] = float(entries["quantile"])
            calibration = Calibration(**calibration_entries, **arrays["calibration"])
        return SurrogateLaw(network=network, domain=domain, calibration=calibration, **header)


def _check_errors(errors: dict[str, Any]) -> None:
    """Raise a TypeError or KeyError where a figure of a component is no number.

    A surrogate without training has no errors.
    """
    if not errors:
        return
    for figure in _FIGURES:
        for component in _STRESSES:
            if not isinstance(errors[figure][component], int | float):
                raise TypeError(f"errors.{figure}.{component}")


def content_fingerprint(path: Path) -> str:
    """Return 16 hexadecimal digits of all in a file on which its stresses depend."""
    with reading(path, SURROGATE) as stored:
        header = {k: str(v) for k, v in stored.file.attrs.items() if k not in _OF_MAKING}
        content = hashlib.sha256(json.dumps(header, sort_keys=True).encode())
        for name, values in stored.arrays().items():
            content.update(name.encode() + values.tobytes())
    return content.hexdigest()[:16]


# Reject a surrogate of another RVE; arguments: path, surrogate, cell and initialisation.
check_surrogate = partial(check_same_rve, "trained", "train a surrogate for {}", wall=True)
