"""What is clamped, what pulls, for how long, what is watched: one object for macro and tissue."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from surrofe2.errors import InputError
from surrofe2.units import ACCELERATION, LENGTH, NONE, TIME


def _quantity(default: object, unit: str, about: str):  # type: ignore[no-untyped-def]
    return field(default=default, metadata={"unit": unit, "about": about})


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadCase:
    """A rectangle of tissue, clamped along its left side, pulled by a body force, at rest at t = 0.

    The defaults are the bending bar of the paper's section 6.2.
    """

    width: float = _quantity(400.0, LENGTH, "extent in x")
    height: float = _quantity(400.0, LENGTH, "extent in y")
    body_force: tuple[float, float] = _quantity(
        (0.0, -0.2), ACCELERATION, "body force per mass (g in eq. 58)"
    )
    amplitude: tuple[tuple[float, float], ...] = _quantity(
        (), f"({TIME}, {NONE})", "(time, factor) of the body force, linear between; empty: constant"
    )
    duration: float = _quantity(250.0, TIME, "length of the run")
    watched: tuple[float, float] = _quantity(
        (400.0, 200.0), LENGTH, "reference position of the watched point"
    )
    output_interval: float = _quantity(0.5, TIME, "time between rows of the curve")

    def __post_init__(self) -> None:
        for name in ("width", "height", "duration", "output_interval"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise InputError(f"load.{name}: {value}; it must be positive")
        if not np.isfinite(self.body_force).all():
            raise InputError(f"load.body_force: {self.body_force}; it must be finite")
        x, y = self.watched
        if not (0.0 <= x <= self.width and 0.0 <= y <= self.height):
            raise InputError(
                f"load.watched: {self.watched}; it must lie within "
                f"[0, {self.width}] x [0, {self.height}] µm"
            )
        times = np.array([t for t, _ in self.amplitude])
        if not np.isfinite(np.array(self.amplitude)).all() or (np.diff(times) <= 0.0).any():
            raise InputError(
                f"load.amplitude: {self.amplitude}; times must increase, entries be finite"
            )

    def amplitude_at(self, t: float) -> float:
        """Factor of the body force at time t (µs)."""
        if not self.amplitude:
            return 1.0
        times, factors = zip(*self.amplitude, strict=True)
        return float(np.interp(t, times, factors))

    def output_times(self) -> np.ndarray:
        """(m,) times in µs at which results are kept: multiples of the interval, and the end."""
        count = int(np.floor(self.duration / self.output_interval * (1.0 + 1e-12)))
        times = self.output_interval * np.arange(count + 1)
        return times if np.isclose(times[-1], self.duration) else np.append(times, self.duration)
