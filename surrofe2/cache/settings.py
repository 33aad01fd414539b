"""What the user asks of the cache: the recipe's section [cache]."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from surrofe2.errors import InputError
from surrofe2.units import NONE


def _setting(default: Any, about: str) -> Any:
    return field(default=default, metadata={"unit": NONE, "about": about})


@dataclass(frozen=True, slots=True, kw_only=True)
class CacheSettings:
    """Tolerance and audit of a cached law."""

    tolerance: float = _setting(
        1e-3, "allowed error of a stress relative to the spread of stress; inf: range alone decides"
    )
    audit: float = _setting(
        0.005, "share of the cache's answers at accepted steps that an RVE answers too"
    )
    seed: int = _setting(1, "of the choice of audited answers")

    def __post_init__(self) -> None:
        if not (_is_number(self.tolerance) and self.tolerance > 0.0):
            raise InputError(
                f"cache.tolerance: {self.tolerance!r}; it must be positive (inf: no bound is asked)"
            )
        if not (_is_number(self.audit) and 0.0 <= self.audit <= 1.0):
            raise InputError(f"cache.audit: {self.audit!r}; it must be within [0, 1]")
        if not (isinstance(self.seed, int) and not isinstance(self.seed, bool) and self.seed >= 0):
            raise InputError(f"cache.seed: {self.seed!r}; it must be an integer of at least 0")


def _is_number(value: Any) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and not math.isnan(value)
