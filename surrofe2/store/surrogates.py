"""Surrogates, and interrupted trainings. Nothing in a file is ever executed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from surrofe2.base import units
from surrofe2.store.hdf5 import (
    Kind,
    Stored,
    check_finite,
    check_same_rve,
    check_units,
    origin,
    reading,
    write,
)
from surrofe2.surrogate.domain import Calibration, Domain
from surrofe2.surrogate.features import NetworkParameters
from surrofe2.surrogate.settings import TrainingSettings
from surrofe2.surrogate.surrogate_law import SurrogateLaw

SURROGATE = Kind("surrogate", 7, advice="train again with: surrofe2 train RECIPE --fresh")
TRAINING = Kind("unfinished training", 6)
_OF_MAKING = ("sha256", "created", "package_version", "seconds")
"""Entries of the header on which no answer depends."""
_STRESSES = ("xx", "xy", "yx", "yy")
_UNITS = {"stress": units.STRESS, "rate": units.RATE, "rest_length": units.LENGTH}

Arrays = dict[str, NDArray[Any]]


def write_surrogate(law: SurrogateLaw, path: str | Path) -> None:
    """Write a surrogate, whole or not at all; a FileError where that fails."""
    header = {
        **origin(law.cell, law.initialisation, range=law.range, settings=law.settings),
        "version": law.version,
        "data_fingerprint": law.data_fingerprint,
        "network": {"symmetry": law.network.symmetry, "degree": law.network.degree},
        "errors": law.errors,
        "seconds": law.seconds,
        "units": _UNITS,
    }
    arrays = {f"network/{name}": values for name, values in law.network.tensors.items()}
    if law.rest_length is not None:
        header["rest_length"] = law.rest_length
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
        for name, values in stored.all_arrays().items():
            check_finite(name, values)
        check_units("stress, rate, rest_length", stored.table("units"), _UNITS)
        errors = stored.table("errors")  # figures by component; none of one without training
        for figure in ("spread", "rms", "worst") if errors else ():
            for component in _STRESSES:
                if not isinstance(errors[figure][component], int | float):
                    raise TypeError(f"errors.{figure}.{component}")
        header = stored.file.attrs
        network = stored.all_arrays("network")
        domain: dict[str, Any] = stored.all_arrays("domain")
        return SurrogateLaw(
            **stored.whose,
            version=stored.word("version"),
            data_fingerprint=stored.word("data_fingerprint"),
            rest_length=stored.optional("rest_length"),
            range=stored.range,
            settings=TrainingSettings(**stored.table("settings")),
            network=NetworkParameters(**stored.table("network"), tensors=network),
            errors=errors,
            domain=Domain(**stored.table("domain"), **domain) if "domain" in header else None,
            calibration=_calibration(stored) if "calibration" in header else None,
            seconds={name: float(each) for name, each in stored.table("seconds").items()},
        )


def _calibration(stored: Stored) -> Calibration:
    """With its quantiles as numbers: "inf" where there is no bound."""
    bound = stored.table("calibration") | stored.all_arrays("calibration")
    for each in (bound, *bound["kinds"].values()):
        each["quantile"] = float(each["quantile"])
    return Calibration(**bound)


def content_fingerprint(path: Path) -> str:
    """16 hexadecimal digits of all in a file that its answers depend on."""
    with reading(path, SURROGATE) as stored:
        header = {k: str(v) for k, v in stored.file.attrs.items() if k not in _OF_MAKING}
        content = hashlib.sha256(json.dumps(header, sort_keys=True).encode())
        for name, values in stored.all_arrays().items():
            content.update(name.encode() + values.tobytes())
    return content.hexdigest()[:16]


def write_training(
    path: Path, identity: Mapping[str, str], iterations: int, arrays: Arrays, seconds: float = 0.0
) -> None:
    """Write an interrupted training, see `surrogate.training.TrainingState`, and its time."""
    header = {"identity": identity, "iterations": iterations, "seconds": seconds}
    write(path, TRAINING, header, arrays)


def read_training(path: Path) -> tuple[dict[str, str], int, Arrays]:
    """(identity, iterations, arrays) of an interrupted training, or a FileError."""
    with reading(path, TRAINING) as stored:
        return stored.table("identity"), int(stored.number("iterations")), stored.all_arrays()


check_surrogate = partial(check_same_rve, "trained", "train a surrogate for {}", wall=True)
"""Refuse one of other plant cells: path, surrogate, and the cell and initialisation wanted."""
