"""What a mechanical test measures: the force of a support, load or body over its displacement."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from surrofe2.base.arrays import Array
from surrofe2.base.units import number

STRESS_NAME = "nominal stress"
STRAIN_NAME = "nominal strain"
"""Beginnings of columns: force over unloaded section and thickness in MPa, and displacement over
the unloaded length of the tissue in its direction."""
_SEEN = 0.02
"""Of the larger component: from there on a displacement counts."""
_TOUCHES = 1e-6
"""Of the largest force: from there on a body touches."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Response:
    """A component of a force on the tissue over that of the displacement where it acts.

    Attributes:
        name: of the support, load or body; axis: "x" or "y".
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
        """(m,) nominal stress, MPa; None without one thickness, or on a single node."""
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
        """(m,) nominal strain."""
        return self.displacement / self.length

    @property
    def work(self) -> float:
        """∫ F du on the tissue, by the trapezoidal rule, pJ."""
        return float(np.trapezoid(self.force, self.displacement))

    @property
    def slope(self) -> float | None:
        """dF/du where the force begins, by the parabola through its first three points, µN/µm; None
        where there are not so many."""
        some = np.flatnonzero(abs(self.force) > _TOUCHES * abs(self.force).max(initial=0.0))
        if not some.size:
            return None
        first = max(0, some[0] - 1)  # the last point without force
        u = self.displacement[first:] - self.displacement[first]
        force = self.force[first:]
        _, places = np.unique(np.round(u / abs(u).max(initial=1e-300), 9), return_index=True)
        places = np.sort(places)[:3]
        if len(places) < 3:
            return None
        u = u[places]
        force = force[places]
        near, far = ((force[k] - force[0]) / u[k] for k in (1, 2))
        return float(near + (near - far) * u[1] / (u[2] - u[1]))

    @property
    def sentence(self) -> str:
        """Peak, slope at the start and work, with the nominal ones where they are known."""
        k = int(abs(self.force).argmax())
        peak = f"peak {number(self.force[k])} µN"
        if self.stress is not None:
            peak += f" ({number(self.stress[k])} MPa)"
        at = f"at {number(self.displacement[k])} µm"
        if self.section is not None:
            at += f" ({100.0 * self.strain[k]:.3g} %)"
        text = f"{self.name} {self.axis}: {peak} {at}"
        if self.slope is not None:
            text += f", slope at the start {number(self.slope)} µN/µm"
            if self.area is not None:
                modulus = self.slope * self.length / self.area
                text += f" ({number(modulus)} MPa)"
        return f"{text}, work {number(self.work)} pJ"


def responses(
    history: Mapping[str, Array], places: Mapping[str, Mapping[str, Any]]
) -> Iterator[Response]:
    """The responses of a run or rest, for each component that moves and has a force.

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
            is_seen = largest[axis] > _SEEN * max(largest.values())
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
    """Columns of nominal stress (MPa) and strain of `responses`, by name."""
    columns: dict[str, Array] = {}
    for each in responses(history, places):
        if each.stress is not None:
            columns[f"{STRESS_NAME} {each.name} {each.axis}"] = each.stress
            columns[f"{STRAIN_NAME} {each.name} {each.axis}"] = each.strain
    return columns
