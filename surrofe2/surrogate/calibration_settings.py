"""How the bound of a surrogate's error is calibrated."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from surrofe2.errors import InputError

_LEAST = {"walks": 0, "states": 0, "runs": 0, "length": 1, "seed": 0}


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationSettings:
    """Number and kind of the paths along which the true stress is asked.

    A third as many again of each kind shape the local scale, which the others then calibrate.

    Attributes:
        walks: random walks in the sampling range.
        states: single random states of it.
        runs: short runs of the recipe's bar under random loads; all points of a run are one path.
        length: states taken along a walk; along a run a third as many.
        share: of new paths on which the bound may break, the nominal share; each kind that is
            used needs at least 1/share − 1 paths.
        seed: of the paths.
    """

    walks: int = 500
    states: int = 2000
    runs: int = 100
    length: int = 24
    share: float = 0.01
    seed: int = 2

    def __post_init__(self) -> None:
        if not isinstance(self.share, float) or not 0.0 < self.share < 1.0:
            raise InputError(f"calibration.share: {self.share!r}; it must be between 0 and 1")
        for name, least in _LEAST.items():
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < least:
                raise InputError(
                    f"calibration.{name}: {value!r}; it must be an integer of at least {least}"
                )
        needed = 1.0 / self.share - 1.0
        for name in ("walks", "states", "runs"):
            if 0 < getattr(self, name) < needed * (1.0 - 1e-9):
                raise InputError(
                    f"calibration.{name}: {getattr(self, name)}; it must be 0 or at least "
                    f"{needed:.4g}, 1/share − 1, for a share of {self.share:g}"
                )

    def to_dict(self) -> dict[str, Any]:
        """All fields by name, for files."""
        return asdict(self)
