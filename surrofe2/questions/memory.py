"""How long an RVE remembers: two pasts that end in the same (F, Ḟ), then one common way.

A cache on (F, Ḟ) presumes that the stress follows from (F, Ḟ). Two RVEs, integrated in time,
meet at t = 0 with the same F and Ḟ and move alike from there on. The difference of their stresses
is what does not follow from (F, Ḟ), and how it fades is the memory.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.settings import check_settings, setting
from surrofe2.base.units import RATE, TIME, number
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.study import Study
from surrofe2.report.tables import Quantity, Table, percent
from surrofe2.run.charts import Curve, Panel
from surrofe2.rve import RveLaw
from surrofe2.rve.micro_integration import integrate_rve

Array = NDArray[np.float64]
Path = Callable[[float], tuple[Array, Array]]
"""(F, Ḟ) at a time in µs."""

_NOISE = 1e-9
"""Differences below this part of the stress are the integrator's."""
_SHORT = 0.1
"""Part of the fastest period within which a memory must fade to 1/e."""


def steady_shear(rate: float, start: float = 0.0) -> Path:
    """F of eq. (73) with F_xy = start + rate t, and Ḟ of eq. (74), rate in 1/µs."""
    F_dot = np.array([[0.0, rate], [0.0, 0.0]])
    return lambda t: (np.array([[1.0, start + rate * t], [0.0, 1.0]]), F_dot)


def returning(path: Path, stretch: float, shear: float, period: float) -> Path:
    """A path, but for an excursion D sin²(πt/T) before t = 0: F and Ḟ meet there, F̈ does not."""
    omega, away = 2.0 * np.pi / period, 0.5 * np.array([[stretch, shear], [0.0, 0.0]])

    def excursion(t: float) -> tuple[Array, Array]:
        F, F_dot = path(t)
        angle = omega * min(t, 0.0)
        return F + (1.0 - np.cos(angle)) * away, F_dot + omega * np.sin(angle) * away

    return excursion


@dataclass(frozen=True, slots=True)
class MemorySettings:
    """The two pasts, of which the second departs from the first by a stretch and a shear."""

    period: float = setting(
        17.0, "of the fastest motion expected; the bar's second mode has 17", TIME, above=0.0
    )
    stretch: float = setting(0.02, "amplitude of F₁₁")
    shear: float = setting(0.03, "amplitude of F₁₂")
    rate: float = setting(0.005, "Ḟ₁₂ where they meet", RATE)
    tolerance: float = setting(
        0.01, "part of the largest stress that may depend on the past", above=0.0
    )
    after: float = setting(10.0, "how long the stresses are watched", TIME, above=0.0)
    micro_step: float = setting(1e-3, unit=TIME, above=0.0)

    def __post_init__(self) -> None:
        check_settings(self, "memory")


@dataclass(frozen=True, slots=True)
class Memory:
    """What the RVE remembers.

    Attributes:
        t: (m,) µs from where the pasts meet.
        steady, returning: (m, 2, 2) stress of either past, µN/µm.
    """

    settings: MemorySettings
    t: Array
    steady: Array
    returning: Array

    @property
    def difference(self) -> Array:
        """(m,) Frobenius norm of the difference of the stresses, µN/µm."""
        return np.linalg.norm(self.returning - self.steady, axis=(1, 2))

    @property
    def largest(self) -> float:
        """Largest difference, µN/µm."""
        return float(self.difference.max())

    @property
    def scale(self) -> float:
        """Largest norm of the stress, µN/µm."""
        return float(np.linalg.norm(self.steady, axis=(1, 2)).max())

    @property
    def fading_time(self) -> float | None:
        """µs after which the difference stays below 1/e of its largest value; None: never."""
        return fading_time(self.t, self.difference, np.exp(-1.0))

    @property
    def sound(self) -> bool:
        """Whether the difference is small and fades fast against the period."""
        fading, forgotten = self.fading_time, self.largest <= _NOISE * self.scale
        short = forgotten or (fading is not None and fading <= _SHORT * self.settings.period)
        return self.largest <= self.settings.tolerance * self.scale and short

    @property
    def verdict(self) -> str:
        """One sentence on whether a cache on (F, Ḟ) is sound."""
        fading, period = self.fading_time, f"{self.settings.period:g} µs"
        fades = f"not faded after {self.settings.after:g} µs"
        if fading is not None:
            fades = f"fading in {number(fading, 2)} µs"
        part = f"up to {percent(2)(self.largest / self.scale)} of the stress, {fades}"
        if self.sound:
            return f"Motions as fast as {period} can be cached: the past makes {part}"
        text = f"At motions as fast as {period} the stress depends on history ({part})"
        if fading is None or self.largest > self.settings.tolerance * self.scale:
            return f"{text}: do not cache them"
        return f"{text}; motions from {number(fading / _SHORT, 2)} µs on can be cached"


def memory(
    cell: CellParameters,
    settings: MemorySettings | None = None,
    *,
    progress: Callable[[float], None] = lambda done: None,
) -> Memory:
    """Integrate both pasts, one and a half periods before they meet, and watch them after.

    Args:
        progress: called with the fraction that is done.
    """
    s = settings or MemorySettings()
    law, t, steady = RveLaw(cell), np.linspace(0.0, s.after, 201), steady_shear(s.rate)
    times = np.concatenate([[-1.5 * s.period], t])
    pasts = steady, returning(steady, s.stretch, s.shear, s.period)
    stresses = []
    for past in pasts:
        stresses.append(integrate_rve(law, past, times, s.micro_step)[1:])
        progress(len(stresses) / len(pasts))
    return Memory(s, t, *stresses)


def fading_time(t: Array, difference: Array, part: float) -> float | None:
    """Time after which the difference stays below `part` of its largest value, or None."""
    above = np.flatnonzero(difference > part * difference.max())
    if above.size == 0:
        return 0.0
    last = int(above[-1])
    return float(t[last + 1]) if last + 1 < len(t) else None


QUANTITIES: tuple[Quantity[Memory], ...] = (
    Quantity("a cache is", "", "", lambda found: "sound" if found.sound else "not sound"),
    Quantity("largest difference", "µN/µm", ".3g", lambda found: found.largest),
    Quantity("largest stress", "µN/µm", ".3g", lambda found: found.scale),
    Quantity("fading time", "µs", ".3g", lambda found: found.fading_time),
    Quantity(
        "time to hundredth", "µs", ".3g", lambda found: fading_time(found.t, found.difference, 0.01)
    ),
    Quantity("verdict", "", None, lambda found: found.verdict),
)


def describe(found: Memory) -> Study:
    """The fading difference of the stresses."""
    labels = "time since both pasts met (µs)", "difference of the stresses (µN/µm)"
    curve = Curve("difference", found.t, found.difference, markers=False)
    return Study(
        title="Two pasts that end in the same (F, Ḟ): difference of the stresses",
        panels=(Panel(*labels, (curve,), log_y=True),),
        table=Table(QUANTITIES, (found,)),
    )
