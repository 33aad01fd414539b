"""Where a plant cell has a stable equilibrium: the map that bounds what may be sampled.

On the reference branch, followed from F = I along a straight line, the elastic Hessian is
positive definite up to the onset of a bifurcation. Beyond, the RVE leaves the branch for another
stable state where there is one (`surrofe2.rve.continuation`); its stress is then one of several.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.law.stress_law import Status
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.study import Study
from surrofe2.report.tables import Quantity, Table
from surrofe2.run.charts import Curve, Panel
from surrofe2.rve import RveLaw
from surrofe2.rve.continuation import Continuation

Array = NDArray[np.float64]

CATEGORIES = (
    "stable",
    "stable after leaving a bifurcation",
    "no stable state found",
    "solve failed",
)
STABLE, LEFT, UNSTABLE, FAILED = range(4)

STRETCH, SHEAR = (0.75, 1.5), (0.0, 0.6)
"""Range of the map; F_xy < 0 mirrors F_xy > 0."""

WAYS: Mapping[str, tuple[tuple[float, float, float], float]] = {
    "uniaxial compression": ((-1.0, 0.0, 0.0), 0.3),
    "equibiaxial compression": ((-1.0, -1.0, 0.0), 0.3),
    "uniaxial stretch": ((1.0, 0.0, 0.0), 0.5),
    "equibiaxial stretch": ((1.0, 1.0, 0.0), 0.5),
    "simple shear": ((0.0, 0.0, 1.0), 0.6),
}
"""Direction (F_xx, F_yy, F_xy) and how far it is followed."""

_CHUNK, _MARCH, _CLOSE = 128, 2.5e-3, 1e-5


@dataclass(frozen=True, slots=True)
class Plane:
    """Deformations and what became of RVEs there: F (m, 2, 2) and index into `CATEGORIES` (m,).

    y_label: of the entry (0, 1) or (1, 1) of F that varies with F_xx.
    """

    title: str
    y_label: str
    y_index: tuple[int, int]
    F: Array
    category: NDArray[np.int_]


@dataclass(frozen=True, slots=True)
class StabilityMap:
    """Planes by name, and by way how far the reference branch is stable; None: all the way."""

    planes: Mapping[str, Plane]
    onset: Mapping[str, float | None]


def stability_map(
    cell: CellParameters, points: int = 41, *, progress: Callable[[float], None] = lambda _: None
) -> StabilityMap:
    """Both planes on points × points deformations each; progress is told the share done."""
    total = 2 * points**2
    planes, done = {}, 0
    for name, title, y_label, index, span in (
        ("stretch", "no shear", "stretch $F_{yy}$", (1, 1), STRETCH),
        ("shear", "$F_{yy}$ = 1", "shear $F_{xy}$", (0, 1), SHEAR),
    ):
        F = np.tile(np.eye(2), (points, points, 1, 1))
        F[:, :, 0, 0] = np.linspace(*STRETCH, points)[:, None]
        F[:, :, *index] = np.linspace(*span, points)
        F, parts = F.reshape(-1, 2, 2), []
        for first in range(0, len(F), _CHUNK):
            parts.append(categories(cell, F[first : first + _CHUNK]))
            done += len(parts[-1])
            progress(done / total)
        planes[name] = Plane(title, y_label, index, F, np.concatenate(parts))
    return StabilityMap(planes, {way: find_onset(cell, *WAYS[way]) for way in WAYS})


def categories(cell: CellParameters, F: Array) -> NDArray[np.int_]:
    """Index into `CATEGORIES` (m,) of the elastic equilibrium at each F (m, 2, 2)."""
    answer = RveLaw(cell, initialisation="elastic").respond(F, np.zeros_like(F))
    category = np.full(len(F), FAILED)
    category[answer.status == Status.OK] = STABLE
    if answer.left_bifurcation is not None:
        category[(answer.status == Status.OK) & answer.left_bifurcation] = LEFT
    category[answer.status == Status.UNSTABLE] = UNSTABLE
    return category


def find_onset(
    cell: CellParameters, direction: tuple[float, float, float], length: float
) -> float | None:
    """How far F = I + s (direction) may go before the reference branch loses stability.

    Followed in steps of 0.0025 and then bisected to 1e-5; None where it is stable up to `length`.
    """
    law = RveLaw(cell, initialisation="elastic")
    unit = law.unit_cell
    continuation = Continuation(unit, law.settings.tolerance)
    xx, yy, xy = direction
    way = np.array([[xx, xy], [0.0, yy]])
    z, s, step = unit.position.T[None].copy(), 0.0, _MARCH
    while s < length:
        trial = continuation.newton((np.eye(2) + (s + step) * way)[None], z)
        if trial.stable[0]:
            z, s = trial.z, s + step
        elif step < _CLOSE:
            return s
        else:
            step *= 0.5
    return None


COLUMNS: tuple[Quantity[Any], ...] = (
    Quantity("way", "", ""),
    Quantity("stable up to", "largest entry of F − I", ".4f"),
    Quantity("loses stability", "", lambda lost: "yes" if lost else "no"),
)


def describe(found: StabilityMap) -> Study:
    """The map: one panel for each plane; the onset along each way."""
    planes = found.planes.values()
    ends = [
        (way, WAYS[way][1] if onset is None else onset, onset is not None)
        for way, onset in found.onset.items()
    ]
    names = [column.name for column in COLUMNS]
    F = np.concatenate([plane.F for plane in planes])
    category = np.concatenate([plane.category for plane in planes])
    return Study(
        title="Stable equilibria of the plant cell at rest",
        panels=tuple(_panel(plane) for plane in planes),
        columns=2,
        table=Table(COLUMNS, [dict(zip(names, each, strict=True)) for each in ends]),
        series={
            "plane": [key for key, plane in found.planes.items() for _ in plane.F],
            "F_xx (1)": F[:, 0, 0],
            "F_yy (1)": F[:, 1, 1],
            "F_xy (1)": F[:, 0, 1],
            "equilibrium": [CATEGORIES[k] for k in category],
        },
        results={
            "counts": {
                key: {label: int((plane.category == k).sum()) for k, label in enumerate(CATEGORIES)}
                for key, plane in found.planes.items()
            }
        },
    )


def _panel(plane: Plane) -> Panel:
    curves = (
        Curve(CATEGORIES[k], plane.F[chosen, 0, 0], plane.F[chosen][:, *plane.y_index])
        for k in range(len(CATEGORIES))
        if (chosen := plane.category == k).any()
    )
    return Panel("stretch $F_{xx}$", plane.y_label, tuple(curves), plane.title)
