"""Settings of a macro run: time integration, tolerances, what is recorded."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from surrofe2.base.settings import check_settings, setting
from surrofe2.base.units import TIME
from surrofe2.problem.conditions import FREE, checked_sides

# An absolute tolerance to advise, over the relative one times the largest displacement.
SMALL = 0.01


@dataclass(frozen=True, slots=True, kw_only=True)
class MacroSettings:
    """Tolerances and what is kept; the defaults are those of section 6.2."""

    absolute_tolerance: float = setting(
        1e-5,
        "absolute error allowed in a step, for displacement and velocity",
        "µm and µm/µs",
        above=0.0,
    )
    relative_tolerance: float = setting(1e-3, "relative error allowed in a step", above=1e-13)
    largest_step: float = setting(
        math.inf, "no time step is longer than this", TIME, above=0.0, inf=True
    )
    integrator: Literal["explicit", "implicit"] = setting(
        "explicit", "Dormand-Prince 5(4), or generalised-α with Newton, second order"
    )
    spectral_radius: float = setting(
        0.9,
        "implicit: amplification per step of infinitely fast modes, 1: none is damped",
        least=0.0,
        most=1.0,
    )
    newton_tolerance: float = setting(
        1e-8,
        "implicit and rest: largest residual relative to the largest force",
        above=1e-13,
        below=1.0,
    )
    frames: int = setting(101, "number of times at which whole fields are kept, at most", least=2)
    record_dissipation: bool = setting(
        True,
        "also evaluate the stress at zero rate, about every other output time, for dissipation",
    )

    def __post_init__(self) -> None:
        check_settings(self, "macro")

    def remark(self, largest: float) -> str | None:
        """Advise on the absolute tolerance by a run's largest displacement, µm; None: no advice.

        Where the absolute tolerance exceeds what the relative one allows of the largest
        displacement, steps are as long as stability or that tolerance bears, whatever the motion.
        """
        if not 0.0 < largest * self.relative_tolerance < self.absolute_tolerance:
            return None
        advised = float(f"{SMALL * self.relative_tolerance * largest:.0e}")
        return (
            f"macro.absolute_tolerance: {self.absolute_tolerance:g} µm is not small against the "
            f"largest displacement, {largest:.2g} µm, so the relative tolerance of "
            f"{self.relative_tolerance:g} does not hold; set it to {advised:g}"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class RestSettings:
    """Load steps to the tissue at rest: the method where time does not matter."""

    factor: float = setting(1.0, "multiplier of all loads and prescribed motions at the end")
    load_steps: int = setting(10, "load steps to begin with; one that fails is halved", least=1)

    def __post_init__(self) -> None:
        check_settings(self, "rest")


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceSettings:
    """The sides of the tissue that have the surface law of their plant cells."""

    on: tuple[str, ...] | Literal["free"] = setting(
        FREE, 'list of boundaries; "free": all outer sides that no condition and no body names',
        read=lambda where, on: checked_sides(on),
    )  # fmt: skip

    def __post_init__(self) -> None:
        object.__setattr__(self, "on", checked_sides(self.on))


# The settings of the bar in the paper's section 6.2.
SECTION_6_2 = MacroSettings()
