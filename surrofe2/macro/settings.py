"""What a macro run can be told besides its load case and its law."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Literal

from surrofe2.errors import InputError
from surrofe2.units import NONE, TIME


def _setting(default: Any, unit: str, about: str) -> Any:
    return field(default=default, metadata={"unit": unit, "about": about})


@dataclass(frozen=True, slots=True, kw_only=True)
class MacroSettings:
    """Mesh, tolerances and what is kept; the defaults are those of section 6.2."""

    elements: tuple[int, int] = _setting((4, 4), NONE, "number of elements in x and in y")
    absolute_tolerance: float = _setting(
        1e-5, "µm and µm/µs", "absolute error allowed in a step, for displacement and velocity"
    )
    relative_tolerance: float = _setting(1e-3, NONE, "relative error allowed in a step")
    largest_step: float = _setting(math.inf, TIME, "no time step is longer than this")
    integrator: Literal["explicit", "implicit"] = _setting(
        "explicit", NONE, "Dormand-Prince 5(4), or generalised-α with Newton, second order"
    )
    spectral_radius: float = _setting(
        0.9, NONE, "implicit: amplification a step of infinitely fast modes, 1: none is damped"
    )
    newton_tolerance: float = _setting(
        1e-8, NONE, "implicit and rest: largest residual relative to the largest force"
    )
    frames: int = _setting(101, NONE, "number of times at which whole fields are kept, at most")
    record_dissipation: bool = _setting(
        True, NONE, "ask the law also at rate 0, about every other output time, for dissipation"
    )

    def __post_init__(self) -> None:
        elements = self.elements
        if not (isinstance(elements, tuple | list) and len(elements) == 2) or any(
            not _is_integer(n) or n < 1 for n in elements
        ):
            raise InputError(f"macro.elements: {elements!r}; it must be two integers of at least 1")
        object.__setattr__(self, "elements", tuple(elements))
        for name, least in (("absolute_tolerance", 0.0), ("relative_tolerance", 1e-13)):
            value = getattr(self, name)
            if not (_is_number(value) and math.isfinite(value) and value > least):
                raise InputError(f"macro.{name}: {value!r}; it must be above {least:g} and finite")
        if not (_is_number(self.largest_step) and self.largest_step > 0.0):
            raise InputError(f"macro.largest_step: {self.largest_step!r}; it must be positive")
        if self.integrator not in ("explicit", "implicit"):
            raise InputError(
                f"macro.integrator: {self.integrator!r}; it must be one of explicit, implicit"
            )
        if not (_is_number(self.spectral_radius) and 0.0 <= self.spectral_radius <= 1.0):
            raise InputError(
                f"macro.spectral_radius: {self.spectral_radius!r}; it must be within [0, 1]"
            )
        if not (_is_number(self.newton_tolerance) and 1e-13 < self.newton_tolerance < 1.0):
            raise InputError(
                f"macro.newton_tolerance: {self.newton_tolerance!r}; it must be above 1e-13 and "
                "below 1"
            )
        if not _is_integer(self.frames) or self.frames < 2:
            raise InputError(f"macro.frames: {self.frames!r}; it must be an integer of at least 2")
        if not isinstance(self.record_dissipation, bool):
            raise InputError(
                f"macro.record_dissipation: {self.record_dissipation!r}; it must be true or false"
            )


def _is_integer(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


SECTION_6_2 = MacroSettings()
"""The bar of the paper's section 6.2."""
