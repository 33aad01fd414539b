"""How the bound of a surrogate's error is calibrated."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from surrofe2.errors import InputError
from surrofe2.settings import check_settings, setting


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationSettings:
    """Number and kind of the paths along which the true stress is asked.

    A third as many again of each kind shape the local scale, which the others then calibrate.
    Each kind that is used needs at least 1/share − 1 paths.
    """

    walks: int = setting(500, "random walks in the sampling range", least=0)
    states: int = setting(2000, "single random states of it", least=0)
    runs: int = setting(
        100, "short runs of the bar under random loads; all points are one path", least=0
    )
    length: int = setting(24, "states taken along a walk; along a run a third as many", least=1)
    share: float = setting(
        0.01, "of new paths on which the bound may break, the nominal share", above=0.0, below=1.0
    )
    seed: int = setting(2, "of the paths", least=0)

    def __post_init__(self) -> None:
        check_settings(self, "calibration")
        needed = 1.0 / self.share - 1.0
        for name, count in (("walks", self.walks), ("states", self.states), ("runs", self.runs)):
            if 0 < count < needed * (1.0 - 1e-9):
                raise InputError(
                    f"calibration.{name}: {count}; it must be 0 or at least {needed:.4g}, "
                    f"1/share − 1, for a share of {self.share:g}"
                )

    def to_dict(self) -> dict[str, Any]:
        """All fields by name, for files."""
        return asdict(self)
