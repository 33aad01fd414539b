"""Curves of long studies, kept one by one, so that an interrupted study goes on where it was."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from surrofe2.compilation import cache_folder
from surrofe2.displacement_curve import DisplacementCurve
from surrofe2.errors import FileError
from surrofe2.io.files import plain, read_json, write_json


@dataclass(frozen=True, slots=True)
class KeptCurve:
    """A curve and what it cost: wall time in s."""

    curve: DisplacementCurve
    seconds: float


class KeptCurves:
    """A folder with one JSON file a curve, NAME-DIGEST.json; the digest is of its configuration.

    A curve is taken from there only if its configuration and the sources of the package are those
    that it was computed with.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def read(self, name: str, configuration: Mapping[str, Any]) -> KeptCurve | None:
        """The curve of exactly this configuration, or None."""
        path, wanted = self._path(name, configuration), _identity(configuration)
        if not path.exists():
            return None
        stored = read_json(path)
        if stored.get("identity") != wanted:
            return None
        try:
            curve = DisplacementCurve(np.array(stored["t"]), np.array(stored["displacement"]))
            return KeptCurve(curve, float(stored["seconds"]))
        except (KeyError, TypeError, ValueError):
            raise FileError(f"{path}: not a whole curve; delete it") from None

    def write(self, name: str, configuration: Mapping[str, Any], kept: KeptCurve) -> Path:
        """Keep a curve; the path of its file."""
        path = self._path(name, configuration)
        record = {
            "identity": _identity(configuration),
            "units": {"t": "µs", "displacement": "µm", "seconds": "s, wall time"},
            "seconds": kept.seconds,
            "t": kept.curve.t,
            "displacement": kept.curve.displacement,
        }
        write_json(path, record)
        return path

    def _path(self, name: str, configuration: Mapping[str, Any]) -> Path:
        text = json.dumps(plain(configuration), sort_keys=True)
        return self.folder / f"{name}-{hashlib.sha256(text.encode()).hexdigest()[:8]}.json"


def _identity(configuration: Mapping[str, Any]) -> dict[str, Any]:
    named: dict[str, Any] = plain({"sources": cache_folder().name, **configuration})
    return named
