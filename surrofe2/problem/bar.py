"""The bar of the paper's section 6.2, which section [load] of a recipe states."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from surrofe2.base.settings import check_settings, setting
from surrofe2.base.units import ACCELERATION, LENGTH, NONE, TIME
from surrofe2.problem.amplitude import ONE, Table
from surrofe2.problem.conditions import BodyForce, Condition, Fixed
from surrofe2.problem.mesh import rectangle
from surrofe2.problem.problem import Problem, sections_of


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadSettings:
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
        if self.amplitude:
            Table(points=self.amplitude)  # raises where times do not increase

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """The clamp and the load."""
        clamp = Fixed(on="left", name="clamp")
        amplitude = Table(points=self.amplitude) if self.amplitude else ONE
        load = BodyForce(name="load", acceleration=self.body_force, amplitude=amplitude)
        return clamp, load

    def sections(self, elements: tuple[int, int]) -> dict[str, dict[str, Any]]:
        """Return the sections of a recipe that state the same problem, on a mesh of `elements`."""
        sections = {"mesh": {"width": self.width, "height": self.height, "elements": elements}}
        sections |= sections_of(self.conditions, (), {"point": self.watched})
        sections["time"] = {
            "duration": self.duration,
            "output_interval": min(self.output_interval, self.duration),
        }
        return sections


def LoadCase(*, elements: tuple[int, int] = (4, 4), **load: Any) -> Problem:
    """Make the bar as a problem.

    Args:
        elements: number of elements in x and in y.
        load: fields of `LoadSettings`: width, height, body_force, amplitude, duration, watched,
            output_interval.

    Raises:
        InputError: naming the field that is out of its bounds.

    Examples:
        The paper's bar of 400 µm × 400 µm, clamped on its left side, on few elements:

        >>> from surrofe2 import LoadCase
        >>> bar = LoadCase(elements=(2, 2), duration=100.0)
        >>> [condition.name for condition in bar.conditions]
        ['clamp', 'load']
        >>> bar.watched
        {'point': (400.0, 200.0)}
    """
    bar = LoadSettings(**load)
    return Problem(
        mesh=rectangle(bar.width, bar.height, elements),
        conditions=bar.conditions,
        duration=bar.duration,
        output_interval=bar.output_interval,
        watched={"point": bar.watched},
    )
