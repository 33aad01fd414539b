"""The responses of a mechanical test: force of a support, load or body over displacement."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from surrofe2.base.arrays import Array, Index
from surrofe2.base.units import number

# Beginnings of columns: force over unloaded section and thickness in MPa, and displacement over
# the unloaded length of the tissue in its direction.
STRESS_NAME = "nominal stress"
STRAIN_NAME = "nominal strain"
# A displacement along x or y smaller than this fraction of the other one is no response: it comes
# from lateral contraction or numerical noise.
_LEAST_COMPONENT = 0.02
# A body touches from this fraction of the largest force on; before, forces are rounding errors.
_LEAST_FORCE = 1e-6
# Displacements that agree to so many digits of the largest one are the same point of the curve: a
# support that rests for a while gives many of them, and no slope can be drawn through two.
_DIGITS = 9


@dataclass(frozen=True, slots=True, kw_only=True)
class Response:
    """A component of a force on the tissue over that of the displacement where it acts.

    Attributes:
        name: of the support, load or body.
        axis: "x" or "y".
        displacement: (m,) of the body, or the mean of the boundary, µm.
        force: (m,) on the tissue, µN.
        section: unloaded length of the boundary, µm; None on a single node, which has no stress.
        length: of the tissue along the axis, µm.
        thickness: of the tissue, µm; None where its cells have several.
    """

    name: str
    axis: str
    displacement: Array
    force: Array
    section: float | None
    length: float
    thickness: float | None

    @property
    def stress(self) -> Array | None:
        """Nominal stress, (m,), MPa; None without one thickness, or on a single node."""
        area = self.area
        return None if area is None else self.force / area

    @property
    def area(self) -> float | None:
        """Unloaded section times thickness, µm²; None without one of them."""
        if self.section is None or self.thickness is None:
            return None
        return self.section * self.thickness

    @property
    def strain(self) -> Array:
        """Nominal strain, (m,)."""
        return self.displacement / self.length

    @property
    def work(self) -> float:
        """∫ F du on the tissue, by the trapezoidal rule, pJ."""
        return float(np.trapezoid(self.force, self.displacement))

    @property
    def slope(self) -> float | None:
        """dF/du where the force begins, µN/µm; None without three points of different displacement.

        It is the slope at the first point of the parabola through the first three.
        """
        largest = abs(self.force).max(initial=0.0)
        with_force = np.flatnonzero(abs(self.force) > _LEAST_FORCE * largest)
        if not with_force.size:
            return None
        first = max(0, with_force[0] - 1)  # the last point without force
        u = self.displacement[first:] - self.displacement[first]
        force = self.force[first:] - self.force[first]
        places = _first_distinct(u, 3)
        if len(places) < 3:
            return None
        _, u_1, u_2 = u[places]
        _, force_1, force_2 = force[places]
        secant_1 = force_1 / u_1
        secant_2 = force_2 / u_2
        return float(secant_1 + (secant_1 - secant_2) * u_1 / (u_2 - u_1))

    @property
    def modulus(self) -> float | None:
        """Nominal modulus where the force begins, MPa; None where slope or area is not known."""
        if self.slope is None or self.area is None:
            return None
        return self.slope * self.length / self.area

    @property
    def sentence(self) -> str:
        """Peak, slope at the start and work in words, with nominal values where they are known."""
        k = int(abs(self.force).argmax())
        peak = f"peak {number(self.force[k])} µN"
        if self.stress is not None:
            peak += f" ({number(self.stress[k])} MPa)"
        where = f"at {number(self.displacement[k])} µm"
        if self.section is not None:
            where += f" ({100.0 * self.strain[k]:.3g} %)"
        text = f"{self.name} {self.axis}: {peak} {where}"
        if self.slope is not None:
            text += f", slope at the start {number(self.slope)} µN/µm"
            if self.modulus is not None:
                text += f" ({number(self.modulus)} MPa)"
        return f"{text}, work {number(self.work)} pJ"


def _first_distinct(u: Array, count: int) -> Index:
    """Return the numbers of the first points, at most `count`, whose displacements differ."""
    largest = abs(u).max(initial=0.0) or 1.0  # of no displacement at all any scale will do
    _, places = np.unique(np.round(u / largest, _DIGITS), return_index=True)
    return np.sort(places)[:count]


def responses(
    history: Mapping[str, Array], places: Mapping[str, Mapping[str, Any]]
) -> Iterator[Response]:
    """Iterate over the responses of a run or rest: each component that moves and has a force.

    Args:
        history: columns by name, as `journal.history_of` gives them.
        places: by name of a support, load or body, as the record of a problem has them: the
            `displacement` column without its axis, `section`, which is None of a single node,
            `length` along x and y, `thickness`.
    """
    for name, place in places.items():
        columns = {axis: f"{place['displacement']} {axis}" for axis in "xy"}
        forces = {axis: f"force {name} {axis}" for axis in "xy"}
        if not {*columns.values(), *forces.values()} <= {*history}:
            continue
        largest = {axis: abs(history[columns[axis]]).max(initial=0.0) for axis in "xy"}
        for axis, length in zip("xy", place["length"], strict=True):
            force = history[forces[axis]]
            is_seen = largest[axis] > _LEAST_COMPONENT * max(largest.values())
            # a boundary without length has no nominal stress; a single node (None) has a force
            has_section = place["section"] is None or place["section"] > 0.0
            if not (is_seen and force.any() and has_section):
                continue
            yield Response(
                name=name,
                axis=axis,
                displacement=history[columns[axis]],
                force=force,
                section=place["section"],
                length=length,
                thickness=place["thickness"],
            )


def nominal(
    history: Mapping[str, Array], places: Mapping[str, Mapping[str, Any]]
) -> dict[str, Array]:
    """Return columns of nominal stress (MPa) and strain of `responses`, by name."""
    columns: dict[str, Array] = {}
    for response in responses(history, places):
        if response.stress is not None:
            columns[f"{STRESS_NAME} {response.name} {response.axis}"] = response.stress
            columns[f"{STRAIN_NAME} {response.name} {response.axis}"] = response.strain
    return columns
