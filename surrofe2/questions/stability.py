"""The map of deformations at which a plant cell has a stable equilibrium.

On the reference branch, followed from F = I along a straight line, the elastic Hessian is
positive definite up to the onset of a bifurcation. Beyond, the RVE leaves the branch for another
stable state where there is one (`surrofe2.rve.continuation`); its stress is then one of several.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from surrofe2.base.arrays import Array, Index
from surrofe2.base.sampling import SamplingRange, contains
from surrofe2.law.stress_law import Status
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.study import Study
from surrofe2.report.tables import Quantity, Table
from surrofe2.run.charts import Curve, Panel
from surrofe2.rve import RveLaw
from surrofe2.rve.continuation import seek

CATEGORIES = (
    "stable",
    "stable after leaving a bifurcation",
    "no stable state found",
    "solve failed",
)
STABLE, LEFT, UNSTABLE, FAILED = range(4)

# Range of the map; F_xy < 0 mirrors F_xy > 0.
STRETCH = (0.75, 1.5)
SHEAR = (0.0, 0.6)

# Direction (F_xx, F_yy, F_xy) and how far it is followed.
WAYS: Mapping[str, tuple[tuple[float, float, float], float]] = {
    "uniaxial compression": ((-1.0, 0.0, 0.0), 0.3),
    "equibiaxial compression": ((-1.0, -1.0, 0.0), 0.3),
    "uniaxial stretch": ((1.0, 0.0, 0.0), 0.5),
    "equibiaxial stretch": ((1.0, 1.0, 0.0), 0.5),
    "simple shear": ((0.0, 0.0, 1.0), 0.6),
}

_BATCH = 128  # RVEs that are solved together
# `find_onset`: the step along a way, and how closely its end is found.
_MARCH = 2.5e-3
_CLOSE = 1e-5

# The planes of the map: title, label, index and span of the entry of F that varies with F_xx.
PLANES: Mapping[str, tuple[str, str, tuple[int, int], tuple[float, float]]] = {
    "stretch": ("no shear", "stretch $F_{yy}$", (1, 1), STRETCH),
    "shear": ("$F_{yy}$ = 1", "shear $F_{xy}$", (0, 1), SHEAR),
}

# Dashes of the outlines of ranges, in turn.
_DASHES = ("-", "--", ":")

COLUMNS: tuple[Quantity[Any], ...] = (
    Quantity("way", "", ""),
    Quantity("stable up to", "largest entry of F − I", ".4f"),
    Quantity("loses stability", "", lambda lost: "yes" if lost else "no"),
)


def stability(
    cell: CellParameters,
    points: int = 41,
    *,
    ranges: Mapping[str, SamplingRange] = MappingProxyType({}),
    progress: Callable[[float], None] = lambda _: None,
) -> Study:
    """Classify RVEs on points × points deformations of two planes, and find the onset along each
    way.

    Args:
        ranges: ranges of surrogates, by name, which the map outlines.
    """
    planes = {}
    counts = {}
    done = 0
    for name, (_, _, index, span) in PLANES.items():
        F = np.tile(np.eye(2), (points, points, 1, 1))
        F[:, :, 0, 0] = np.linspace(*STRETCH, points)[:, None]
        F[:, :, *index] = np.linspace(*span, points)
        F = F.reshape(-1, 2, 2)
        parts = []
        for first in range(0, len(F), _BATCH):
            parts.append(categories(cell, F[first : first + _BATCH]))
            done += len(parts[-1])
            progress(done / (len(PLANES) * len(F)))
        chosen = np.concatenate(parts) == np.arange(len(CATEGORIES))[:, None]
        counts[name] = dict(zip(CATEGORIES, chosen.sum(axis=1).tolist(), strict=True))
        planes[name] = [
            Curve(category, F[is_of_it, 0, 0], F[is_of_it][:, *index])
            for category, is_of_it in zip(CATEGORIES, chosen, strict=True)
        ]
    # a category that is met in one plane is named for both, so that they have one legend
    met = {curve.name for curves in planes.values() for curve in curves if curve.x.size}
    panels = []
    for name, (title, y_label, _, _) in PLANES.items():
        curves = [curve for curve in planes[name] if curve.name in met]
        at_rest = np.array([PLANES[name][3][0] if name == "shear" else 1.0])
        curves.append(Curve("point", np.ones(1), at_rest, "F = I"))
        for k, (label, range_) in enumerate(ranges.items()):
            x, y = outline(range_, name)
            curves.append(
                Curve("outline", x, y, f"[range] of {label}", False, dash=_DASHES[k % len(_DASHES)])
            )
        panels.append(Panel("stretch $F_{xx}$", y_label, tuple(curves), title))
    rows = []
    for way, (direction, length) in WAYS.items():
        onset = find_onset(cell, direction, length)
        up_to = length if onset is None else onset
        loses = onset is not None
        rows.append({"way": way, "stable up to": up_to, "loses stability": loses})
    return Study(
        title="Stable equilibria of the plant cell at rest",
        panels=tuple(panels),
        columns=2,
        table=Table(COLUMNS, rows),
        results={"counts": counts},
    )


def outline(range_: SamplingRange, plane: str) -> tuple[Array, Array]:
    """Return the line (k,) in a plane of the map about the deformations within a range."""
    low, high = range_.stretch
    if plane == "stretch":
        return np.array([low, high, high, low, low]), np.array([low, low, high, high, low])
    stretch = np.linspace(low, high, 101)
    shear = np.linspace(*SHEAR, 1201)
    F = np.tile(np.eye(2), (stretch.size * shear.size, 1, 1))
    F[:, 0, 0] = np.repeat(stretch, shear.size)
    F[:, 0, 1] = np.tile(shear, stretch.size)
    is_within = contains(range_, F, np.zeros_like(F)).reshape(stretch.size, shear.size)
    # stretches at which some shear is within it, and the largest
    is_any = is_within.any(axis=1)
    largest = shear[len(shear) - 1 - is_within[:, ::-1].argmax(axis=1)]
    x = stretch[is_any]
    return np.r_[x[0], x, x[-1]], np.r_[0.0, largest[is_any], 0.0]


def categories(cell: CellParameters, F: Array) -> Index:
    """Return the index into `CATEGORIES` (m,) of the elastic equilibrium at each F (m, 2, 2)."""
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
    """Find how far F = I + s (direction) may go before the reference branch loses stability.

    It is followed in steps of 0.0025 and then bisected to 1e-5.

    Returns:
        s; None where it is stable up to `length`.
    """
    law = RveLaw(cell, initialisation="elastic")
    unit = law.unit_cell
    xx, yy, xy = direction
    way = np.array([[xx, xy], [0.0, yy]])
    z = unit.position.T[None].copy()
    s = 0.0
    step = _MARCH
    while s < length:
        F = (np.eye(2) + (s + step) * way)[None]
        trial = seek(unit, F, z, law.settings.tolerance)
        if trial.stable[0]:
            z = trial.z
            s = s + step
        elif step < _CLOSE:
            return s
        else:
            step *= 0.5  # and stays so: the onset is within the step that failed
    return None
