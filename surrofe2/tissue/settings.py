"""What a run of the full tissue can be told besides its load case and its plant cell."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from surrofe2.errors import InputError
from surrofe2.units import FORCE, LENGTH, NONE, TIME


def _setting(default: Any, unit: str, about: str) -> Any:
    return field(default=default, metadata={"unit": unit, "about": about})


@dataclass(frozen=True, slots=True, kw_only=True)
class TissueSettings:
    """Time step, accuracy of the unloaded equilibrium, and what is kept."""

    micro_step: float = _setting(
        2e-3, TIME, "longest leapfrog step; an output interval has a whole number of them"
    )
    residual: float = _setting(
        1e-6, FORCE, "largest force left on a particle of the unloaded tissue"
    )
    skin: float = _setting(
        2.0, LENGTH, "reach of neighbour lists beyond the cut-off; it changes the cost only"
    )
    energy_steps: int = _setting(
        50, NONE, "steps between two evaluations of the dissipated power, at most"
    )
    frames: int = _setting(51, NONE, "number of times at which particle fields are kept, at most")

    def __post_init__(self) -> None:
        for name in ("micro_step", "residual", "skin"):
            value = getattr(self, name)
            number = isinstance(value, int | float) and not isinstance(value, bool)
            if not (number and math.isfinite(value) and value > 0.0):
                raise InputError(f"tissue.{name}: {value!r}; it must be positive and finite")
        for name, least in (("energy_steps", 1), ("frames", 2)):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or value < least:
                raise InputError(
                    f"tissue.{name}: {value!r}; it must be an integer of at least {least}"
                )
