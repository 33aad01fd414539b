"""Surrogates in files: weights and plain data, loaded with `weights_only`, so never executed."""

from __future__ import annotations

import io
import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from surrofe2 import units
from surrofe2.errors import FileError
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.sampling import SamplingRange
from surrofe2.surrogate.calibration import Calibration
from surrofe2.surrogate.domain import Domain
from surrofe2.surrogate.network import StressNetwork
from surrofe2.surrogate.settings import TrainingSettings

if TYPE_CHECKING:
    from surrofe2.surrogate.surrogate_law import SurrogateLaw

FORMAT = "surrofe2 surrogate 2"
_OLD_FORMATS = ("surrofe2 surrogate 1",)
_UNITS = {"stress": units.STRESS, "rate": units.RATE, "rest_length": units.LENGTH}


def write_surrogate(law: SurrogateLaw, path: Path) -> None:
    """Write a surrogate, whole or not at all: to a temporary file beside it, then renamed."""
    content = {
        "format": FORMAT,
        "version": law.version,
        "units": _UNITS,
        "weights": law.network.state_dict(),
        "symmetry": law.network.symmetry,
        "settings": {
            key: list(value) if isinstance(value, tuple) else value
            for key, value in law.settings.to_dict().items()
        },
        "range": {**law.range.to_dict(), "stretch": list(law.range.stretch)},
        "cell": law.cell.to_dict(),
        "cell_fingerprint": law.cell.fingerprint,
        "initialisation": law.initialisation,
        "rest_length": law.rest_length,
        "data_fingerprint": law.data_fingerprint,
        "errors": _plain(law.errors),
        "domain": None if law.domain is None else law.domain.to_dict(),
        "calibration": None if law.calibration is None else law.calibration.to_dict(),
    }
    buffer = io.BytesIO()
    torch.save(content, buffer)
    try:
        _replace(path, buffer.getvalue())
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror}") from None


def read_surrogate(path: Path) -> SurrogateLaw:
    """Read a surrogate, or a FileError that says why not."""
    from surrofe2.surrogate.surrogate_law import SurrogateLaw

    content = _read(path)
    try:
        settings = TrainingSettings(**content["settings"])
        cell = CellParameters(**content["cell"])
        network = StressNetwork(settings, content["symmetry"])
        network.to(getattr(torch, settings.precision)).load_state_dict(content["weights"])
        law = SurrogateLaw(
            network=network,
            cell=cell,
            initialisation=content["initialisation"],
            range=SamplingRange(**content["range"]),
            settings=settings,
            errors=content["errors"],
            data_fingerprint=content["data_fingerprint"],
            rest_length=content["rest_length"],
            version=content["version"],
            domain=_read_part(Domain, content.get("domain")),
            calibration=_read_part(Calibration, content.get("calibration")),
        )
        fingerprint = content["cell_fingerprint"]
    except (KeyError, TypeError, ValueError, RuntimeError, AttributeError):
        raise FileError(
            f"{path}: a surrofe2 surrogate with missing or damaged entries; train it anew"
        ) from None
    if cell.fingerprint != fingerprint:
        raise FileError(
            f"{path}: its cell parameters give fingerprint {cell.fingerprint}, but it was "
            f"trained for {fingerprint}; train it anew"
        )
    return law


def _read_part(kind: type[Any], content: dict[str, Any] | None) -> Any:
    return None if content is None else kind.from_dict(content)


def _read(path: Path) -> dict[str, Any]:
    try:
        stored = path.read_bytes()
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror}") from None
    try:
        content = torch.load(io.BytesIO(stored), weights_only=True, map_location="cpu")
    except Exception:  # bytes from anywhere fail in the reader in ways it does not list
        raise FileError(
            f"{path}: not a surrogate: truncated, foreign, or holding more than weights"
        ) from None
    if isinstance(content, dict) and content.get("format") in _OLD_FORMATS:
        raise FileError(
            f"{path}: {content['format']}, from before the network had an energy; train it anew"
        )
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise FileError(f"{path}: not a surrogate that this version of surrofe2 reads")
    return content


def _replace(path: Path, content: bytes) -> None:
    descriptor, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return value if isinstance(value, int | str) else float(value)
