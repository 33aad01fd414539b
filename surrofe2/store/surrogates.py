"""Surrogates, and interrupted trainings. Nothing in a file is ever executed."""

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

_OF_LAW: dict[str, Any] = {
    "version": WORD, "data_fingerprint": WORD, "range": SamplingRange, "settings": TrainingSettings,
    "errors": dict, "seconds": dict, "rest_length": float | None,
}  # fmt: skip
"""Entries of the header that are attributes of the law."""
SURROGATE = Kind(
    "surrogate",
    7,
    ORIGIN
    | _OF_LAW
    | {"network": dict, "units": dict, "domain": dict | None, "calibration": dict | None},
    finite=True,
    advice="train again with: surrofe2 train RECIPE --fresh",
)
TRAINING = Kind("unfinished training", 6, {"identity": dict, "iterations": int, "seconds": float})
"""An interrupted training; its arrays are those of `surrogate.training.TrainingState`."""
_OF_MAKING = ("sha256", "created", "package_version", "seconds")
"""Entries of the header on which no answer depends."""
_STRESSES = ("xx", "xy", "yx", "yy")
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
        arrays |= {"domain/scale": law.domain.scale, "domain/boundary": law.domain.boundary}
    if law.calibration is not None:
        bound = asdict(law.calibration)
        arrays |= {f"calibration/{name}": bound.pop(name) for name in ("scale", "near")}
        header["calibration"] = bound
    write(Path(path), SURROGATE, header, arrays)


def read_surrogate(path: str | Path) -> SurrogateLaw:
    """Read a surrogate.

    Raises:
        FileError: missing, truncated, foreign, altered, or of an older version.
    """
    with reading(Path(path), SURROGATE) as stored:
        header = stored.header()
        parts: dict[str, Any] = {"network": {}, "domain": {}, "calibration": {}}
        for name, values in stored.arrays().items():
            part, _, name = name.partition("/")
            parts[part][name] = values
        network, domain, bound = (header.pop(part) for part in parts)
        check_units("stress, rate, rest_length", header.pop("units"), _UNITS)
        errors = header["errors"]  # figures by component; none of one without training
        for figure in ("spread", "rms", "worst") if errors else ():
            for component in _STRESSES:
                if not isinstance(errors[figure][component], int | float):
                    raise TypeError(f"errors.{figure}.{component}")
        header["seconds"] = {name: float(each) for name, each in header["seconds"].items()}
        if bound is not None:
            for each in (bound, *bound["kinds"].values()):  # "inf" where there is no bound
                each["quantile"] = float(each["quantile"])
            bound = Calibration(**bound, **parts["calibration"])
        return SurrogateLaw(
            network=NetworkParameters(**network, tensors=parts["network"]),
            domain=None if domain is None else Domain(**domain, **parts["domain"]),
            calibration=bound,
            **header,
        )


def content_fingerprint(path: Path) -> str:
    """16 hexadecimal digits of all in a file that its answers depend on."""
    with reading(path, SURROGATE) as stored:
        header = {k: str(v) for k, v in stored.file.attrs.items() if k not in _OF_MAKING}
        content = hashlib.sha256(json.dumps(header, sort_keys=True).encode())
        for name, values in stored.arrays().items():
            content.update(name.encode() + values.tobytes())
    return content.hexdigest()[:16]


check_surrogate = partial(check_same_rve, "trained", "train a surrogate for {}", wall=True)
"""Refuse one of other plant cells: path, surrogate, and the cell and initialisation wanted."""
