"""The memory of an RVE: its stress after two pasts that end in the same (F, Ḟ).

A cache on (F, Ḟ) presumes that the stress follows from (F, Ḟ). Two RVEs, integrated in time,
meet at t = 0 with the same F and Ḟ and move alike from there on. The difference of their stresses
is what does not follow from (F, Ḟ), and how it fades is the memory.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from surrofe2.base.arrays import Array
from surrofe2.base.errors import InputError
from surrofe2.base.units import number
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.study import Study
from surrofe2.report.tables import Quantity, Table, percent
from surrofe2.run.charts import Curve, Panel
from surrofe2.rve import RveLaw
from surrofe2.rve.micro_integration import integrate_rve

# A function that returns (F, Ḟ) at a time in µs.
Path = Callable[[float], tuple[Array, Array]]

# Period of the bar's second mode, µs.
PERIOD = 17.0
# Amplitudes of F₁₁ and F₁₂ by which the second past departs.
STRETCH = 0.02
SHEAR = 0.03
# Ḟ₁₂ where both pasts meet, 1/µs.
RATE = 0.005
# How long the stresses are watched, and the step of the integration, µs.
AFTER = 10.0
MICRO_STEP = 1e-3
# Fraction of the largest stress that may depend on the past.
TOLERANCE = 0.01
# Differences below this fraction of the stress are the integrator's.
_NOISE = 1e-9
# Fraction of the fastest period within which a memory must fade to 1/e.
_SHORT = 0.1


def steady_shear(rate: float, start: float = 0.0) -> Path:
    """Make the path F of eq. (73) with F_xy = start + rate t, and Ḟ of eq. (74), rate in 1/µs."""
    F_dot = np.array([[0.0, rate], [0.0, 0.0]])
    return lambda t: (np.array([[1.0, start + rate * t], [0.0, 1.0]]), F_dot)


def returning(path: Path, period: float) -> Path:
    """Make a path with an excursion D sin²(πt/T) before t = 0; F and Ḟ meet there, F̈ does not."""
    omega = 2.0 * np.pi / period
    away = 0.5 * np.array([[STRETCH, SHEAR], [0.0, 0.0]])

    def excursion(t: float) -> tuple[Array, Array]:
        """Return F and Ḟ with those of the excursion."""
        F, F_dot = path(t)
        angle = omega * min(t, 0.0)
        return F + (1.0 - np.cos(angle)) * away, F_dot + omega * np.sin(angle) * away

    return excursion


@dataclass(frozen=True, slots=True)
class Memory:
    """The difference of the stresses after two pasts.

    Attributes:
        period: of the fastest motion expected, µs.
        t: (m,) µs from where the pasts meet.
        difference: (m,) Frobenius norm of the difference of the stresses, µN/µm.
        scale: largest norm of the stress, µN/µm.
        tolerance: fraction of it that may depend on the past.
    """

    period: float
    t: Array
    difference: Array
    scale: float
    tolerance: float = TOLERANCE

    @property
    def largest(self) -> float:
        """Largest difference, µN/µm."""
        return float(self.difference.max())

    def fading_time(self, part: float = float(np.exp(-1.0))) -> float | None:
        """Return the time, µs, from which the difference stays below a fraction of its largest.

        None: never, as far as it was watched.
        """
        above = np.flatnonzero(self.difference > part * self.largest)
        last = int(above[-1]) + 1 if above.size else 0
        return float(self.t[last]) if last < len(self.t) else None

    @property
    def sound(self) -> bool:
        """True if the difference is small and fades fast against the period."""
        fading = self.fading_time()
        forgotten = self.largest <= _NOISE * self.scale
        short = forgotten or (fading is not None and fading <= _SHORT * self.period)
        return self.largest <= self.tolerance * self.scale and short

    @property
    def verdict(self) -> str:
        """The verdict in words: whether a cache on (F, Ḟ) is sound."""
        fading = self.fading_time()
        period = f"{self.period:g} µs"
        fades = f"not faded after {self.t[-1]:g} µs"
        if fading is not None:
            fades = f"fading in {number(fading, 2)} µs"
        part = f"up to {percent(2)(self.largest / self.scale)} of the stress, {fades}"
        if self.sound:
            return f"Motions as fast as {period} can be cached: the past makes {part}"
        text = f"At motions as fast as {period} the stress depends on history ({part})"
        if fading is None or self.largest > self.tolerance * self.scale:
            return f"{text}: do not cache them"
        return f"{text}; motions from {number(fading / _SHORT, 2)} µs on can be cached"


def memory(
    cell: CellParameters,
    period: float = PERIOD,
    *,
    after: float = AFTER,
    micro_step: float = MICRO_STEP,
    progress: Callable[[float], None] = lambda done: None,
) -> Memory:
    """Integrate both pasts, one and a half periods before they meet, and watch them after.

    Args:
        period: of the fastest motion expected, µs.
        after: µs for which the stresses are watched.
        micro_step: step of the integration, µs.
        progress: called with the fraction that is done.
    """
    if not 0.0 < period < np.inf:
        raise InputError(f"--period: {period}; it must be positive and finite (µs)")
    law = RveLaw(cell)
    t = np.linspace(0.0, after, 201)
    steady = steady_shear(RATE)
    times = np.concatenate([[-1.5 * period], t])
    pasts = (steady, returning(steady, period))
    stresses = []
    for past in pasts:
        stresses.append(integrate_rve(law, past, times, micro_step)[1:])
        progress(len(stresses) / len(pasts))
    apart = np.linalg.norm(stresses[1] - stresses[0], axis=(1, 2))
    return Memory(period, t, apart, float(np.linalg.norm(stresses[0], axis=(1, 2)).max()))


QUANTITIES: tuple[Quantity[Memory], ...] = (
    Quantity("a cache is", "", "", lambda result: "sound" if result.sound else "not sound"),
    Quantity("largest difference", "µN/µm", ".3g", lambda result: result.largest),
    Quantity("largest stress", "µN/µm", ".3g", lambda result: result.scale),
    Quantity("fading time", "µs", ".3g", lambda result: result.fading_time()),
    Quantity("time to hundredth", "µs", ".3g", lambda result: result.fading_time(0.01)),
    Quantity("verdict", "", None, lambda result: result.verdict),
)


def memory_study(
    cell: CellParameters,
    period: float = PERIOD,
    *,
    progress: Callable[[float], None] = lambda done: None,
) -> Study:
    """Compute the fading difference of the stresses; see `memory`."""
    result = memory(cell, period, progress=progress)
    labels = "time since both pasts met (µs)", "difference of the stresses (µN/µm)"
    curve = Curve("difference", result.t, result.difference, markers=False)
    return Study(
        title="Two pasts that end in the same (F, Ḟ): difference of the stresses",
        panels=(Panel(*labels, (curve,), log_y=True),),
        table=Table(QUANTITIES, (result,)),
    )
