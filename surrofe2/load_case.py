"""What is clamped, what pulls, for how long, what is watched: one object for macro and tissue."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import InputError
from surrofe2.settings import check_settings, setting
from surrofe2.units import ACCELERATION, LENGTH, NONE, TIME


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadCase:
    """A rectangle of tissue, clamped along its left side, pulled by a body force, at rest at t = 0.

    The defaults are the bending bar of the paper's section 6.2.
    """

    width: float = setting(400.0, "extent in x", LENGTH, above=0.0)
    height: float = setting(400.0, "extent in y", LENGTH, above=0.0)
    body_force: tuple[float, float] = setting(
        (0.0, -0.2), "body force per mass (g in eq. 58)", ACCELERATION
    )
    amplitude: tuple[tuple[float, float], ...] = setting(
        (), "(time, factor) of the body force, linear between; empty: constant", f"({TIME}, {NONE})"
    )
    duration: float = setting(250.0, "length of the run", TIME, above=0.0)
    watched: tuple[float, float] = setting(
        (400.0, 200.0), "reference position of the watched point", LENGTH
    )
    output_interval: float = setting(0.5, "time between rows of the curve", TIME, above=0.0)

    def __post_init__(self) -> None:
        check_settings(self, "load")
        x, y = self.watched
        if not (0.0 <= x <= self.width and 0.0 <= y <= self.height):
            raise InputError(
                f"load.watched: {self.watched}; it must lie within "
                f"[0, {self.width}] x [0, {self.height}] µm"
            )
        if (np.diff([t for t, _ in self.amplitude]) <= 0.0).any():
            raise InputError(f"load.amplitude: {self.amplitude}; times must increase")

    def output_times(self) -> NDArray[np.float64]:
        """(m,) times in µs at which results are kept, as of the function of this name."""
        return output_times(self.duration, self.output_interval)


def output_times(duration: float, interval: float) -> NDArray[np.float64]:
    """(m,) times in µs at which results are kept: multiples of the interval, and the end."""
    count = int(np.floor(duration / interval * (1.0 + 1e-12)))
    times: NDArray[np.float64] = interval * np.arange(count + 1.0)
    return times if np.isclose(times[-1], duration) else np.append(times, duration)
