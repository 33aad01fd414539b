"""Factors in time by which loads, motions and rigid bodies follow their largest value.

A factor is smooth but at its corners, where it or its rate jumps. Time integration ends a step at
each corner, so a step only ever sees one smooth piece. The argument `within` names that piece by
any time inside it, for at a corner itself both sides may differ.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from bisect import bisect_right
from dataclasses import dataclass
from operator import itemgetter
from typing import Any, Literal

import numpy as np

from surrofe2.base.errors import InputError
from surrofe2.base.settings import (
    build_kind,
    check_settings,
    check_value,
    setting,
    with_kind,
)
from surrofe2.base.units import NONE, TIME

Value = tuple[float, float, float]  # a factor, its rate (1/µs) and the rate of that (1/µs²)

# Time steps that a smooth ramp, a half sine or a whole oscillation must have at least.
_STEPS_OF_A_SHAPE = 8.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Amplitude(ABC):
    """A factor in time.

    A subclass states `at`; it overrides `corners` and `resolved_by` where it has corners, or a
    shape that time steps must resolve.
    """

    def __post_init__(self) -> None:
        check_settings(self, "amplitude")

    @staticmethod
    def read(where: str, entry: Any) -> Amplitude:
        """Read what a recipe states: a number, a list of (time, factor), or a table with `kind`."""
        if isinstance(entry, list | tuple):
            entry = {"kind": "table", "points": entry}
        if not isinstance(entry, dict):
            return Constant(value=check_value(where, entry, float, {}))
        return build_kind(KINDS, entry, where)

    def entry(self) -> dict[str, Any]:
        """Return the table that states this amplitude in a recipe.

        For a class that recipes do not know, it is the name of the class alone.
        """
        kind, entries = with_kind(self, KINDS)
        return {"kind": kind, **entries}

    @abstractmethod
    def at(self, t: float, within: float) -> Value:
        """Compute the factor and its rates at time t, µs.

        At a corner, where the factor or its rate jumps, t belongs to two smooth pieces. `within` is
        any time, µs, inside the piece that is meant; away from corners it may be t itself.
        """

    def corners(self) -> tuple[float, ...]:
        """Return the times (µs) at which the factor or its rate jumps, increasing."""
        return ()

    @property
    def resolved_by(self) -> float:
        """Longest step (µs) that sees the factor's shape; infinite where it has none."""
        return math.inf


@dataclass(frozen=True, slots=True, kw_only=True)
class Constant(Amplitude):
    """The same factor at all times."""

    value: float = setting(1.0, "the factor")

    def at(self, t: float, within: float) -> Value:
        return self.value, 0.0, 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Table(Amplitude):
    """Linear between points, constant before the first and after the last.

    Examples:
        A load that rises within 10 µs, stays, and is gone at 50 µs:

        >>> from surrofe2 import Table
        >>> load = Table(points=((0.0, 0.0), (10.0, 1.0), (40.0, 1.0), (50.0, 0.0)))
        >>> [load.at(t, within=t)[0] for t in (5.0, 20.0, 45.0)]
        [0.5, 1.0, 0.5]
    """

    points: tuple[tuple[float, float], ...] = setting((), "(time, factor)", f"({TIME}, {NONE})")

    def __post_init__(self) -> None:
        super(Table, self).__post_init__()
        if not self.points:
            raise InputError("amplitude.points", "[]; it must have at least one (time, factor)")
        if (np.diff([t for t, _ in self.points]) <= 0.0).any():
            raise InputError("amplitude.points", f"{list(self.points)}; times must increase")

    def at(self, t: float, within: float) -> Value:
        following = bisect_right(self.points, within, key=itemgetter(0))  # first point after it
        if following == 0:
            _, first_factor = self.points[0]
            return first_factor, 0.0, 0.0
        if following == len(self.points):
            _, last_factor = self.points[-1]
            return last_factor, 0.0, 0.0
        begin, factor_at_begin = self.points[following - 1]
        end, factor_at_end = self.points[following]
        slope = (factor_at_end - factor_at_begin) / (end - begin)
        return factor_at_begin + slope * (t - begin), slope, 0.0

    def corners(self) -> tuple[float, ...]:
        return tuple(t for t, _ in self.points)


@dataclass(frozen=True, slots=True, kw_only=True)
class Ramp(Amplitude):
    """A rise from 0 to 1 between two times.

    A smooth ramp begins and ends without rate and acceleration.

    With s = (t − begin)/(end − begin) the factor is s, or s³ (10 − 15 s + 6 s²) if smooth.

    Examples:
        >>> from surrofe2 import Ramp
        >>> ramp = Ramp(end=100.0, smooth=True)  # µs
        >>> [round(ramp.at(t, within=t)[0], 3) for t in (0.0, 25.0, 50.0, 100.0)]
        [0.0, 0.104, 0.5, 1.0]
    """

    begin: float = setting(0.0, "time up to which the factor is 0", TIME)
    end: float = setting(about="time from which the factor is 1", unit=TIME)
    smooth: bool = setting(False, "whether rate and acceleration are continuous")

    def __post_init__(self) -> None:
        super(Ramp, self).__post_init__()
        if not self.end > self.begin:
            raise InputError(
                "amplitude.end", f"{self.end}; it must be after begin, {self.begin} µs"
            )

    def at(self, t: float, within: float) -> Value:
        if within <= self.begin:
            return 0.0, 0.0, 0.0
        if within >= self.end:
            return 1.0, 0.0, 0.0
        length = self.end - self.begin
        s = (t - self.begin) / length
        if not self.smooth:
            return s, 1.0 / length, 0.0
        value = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        rate = 30.0 * s**2 * (1.0 - s) ** 2 / length
        acceleration = 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / length**2
        return value, rate, acceleration

    def corners(self) -> tuple[float, ...]:
        return self.begin, self.end

    @property
    def resolved_by(self) -> float:
        if not self.smooth:  # a step ends at each corner, and a line needs no more
            return math.inf
        return (self.end - self.begin) / _STEPS_OF_A_SHAPE


@dataclass(frozen=True, slots=True, kw_only=True)
class Sine(Amplitude):
    """offset + sin(2π frequency (t − begin) + phase) from `begin` on, its first value before.

    Examples:
        Twenty oscillations in a millisecond, at an eighth and at a quarter of the first:

        >>> from surrofe2 import Sine
        >>> swing = Sine(frequency=0.02)  # 1/µs, so 20 kHz
        >>> [round(swing.at(t, within=t)[0], 3) for t in (6.25, 12.5)]
        [0.707, 1.0]
    """

    frequency: float = setting(about="oscillations per µs", unit="1/µs", above=0.0)
    phase: float = setting(0.0, "angle at begin", "°")
    offset: float = setting(0.0, "the mean factor")
    begin: float = setting(0.0, "time at which the oscillation begins", TIME)

    def at(self, t: float, within: float) -> Value:
        omega = 2.0 * math.pi * self.frequency
        phase = math.radians(self.phase)
        if within <= self.begin:
            return self.offset + math.sin(phase), 0.0, 0.0
        angle = omega * (t - self.begin) + phase
        value = self.offset + math.sin(angle)
        rate = omega * math.cos(angle)
        acceleration = -(omega**2) * math.sin(angle)
        return value, rate, acceleration

    def corners(self) -> tuple[float, ...]:
        return (self.begin,)

    @property
    def resolved_by(self) -> float:
        return 1.0 / (_STEPS_OF_A_SHAPE * self.frequency)


@dataclass(frozen=True, slots=True, kw_only=True)
class Pulse(Amplitude):
    """A rise from 0 to 1 and back to 0 within `length`: by a half sine, a triangle or at once."""

    begin: float = setting(0.0, "time at which the factor leaves 0", TIME)
    length: float = setting(about="time until it is 0 again", unit=TIME, above=0.0)
    shape: Literal["half-sine", "triangle", "rectangle"] = setting(
        "half-sine", "shape of the pulse"
    )

    def at(self, t: float, within: float) -> Value:
        s = (t - self.begin) / self.length
        s_within = (within - self.begin) / self.length
        if not 0.0 < s_within < 1.0:
            return 0.0, 0.0, 0.0
        if self.shape == "rectangle":
            return 1.0, 0.0, 0.0
        if self.shape == "triangle":
            is_rising = s_within < 0.5
            if is_rising:
                return 2.0 * s, 2.0 / self.length, 0.0
            return 2.0 - 2.0 * s, -2.0 / self.length, 0.0
        omega = math.pi / self.length
        value = math.sin(math.pi * s)
        return value, omega * math.cos(math.pi * s), -(omega**2) * value

    def corners(self) -> tuple[float, ...]:
        end = self.begin + self.length
        if self.shape == "triangle":
            middle = self.begin + 0.5 * self.length
            return self.begin, middle, end
        return self.begin, end

    @property
    def resolved_by(self) -> float:
        if self.shape != "half-sine":  # corners show a triangle and a rectangle fully
            return math.inf
        return self.length / _STEPS_OF_A_SHAPE


# Amplitudes by the name that recipes use.
KINDS: dict[str, type[Amplitude]] = {
    "constant": Constant,
    "table": Table,
    "ramp": Ramp,
    "sine": Sine,
    "pulse": Pulse,
}
ONE = Constant()
IN_TIME = "its factor in time: a number, a list of (time, factor), or a table with `kind`"


@dataclass(frozen=True, slots=True, kw_only=True)
class Proportional(Amplitude):
    """The factor t itself: loads grow together by a load factor, which takes the place of time.

    Its rate is 0, so what such loads move has no velocity.
    """

    def at(self, t: float, within: float) -> Value:
        return t, 0.0, 0.0
