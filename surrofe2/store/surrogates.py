"""Surrogates in safetensors files, arrays with JSON in the metadata; interrupted trainings in HDF5.

The metadata hold a SHA-256 of the whole file, in which its own digits are zeros, so that a flipped
bit anywhere is seen when the file is read. Nothing in a file is ever executed.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load, save

from surrofe2 import units
from surrofe2.cache.branches import part_of, within
from surrofe2.errors import FileError, shortened
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.plant_cell.reference_state import ReferenceState
from surrofe2.sampling import SamplingRange
from surrofe2.settings import check_value
from surrofe2.store.hdf5 import Kind, check_same_rve, reading, write
from surrofe2.store.store import (
    NO_DIGEST,
    SEAL,
    check_seal,
    plain,
    read_bytes,
    sealed,
    write_bytes,
)
from surrofe2.surrogate.domain import Domain
from surrofe2.surrogate.error_bound import Calibration
from surrofe2.surrogate.network_arrays import NetworkParameters
from surrofe2.surrogate.settings import TrainingSettings
from surrofe2.surrogate.surrogate_law import SurrogateLaw

SURROGATE = Kind("surrogate", 6)  # 1 and 2: by torch; 4: energy form, half-spaces; 5: no alpha
TRAINING = Kind("unfinished training", 6)
_TEXTS = {
    "version": str,
    "initialisation": str,
    "data_fingerprint": str,
    "rest_length": float | None,
}
_SECTIONS = {"cell": CellParameters, "range": SamplingRange, "settings": TrainingSettings}
_STRESSES = ("xx", "xy", "yx", "yy")
_UNITS = {"stress": units.STRESS, "rate": units.RATE, "rest_length": units.LENGTH}
_ANEW = "train again with: surrofe2 train RECIPE --fresh"
_FOREIGN = (ValueError, KeyError, TypeError, AttributeError, RecursionError)
_ZIP = b"PK\x03\x04"  # how files of torch begin

Tensors = dict[str, NDArray[Any]]


def write_surrogate(law: SurrogateLaw, path: str | Path) -> None:
    """Write a surrogate, whole or not at all; a FileError where that fails."""
    domain = {} if law.domain is None else asdict(law.domain)
    square = domain.pop("square", None)
    tensors = within("network", law.network.tensors) | within("domain", domain)
    if law.reference is not None:
        tensors |= within("reference", law.reference.to_arrays())
    content = {
        **{name: getattr(law, name) for name in (*_TEXTS, *_SECTIONS, "errors", "seconds")},
        "units": _UNITS,
        "cell_fingerprint": law.cell.fingerprint,
        "network": {"symmetry": law.network.symmetry, "degree": law.network.degree},
        "domain": {"square": square} if domain else None,
        "calibration": law.calibration,
    }
    _write(Path(path), content, tensors)


def read_surrogate(path: str | Path) -> SurrogateLaw:
    """Read a surrogate.

    Raises:
        FileError: missing, truncated, foreign, altered, or of an older version.
    """
    path = Path(path)
    content, tensors = _read(path)
    try:
        domain, calibration = content["domain"], content["calibration"]
        reference = part_of(tensors, "reference")
        for name, values in tensors.items():
            if not np.isfinite(values).all():
                raise ValueError(f"{name}: not finite")
        errors = content["errors"]  # figures by component; none of a surrogate without training
        for figure in ("spread", "rms", "worst") if errors else ():
            for component in _STRESSES:
                if not isinstance(errors[figure][component], int | float):
                    raise TypeError(f"errors.{figure}.{component}")
        law = SurrogateLaw(
            **{name: check_value(name, content[name], kind, {}) for name, kind in _TEXTS.items()},
            **{name: kind(**content[name]) for name, kind in _SECTIONS.items()},
            network=NetworkParameters(**content["network"], tensors=part_of(tensors, "network")),
            errors=errors,
            domain=domain and Domain(square=domain["square"], **part_of(tensors, "domain")),
            calibration=calibration and _calibration(calibration),
            reference=ReferenceState.from_arrays(reference) if reference else None,
            seconds={name: float(each) for name, each in content["seconds"].items()},
        )
        known, cell = content["cell_fingerprint"], law.cell.fingerprint
        if cell != known:
            raise ValueError(f"its cell parameters give fingerprint {cell}, not {known}")
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise FileError(
            f"{path}: a surrofe2 surrogate with missing or damaged entries "
            f"({shortened(str(error), 80)}); {_ANEW}"
        ) from None
    return law


def _calibration(content: Mapping[str, Any]) -> Calibration:
    kinds = {
        kind: {**figures, "quantile": float(figures["quantile"])}
        for kind, figures in content["kinds"].items()
    }
    arrays = {name: np.array(content[name]) for name in ("scale", "near")}
    quantile = float(content["quantile"])  # "inf" where there is no bound
    return Calibration(**{**content, **arrays, "quantile": quantile, "kinds": kinds})


def content_fingerprint(path: Path) -> str:
    """16 hexadecimal digits of all in a file but the seconds that it took.

    Raises:
        FileError: it cannot be read.
    """
    try:
        head, content, arrays = _head_of(read_bytes(path))
        del head["__metadata__"], content[SEAL]
    except _FOREIGN:
        raise FileError(f"{path}: not of surrofe2; {_ANEW}") from None
    content.pop("seconds", None)
    text = json.dumps([head, content], sort_keys=True).encode()
    return hashlib.sha256(text + arrays).hexdigest()[:16]


def write_training(
    path: Path,
    identity: Mapping[str, str],
    iterations: int,
    arrays: Tensors,
    seconds: float = 0.0,
) -> None:
    """Write an interrupted training, see `surrogate.training.TrainingState`, and its time."""
    header = {"identity": identity, "iterations": iterations, "seconds": seconds}
    write(path, TRAINING, header, arrays)


def read_training(path: Path) -> tuple[dict[str, str], int, Tensors]:
    """(identity, iterations, arrays) of an interrupted training, or a FileError."""
    with reading(path, TRAINING) as stored:
        return stored.table("identity"), int(stored.number("iterations")), stored.all_arrays()


def _write(path: Path, content: Mapping[str, Any], tensors: Tensors) -> None:
    head = {SEAL: NO_DIGEST, "schema": SURROGATE.schema, "schema_version": SURROGATE.version}
    text = json.dumps(plain(content) | head, ensure_ascii=False)
    arrays = {name: np.ascontiguousarray(array) for name, array in tensors.items()}
    write_bytes(path, sealed(save(arrays, metadata={"surrofe2": text})))


def _head_of(stored: bytes) -> tuple[dict[str, Any], dict[str, Any], bytes]:
    """The header of safetensors, our metadata in it, and the bytes of the arrays."""
    length = int.from_bytes(stored[:8], "little")
    head = json.loads(stored[8 : 8 + length])
    content = json.loads(head["__metadata__"]["surrofe2"])
    if not isinstance(content, dict):
        raise TypeError("metadata: no JSON object")
    return head, content, stored[8 + length :]


def _read(path: Path) -> tuple[dict[str, Any], Tensors]:
    stored = read_bytes(path)
    if stored.startswith(_ZIP):
        raise FileError(f"{path}: a surrogate of an older surrofe2, stored by torch; {_ANEW}")
    if SEAL.encode() not in stored:
        raise FileError(f"{path}: not a surrofe2 surrogate, or truncated; {_ANEW}")
    try:
        check_seal(path, stored)
        _, content, _ = _head_of(stored)
        tensors = load(stored)
    except FileError as error:
        raise FileError(f"{error}; {_ANEW}") from None
    except (SafetensorError, *_FOREIGN):
        raise FileError(f"{path}: not a surrofe2 surrogate; {_ANEW}") from None
    schema, version = content.get("schema"), content.get("schema_version")
    if (schema, version) != (SURROGATE.schema, SURROGATE.version):
        raise FileError(
            f"{path}: {schema} {version}; this surrofe2 reads {SURROGATE.schema} "
            f"{SURROGATE.version}; {_ANEW}"
        )
    return content, tensors


check_surrogate = partial(check_same_rve, "trained", "train a surrogate for {}", wall=True)
"""Refuse one of other plant cells: path, surrogate, and the cell and initialisation wanted."""
