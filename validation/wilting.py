"""Wilting of potato against published tests, and one pressurised cell alone and between plates.

docs/validation/potato.md has the figures. What was published:

* Niklas 1988, Am. J. Bot. 75, 1286: Young's modulus of potato parenchyma in tension grows from 1.2
  to 19 MPa as its water potential goes from −1.4 to −0.4 MPa.
* Bland and Tanner 1985, Plant Physiol. 79, 891: the osmotic pressure of potato tubers balances the
  pressure chamber at −0.7 MPa: without turgor.
* Murphy and Ortega 1995, Plant Physiol. 107, 995: volumetric modulus of cells in pea stems,
  ε = 10 MPa (1 − exp(−7 (P − 0.01))) with the turgor P in MPa.

One cell in the section is a ring of wall: with pressure p and radius r its tension is T = p r
(Young and Laplace). Between plates at a distance h it has two flat sides of length w and two
half circles::

    p h/2 = E d (S/S₀ − 1)       S = 2 w + π h       A = w h + π h²/4       force = p w

by the thickness of the layer, with the length S₀ of the slack wall and p A constant where water
leaves the cell slowly, A constant where it cannot.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from surrofe2.plant_cell.parameters import CellParameters, LivingTissue
from surrofe2.questions.moduli import young
from surrofe2.questions.wilting import Wilting, wilt
from surrofe2.report.study import Study
from surrofe2.report.tables import Quantity, Table
from surrofe2.run.charts import Curve, Panel
from validation.case import Setting

Array = NDArray[np.float64]

NIKLAS = np.array([[-1.4, 1.2], [-0.4, 19.0]])
"""Ends of the range: water potential and Young's modulus, MPa."""
WITHOUT_TURGOR = -0.7
"""Water potential of potato tubers without turgor, MPa."""
ARRANGEMENTS: Mapping[str, dict[str, Any]] = {
    "squares, along walls": {"arrangement": "square"},
    "hexagons": {"arrangement": "hexagon"},
    "9 Voronoi cells, seed 1": {"arrangement": "voronoi", "cells": 9, "arrangement_seed": 1},
    "9 Voronoi cells, seed 2": {"arrangement": "voronoi", "cells": 9, "arrangement_seed": 2},
    "9 Voronoi cells, seed 3": {"arrangement": "voronoi", "cells": 9, "arrangement_seed": 3},
}
TURGORS = (0.5, 0.4, 0.3, 0.2, 0.1)
"""MPa, of the table's rows."""
STIFFER = 4.0
"""Times as stiff walls, of which a hexagon is no stiffer."""
_DIRECTIONS = (0.0, 45.0, 90.0, 135.0)
_POINTS = 16


def pea(turgor: Array) -> Array:
    """Volumetric modulus of cells of pea stems, MPa, by Murphy and Ortega."""
    return np.asarray(10.0 * (1.0 - np.exp(-7.0 * (turgor - 0.01))))


def mean_young(states: Wilting) -> Array:
    """(n,) Young's modulus, MPa: mean over directions."""
    values = [[young(C, degrees) for degrees in _DIRECTIONS] for C in states.elastic]
    return np.array(values).mean(axis=1)


def volumetric(states: Wilting) -> Array:
    """(n,) dT/d ln A along wilting, MPa: what a pressure probe calls ε."""
    return np.asarray(np.gradient(states.turgor, 2.0 * np.log(states.size)))


def wilting(setting: Setting) -> Study:
    """Young's modulus and volumetric modulus along wilting, by arrangement."""
    cell = setting.of.cell
    moduli, probes, rows = [], [], []
    for name, arrangement in ARRANGEMENTS.items():
        for stiffer in (1.0, STIFFER) if name == "hexagons" else (1.0,):
            changed = replace(
                cell, **arrangement, fluid="uniform", wall_stiffness=stiffer * cell.wall_stiffness
            )
            states = wilt(changed, _POINTS)
            label = name if stiffer == 1.0 else f"{name}, walls {stiffer:g} times as stiff"
            is_square = arrangement["arrangement"] == "square"
            E = np.array([young(C, 0.0) for C in states.elastic])
            E = E if is_square else mean_young(states)
            moduli.append(Curve(label, -states.bath, E, markers=False))
            probes.append(Curve(label, states.turgor, volumetric(states), markers=False))
            rows += _rows(label, states, E)
    x, y = NIKLAS.T
    moduli.append(Curve("reference", x, y, "Niklas 1988: ends of the range"))
    T = np.linspace(0.01, 0.5, 50)
    probes.append(Curve("reference", T, pea(T), "Murphy and Ortega 1995: pea", False, dash=":"))
    return Study(
        title="Potato wilts: Young's modulus, and the volumetric modulus of its cells",
        panels=(
            Panel("water potential (MPa)", "Young's modulus (MPa)", tuple(moduli)),
            Panel("turgor (MPa)", "volumetric modulus ε (MPa)", tuple(probes)),
        ),
        columns=2,
        table=Table(COLUMNS, rows),
    )


def _rows(name: str, states: Wilting, E: Array) -> list[dict[str, Any]]:
    """Values at the turgors of the table, between states."""
    order = np.argsort(states.turgor)
    T = states.turgor[order]

    def at(values: Array, turgor: float) -> float:
        return float(np.interp(turgor, T, values[order]))

    wanted = [T[-1], *(turgor for turgor in TURGORS if T[0] < turgor < T[-1] - 1e-6)]
    return [
        {
            "plant cells": name,
            "turgor": turgor,
            "water potential": 0.0 - round(at(states.bath, turgor), 9),
            "Young's modulus": at(E, turgor),
            "ε": at(volumetric(states), turgor),
        }
        for turgor in wanted
    ]


COLUMNS: tuple[Quantity[Any], ...] = (
    Quantity("plant cells", "", ""),
    Quantity("turgor", "MPa", ".2f"),
    Quantity("water potential", "MPa", ".3f"),
    Quantity("Young's modulus", "MPa", ".3g"),
    Quantity("ε", "MPa", ".3g"),
)


def radius_of(tissue: LivingTissue) -> float:
    """Radius of a round cell of the area of the tissue's, µm."""
    return tissue.cell_size / float(np.sqrt(np.pi))


def laplace_tension(tissue: LivingTissue) -> float:
    """Tension of the wall of one round cell, N/m in the section: p r."""
    return tissue.turgor * radius_of(tissue)


def between_plates(
    tissue: LivingTissue, compressions: Array, *, drained: bool
) -> tuple[Array, Array]:
    """Force by the thickness of the layer, N/m, and pressure, MPa, of a cell between plates.

    Args:
        compressions: (n,) parts of the diameter by which the plates come nearer than it.
        drained: whether water leaves the cell until its sap has the pressure of its solutes.
    """
    radius, stiffness = radius_of(tissue), tissue.wall_modulus * tissue.wall_thickness
    slack = 2.0 * np.pi * radius / (1.0 + laplace_tension(tissue) / stiffness)
    area = np.pi * radius**2

    def state(h: float, w: float) -> tuple[float, float]:
        """Pressure, and tension beyond that of the half circles."""
        A, S = w * h + np.pi * h**2 / 4.0, 2.0 * w + np.pi * h
        tension = stiffness * (S / slack - 1.0)
        p = tissue.turgor * area / A if drained else 2.0 * tension / h
        return p, tension - p * h / 2.0

    forces, pressures = [], []
    for h in 2.0 * radius * (1.0 - np.asarray(compressions)):
        if drained:
            w = float(scipy.optimize.brentq(lambda w, h=h: state(h, w)[1], 0.0, 4.0 * radius))
        else:
            w = (area - np.pi * h**2 / 4.0) / h
        p, _ = state(h, w)
        forces.append(p * w)
        pressures.append(p)
    return np.array(forces), np.array(pressures)


def ring_between_plates(
    tissue: LivingTissue, compression: float, springs: int = 40
) -> tuple[float, float]:
    """The drained force by the thickness and pressure as of `between_plates`, by the springs and
    the uniform fluid of the package: the least energy of a ring of wall between plates."""
    cell: CellParameters = tissue.parameters()
    t = cell.tissue_thickness
    length = 2.0 * np.pi * radius_of(tissue)
    osmotic = tissue.turgor * t * np.pi * radius_of(tissue) ** 2
    # tension over strain of one wall of the two between cells, µN
    modulus = 0.5 * cell.wall_stiffness * cell.spring_length
    slack = length / springs / (1.0 + laplace_tension(tissue) * t / modulus)
    stiffness = modulus / slack
    angle = 2.0 * np.pi * (np.arange(springs) + 0.5) / springs
    circle = radius_of(tissue) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    half = radius_of(tissue) * (1.0 - compression)

    def energy(flat: Array) -> tuple[float, Array]:
        x = flat.reshape(-1, 2)
        way = np.roll(x, -1, axis=0) - x
        long = np.linalg.norm(way, axis=1)
        chord = 0.5 * (np.roll(x, -1, axis=0) - np.roll(x, 1, axis=0))
        area = 0.5 * float(x[:, 0] @ np.roll(x[:, 1], -1) - x[:, 1] @ np.roll(x[:, 0], -1))
        pull = stiffness * (long - slack)
        along = (pull / long)[:, None] * way
        gradient = np.roll(along, 1, axis=0) - along
        gradient -= osmotic / area * np.stack([chord[:, 1], -chord[:, 0]], axis=1)
        value = 0.5 * stiffness * float(((long - slack) ** 2).sum()) - osmotic * np.log(area)
        return value, gradient.ravel()

    start = circle * [1.0 + compression, 1.0 - compression]
    bounds = [pair for _ in range(springs) for pair in ((None, None), (-half, half))]
    options = {"maxiter": 20_000, "maxfun": 40_000, "ftol": 1e-15, "gtol": 1e-9, "maxcor": 30}
    found = scipy.optimize.minimize(
        energy, start.ravel(), jac=True, method="L-BFGS-B", bounds=bounds, options=options
    )
    x = found.x.reshape(-1, 2)
    area = 0.5 * float(x[:, 0] @ np.roll(x[:, 1], -1) - x[:, 1] @ np.roll(x[:, 0], -1))
    push = energy(found.x)[1].reshape(-1, 2)[:, 1]
    force = float(np.abs(push[x[:, 1] >= half - 1e-9]).sum())
    return force / t, osmotic / area / t
